"""Which kernels are used: as the environment says, else the compiled ones where they are installed."""

import os
from collections.abc import Mapping
from importlib.util import find_spec
from typing import get_args

from mscf.errors import ConfigError
from mscf.kernels import Kernels, KernelsName
from mscf.kernels.numpy_kernels import NumpyKernels

VARIABLE = "MSCF_KERNELS"


def kernels_named(name: KernelsName) -> Kernels:
    """The kernels of a name.

    Raises
    ------
    ConfigError
        If the compiled ones are asked for and cannot be loaded.
    """
    if name == "numpy":
        return NumpyKernels()
    try:
        from mscf.kernels.native_kernels import NativeKernels  # noqa: PLC0415 - it is not everywhere
    except ImportError as error:
        is_there = find_spec("mscf.kernels._native") is not None
        why = f"cannot be loaded: {error}" if is_there else "is not here: install with a C++17 compiler to have it"
        raise ConfigError(f"the compiled core {why}") from error
    return NativeKernels()


def chosen_kernels(environ: Mapping[str, str] = os.environ) -> Kernels:
    """Kernels as the variable MSCF_KERNELS says, or the compiled ones where they are installed.

    Raises
    ------
    ConfigError
        If the variable names none, or the compiled ones where they cannot be loaded.
    """
    asked = environ.get(VARIABLE, "")
    if asked and asked not in get_args(KernelsName):
        raise ConfigError(f"{VARIABLE}={asked} must be one of {', '.join(get_args(KernelsName))}, or unset")
    if asked == "native":
        try:
            return kernels_named("native")
        except ConfigError as error:
            raise ConfigError(f"{VARIABLE}=native, but {error}; or unset it") from error
    return kernels_named("numpy" if asked or native_fault() else "native")


def native_fault() -> str:
    """Why the compiled kernels cannot be used; empty where they can."""
    try:
        kernels_named("native")
    except ConfigError as error:
        return str(error)
    return ""
