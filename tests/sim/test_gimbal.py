"""The fake autopilot's gimbal: what turns it, who may, and what it tells; and the picture that is taken from it."""

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from ground_station import GroundStation, velocity
from pymavlink.dialects.v20 import common as mavlink

from companion.config import parse
from companion.types import Engage, Select
from sim.ardupilot import ArduCopter
from sim.autopilot import FakeAutopilot, Personality, Start
from sim.eyes import TrueEyes
from sim.gimbal import PITCH_RANGE_RAD, RATE_RADPS, Gimbal
from sim.loop import Loop, gimbal_of
from sim.px4 import Px4
from sim.stages import STAGE_NAMES, Stage, stage

BOTH = pytest.mark.parametrize("personality", [ArduCopter, Px4], ids=["ArduCopter", "PX4"])
YAW_RAD = 0.7
LOCK = mavlink.GIMBAL_MANAGER_FLAGS_YAW_LOCK
CONFIGURE = mavlink.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE
US, STATION = (1, 191), (255, 190)


def flying(personality: type[Personality], *, has_gimbal: bool = True, mode: str | None = None) -> GroundStation:
    gimbal = Gimbal(-0.5, YAW_RAD) if has_gimbal else None
    start = Start(pos_ned_m=(0.0, 0.0, -20.0), yaw_rad=YAW_RAD, mode=mode)
    return GroundStation(FakeAutopilot(personality, start=start, gimbal=gimbal))


def gimbal(station: GroundStation) -> Gimbal:
    found = station.autopilot.gimbal
    assert found is not None
    return found


def pitch_yaw(pitch_rad: float, yaw_rad: float, flags: int = LOCK) -> Any:
    return mavlink.MAVLink_gimbal_manager_set_pitchyaw_message(1, 1, flags, 0, pitch_rad, yaw_rad, math.nan, math.nan)


def attitude(pitch_rad: float, yaw_rad: float, flags: int = LOCK) -> Any:
    (c_p, s_p), (c_y, s_y) = ((math.cos(a / 2), math.sin(a / 2)) for a in (pitch_rad, yaw_rad))
    q = (c_p * c_y, -s_p * s_y, s_p * c_y, c_p * s_y)
    return mavlink.MAVLink_gimbal_manager_set_attitude_message(1, 1, flags, 0, q, math.nan, math.nan, math.nan)


def send_as(station: GroundStation, sender: tuple[int, int], message: Any) -> None:
    other = mavlink.MAVLink(None, srcSystem=sender[0], srcComponent=sender[1])
    station.autopilot.receive(bytes(message.pack(other)))


def told(station: GroundStation) -> tuple[tuple[float, ...], int]:
    """Quaternion and flags of an attitude that is asked for now."""
    station.command(mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_GIMBAL_DEVICE_ATTITUDE_STATUS)
    message = station.of("GIMBAL_DEVICE_ATTITUDE_STATUS")[-1]
    return tuple(message.q), message.flags


def primary(station: GroundStation) -> tuple[int, int]:
    station.command(mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_GIMBAL_MANAGER_STATUS)
    message = station.of("GIMBAL_MANAGER_STATUS")[-1]
    return message.primary_control_sysid, message.primary_control_compid


@pytest.mark.parametrize(("personality", "order"), [(ArduCopter, pitch_yaw), (ArduCopter, attitude), (Px4, attitude)])
@pytest.mark.parametrize(("pitch_rad", "yaw_rad"), [(-1.2, 2.0), (0.3, -3.0), (-0.5, YAW_RAD)])
def test_the_gimbal_goes_where_it_is_told_and_no_faster_than_it_can(
    personality: type[Personality], order: Callable[[float, float], Any], pitch_rad: float, yaw_rad: float
) -> None:
    station = flying(personality)
    station.command(CONFIGURE, *US, -1, -1)
    station.send(order(pitch_rad, yaw_rad))
    angles = []
    for _ in range(300):
        station.autopilot.step(0.02)
        angles.append((gimbal(station).pitch_rad, gimbal(station).yaw_rad))
    assert angles[-1] == pytest.approx((pitch_rad, yaw_rad), abs=1e-3)
    for before, after in pairwise(angles):
        steps = [abs(math.remainder(b - a, math.tau)) for a, b in zip(before, after, strict=True)]
        assert max(steps) <= RATE_RADPS * 0.02 + 1e-9


