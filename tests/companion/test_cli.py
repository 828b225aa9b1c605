import logging
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from companion import cli


def test_without_a_command_it_says_in_one_line_what_is_wanted(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        cli.main([])
    assert end.value.code == 2
    said = capsys.readouterr().err
    assert "COMMAND" in said
    assert len(said.splitlines()) == 1


@pytest.mark.parametrize("vehicle", cli.EXAMPLES)
def test_an_example_is_a_complete_configuration(
    vehicle: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["example", vehicle]) == 0
    path = tmp_path / "config.toml"
    path.write_text(capsys.readouterr().out)
    assert cli.main(["check", "-c", str(path)]) == 0
    said = capsys.readouterr().out
    assert said.startswith(f"config    {path}: ")
    assert "WARNING" not in said


def test_nothing_that_other_packages_bring_keeps_the_application_from_starting(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    broken = EntryPoint("sim", "no_such_module:add_command", cli.COMMANDS)
    monkeypatch.setattr(cli, "entry_points", lambda **_: (broken,))
    assert cli.main(["run", "-c", "/nowhere/config.toml"]) == cli.EXIT_CONFIG
    assert "/nowhere/config.toml cannot be read" in capsys.readouterr().err
    with pytest.raises(ModuleNotFoundError):
        cli.main(["sim"])


def test_a_control_socket_that_cannot_be_is_a_wrong_configuration(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "config.toml"
    path.write_text('[camera]\nfocal_px = 900\n[control]\nsocket = "/nowhere/control.sock"\n')
    assert cli.main(["run", "-c", str(path)]) == cli.EXIT_CONFIG
    said = capsys.readouterr().err.splitlines()[-1]
    assert "control.socket = '/nowhere/control.sock' cannot be used" in said


@pytest.mark.parametrize(
    ("level", "priority"),
    [
        (logging.CRITICAL, "<2>"),
        (logging.ERROR, "<3>"),
        (logging.WARNING, "<4>"),
        (logging.INFO, "<6>"),
        (logging.DEBUG, "<7>"),
    ],
)
def test_the_journal_is_given_the_priority_and_no_time(level: int, priority: str) -> None:
    record = logging.LogRecord("companion", level, __file__, 1, "mode %s", ("idle",), None)
    assert cli._JournalFormatter("%(message)s").format(record) == f"{priority}mode idle"
