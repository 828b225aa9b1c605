"""The closed loop on a signed link, in virtual time: flight code, an autopilot and a ground station with the key.

Autopilot and ground station sign and check by pymavlink's own means.
"""

import math
import os
import subprocess
import sys
import time
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from companion.config import parse
from companion.follower import Step
from companion.modes import Mode
from companion.signing import STAMPS_PER_S, Signing, stamp_at
from companion.signing_keeper import STAMP_NAME
from companion.types import Select
from sim.ardupilot import ArduCopter
from sim.autopilot import Personality
from sim.eyes import TrueEyes
from sim.loop import OUR_CLOCK_S, Loop
from sim.px4 import Px4
from sim.server import UdpEnd
from sim.stages import stage

KEY, OTHER_KEY = bytes(range(32)), bytes(32)
NOW_S = 1_790_000_000.0  # Unix time
ENGAGE = 31010
DEADLINE_S = 40.0  # of every wait: far beyond what a busy machine needs
BOTH = pytest.mark.parametrize("kind", [ArduCopter, Px4])


def sign(end: Any, key: bytes = KEY, *, link: int = 0, wall_s: float = NOW_S) -> Any:
    """Give an end of pymavlink's a key."""
    end.robust_parsing = True
    end.signing.secret_key, end.signing.sign_outgoing = key, True
    end.signing.link_id, end.signing.timestamp = link, stamp_at(wall_s)
    return end


class Flight:
    """A vehicle in the air 25 degrees beside its target, its computer, and a ground station; all have the key."""

    def __init__(self, kind: type[Personality], signing: Signing) -> None:
        ground = stage("straight", 7)
        start = replace(ground.start, yaw_rad=ground.start.yaw_rad - math.radians(25))
        ground = replace(ground, start=start)
        config = parse(
            f"[camera]\nwidth_px=640\nheight_px=480\nfocal_px={ground.camera.focal_px}\n"
            f"mount_pitch_deg={math.degrees(ground.camera.mount_pitch_rad)}\n[ground]\nengage_command={ENGAGE}\n"
        )
        mode = "GUIDED" if kind is ArduCopter else "POSCTL"
        self.station = sign(mavlink.MAVLink(BytesIO(), 255, 190), link=2)
        self.loop = Loop(ground, kind, config, TrueEyes(ground), wait_s=1e6, mode=mode, recorder=self._overhear)
        sign(self.loop.autopilot._link, link=1)
        self.use(signing)

    def use(self, signing: Signing) -> None:
        wire = self.loop.follower._wire
        for end in (wire._parser, *wire._senders.values()):
            signing.equip(end)

    def _overhear(self, step: Step) -> None:
        self.station.parse_buffer(step.data)

    @property
    def mode(self) -> str:
        return self.loop.mode

    def run(self, duration_s: float) -> None:
        self.loop.run(self.loop.time_s + duration_s)

    def inject(self, data: bytes) -> None:
        """Bytes from somebody else on the link."""
        self.loop._telemetry.append((self.loop.time_s, data))

    def tracked(self) -> "Flight":
        self.run(3.0)
        self.loop.commands.append(Select(self.loop.truth.box))
        self.run(1.5)
        assert self.mode == Mode.TRACKING.value
        return self

    def order(self, sender: Any, what: int = 1) -> bytes:
        message = mavlink.MAVLink_command_long_message(1, 191, ENGAGE, 0, what, 0, 0, 0, 0, 0, 0)
        return bytes(message.pack(sender))


def signing(wall_s: float = NOW_S, key: bytes = KEY) -> Signing:
    return Signing(key, 7, stamp_at(wall_s))


@pytest.mark.parametrize("clock_s", [0.0, 3600.0, -3600.0], ids=["right", "an hour ahead", "an hour behind"])
def test_with_the_same_key_the_vehicle_turns_to_the_target_whatever_our_clock_says(clock_s: float) -> None:
    flight = Flight(ArduCopter, signing(NOW_S + clock_s)).tracked()
    flight.run(1.0)
    flight.inject(flight.order(flight.station))
    flight.run(6.0)
    assert flight.mode == Mode.FOLLOWING.value
    box = flight.loop.truth.box
    assert box is not None
    assert abs(box.x + box.w / 2 - 320) < 40  # it was at the edge


@BOTH
def test_an_autopilot_without_our_key_is_not_heard_and_does_not_move(kind: type[Personality]) -> None:
    flight = Flight(kind, signing(key=OTHER_KEY))
    before = flight.loop.autopilot.pose
    flight.run(3.0)
    flight.loop.commands.append(Select(flight.loop.truth.box))
    flight.run(3.0)
    assert flight.loop.follower.heartbeat is None
    assert flight.loop.autopilot.setpoint is None
    assert flight.loop.autopilot.pose.yaw_rad == pytest.approx(before.yaw_rad, abs=0.02)


