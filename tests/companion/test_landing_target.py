"""The landing target: where it is, in the words of either autopilot, and only where it was measured from above."""

import math
from itertools import product
from typing import Any

import numpy as np
import pytest
from cockpit import CAMERA, SIZE_HW, Cockpit
from pymavlink.dialects.v20 import common as mavlink

from companion.camera_model import CameraModel, ray_to, rotation
from companion.codec import MavlinkCodec
from companion.config import parse
from companion.landing import landing_target
from companion.target import measure
from companion.types import Attitude, LandingTarget, LocalState, Select
from companion.wire import Wire
from mscf import Box
from sim.ardupilot import ArduCopter
from sim.autopilot import Personality
from sim.eyes import TrueEyes
from sim.loop import Loop
from sim.px4 import Px4
from sim.stages import stage

NADIR = CameraModel(SIZE_HW, 500.0, mount_rpy_rad=(0.0, -math.pi / 2, 0.0))
HEIGHT_M = 10.0
LOCAL = LocalState(9.9, (100.0, -50.0, -30.0), (2.0, 0.0, 0.0))  # its origin is not where the target's ground is
ATTITUDES = [Attitude(10.0, *rpy, 0.0) for rpy in product((-0.1, 0.0, 0.12), (-0.12, 0.0, 0.1), (0.0, 2.0))]
DOWN = NADIR.mount_rpy_rad
CONFIG = CAMERA.replace("mount_pitch_deg=-30", "mount_pitch_deg=-90") + '[follow]\nmode="overhead"\n'
SENT = CONFIG + "[landing]\nsend_target=true\n"


def box_of(offset_ned_m: tuple[float, float, float], attitude: Attitude) -> Box:
    uv = NADIR.pixel(ray_to(np.array(offset_ned_m), attitude))
    assert uv is not None
    return Box(uv[0] + 0.5 - 10, uv[1] + 0.5 - 8, 20, 16)


@pytest.mark.parametrize("attitude", ATTITUDES)
@pytest.mark.parametrize("offset_ne_m", [(0.0, 0.0), (2.0, 0.0), (0.0, 2.0), (-1.5, 1.0)])
def test_the_target_is_told_where_it_is(attitude: Attitude, offset_ne_m: tuple[float, float]) -> None:
    offset_ned_m = (*offset_ne_m, HEIGHT_M)
    seen = measure(NADIR, box_of(offset_ned_m, attitude), attitude, 10.0)
    target = landing_target(NADIR, seen, attitude, LOCAL, HEIGHT_M)
    assert target is not None
    assert target.distance_m == pytest.approx(math.hypot(*offset_ned_m))
    np.testing.assert_allclose(target.place_ned_m or (), np.add((100.2, -50.0, -30.0), offset_ned_m), atol=1e-9)
    body_m = np.multiply(target.ray_frd, target.distance_m)
    ned_from_body = rotation(attitude.roll_rad, attitude.pitch_rad, attitude.yaw_rad)
    np.testing.assert_allclose(ned_from_body @ body_m, offset_ned_m, atol=1e-9)
    assert target.time_s == 10.0
    assert target.size_rad == pytest.approx((0.04, 0.032), abs=1e-4)


@pytest.mark.parametrize("height_m", [None, 0.0, -3.0])
def test_without_a_height_there_is_a_direction_only(height_m: float | None) -> None:
    level = Attitude(10.0, 0.0, 0.0, 0.0, 0.0)
    target = landing_target(NADIR, measure(NADIR, Box(310, 230, 20, 20), level, 10.0), level, LOCAL, height_m)
    assert target is not None
    assert (target.distance_m, target.place_ned_m) == (None, None)


@pytest.mark.parametrize(("pitch_deg", "is_told"), [(-90, True), (-72, True), (-68, False), (-30, False), (0, False)])
def test_a_camera_that_does_not_look_down_tells_nothing(pitch_deg: float, is_told: bool) -> None:  # noqa: FBT001
    level = Attitude(10.0, 0.0, 0.0, 0.0, 0.0)
    camera = NADIR.mounted((0.0, math.radians(pitch_deg), 0.0))
    seen = measure(camera, Box(310, 230, 20, 20), level, 10.0)
    assert (landing_target(camera, seen, level, LOCAL, HEIGHT_M) is not None) is is_told


# ----------------------------------------------------------------------------------------------- messages
WHOLE = LandingTarget(12.5, (0.0, 0.6, 0.8), 10.0, (1.0, 2.0, 3.0), (0.04, 0.03))
NO_PLACE = LandingTarget(12.5, (0.0, 0.6, 0.8), 10.0, None, (0.04, 0.03))
NO_DISTANCE = LandingTarget(12.5, (0.6, 0.0, 0.8), None, None, (0.04, 0.03))
COPTER, PX4 = 3, 12


def sent(target: LandingTarget, autopilot: int) -> list[Any]:
    wire = Wire()
    codec = MavlinkCodec(wire)
    other = mavlink.MAVLink(None, srcSystem=7, srcComponent=1)
    data = mavlink.MAVLink_heartbeat_message(2, autopilot, 0x81, 4, 4, 3).pack(other)
    codec.receive(wire.receive(bytes(data)), 1.0)
    codec.send_landing_target(target)
    return mavlink.MAVLink(None).parse_buffer(b"".join(wire.drain())) or []


