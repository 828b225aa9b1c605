import sys

import pytest

from mscf.errors import ConfigError
from mscf.kernels import Kernels
from mscf.kernels.choice import chosen_kernels, has_native, kernels_named

MEND = r"MSCF_KERNELS=native, but .* C\+\+17 compiler .* unset it"


@pytest.fixture
def _no_native(monkeypatch: pytest.MonkeyPatch) -> None:
    """As where nothing could be compiled."""
    monkeypatch.delitem(sys.modules, "mscf.kernels.native_kernels", raising=False)
    monkeypatch.setitem(sys.modules, "mscf.kernels._native", None)
    monkeypatch.delattr("mscf.kernels._native", raising=False)  # what a package has imported, it has as attribute


@pytest.mark.parametrize("environ", [{}, {"MSCF_KERNELS": ""}])
def test_the_compiled_kernels_are_used_where_they_are(native: Kernels, environ: dict[str, str]) -> None:
    assert has_native()
    assert chosen_kernels(environ).name == native.name == "native"


def test_what_the_environment_says_is_used(native: Kernels) -> None:
    assert chosen_kernels({"MSCF_KERNELS": "native"}).name == native.name
    assert chosen_kernels({"MSCF_KERNELS": "numpy"}).name == "numpy"


@pytest.mark.parametrize("asked", ["nonsense", "Native", " numpy", "1"])
def test_a_name_that_is_none_is_refused(asked: str) -> None:
    with pytest.raises(ConfigError, match=f"MSCF_KERNELS={asked} must be one of numpy, native, or unset"):
        chosen_kernels({"MSCF_KERNELS": asked})


@pytest.mark.usefixtures("_no_native")
@pytest.mark.parametrize("environ", [{}, {"MSCF_KERNELS": ""}, {"MSCF_KERNELS": "numpy"}])
def test_without_a_compiled_core_numpy_computes(environ: dict[str, str]) -> None:
    assert not has_native()
    assert chosen_kernels(environ).name == "numpy"


@pytest.mark.usefixtures("_no_native")
def test_who_asks_for_a_compiled_core_that_is_not_there_is_told_how_to_mend_it() -> None:
    with pytest.raises(ConfigError, match=MEND):
        kernels_named("native")
    with pytest.raises(ConfigError, match=MEND):
        chosen_kernels({"MSCF_KERNELS": "native"})


def test_kernels_are_of_the_name_they_are_asked_for_by(kernels: Kernels) -> None:
    assert kernels_named(kernels.name).name == kernels.name
