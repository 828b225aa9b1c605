"""What a user installs: the built wheel in an empty environment, and nothing of this checkout."""

import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
CORE = "mscf/kernels/_native.abi3.so"


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    run(sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "-w", str(folder), str(ROOT))
    return next(folder.glob("mscf_companion-*.whl"))


@pytest.fixture(scope="module")
def environment(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("environment") / "venv"
    run(sys.executable, "-m", "venv", str(folder))
    run(str(folder / "bin" / "pip"), "install", "-q", str(wheel))
    return folder / "bin"


def run(*command: str, status: int = 0, cwd: Path | None = None, **variables: str) -> str:
    environ = os.environ | {"PIP_CONSTRAINT": str(ROOT / "constraints.txt"), "PIP_DISABLE_PIP_VERSION_CHECK": "1"}
    environ.pop("PYTHONPATH", None)
    environ |= variables
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environ, cwd=cwd)
    assert done.returncode == status, done.stdout + done.stderr
    return done.stdout + done.stderr


def test_the_wheel_holds_the_packages_and_the_table_and_no_tests(wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    tops = {name.split("/")[0] for name in names if ".dist-info/" not in name}
    assert tops == {"mscf", "companion", "sim"}
    assert "mscf/data/color_names.npz" in names
    assert {"mscf/py.typed", "companion/py.typed", "sim/py.typed"} <= set(names)
    assert not any(name.endswith((".cpp", ".hpp")) for name in names)
    assert any(name.endswith("licenses/LICENSE") for name in names)
    # one build for Python 3.11 and later
    assert wheel.name.split("-")[2:4] == ["cp311", "abi3"]
    assert shutil.which("g++") is None or CORE in names


def test_without_a_compiler_the_wheel_has_no_core_and_numpy_computes(
    environment: Path, sequence_dir: Path, tmp_path: Path
) -> None:
    build = (sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "-w", str(tmp_path), str(ROOT))
    run(*build, CC="/bin/false", CXX="/bin/false")
    with zipfile.ZipFile(next(tmp_path.glob("mscf_companion-*.whl"))) as archive:
        assert CORE not in archive.namelist()
        archive.extractall(tmp_path / "site")  # what that wheel would have installed, in the place of the other one's
    site = {"PYTHONPATH": str(tmp_path / "site")}
    demo = (str(environment / "mscf"), "demo", str(sequence_dir))
    assert "numpy kernels" in run(*demo, cwd=tmp_path, **site)
    said = run(*demo, status=2, cwd=tmp_path, MSCF_KERNELS="native", **site)
    assert said.startswith(
        "mscf: MSCF_KERNELS=native, but the compiled core is not here: install with a C++17 compiler"
    )


def test_the_commands_run_from_the_wheel_alone(environment: Path, sequence_dir: Path, tmp_path: Path) -> None:
    assert run(str(environment / "mscf"), "--version", cwd=tmp_path).startswith("mscf 0.")
    assert run(str(environment / "mscf-companion"), "--version", cwd=tmp_path).startswith("mscf-companion 0.")
    said = run(str(environment / "mscf"), "demo", str(sequence_dir), "--boxes", "boxes.txt", cwd=tmp_path)
    assert "precision at 20 px 1.000" in said
    assert len((tmp_path / "boxes.txt").read_text().splitlines()) == 12
    said = run(str(environment / "mscf"), "demo", "--max-frames", "2", cwd=tmp_path)
    assert "mscf: 2 frames" in said


def test_an_extra_that_is_missing_is_named(environment: Path, sequence_dir: Path, tmp_path: Path) -> None:
    demo = [str(environment / "mscf"), "demo", str(sequence_dir)]
    said = run(*demo, "--save", "a.mp4", status=2, cwd=tmp_path)
    assert "pip install av" in said
    said = run(*demo, "--plot", "a.png", status=2, cwd=tmp_path)
    assert "pip install matplotlib" in said


def test_the_tracker_imports_neither_application_nor_simulator(environment: Path, tmp_path: Path) -> None:
    code = "import sys, mscf; print(sorted(m for m in sys.modules if m.split('.')[0] in ('companion', 'sim', 'av')))"
    assert run(str(environment / "python"), "-c", code, cwd=tmp_path).strip() == "[]"
