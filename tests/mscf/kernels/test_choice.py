import sys
from importlib.machinery import ModuleSpec

import pytest

from mscf.errors import ConfigError
from mscf.kernels import Kernels
from mscf.kernels.choice import chosen_kernels, kernels_named, native_fault

MEND = r"MSCF_KERNELS=native, but .* C\+\+17 compiler .* unset it"


@pytest.fixture
def _no_native(monkeypatch: pytest.MonkeyPatch) -> None:
    """As where nothing could be compiled."""
    monkeypatch.delitem(sys.modules, "mscf.kernels.native_kernels", raising=False)
    monkeypatch.setitem(sys.modules, "mscf.kernels._native", None)
    monkeypatch.delattr("mscf.kernels._native", raising=False)  # what a package has imported, it has as attribute


@pytest.mark.parametrize("environ", [{}, {"MSCF_KERNELS": ""}])
def test_the_compiled_kernels_are_used_where_they_are(native: Kernels, environ: dict[str, str]) -> None:
    assert not native_fault()
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
    assert native_fault()
    assert chosen_kernels(environ).name == "numpy"


@pytest.mark.usefixtures("_no_native")
def test_who_asks_for_a_compiled_core_that_is_not_there_is_told_how_to_mend_it() -> None:
    with pytest.raises(ConfigError, match=r"C\+\+17 compiler"):
        kernels_named("native")
    with pytest.raises(ConfigError, match=MEND):
        chosen_kernels({"MSCF_KERNELS": "native"})


def test_kernels_are_of_the_name_they_are_asked_for_by(kernels: Kernels) -> None:
    assert kernels_named(kernels.name).name == kernels.name


def test_a_core_that_cannot_be_loaded_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    class Broken:
        """Finds the core, and fails to load it."""

        def find_spec(self, name: str, *_: object) -> ModuleSpec | None:
            return ModuleSpec(name, self) if name == "mscf.kernels._native" else None

        def create_module(self, _spec: ModuleSpec) -> None:
            return None

        def exec_module(self, _module: object) -> None:
            raise ImportError("the compiled kernels need a processor with AVX2 and FMA")

    monkeypatch.delitem(sys.modules, "mscf.kernels.native_kernels", raising=False)
    monkeypatch.delitem(sys.modules, "mscf.kernels._native", raising=False)
    monkeypatch.delattr("mscf.kernels._native", raising=False)
    monkeypatch.setattr(sys, "meta_path", [Broken(), *sys.meta_path])
    assert (
        native_fault() == "the compiled core cannot be loaded: the compiled kernels need a processor with AVX2 and FMA"
    )
    assert chosen_kernels({}).name == "numpy"