def test_an_order_without_the_key_neither_engages_nor_ends_anything() -> None:
    flight = Flight(ArduCopter, signing()).tracked()
    strangers = [
        mavlink.MAVLink(BytesIO(), 255, 190),
        sign(mavlink.MAVLink(BytesIO(), 255, 190), OTHER_KEY),
        sign(mavlink.MAVLink(BytesIO(), 255, 190), wall_s=NOW_S - 3600),
    ]
    for stranger in strangers:
        flight.inject(flight.order(stranger))
        flight.run(0.5)
        assert flight.mode == Mode.TRACKING.value
    flight.station.signing.timestamp += STAMPS_PER_S
    order = flight.order(flight.station)
    flight.inject(order)
    flight.run(1.0)
    assert flight.mode == Mode.FOLLOWING.value
    for stranger in strangers:
        flight.inject(flight.order(stranger, 0))
        flight.run(0.5)
        assert flight.mode == Mode.FOLLOWING.value
    flight.inject(flight.order(flight.station, 0))
    flight.run(0.5)
    assert flight.mode == Mode.TRACKING.value
    flight.inject(order)  # recorded
    flight.run(0.5)
    assert flight.mode == Mode.TRACKING.value


def test_whoever_plays_the_autopilot_without_the_key_cannot_end_the_following() -> None:
    flight = Flight(ArduCopter, signing()).tracked()
    flight.inject(flight.order(flight.station))
    flight.run(1.0)
    liar = mavlink.MAVLink(BytesIO(), 1, 1)
    for _ in range(20):
        loiter = mavlink.MAVLink_heartbeat_message(2, 3, 0x81, 5, 4, 3)
        sticks = mavlink.MAVLink_rc_channels_message(5000, 4, 1900, 1900, 1500, 1900, *[65535] * 14, 200)
        flight.inject(b"".join(bytes(message.pack(liar)) for message in (loiter, sticks)))
        flight.run(0.1)
    assert flight.mode == Mode.FOLLOWING.value


def test_a_computer_that_restarts_in_flight_with_its_stamp_ahead_hears_and_is_heard() -> None:
    flight = Flight(ArduCopter, signing()).tracked()
    flight.use(signing(NOW_S + 60))
    flight.run(4.0)
    assert flight.loop.follower.is_connected(OUR_CLOCK_S + flight.loop.time_s)
    flight.inject(flight.order(flight.station))
    flight.run(2.0)
    assert flight.mode == Mode.FOLLOWING.value
    assert flight.loop.autopilot.setpoint is not None


# --------------------------------------------------------------------------------- the command, as a process
class Application:
    """`mscf-companion run` with a key, and an autopilot that signs, at both ends of a socket."""

    def __init__(self, folder: Path, key: str = KEY.hex()) -> None:
        self.folder = folder
        (folder / "key").write_text(key)
        (folder / "key").chmod(0o600)
        self.end = UdpEnd()
        self.peer = sign(mavlink.MAVLink(BytesIO(), 1, 1), wall_s=time.time() - 5)
        text = (
            f'[camera]\nsource = "unix:{folder}/none"\nwidth_px = 320\nheight_px = 240\nfocal_px = 277\n[record]\n'
            f'enabled = false\n[control]\nsocket = ""\n[link]\ndevice = "{self.end.device}"\n[signing]\n'
            f'key_file = "{folder}/key"\nlink_id = 7\n'
        )
        (folder / "config.toml").write_text(text)
        command = [str(Path(sys.executable).with_name("mscf-companion")), "run", "-c", str(folder / "config.toml")]
        environ = {name: value for name, value in os.environ.items() if name != "STATE_DIRECTORY"}
        self.process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=environ)

    def heard(self, kind: str) -> list[Any]:
        """What the autopilot takes from the application, until a message of a kind is among it."""
        messages: list[Any] = []
        end_s = time.monotonic() + DEADLINE_S
        while not any(message.get_type() == kind for message in messages):
            assert time.monotonic() < end_s, f"no {kind}"
            beat = mavlink.MAVLink_heartbeat_message(2, 3, 0x81, 4, 4, 3)
            self.end.write(bytes(beat.pack(self.peer)))
            time.sleep(0.05)
            messages += self.peer.parse_buffer(self.end.read()) or []
        return messages

    def stop(self) -> str:
        self.process.terminate()
        _, said = self.process.communicate(timeout=DEADLINE_S)
        self.end.close()
        return said


def test_the_command_signs_hears_who_signs_and_keeps_its_time_stamp(tmp_path: Path) -> None:
    application = Application(tmp_path)
    signed = application.heard("PARAM_REQUEST_READ")  # it has heard the autopilot, and asks
    said = application.stop()
    assert application.process.returncode == 0
    assert all(message.get_signed() for message in signed if message.get_type() != "BAD_DATA")
    assert int((tmp_path / STAMP_NAME).read_text()) >= stamp_at(time.time() - DEADLINE_S)
    assert KEY.hex() not in said


def test_a_key_file_without_a_key_is_a_wrong_configuration_in_one_line(tmp_path: Path) -> None:
    application = Application(tmp_path, KEY.hex()[1:])
    _, said = application.process.communicate(timeout=DEADLINE_S)
    application.end.close()
    assert application.process.returncode == 78
    assert "63 hexadecimal digits: a key has 64" in said.splitlines()[-1]
    assert "Traceback" not in said
