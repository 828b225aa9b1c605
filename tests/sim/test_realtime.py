import tempfile
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.config import Config, parse
from companion.control_socket import ControlSocket, command_of
from companion.errors import UsageError
from companion.types import Deselect, Disengage, Engage, OperatorCommand, Select
from mscf import Box
from sim.realtime import ControlLine, Flight, config_text, fake_autopilot, request_of
from sim.scenarios import AUTOPILOTS, SCENARIOS
from sim.stages import stage

FOCAL = "[camera]\nfocal_px = 900\n"


@pytest.fixture
def folder() -> Iterator[Path]:
    """A folder with a short path, as those of sockets must be."""
    with tempfile.TemporaryDirectory() as path:
        yield Path(path)


def read_back(config: Config, name: str) -> tuple[Config, Config]:
    """A configuration with the simulator's ends in it, and what the application reads of it."""
    ends = replace(
        config,
        camera=replace(config.camera, source=f"unix:{name}"),
        link=replace(config.link, device=name),
        control=replace(config.control, socket=name),
    )
    return ends, parse(config_text(config, source=f"unix:{name}", device=name, control=Path(name)))


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_the_application_reads_the_configuration_of_every_scenario_as_it_is(scenario: str) -> None:
    wanted, read = read_back(SCENARIOS[scenario].config(stage(SCENARIOS[scenario].stage, 7)), "/run/x")
    assert read == wanted


@pytest.mark.parametrize(
    "text",
    [
        FOCAL,
        FOCAL + "distortion = [0.1, -0.02, 1e-7, 0]\n",
        FOCAL + '[select]\nat_start = "box"\nbox = [1, 2, 30.5, 40]\n[engage]\nauto = true\n',
    ],
)
def test_lists_flags_and_small_numbers_survive(text: str) -> None:
    wanted, read = read_back(parse(text), "/run/x")
    assert read == wanted


@given(st.text(st.characters(codec="utf-8", exclude_categories=("Cc",)), min_size=1))
def test_any_path_survives(name: str) -> None:
    wanted, read = read_back(parse(FOCAL), str(Path("/", name)))
    assert read == wanted


@pytest.mark.parametrize(
    "command", [Select(None), Select(Box(1.5, 2.0, 30.0, 40.0)), Deselect(), Engage(), Disengage()]
)
def test_an_order_is_understood_by_the_control_socket(command: OperatorCommand) -> None:
    assert command_of(request_of(command)) == command


class Answering(threading.Thread):
    """A control socket that answers with the number of the request."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self._control = ControlSocket(path)
        self._stop_asked = threading.Event()

    def run(self) -> None:
        count = 0
        while not self._stop_asked.is_set():
            self._control.poll()
            if self._control.is_asked:
                count += 1
                self._control.answer({"count": count}, dict)

    def close(self) -> None:
        self._stop_asked.set()
        self.join()
        self._control.close()


def test_a_control_line_gets_its_answers_and_connects_again(folder: Path) -> None:
    line = ControlLine(folder / "control.sock")
    assert line.ask({"do": "status"}) is None  # nobody is there
    for _ in range(2):  # the second time to a process that was started again
        control = Answering(folder / "control.sock")
        control.start()
        answers: list[Any] = [line.ask({"do": "status"}) for _ in range(2)]
        if answers[0] is None:  # that the old connection is broken shows with the first request
            answers = [answers[1], line.ask({"do": "status"})]
        assert answers == [{"count": 1}, {"count": 2}]
        control.close()
    line.close()


@pytest.mark.parametrize("link", ["udp", "serial"])
def test_an_application_that_does_not_start_is_said_with_its_own_words(folder: Path, link: str) -> None:
    scenario = SCENARIOS["straight"]
    place = stage(scenario.stage, 7)
    flight = Flight(scenario, place, fake_autopilot(scenario, place, "px4"), AUTOPILOTS["px4"], link, folder)
    flight.config_path.write_text("[folow]")
    with pytest.raises(UsageError, match=r"does not start: .*unknown table, 'folow'"):
        flight.start_application()
    assert flight.end_application() == 78
    flight.end()
