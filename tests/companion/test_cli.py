import pytest

from companion import cli


def test_it_says_that_it_cannot_fly_yet(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main([]) == 2
    said = capsys.readouterr().err
    assert "cannot run on a vehicle yet" in said
    assert len(said.splitlines()) == 1