@pytest.mark.parametrize("target", [WHOLE, NO_PLACE])
def test_ardupilot_is_told_a_position_in_the_bodys_axes(target: LandingTarget) -> None:
    (message,) = sent(target, COPTER)
    assert message.position_valid == 1
    assert message.frame == mavlink.MAV_FRAME_BODY_FRD
    assert (message.x, message.y, message.z, message.distance) == pytest.approx((0.0, 6.0, 8.0, 10.0))
    assert message.time_usec == 12_500_000
    assert (message.size_x, message.size_y) == pytest.approx((0.04, 0.03))


@pytest.mark.parametrize("ray_frd", [(0.6, 0.0, 0.8), (0.0, 0.6, 0.8), (-0.36, -0.48, 0.8)])
def test_ardupilot_is_told_angles_where_there_is_no_distance(ray_frd: tuple[float, float, float]) -> None:
    """It makes (-tan(angle_y), tan(angle_x), 1) of them, in the body's axes."""
    (message,) = sent(LandingTarget(12.5, ray_frd, None, None, (0.0, 0.0)), COPTER)
    assert (message.position_valid, message.distance) == (0, 0.0)
    read = np.array([-math.tan(message.angle_y), math.tan(message.angle_x), 1.0])
    np.testing.assert_allclose(read / np.linalg.norm(read), ray_frd, atol=1e-6)


def test_px4_is_told_a_place_in_the_local_frame() -> None:
    (message,) = sent(WHOLE, PX4)
    assert message.position_valid == 1
    assert message.frame == mavlink.MAV_FRAME_LOCAL_NED
    assert (message.x, message.y, message.z) == (1.0, 2.0, 3.0)


@pytest.mark.parametrize("target", [NO_PLACE, NO_DISTANCE])
def test_px4_is_told_nothing_where_there_is_no_place(target: LandingTarget) -> None:
    assert sent(target, PX4) == []


def test_nothing_is_told_before_an_autopilot_is_there() -> None:
    wire = Wire()
    MavlinkCodec(wire).send_landing_target(WHOLE)
    assert wire.drain() == ()


# ----------------------------------------------------------------------------------------- in the controller
def test_every_measured_frame_is_told_once_and_it_moves_nothing() -> None:
    cockpit = Cockpit(SENT).track()
    told = [output.landing for output in cockpit.run(1.0)]
    assert all(target is not None for target in told)
    assert len({target.time_s for target in told if target is not None}) == 16
    assert {output.setpoint for output in cockpit.outputs} == {None}
    cockpit.muted = {"frames"}
    assert {output.landing for output in cockpit.run(0.25)} == {None}
    cockpit.muted = set()
    cockpit.is_seen = False
    assert {output.landing for output in cockpit.run(0.25)} == {None}


def test_the_time_told_is_that_of_the_exposure() -> None:
    cockpit = Cockpit(SENT.replace("latency_ms=0", "latency_ms=80")).track()
    landing, sample = cockpit.outputs[-1].landing, cockpit.inputs[-1].track
    assert landing is not None
    assert sample is not None
    assert landing.time_s == pytest.approx(sample.captured_s - 0.08)


def test_it_is_off_by_default() -> None:
    assert {output.landing for output in Cockpit(CONFIG).track().run(1.0)} == {None}


def test_following_is_the_same_with_and_without_it() -> None:
    with_it, without = Cockpit(SENT).engage(), Cockpit(CONFIG).engage()
    assert [o.setpoint for o in with_it.outputs] == [o.setpoint for o in without.outputs]


@pytest.mark.parametrize("kind", [ArduCopter, Px4])
def test_in_the_loop_an_autopilot_hears_where_the_target_is(kind: type[Personality]) -> None:
    place = stage("overhead", 7)
    config = parse(SENT.replace("focal_px=554", f"focal_px={place.camera.focal_px}"))
    loop = Loop(place, kind, config, TrueEyes(place), delay_s=0.02)
    parser, heard = mavlink.MAVLink(None), []
    while loop.time_s < 4.0:
        if loop.time_s == 1.0:
            loop.commands.append(Select(loop.truth.box))
        loop.tick()
        messages = parser.parse_buffer(loop.step.data) if loop.step is not None else None
        vehicle = loop.autopilot.pose
        off_m = np.subtract(loop.stage.target.motion.pose(loop.world_s).pos_ned_m, vehicle.pos_ned_m)
        for message in messages or ():
            if message.get_type() == "LANDING_TARGET":
                told_m = np.array([message.x, message.y, message.z])
                if kind is Px4:
                    heard.append((told_m - vehicle.pos_ned_m, off_m))
                else:
                    heard.append((vehicle.ned_from_body() @ told_m, off_m))
    assert len(heard) > 50
    for told_m, off_m in heard:
        np.testing.assert_allclose(told_m, off_m, atol=0.8)  # the box's middle is on its roof
