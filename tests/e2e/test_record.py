"""Flight records of the command `mscf-companion`, as processes of its own write, lose and read them."""

import json
import math
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import common as mavlink

from companion.control_socket import ask
from companion.flight_record import ABOUT, CONFIG, CONTROL, TLOG, VIDEO
from sim.realtime import RECORDS, Flight, fake_autopilot
from sim.scenarios import AUTOPILOTS, SCENARIOS, Operator
from sim.server import End
from sim.stages import stage
from sim.trace import Moment

COMPANION = str(Path(sys.executable).with_name("mscf-companion"))
DEADLINE_S = 40.0  # of every wait: far beyond what a busy machine needs
FLOWN_S = 6.0


@pytest.fixture
def folder() -> Iterator[Path]:
    """A folder with a short path, as those of sockets must be."""
    with tempfile.TemporaryDirectory() as path:
        yield Path(path)


def until(what: str, is_there: Callable[[], bool]) -> None:
    end_s = time.monotonic() + DEADLINE_S
    while not is_there():
        assert time.monotonic() < end_s, f"waited {DEADLINE_S:g} s for {what}"
        time.sleep(0.02)


def replayed(record: Path) -> str:
    done = subprocess.run(
        [COMPANION, "replay", str(record)], capture_output=True, text=True, check=False, timeout=DEADLINE_S
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_a_flight_whose_application_is_killed_leaves_a_record_that_can_be_read(folder: Path) -> None:
    scenario = SCENARIOS["straight"]
    place = stage(scenario.stage, 7)
    fake = fake_autopilot(scenario, place, "ardupilot")
    flight = Flight(scenario, place, fake, AUTOPILOTS["ardupilot"], "udp", folder)
    try:
        flight.start_application()
        operator = Operator(scenario)
        flight.begin()
        while flight.time_s < FLOWN_S:
            flight.advance(operator)
        said = flight.status["record"]
        assert flight.process is not None
        flight.process.kill()
        assert flight.process.wait(DEADLINE_S) == -signal.SIGKILL
    finally:
        flight.end_application()
        flight.end()
    (record,) = (folder / RECORDS).iterdir()
    assert said == str(record.resolve())
    assert {path.name for path in record.iterdir()} == {ABOUT, CONFIG, CONTROL, TLOG, VIDEO}
    assert " steps, all equal" in replayed(record)
    log, kinds = mavutil.mavlogfile(str(record / TLOG)), set()
    while (message := log.recv_msg()) is not None:
        kinds.add(message.get_type())
    log.f.close()
    assert {"ATTITUDE", "HEARTBEAT", "STATUSTEXT"} <= kinds
    with av.open(str(record / VIDEO)) as container:
        pictures = [frame.to_ndarray(format="gray") for frame in container.decode(video=0)]
    assert len(pictures) > 5
    assert all(np.ptp(picture) > 50 for picture in pictures)


def test_a_record_that_cannot_grow_ends_and_the_application_does_not(folder: Path) -> None:
    control = folder / "control.sock"
    (folder / "config.toml").write_text(
        f'[camera]\nsource = "unix:{folder}/none"\nwidth_px = 64\nheight_px = 48\nfocal_px = 60\n'
        f'[link]\ndevice = "udpout:127.0.0.1:9"\n[control]\nsocket = "{control}"\n'
        f'[record]\nfolder = "{folder}/flights"\nmin_free_mb = 1\n'
    )
    command = [COMPANION, "run", "-c", str(folder / "config.toml")]
    with (folder / "log").open("w") as log, subprocess.Popen(command, stderr=log) as process:
        try:
            until("the record", lambda: control.exists() and bool(ask(control, {"do": "status"})["record"]))
            # what the kernel does to a write on a disk that is full, for this process alone
            resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (4096, 4096))
            until("the end of the record", lambda: ask(control, {"do": "status"})["record"] is None)
            assert ask(control, {"do": "deselect"})["mode"] == "idle"
        finally:
            process.terminate()
            status = process.wait(DEADLINE_S)
    assert status == 0


