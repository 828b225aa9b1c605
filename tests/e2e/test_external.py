"""The simulator's camera with somebody else's autopilot: a fake one, served as ArduPilot and PX4 serve their SITL."""

import math
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest
from sitl import Sitl

from sim.autopilot import FakeAutopilot, Start
from sim.external import ExternalAutopilot
from sim.realtime import fly_external
from sim.scenarios import AUTOPILOTS, SCENARIOS

BOOT_S = 45.0  # after which either autopilot is ready; ArduCopter 4.7 was measured to take GUIDED after 41.4 s
CLIMB_SPEEDUP = 4.0  # SITLs can be told to run faster than the clock; here for as long as nothing is filmed


@pytest.fixture
def serve() -> Iterator[Callable[[FakeAutopilot], Sitl]]:
    served: list[Sitl] = []

    def start(autopilot: FakeAutopilot) -> Sitl:
        served.append(Sitl(autopilot, CLIMB_SPEEDUP))
        served[-1].start()
        return served[-1]

    yield start
    for sitl in served:
        sitl.close()


SHORT = replace(SCENARIOS["straight"], duration_s=12.0, checks=())
# A stage's own place on the map is nowhere near the vehicle's, and north is not where it looks.
GROUND = Start(pos_ned_m=(40.0, -25.0, 0.0), yaw_rad=2.0)


@pytest.mark.parametrize("name", AUTOPILOTS)
def test_it_arms_takes_off_follows_and_lands(serve: Callable[[FakeAutopilot], Sitl], name: str, tmp_path: Path) -> None:
    autopilot = FakeAutopilot(AUTOPILOTS[name], start=GROUND)
    autopilot.step(BOOT_S)
    sitl = serve(autopilot)
    with closing(ExternalAutopilot(sitl.end.device, 115200, sitl.say, is_ours=True)) as external:
        external.connect()
        trace, _, facts = fly_external(SHORT, external, say=sitl.say, folder=tmp_path)
    assert facts["exit_status"] == 0
    assert trace.moments[-1].mode == "following"
    assert trace.moments[-1].speed_mps > 1.0
    assert abs(trace.moments[-1].bearing_error_rad) < math.radians(10)
    assert {moment.is_armed for moment in trace.moments} == {True}
    # the stage is laid out around the vehicle: it sees what it would have seen at the stage's own start
    seen = [moment for moment in trace.moments if moment.truth is not None and moment.box is not None]
    assert max(moment.iou or 0.0 for moment in seen) > 0.5
    last = {"ardupilot": ["GUIDED", "BRAKE", "LAND"], "px4": ["OFFBOARD", "AUTO.LOITER", "AUTO.LAND"]}[name]
    assert sitl.modes[-3:] == last
    assert sitl.was_armed
    sitl.close()
    autopilot.step(60.0)
    assert autopilot.is_landed
    assert not autopilot.is_armed
    assert (tmp_path / "application.log").is_file()


def test_without_arming_it_waits_for_the_pilot_and_leaves_the_landing_to_him(
    serve: Callable[[FakeAutopilot], Sitl], tmp_path: Path
) -> None:
    autopilot = FakeAutopilot(AUTOPILOTS["ardupilot"], start=replace(GROUND, mode="LOITER"))
    autopilot.step(BOOT_S)
    sitl = serve(autopilot)

    def pilot(text: str) -> None:
        sitl.say(text)
        if text.startswith("waiting for a height"):
            assert autopilot.arm()
            autopilot.set_sticks(throttle=1.0)
        if text.startswith("flying"):
            autopilot.set_sticks()
            autopilot.select_mode("GUIDED")

    with closing(ExternalAutopilot(sitl.end.device, 115200, pilot, is_ours=False)) as external:
        external.connect()
        trace, _, facts = fly_external(SHORT, external, say=pilot, folder=tmp_path)
    assert facts["exit_status"] == 0
    assert trace.first("following") is not None
    assert "LAND" not in sitl.modes
    assert autopilot.is_armed