@pytest.mark.parametrize("pitch_rad", [-2.0, 1.0])
def test_the_gimbal_stops_at_its_ends(pitch_rad: float) -> None:
    station = flying(ArduCopter)
    station.send(pitch_yaw(pitch_rad, 0.0))
    station.run(5.0)
    assert PITCH_RANGE_RAD[0] - 1e-6 <= gimbal(station).pitch_rad <= PITCH_RANGE_RAD[1] + 1e-6


def test_ardupilot_obeys_anybody_and_px4_the_one_in_control() -> None:
    for personality, is_obeyed in ((ArduCopter, True), (Px4, False)):
        station = flying(personality)
        station.command(CONFIGURE, *US, -1, -1)
        send_as(station, STATION, attitude(-1.0, YAW_RAD))
        station.run(3.0)
        assert (gimbal(station).pitch_rad == pytest.approx(-1.0, abs=1e-3)) is is_obeyed


def test_px4_does_not_read_pitch_and_yaw() -> None:
    station = flying(Px4)
    station.command(CONFIGURE, *US, -1, -1)
    station.send(pitch_yaw(-1.0, YAW_RAD))
    station.run(3.0)
    assert gimbal(station).pitch_rad == -0.5


@BOTH
def test_control_is_taken_given_up_and_not_given_up_for_others(personality: type[Personality]) -> None:
    station = flying(personality)
    assert primary(station) == (0, 0)
    assert station.command(CONFIGURE, *US, -1, -1) == [mavlink.MAV_RESULT_ACCEPTED]
    assert primary(station) == US
    release = mavlink.MAVLink_command_long_message(1, 1, CONFIGURE, 0, -3, -3, -1, -1, 0, 0, 0)
    send_as(station, STATION, release)
    assert primary(station) == US
    send_as(station, STATION, mavlink.MAVLink_command_long_message(1, 1, CONFIGURE, 0, *STATION, -1, -1, 0, 0, 0))
    assert primary(station) == STATION
    assert station.command(CONFIGURE, -1, -1, -1, -1) == [mavlink.MAV_RESULT_ACCEPTED]
    assert primary(station) == STATION
    send_as(station, STATION, release)
    assert primary(station) == (0, 0)


@BOTH
@pytest.mark.parametrize(("flags", "turns"), [(LOCK, False), (0, True)])
def test_the_yaw_turns_with_the_vehicle_only_where_it_is_not_locked(
    personality: type[Personality],
    flags: int,
    turns: bool,  # noqa: FBT001
) -> None:
    station = flying(personality, mode="GUIDED" if personality is ArduCopter else "POSCTL")
    station.command(CONFIGURE, *US, -1, -1)
    station.send(attitude(-0.5, YAW_RAD if flags else 0.0, flags))
    if personality is ArduCopter:
        station.run(4.0, velocity(yaw_rate_dps=20.0))
    else:
        station.autopilot.set_sticks(yaw=0.5)
        station.run(4.0)
    turned_rad = math.remainder(station.autopilot.pose.yaw_rad - YAW_RAD, math.tau)
    assert abs(turned_rad) > 0.3
    assert gimbal(station).yaw_rad == pytest.approx(YAW_RAD + turned_rad * turns, abs=0.1)
    assert gimbal(station).pitch_rad == pytest.approx(-0.5, abs=1e-3)


def test_ardupilot_tells_the_yaw_from_the_nose_and_px4_from_north() -> None:
    for personality, flag, yaw_rad in (
        (ArduCopter, mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME, 0.0),
        (Px4, mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_EARTH_FRAME, YAW_RAD),
    ):
        (w, x, y, z), flags = told(flying(personality))
        assert flags & flag
        assert 2 * math.asin(w * y - x * z) / 2 == pytest.approx(-0.5 / 2, abs=0.02)
        assert math.atan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z)) == pytest.approx(yaw_rad, abs=1e-3)


@BOTH
def test_without_a_gimbal_nothing_of_it_is_known(personality: type[Personality]) -> None:
    station = flying(personality, has_gimbal=False)
    assert station.command(CONFIGURE, *US, -1, -1) == [mavlink.MAV_RESULT_UNSUPPORTED]
    for number in (280, 281, 285):
        assert station.command(mavlink.MAV_CMD_REQUEST_MESSAGE, number) == [mavlink.MAV_RESULT_DENIED]
    station.send(attitude(-1.0, 0.0))
    station.run(0.5)
    assert station.autopilot.camera_pose == station.autopilot.pose


