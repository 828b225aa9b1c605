"""Flight records of the command `mscf-companion`, as processes of its own write, lose and read them."""

import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import av
import numpy as np
import pytest
from pymavlink import mavutil

from companion.control_socket import ask
from companion.flight_record import ABOUT, CONFIG, CONTROL, TLOG, VIDEO
from sim.realtime import RECORDS, Flight, fake_autopilot
from sim.scenarios import AUTOPILOTS, SCENARIOS, Operator
from sim.stages import stage

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
    assert replayed(record).endswith(" steps, all equal\n")
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


def test_a_flight_in_virtual_time_can_be_decided_again(folder: Path) -> None:
    words = ["sim", "straight", "--duration", "5", "--no-video", "--autopilot", "px4", "--out", str(folder)]
    subprocess.run([COMPANION, *words], capture_output=True, check=False, timeout=240.0, env={**os.environ})
    run = folder / "straight-px4"
    assert replayed(run) == "100 steps, all equal\n"
    page = (run / "index.html").read_text()
    for name in (ABOUT, CONFIG, CONTROL, TLOG):
        assert f'href="{name}"' in page
    assert json.loads((run / ABOUT).read_text())["start_utc"].startswith("2026-01-01")
