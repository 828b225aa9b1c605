"""install.sh and uninstall.sh below a folder of their own: what is written, kept and removed."""

import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SYSTEMD = ROOT / "systemd"
VENV = Path("opt/mscf-companion/venv")
CONFIG = Path("etc/mscf-companion/config.toml")
EXAMPLE = Path("etc/mscf-companion/config.toml.example")
RECORDING = Path("var/log/mscf-companion/flight.mkv")
STATE = Path("var/lib/mscf-companion/state")
WRITTEN = {
    Path("etc/systemd/system/mscf-companion.service"): 0o644,
    Path("etc/sysusers.d/mscf-companion.conf"): 0o644,
    Path("etc/udev/rules.d/70-mscf-companion.rules"): 0o644,
    EXAMPLE: 0o644,
    CONFIG: 0o640,
}


def stand_in(folder: Path, version: str, *, requires: str = "") -> Path:
    """A wheel with all that install.sh asks of one: the command, and the example it prints."""
    command = f'import sys\n\n\ndef main():\n    print(f"# version {version}, {{sys.argv[1:]}}")\n'
    info = f"mscf_companion-{version}.dist-info"
    metadata = f"Metadata-Version: 2.1\nName: mscf-companion\nVersion: {version}\nProvides-Extra: recording\n"
    members = {
        "stand_in.py": command,
        f"{info}/METADATA": metadata + (f"Requires-Dist: {requires}\n" if requires else ""),
        f"{info}/WHEEL": "Wheel-Version: 1.0\nGenerator: test\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
        f"{info}/entry_points.txt": "[console_scripts]\nmscf-companion = stand_in:main\n",
    }
    path = folder / f"mscf_companion-{version}-py3-none-any.whl"
    with zipfile.ZipFile(path, "w") as wheel:
        for name, text in members.items():
            wheel.writestr(name, text)
        wheel.writestr(f"{info}/RECORD", "".join(f"{name},,\n" for name in [*members, f"{info}/RECORD"]))
    return path


def run(script: str, *arguments: str | Path, status: int = 0, **environ: str) -> str:
    """What a script says; pip reaches no index, and the umask is not a kind one."""
    done = subprocess.run(
        ["/bin/sh", str(SYSTEMD / script), *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"PIP_NO_INDEX": "1"} | environ,
        umask=0o077,
    )
    assert done.returncode == status, done.stdout + done.stderr
    return done.stdout + done.stderr


def install(root: Path, wheel: Path, *options: str, status: int = 0, **environ: str) -> str:
    return run("install.sh", "--python", sys.executable, "--root", root, *options, wheel, status=status, **environ)


