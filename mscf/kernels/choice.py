"""Which kernels are used: as the environment says, else the compiled ones where they are installed."""

import os
from collections.abc import Mapping
from typing import get_args

from mscf.errors import ConfigError
from mscf.kernels import Kernels, KernelsName
from mscf.kernels.numpy_kernels import NumpyKernels

VARIABLE = "MSCF_KERNELS"
NATIVE_MISSING = "there is no compiled core here: install with a C++17 compiler to have it"


def kernels_named(name: KernelsName) -> Kernels:
    """The kernels of a name.

    Raises
    ------
    ConfigError
        If the compiled ones are asked for and not there.
    """
    if name == "numpy":
        return NumpyKernels()
    try:
        from mscf.kernels.native_kernels import NativeKernels  # noqa: PLC0415 - it is not everywhere
    except ImportError as error:
        raise ConfigError(f"{VARIABLE}=native, but {NATIVE_MISSING}, or unset it ({error})") from error
    return NativeKernels()


def chosen_kernels(environ: Mapping[str, str] = os.environ) -> Kernels:
    """Kernels as the variable MSCF_KERNELS says, or the compiled ones where they are installed.

    Raises
    ------
    ConfigError
        If the variable names none, or the compiled ones where they are not installed.
    """
    asked = environ.get(VARIABLE, "")
    if asked and asked not in get_args(KernelsName):
        raise ConfigError(f"{VARIABLE}={asked} must be one of {', '.join(get_args(KernelsName))}, or unset")
    if asked:
        return kernels_named("numpy" if asked == "numpy" else "native")
    return kernels_named("native" if has_native() else "numpy")


def has_native() -> bool:
    """Whether the compiled kernels are installed."""
    try:
        kernels_named("native")
    except ConfigError:
        return False
    return True