class Overheard:
    """The autopilot's end of the link, which keeps what the application sent."""

    def __init__(self, end: End) -> None:
        self.device = end.device
        self.data = b""
        self._end = end

    def read(self) -> bytes:
        data = self._end.read()
        self.data += data
        return data

    def write(self, data: bytes) -> None:
        self._end.write(data)

    def close(self) -> None:
        self._end.close()

    def messages(self, mark: int) -> list[Any]:
        """What was sent after so many bytes; of a packet that was cut there, nothing."""
        parser = mavlink.MAVLink(None)
        parser.robust_parsing = True
        return [m for m in parser.parse_buffer(self.data[mark:]) or () if m.get_type() != "BAD_DATA"]


def test_a_vehicle_that_follows_goes_on_when_its_record_ends_and_the_operator_is_told(folder: Path) -> None:
    scenario = replace(SCENARIOS["straight"], duration_s=DEADLINE_S)
    place = stage(scenario.stage, 7)
    fake = fake_autopilot(scenario, place, "ardupilot")
    flight = Flight(scenario, place, fake, AUTOPILOTS["ardupilot"], "udp", folder)
    wire = flight.realtime.end = Overheard(flight.realtime.end)
    operator = Operator(scenario)

    def fly_until(what: str, is_there: Callable[[], bool]) -> None:
        end_s = time.monotonic() + DEADLINE_S
        while not is_there():
            assert time.monotonic() < end_s, f"waited {DEADLINE_S:g} s for {what}; {flight.moments[-1]}"
            flight.advance(operator)

    def texts(mark: int) -> list[str]:
        return [message.text for message in wire.messages(mark) if message.get_type() == "STATUSTEXT"]

    try:
        flight.start_application()
        flight.begin()
        fly_until("a vehicle that follows and moves", lambda: bool(flight.moments) and is_following(flight.moments[-1]))
        record = Path(flight.status["record"])
        assert flight.process is not None
        mark, first = len(wire.data), len(flight.moments)
        # what the kernel does to a write on a disk that is full, for this process alone
        size = (record / CONTROL).stat().st_size + 1000
        resource.prlimit(flight.process.pid, resource.RLIMIT_FSIZE, (size, size))
        fly_until("the text", lambda: "Record stopped: file too large" in texts(mark))
        fly_until("the end of the record", lambda: flight.status["record"] is None)
        ended, ended_s = len(wire.data), flight.time_s
        fly_until("time to pass", lambda: flight.time_s > ended_s + 2.0)
        assert [text for text in texts(mark) if text.startswith("Record")] == ["Record stopped: file too large"]
        assert {moment.mode for moment in flight.moments[first:]} == {"following"}
        setpoints = [m for m in wire.messages(ended) if m.get_type() == "SET_POSITION_TARGET_LOCAL_NED"]
        assert len(setpoints) > 20  # of 40
        assert all(math.hypot(m.vx, m.vy) > 0.5 for m in setpoints)
    finally:
        status = flight.end_application()
        flight.end()
    assert status == 0
    assert " steps, all equal" in replayed(record)


def is_following(moment: Moment) -> bool:
    return moment.mode == "following" and moment.speed_mps > 1.0


def test_a_flight_in_virtual_time_can_be_decided_again(folder: Path) -> None:
    words = ["sim", "straight", "--duration", "5", "--no-video", "--autopilot", "px4", "--out", str(folder)]
    subprocess.run([COMPANION, *words], capture_output=True, check=False, timeout=240.0, env={**os.environ})
    run = folder / "straight-px4"
    assert replayed(run) == "100 steps, all equal\n"
    page = (run / "index.html").read_text()
    for name in (ABOUT, CONFIG, CONTROL, TLOG):
        assert f'href="{name}"' in page
    assert json.loads((run / ABOUT).read_text())["start_utc"].startswith("2026-01-01")