def tree(root: Path) -> dict[str, str | None]:
    """Path -> content of everything but the environment's inside."""
    return {
        str(path.relative_to(root)): path.read_text() if path.is_file() else None
        for path in sorted(root.rglob("*"))
        if VENV not in path.relative_to(root).parents
    }


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A root with version 1 installed, and what the script said."""
    folder = tmp_path_factory.mktemp("first")
    said = install(folder / "root", stand_in(folder, "1.0"))
    return folder / "root", said


@pytest.fixture
def root(first: tuple[Path, str], tmp_path: Path) -> Path:
    """A copy of that root for a test of its own, flown once."""
    copy = tmp_path / "root"
    shutil.copytree(first[0], copy, symlinks=True)
    for path in (copy / RECORDING, copy / STATE):
        path.parent.mkdir(parents=True)
        path.write_text("kept")
    return copy


@pytest.mark.parametrize("script", ["install.sh", "uninstall.sh"])
def test_the_scripts_are_sound_posix_shell(script: str) -> None:
    subprocess.run(["/bin/sh", "-n", str(SYSTEMD / script)], check=True)
    assert os.access(SYSTEMD / script, os.X_OK)
    assert "\nset -eu\n" in (SYSTEMD / script).read_text()


def test_shellcheck_is_content() -> None:
    beside = Path(sys.executable).with_name("shellcheck")
    shellcheck = shutil.which("shellcheck") or (str(beside) if beside.exists() else None)
    if shellcheck is None:
        pytest.skip("no shellcheck on this machine")
    done = subprocess.run([shellcheck, *map(str, SYSTEMD.glob("*.sh"))], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize(("path", "mode"), WRITTEN.items(), ids=lambda value: getattr(value, "name", None))
def test_each_file_is_in_its_place_whatever_the_umask(first: tuple[Path, str], path: Path, mode: int) -> None:
    assert (first[0] / path).stat().st_mode & 0o777 == mode


def test_nothing_else_is_written(first: tuple[Path, str]) -> None:
    files = {path for path, content in tree(first[0]).items() if content is not None}
    assert files == {str(path) for path in WRITTEN}


def test_every_folder_can_be_entered_by_the_account_of_the_service(first: tuple[Path, str]) -> None:
    folders = [path for path in [first[0], *first[0].rglob("*")] if path.is_dir() and not path.is_symlink()]
    assert [path for path in folders if path.stat().st_mode & 0o005 != 0o005] == []


def test_the_units_command_is_there_and_names_the_place_it_runs_from(first: tuple[Path, str]) -> None:
    unit = (first[0] / "etc/systemd/system/mscf-companion.service").read_text()
    found = re.search(r"(?m)^ExecStart=/(\S+)", unit)
    assert found is not None
    command = first[0] / found[1]
    assert os.access(command, os.X_OK)
    assert command.read_text().startswith("#!/opt/mscf-companion/venv/bin/python")


def test_no_text_of_the_environment_names_the_folder_it_was_built_in(first: tuple[Path, str]) -> None:
    venv = first[0] / VENV
    files = [venv / "pyvenv.cfg", *(path for path in (venv / "bin").iterdir() if not path.is_symlink())]
    assert len(files) > 3
    assert [path.name for path in files if str(first[0]).encode() in path.read_bytes()] == []


def test_the_configuration_is_the_example_and_the_next_steps_are_said(first: tuple[Path, str]) -> None:
    root, said = first
    assert (root / CONFIG).read_text() == "# version 1.0, ['example', 'ardupilot']\n"
    assert (root / EXAMPLE).read_text() == (root / CONFIG).read_text()
    edit, check, start = (step.strip() for step in said.split("next:\n")[1].splitlines())
    assert edit == "sudoedit /etc/mscf-companion/config.toml"
    assert check.endswith("/opt/mscf-companion/venv/bin/mscf-companion check -c /etc/mscf-companion/config.toml")
    assert start.endswith("systemctl enable --now mscf-companion")


def test_installing_once_more_keeps_the_configuration_and_renews_everything_else(root: Path, tmp_path: Path) -> None:
    (root / CONFIG).write_text("# mine\n")
    (root / CONFIG).chmod(0o600)
    expected = tree(root) | {str(EXAMPLE): "# version 2.0, ['example', 'px4']\n"}
    (root / "etc/systemd/system/mscf-companion.service").write_text("# an older unit\n")
    stale = root / VENV / "stale"
    stale.touch()
    assert "kept" in install(root, stand_in(tmp_path, "2.0"), "--vehicle", "px4")
    assert tree(root) == expected
    assert (root / CONFIG).stat().st_mode & 0o777 == 0o600
    assert not stale.exists()


@pytest.mark.parametrize(
    ("requires", "environ"),
    [
        ("no-such-part-of-mscf-companion", {}),  # pip fails: a requirement cannot be had
        ("", {"PYTHONHASHSEED": "no number"}),  # the interpreter fails at once
    ],
)
def test_a_failed_upgrade_leaves_the_old_version_whole(
    root: Path, tmp_path: Path, requires: str, environ: dict[str, str]
) -> None:
    before = tree(root)
    install(root, stand_in(tmp_path, "2.0", requires=requires), status=1, **environ)
    assert tree(root) == before
    command = [str(root / VENV / "bin/python"), str(root / VENV / "bin/mscf-companion"), "example", "px4"]
    assert subprocess.run(command, capture_output=True, text=True, check=True).stdout.startswith("# version 1.0")


def test_uninstalling_keeps_configuration_state_and_recordings(root: Path) -> None:
    assert "kept" in run("uninstall.sh", "--root", root)
    files = {path for path, content in tree(root).items() if content is not None}
    assert files == {str(CONFIG), str(RECORDING), str(STATE)}
    assert not (root / "opt/mscf-companion").exists()
    run("uninstall.sh", "--root", root)  # nothing left to do is no error


def test_purging_leaves_nothing(root: Path) -> None:
    run("uninstall.sh", "--root", root, "--purge")
    assert [path for path, content in tree(root).items() if content is not None] == []
    assert list(root.rglob("*mscf-companion*")) == []


@pytest.mark.parametrize("script", ["install.sh", "uninstall.sh"])
@pytest.mark.parametrize(
    ("root", "complaint"),
    [
        ("", "--root needs a value"),  # "$UNSET" in somebody's build of an image
        ("/", "leave it out"),
        ("/usr/..", "leave it out"),
    ],
)
def test_a_root_that_is_the_running_system_is_refused(script: str, root: str, complaint: str) -> None:
    # the second mistake stops a script that has lost its guard: this test must never install anything
    said = run(script, "--root", root, "--no-such-option", status=2)
    assert complaint in said.splitlines()[0]
    assert f"usage: {script}" in said


@pytest.mark.parametrize(
    ("arguments", "status", "complaint"),
    [
        ((), 2, "the wheel is missing"),
        (("--no-such",), 2, "no option --no-such"),
        (("--root",), 2, "--root needs a value"),
        (("a.whl", "b.whl"), 2, "one wheel, not a.whl and b.whl"),
        (("--vehicle", "plane", "a.whl"), 2, "--vehicle is ardupilot or px4, not plane"),
        (("--root", "new", "a.whl"), 1, "a.whl is not there"),
    ],
)
def test_a_wrong_call_is_one_line_and_writes_nothing(
    arguments: tuple[str, ...], status: int, complaint: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert complaint in run("install.sh", *arguments, status=status).splitlines()[0]
    assert list(tmp_path.iterdir()) == []


@pytest.fixture
def requirements(tmp_path: Path) -> Path:
    """This environment's packages, for a PYTHONPATH: downloading them once more would show nothing new.

    Without the project, which must come from the wheel, and without pip, which would see it as installed.
    """
    folder = tmp_path / "requirements"
    folder.mkdir()
    for path in Path(sysconfig.get_path("purelib")).iterdir():
        if not path.name.startswith(("mscf_companion", "_mscf_companion", "pip", "__pycache__")):
            (folder / path.name).symlink_to(path)
    return folder


def test_the_projects_own_wheel_brings_its_configuration(requirements: Path, tmp_path: Path) -> None:
    command = [str(Path(sys.executable).with_name("mscf-companion")), "--help"]
    if "example" not in subprocess.run(command, capture_output=True, text=True, check=True).stdout:
        pytest.skip("the application has no command `example` yet")
    command = [sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "-w", str(tmp_path), str(ROOT)]
    environ = {"PIP_CONSTRAINT": str(ROOT / "constraints.txt"), "PIP_DISABLE_PIP_VERSION_CHECK": "1"}
    subprocess.run(command, check=True, env=os.environ | environ)
    wheel = next(tmp_path.glob("mscf_companion-*.whl"))
    install(tmp_path / "root", wheel, PIP_NO_DEPS="1", PYTHONPATH=str(requirements))
    assert tomllib.loads((tmp_path / "root" / CONFIG).read_text())