@BOTH
def test_the_picture_is_level_however_the_vehicle_leans(personality: type[Personality]) -> None:
    mode = "GUIDED" if personality is ArduCopter else "POSCTL"
    station = flying(personality, mode=mode)
    if personality is ArduCopter:
        station.run(1.0, velocity(5.0, 3.0))
    else:
        station.autopilot.set_sticks(roll=0.7, pitch=-0.7)
        station.run(1.0)
    vehicle, camera = station.autopilot.pose, station.autopilot.camera_pose
    assert math.hypot(vehicle.roll_rad, vehicle.pitch_rad) > 0.05
    assert camera.roll_rad == 0.0
    assert camera.pitch_rad == pytest.approx(-0.5, abs=1e-3)
    assert camera.pos_ned_m == vehicle.pos_ned_m


@pytest.mark.parametrize("name", STAGE_NAMES)
def test_a_stage_without_a_gimbal_carries_its_camera_as_it_is_mounted(name: str) -> None:
    place = stage(name, 7)
    assert (gimbal_of(place) is not None) is place.has_gimbal
    assert (place.carried_camera == place.camera) is not place.has_gimbal


def test_the_gimbals_picture_at_the_start_is_that_of_a_camera_mounted_so() -> None:
    place = stage("under", 7)
    begun = gimbal_of(place)
    assert begun is not None
    fake = FakeAutopilot(
        ArduCopter, start=Start(pos_ned_m=place.start.pos_ned_m, yaw_rad=place.start.yaw_rad), gimbal=begun
    )
    np.testing.assert_allclose(
        place.carried_camera.optical_from_ned(fake.camera_pose), place.camera.optical_from_ned(place.start), atol=1e-12
    )


def flown(
    personality: type[Personality], place: Stage, settings: str, *, until_s: float, delay_s: float = 0.0, engages: bool
) -> Loop:
    """A loop whose autopilot's messages are late; the target is selected, and followed where that is wanted."""
    config = parse(
        f"[camera]\nwidth_px=640\nheight_px=480\nfocal_px={place.camera.focal_px}\nlatency_ms=20\n"
        f"mount_pitch_deg={math.degrees(place.camera.mount_pitch_rad)}\n{settings}"
    )
    loop = Loop(
        place,
        personality,
        config,
        TrueEyes(place),
        wait_s=5.0,
        telemetry_delay_s=delay_s,
        mode="GUIDED" if personality is ArduCopter else None,
    )
    loop.run(1.0)
    loop.commands.append(Select(loop.truth.box))
    loop.run(2.0)
    if engages:
        loop.commands.append(Engage())
    loop.run(until_s)
    return loop


def off_middle_px(loop: Loop, start_s: float) -> tuple[float, float]:
    """The farthest that the target is from the middle of the picture, across and down."""
    boxes = [m.truth for m in loop.moments if m.time_s >= start_s]
    assert None not in boxes
    centers = np.array([box.center_xy for box in boxes if box is not None])
    across, down = np.abs(centers - (320, 240)).max(axis=0)
    return float(across), float(down)


@BOTH
@pytest.mark.parametrize("delay_s", [0.0, 0.06])
def test_what_passes_nearly_underneath_stays_in_the_middle_of_the_picture(
    personality: type[Personality], delay_s: float
) -> None:
    settings = '[gimbal]\naxes="pitch_yaw"\nrate_dps=60\n'
    loop = flown(personality, stage("under", 7), settings, until_s=18.0, delay_s=delay_s, engages=False)
    assert max(off_middle_px(loop, 4.0)) < 45
    assert all(m.setpoint_ned_mps is None for m in loop.moments)


def test_a_gimbal_that_only_pitches_keeps_what_the_vehicle_follows_in_the_middle_of_the_picture() -> None:
    place = replace(stage("straight", 7), has_gimbal=True)
    settings = '[follow]\nmode="follow"\n[limits]\nspeed_mps=10\nradius_m=5000\n[gimbal]\naxes="pitch"\n'
    loop = flown(ArduCopter, place, settings, until_s=25.0, engages=True)
    assert loop.mode == "following"
    across, down = off_middle_px(loop, 5.0)
    assert down < 25
    assert across < 60
    assert loop.moments[-1].true_range_m == pytest.approx(loop.moments[45].true_range_m, rel=0.3)
    assert not any("leaning" in note for m in loop.moments for note in m.notes)
