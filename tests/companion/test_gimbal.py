"""The gimbal: which way each axis counts, when it looked where, who may turn it, and where to."""

import math
from dataclasses import replace
from itertools import pairwise, product

import cv2
import numpy as np
import pytest
from cockpit import AHEAD, CAMERA, SIZE_HW, STEP_S, Cockpit, sent, speed_mps

from companion.camera_model import CameraModel, angles, rotation, wrapped
from companion.config import GimbalConfig
from companion.gimbal import IN_USE, MAX_TURN_RADPS, TAKEN_OVER, Gimbal, GimbalHistory, mounted
from companion.modes import Mode
from companion.target import Measurement, Rate, TargetEstimate, estimate, measure
from companion.types import (
    Attitude,
    Claim,
    Deselect,
    Engage,
    GimbalAim,
    GimbalAttitude,
    GimbalControl,
    GimbalManager,
    GimbalOrder,
    Holder,
    LinkEvent,
    Rebooted,
    Select,
)
from mscf import Box
from mscf.arrays import Real64

CONFIG = CAMERA + '[follow]\nmode="spotlight"\n[gimbal]\naxes="pitch_yaw"\nrate_dps=40\n'
MODEL = CameraModel(SIZE_HW, 500.0, mount_rpy_rad=(0.3, -0.9, 1.0))  # a mount that is not to count
MIDDLE = Box(310, 230, 20, 20)
ENDLESS = GimbalManager((math.radians(-90), math.radians(30)), None, can_lock_yaw=True)
BOTH_AXES = GimbalConfig(axes="pitch_yaw", rate_dps=40)
PITCH_ONLY = GimbalConfig(axes="pitch", rate_dps=40)
LEVEL = Attitude(10.0, 0.0, 0.0, 0.0, 0.0)
AT_NORTH = rotation(0.0, 0.0, 0.0)  # where a camera looks
VEHICLES = [Attitude(0.0, *rpy, 0.0) for rpy in product((-0.3, 0.0, 0.2), (-0.4, 0.0, 0.3), (-3.0, 0.0, 2.0))]


# ------------------------------------------------------------------------------------------------ geometry
@pytest.mark.parametrize("rpy_rad", [*product((-2.0, 0.0, 0.7), (-1.5, -0.4, 0.0, 1.5), (-3.0, 0.0, 1.2))])
def test_angles_are_those_that_the_rotation_was_made_of(rpy_rad: tuple[float, float, float]) -> None:
    assert angles(rotation(*rpy_rad)) == pytest.approx(rpy_rad)


@pytest.mark.parametrize(
    ("pitch_rad", "roll_rad", "yaw_rad"), [*product((-math.pi / 2, math.pi / 2), (0, 0.4), (-2, 1))]
)
def test_angles_straight_up_and_down_make_the_same_rotation(pitch_rad: float, roll_rad: float, yaw_rad: float) -> None:
    wanted = rotation(roll_rad, pitch_rad, yaw_rad)
    np.testing.assert_allclose(rotation(*angles(wanted)), wanted, atol=1e-9)


@pytest.mark.parametrize("vehicle", VEHICLES)
@pytest.mark.parametrize(("pitch_rad", "yaw_rad"), [(-0.5, 0.0), (-1.2, 2.5), (0.2, -1.0), (-0.05, -3.1)])
def test_the_middle_of_the_picture_lies_where_the_gimbal_looks_however_the_vehicle_leans(
    vehicle: Attitude, pitch_rad: float, yaw_rad: float
) -> None:
    seen = measure(mounted(MODEL, rotation(0.0, pitch_rad, yaw_rad), vehicle), MIDDLE, vehicle, 0.0)
    assert wrapped(seen.bearing_rad - yaw_rad) == pytest.approx(0.0, abs=2e-3)  # the middle is half a pixel aside
    assert seen.depression_rad == pytest.approx(-pitch_rad, abs=2e-3)
    assert wrapped(seen.azimuth_rad + vehicle.yaw_rad - yaw_rad) == pytest.approx(0.0, abs=2e-3)


@pytest.mark.parametrize("vehicle", VEHICLES)
def test_right_in_the_picture_is_right_on_earth_and_low_is_down(vehicle: Attitude) -> None:
    camera = mounted(MODEL, rotation(0.0, -0.5, 1.0), vehicle)
    middle, right, low = (
        measure(camera, box, vehicle, 0.0) for box in (MIDDLE, replace(MIDDLE, x=360.0), replace(MIDDLE, y=280.0))
    )
    assert right.bearing_rad == pytest.approx(middle.bearing_rad + 0.1 / math.cos(0.5), abs=0.01)
    assert low.depression_rad == pytest.approx(middle.depression_rad + math.atan(0.1), abs=0.01)
    assert low.bearing_rad == pytest.approx(middle.bearing_rad, abs=1e-3)


def test_a_rolled_gimbal_turns_the_picture() -> None:
    """Rolled to the right by a quarter, what is right in the picture is below."""
    camera = mounted(MODEL, rotation(math.pi / 2, 0.0, 0.0), LEVEL)
    assert measure(camera, replace(MIDDLE, x=360.0), LEVEL, 0.0).depression_rad == pytest.approx(0.1, abs=0.01)


# ---------------------------------------------------------------------------------------------------- time
def panning(*, is_on_earth: bool = True, delay_s: float = 0.0) -> GimbalHistory:
    """Turns right by half a radian and down by a quarter a second, told 20 times a second until 10.0 less a delay."""
    history = GimbalHistory()
    for k in range(21):
        time_s = 9.0 + k * 0.05
        if time_s <= 10.0 - delay_s + 1e-9:
            history.add(GimbalAttitude(time_s, 0.0, -0.25 * (time_s - 9), 0.5 * (time_s - 9), is_on_earth))
    return history


@pytest.mark.parametrize("time_s", [9.0, 9.11, 9.5, 9.999])
def test_the_gimbal_is_asked_where_it_looked_at_the_frames_time(time_s: float) -> None:
    found = looked(panning(), time_s)
    np.testing.assert_allclose(found, rotation(0.0, -0.25 * (time_s - 9), 0.5 * (time_s - 9)), atol=1e-4)


def looked(history: GimbalHistory, time_s: float, vehicle: Attitude = LEVEL) -> Real64:
    """Rotation (3, 3) from the camera to NED, where it is known."""
    found = history.at(time_s, vehicle)
    assert found is not None
    return found


def test_a_late_attitude_is_turned_on_for_a_tenth_of_a_second_and_no_longer() -> None:
    late = panning(delay_s=0.1)
    np.testing.assert_allclose(
        looked(late, 9.99), rotation(0.0, -0.2475, 0.495), atol=1e-3
    )  # all axes, not the yaw only
    assert late.at(10.01, LEVEL) is None
    assert late.at(8.99, LEVEL) is None
    assert GimbalHistory().at(10.0, LEVEL) is None


@pytest.mark.parametrize("rate_radps", [9.0, 11.0, 24.0, 60.0])
def test_what_turned_faster_than_any_gimbal_is_between_its_attitudes_but_not_turned_on(rate_radps: float) -> None:
    history = history_of((9.95, rotation(0.0, 0.0, 0.0)), (10.0, rotation(0.0, 0.0, rate_radps * 0.05)))
    further_s = 0.09 if rate_radps < MAX_TURN_RADPS else 0.0
    for time_s, wanted_s in ((9.97, -0.03), (10.0, 0.0), (10.09, further_s)):
        wanted = rotation(0.0, 0.0, rate_radps * (0.05 + wanted_s))
        assert apart_rad(looked(history, time_s), wanted) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("vehicle_yaw_rad", [0.0, 1.0, -2.9])
def test_a_yaw_from_the_nose_turns_with_the_vehicle_and_one_from_north_does_not(vehicle_yaw_rad: float) -> None:
    vehicle = replace(LEVEL, yaw_rad=vehicle_yaw_rad)
    from_nose, from_north = (looked(panning(is_on_earth=on_earth), 9.5, vehicle) for on_earth in (False, True))
    np.testing.assert_allclose(from_nose, rotation(0.0, -0.125, 0.25 + vehicle_yaw_rad), atol=1e-9)
    np.testing.assert_allclose(from_north, rotation(0.0, -0.125, 0.25), atol=1e-9)


@pytest.mark.parametrize(("roll_rad", "pitch_rad"), [(0.4, 0.0), (0.0, -0.5), (-0.3, 0.2)])
def test_a_yaw_from_the_nose_does_not_lean_with_the_vehicle(roll_rad: float, pitch_rad: float) -> None:
    """The frame of the gimbal turns with the nose and stays level."""
    leaning = Attitude(9.5, roll_rad, pitch_rad, 1.0, 0.0)
    found = looked(panning(is_on_earth=False), 9.5, leaning)
    np.testing.assert_allclose(found, rotation(0.0, -0.125, 1.25), atol=1e-9)


def test_angles_in_two_frames_are_never_mixed() -> None:
    history = panning(is_on_earth=False)
    history.add(GimbalAttitude(10.05, 0.0, -0.3, 2.0, is_yaw_on_earth=True))
    assert history.at(10.02, LEVEL) is None
    found = looked(history, 10.05, replace(LEVEL, yaw_rad=1.0))
    np.testing.assert_allclose(found, rotation(0.0, -0.3, 2.0), atol=1e-9)


def history_of(*told: tuple[float, Real64]) -> GimbalHistory:
    """Of times and rotations (3, 3) from the camera to NED."""
    history = GimbalHistory()
    for time_s, ned_from_camera in told:
        history.add(GimbalAttitude(time_s, *angles(ned_from_camera), is_yaw_on_earth=True))
    return history


def apart_rad(first: Real64, second: Real64) -> float:
    """Angle of the turn from one rotation (3, 3) to another; where it is small, from its sine, which is exact there."""
    turn = first.T @ second
    sine = math.hypot(turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]) / 2
    return math.atan2(sine, (float(np.trace(turn)) - 1) / 2)


WORLDS = [*product((0.0, 1.3, 3.0), (-math.pi / 2, -0.8, 0.9), (-2.0, 0.5))]


@pytest.mark.parametrize("world", WORLDS)
@pytest.mark.parametrize("time_s", [9.02, 9.05, 9.13, 9.19])  # between, between others, and beyond the newest
def test_what_lies_between_two_attitudes_turns_with_the_world(world: tuple[float, float, float], time_s: float) -> None:
    turn = rotation(*world)
    told = [(9.0, rotation(0.1, -1.2, 0.4)), (9.06, rotation(-0.2, -1.4, 1.0)), (9.1, rotation(0.0, -1.1, 1.2))]
    found = looked(history_of(*told), time_s)
    turned = looked(history_of(*((when_s, turn @ ned_from_camera) for when_s, ned_from_camera in told)), time_s)
    assert apart_rad(turn @ found, turned) < 1e-3  # as near as angles tell a rotation that looks straight down


@pytest.mark.parametrize("share", [0.0, 0.25, 0.5, 0.9, 1.0, 1.5, 2.0])
def test_a_gimbal_that_turns_about_any_axis_turns_on_evenly_between_two_attitudes_and_beyond_them(share: float) -> None:
    axis = np.array([0.48, -0.6, 0.64])
    start = rotation(0.2, -1.5, 2.0)

    def turned(angle_rad: float) -> Real64:
        return np.asarray(cv2.Rodrigues(axis * angle_rad)[0] @ start)

    history = history_of((9.0, turned(0.0)), (9.05, turned(0.3)))
    assert apart_rad(looked(history, 9.0 + 0.05 * share), turned(0.3 * share)) < 1e-9


@pytest.mark.parametrize("yaw_rad", [-2.0, 0.0, 3.1])
@pytest.mark.parametrize("share", [0.0, 0.3, 0.5, 0.8, 1.0, 1.7])
def test_a_gimbal_that_swings_through_straight_down_does_not_turn_round(yaw_rad: float, share: float) -> None:
    """Behind it, its angles say that it looks the other way and has rolled by half a turn."""
    before, after = (rotation(0.0, -math.pi / 2 + off_rad, yaw_rad) for off_rad in (0.05, -0.05))
    found = looked(history_of((9.0, before), (9.05, after)), 9.0 + 0.05 * share)
    assert apart_rad(found, rotation(0.0, -math.pi / 2 + 0.05 - 0.1 * share, yaw_rad)) < 1e-9


SPLITS = [*product((-2.5, -0.7, 0.0, 1.9), (-3.0, 0.3, 1.4))]


@pytest.mark.parametrize(("first_rad", "second_rad"), SPLITS)
@pytest.mark.parametrize("time_s", [9.0, 9.02, 9.05, 9.09])
def test_straight_down_it_is_the_same_camera_however_yaw_and_roll_share_its_turn(
    first_rad: float, second_rad: float, time_s: float
) -> None:
    """Down, a roll of one and a yaw of another amount make the turn of their sum; the gimbal stands."""
    history, turn_rad = GimbalHistory(), 0.6
    for when_s, roll_rad in ((9.0, first_rad), (9.05, second_rad)):
        history.add(GimbalAttitude(when_s, roll_rad, -math.pi / 2, turn_rad - roll_rad, is_yaw_on_earth=True))
    assert apart_rad(looked(history, time_s), rotation(0.0, -math.pi / 2, turn_rad)) < 1e-9


@pytest.mark.parametrize("off_rad", [0.0, 1e-3, 0.02])
@pytest.mark.parametrize("age_s", [-0.05, 0.02, 0.06, 0.1])  # of the newest attitude at the frame's time
def test_looking_down_noise_moves_what_a_pixel_sees_by_no_more_than_itself_and_its_rate(
    off_rad: float, age_s: float
) -> None:
    noise_rad, gap_s, rng = math.radians(0.1), 1 / 30, np.random.default_rng(7)
    truth = rotation(0.0, -math.pi / 2 + off_rad, 0.8)
    aside = replace(MIDDLE, x=410.0)
    wanted = measure(mounted(MODEL, truth, LEVEL), aside, LEVEL, 0.0)
    worst_rad = 0.0
    for _ in range(50):
        told = [(9.0 + k * gap_s, truth @ rotation(*rng.uniform(-noise_rad, noise_rad, 3))) for k in range(5)]
        found = looked(history_of(*told), 9.0 + 4 * gap_s + age_s)
        seen = measure(mounted(MODEL, found, LEVEL), aside, LEVEL, 0.0)
        worst_rad = max(worst_rad, apart_rad(truth, found), abs(wrapped(seen.depression_rad - wanted.depression_rad)))
        # the same turn of the camera is a larger one of the bearing the nearer to straight down the pixel looks
        turned_rad = abs(wrapped(seen.bearing_rad - wanted.bearing_rad)) * math.cos(wanted.depression_rad)
        worst_rad = max(worst_rad, turned_rad)
    turns = max(age_s, 0.0) / gap_s  # by which the noise of the rate grows
    assert worst_rad <= math.sqrt(3) * noise_rad * (1 + 2 * turns) + 1e-4


def test_two_attitudes_that_are_hardly_apart_do_not_tell_how_fast_it_turns() -> None:
    """The same one by two ways, say: their noise would be turned on for a tenth of a second."""
    history = history_of(
        (9.0, rotation(0.0, -0.5, 0.0)), (9.05, rotation(0.0, -0.5, 0.1)), (9.0501, rotation(0.0, -0.501, 0.1))
    )
    assert apart_rad(looked(history, 9.1), rotation(0.0, -0.501, 0.2)) < 0.01


@pytest.mark.parametrize(("gap_s", "is_known"), [(0.1, True), (0.29, True), (0.31, False)])
def test_over_a_gap_no_attitude_is_made_up(gap_s: float, is_known: bool) -> None:  # noqa: FBT001 - a table
    first, second = rotation(0.0, -0.5, 0.0), rotation(0.0, -0.5, 0.2)
    history = history_of((9.0, first), (9.0 + gap_s, second))
    assert (history.at(9.0 + gap_s / 2, LEVEL) is not None) is is_known
    on_rad = apart_rad(looked(history, 9.05 + gap_s), second)
    assert (on_rad > 0.01) is is_known  # without a rate it stands


def test_aiming_begins_where_a_gimbal_looks_straight_down_however_its_yaw_and_roll_share_the_turn() -> None:
    """Else it would begin with a turn by whatever the noise has made of the yaw."""
    for roll_rad in (0.0, 0.5, -2.0):
        camera = rotation(roll_rad, -math.pi / 2, 0.7 - roll_rad)
        _, aim = Gimbal(ENDLESS).aimed(seen_at(0.7, math.pi / 2), LEVEL, camera, 10.0, BOTH_AXES)
        assert (aim.pitch_rad, aim.yaw_rad) == pytest.approx((-math.pi / 2, 0.7))


# -------------------------------------------------------------------------------------------------- control
NOT, SEEN, GONE = math.inf, 0.1, 12.0  # s since the target was measured or selected; given up after 10


@pytest.mark.parametrize(
    ("holder", "selection", "lost_s", "was_ours", "claim", "is_ours", "text"),
    [
        (Holder.NOBODY, None, NOT, False, None, False, ""),
        (Holder.NOBODY, 4, SEEN, False, Claim.TAKE, False, ""),
        (Holder.NOBODY, 4, SEEN, True, Claim.TAKE, False, ""),  # given to nobody, or a manager that began anew
        (Holder.NOBODY, 4, GONE, True, None, False, ""),
        (Holder.US, None, NOT, True, Claim.RELEASE, False, ""),
        (Holder.US, None, NOT, False, Claim.RELEASE, False, ""),  # left over from a process that died
        (Holder.US, 4, SEEN, False, None, True, ""),
        (Holder.US, 4, SEEN, True, None, True, ""),
        (Holder.US, 4, GONE, True, Claim.RELEASE, False, ""),
        (Holder.OTHER, None, NOT, False, None, False, ""),
        (Holder.OTHER, 4, SEEN, False, None, False, IN_USE),
        (Holder.OTHER, 4, SEEN, True, None, False, TAKEN_OVER),
        (Holder.OTHER, 4, GONE, True, None, False, ""),
        (None, 4, SEEN, True, None, False, ""),  # its manager is silent: nobody knows who has it
        (None, None, NOT, True, None, False, ""),
    ],
)
def test_control_is_taken_from_nobody_only_and_given_up_for_good(
    holder: Holder | None,
    selection: int | None,
    lost_s: float,
    was_ours: bool,  # noqa: FBT001
    claim: Claim | None,
    is_ours: bool,  # noqa: FBT001
    text: str,
) -> None:
    control = GimbalControl(9.9, holder) if holder is not None else GimbalControl(8.0, Holder.US)
    gimbal = Gimbal(ENDLESS, control, is_ours=was_ours)
    after, asked, said = gimbal.claimed(selection, lost_s, 10.0, 10.0)
    assert (asked, after.is_ours, said) == (claim, is_ours, text)


@pytest.mark.parametrize("holder", Holder)
@pytest.mark.parametrize("first", [(Holder.OTHER, SEEN), (Holder.US, GONE)])
def test_what_was_let_go_is_not_taken_again_before_another_selection(
    first: tuple[Holder, float], holder: Holder
) -> None:
    gimbal, _, _ = Gimbal(ENDLESS, GimbalControl(10.0, first[0]), is_ours=True).claimed(4, first[1], 10.0, 10.0)
    gimbal = gimbal.after(GimbalControl(12.0, holder))
    same, claim, text = gimbal.claimed(4, SEEN, 10.0, 12.0)
    assert (same.is_ours, text) == (False, "")
    assert claim is (Claim.RELEASE if holder is Holder.US else None)
    other, claim, _ = gimbal.claimed(5, SEEN, 10.0, 12.0)
    assert other.is_ours is (holder is Holder.US)
    assert claim is (Claim.TAKE if holder is Holder.NOBODY else None)


def test_an_order_without_effect_is_given_again_once_a_second() -> None:
    gimbal, claims = Gimbal(ENDLESS), []
    for k in range(41):
        now_s = 10.0 + k * STEP_S
        gimbal = gimbal.after(GimbalControl(now_s, Holder.NOBODY))
        gimbal, claim, _ = gimbal.claimed(4, SEEN, 10.0, now_s)
        claims.append(claim)
    assert claims.count(Claim.TAKE) == 3
    assert claims[0] is Claim.TAKE


def test_who_has_control_is_not_known_after_a_reboot() -> None:
    gimbal = Gimbal(ENDLESS, GimbalControl(10.0, Holder.US)).after(Rebooted(10.0))
    assert not gimbal.claimed(4, SEEN, 10.0, 10.0)[0].is_ours


# --------------------------------------------------------------------------------------------------- aiming
def seen_at(bearing_rad: float, depression_rad: float, time_s: float = 10.0) -> TargetEstimate:
    box = Box(310, 230, 20, 20)
    flat = math.cos(depression_rad)
    ray = np.array([flat * math.cos(bearing_rad), flat * math.sin(bearing_rad), math.sin(depression_rad)])
    seen = Measurement(
        time_s,
        box,
        bearing_rad,
        bearing_rad,
        depression_rad,
        depression_rad,
        0.2,
        ray,
        is_size_valid=True,
        off_nose_rad=0,
    )
    return estimate(seen, None, None, None)


def turned(
    target: TargetEstimate,
    *,
    duration_s: float = 10.0,
    config: GimbalConfig = BOTH_AXES,
    manager: GimbalManager = ENDLESS,
    vehicle: Attitude = LEVEL,
    camera: Real64 = AT_NORTH,
) -> list[GimbalAim]:
    """Aims, a step each, at a target that stands and is seen again and again, from where the gimbal looked."""
    gimbal, aims = Gimbal(manager), []
    for k in range(round(duration_s / STEP_S) + 1):
        now_s = 10.0 + k * STEP_S
        target = replace(target, seen=replace(target.seen, time_s=now_s))
        gimbal, aim = gimbal.aimed(target, vehicle, camera, now_s, config)
        aims.append(aim)
    return aims


@pytest.mark.parametrize(
    ("bearing_deg", "depression_deg"), [(0, 20), (90, 20), (-90, 45), (179, 5), (-179, 80), (30, -10), (45, 89)]
)
def test_the_gimbal_comes_to_look_at_the_target(bearing_deg: float, depression_deg: float) -> None:
    aim = turned(seen_at(math.radians(bearing_deg), math.radians(depression_deg)))[-1]
    assert aim.is_yaw_on_earth
    assert (math.degrees(aim.pitch_rad), math.degrees(aim.yaw_rad)) == pytest.approx((-depression_deg, bearing_deg))


def test_the_gimbal_begins_where_it_looks_and_turns_no_faster_than_configured() -> None:
    camera = rotation(0.0, -0.1, 0.2)
    aims = turned(seen_at(2.0, 1.2), camera=camera)
    assert (aims[0].pitch_rad, aims[0].yaw_rad) == pytest.approx((-0.1, 0.2))
    most_rad = math.radians(40.0) * STEP_S + 1e-9
    for before, after in pairwise(aims):
        assert abs(after.pitch_rad - before.pitch_rad) <= most_rad
        assert abs(wrapped(after.yaw_rad - before.yaw_rad)) <= most_rad
    assert aims[-1].yaw_rad == pytest.approx(2.0)


def test_the_gimbal_goes_the_short_way_round_where_it_has_no_ends_and_not_through_them_where_it_has() -> None:
    target, camera = seen_at(math.radians(-170), 0.3), rotation(0.0, 0.0, math.radians(170))
    short = turned(target, camera=camera, duration_s=1.0)
    assert all(abs(aim.yaw_rad) > math.radians(169) for aim in short)
    ends = replace(ENDLESS, yaw_range_rad=(math.radians(-175), math.radians(175)))
    long = turned(target, camera=camera, manager=ends)
    assert any(abs(aim.yaw_rad) < 0.1 for aim in long)
    assert long[-1].yaw_rad == pytest.approx(math.radians(-170))


def test_the_gimbal_stops_at_its_ends_which_turn_with_the_vehicle() -> None:
    manager = GimbalManager((math.radians(-40), 0.0), (math.radians(-60), math.radians(60)), can_lock_yaw=True)
    vehicle = replace(LEVEL, yaw_rad=math.radians(30))
    aim = turned(seen_at(math.radians(120), math.radians(70)), manager=manager, vehicle=vehicle)[-1]
    assert (math.degrees(aim.pitch_rad), math.degrees(aim.yaw_rad)) == pytest.approx((-40, 90))


def test_a_gimbal_that_cannot_keep_its_yaw_on_earth_is_told_it_from_the_nose() -> None:
    vehicle = replace(LEVEL, yaw_rad=0.5)
    aim = turned(seen_at(0.8, 0.4), manager=replace(ENDLESS, can_lock_yaw=False), vehicle=vehicle)[-1]
    assert (aim.pitch_rad, aim.yaw_rad) == pytest.approx((-0.4, 0.3))
    assert not aim.is_yaw_on_earth


def test_a_gimbal_without_yaw_looks_along_the_nose_and_as_near_to_the_target_as_it_can() -> None:
    aim = turned(seen_at(0.0, 0.5), config=PITCH_ONLY)[-1]
    assert (aim.pitch_rad, aim.yaw_rad) == pytest.approx((-0.5, 0.0))
    assert not aim.is_yaw_on_earth
    aside = turned(seen_at(1.0, 0.5), config=PITCH_ONLY)[-1]
    rays = rotation(0.0, aside.pitch_rad, 0.0)[:, 0], rotation(0.0, -0.5, 1.0)[:, 0]
    near = float(rays[0] @ rays[1])
    for off_rad in (-0.02, 0.02):
        assert float(rotation(0.0, aside.pitch_rad + off_rad, 0.0)[:, 0] @ rays[1]) < near


def test_towards_what_has_passed_underneath_it_looks_straight_down_while_the_yaw_follows() -> None:
    aims = turned(seen_at(math.pi, math.radians(70)), camera=rotation(0.0, math.radians(-80), 0.0))
    way_rad = [abs(aim.yaw_rad) for aim in aims]
    half = next(k for k, yaw_rad in enumerate(way_rad) if yaw_rad > math.pi / 2)
    assert aims[half - 1].pitch_rad == pytest.approx(-math.pi / 2, abs=0.01)
    assert aims[-1].pitch_rad == pytest.approx(-math.radians(70))


def test_without_a_measurement_the_prediction_is_followed_for_half_a_second_and_then_held() -> None:
    first = seen_at(0.0, 0.3, 9.9)
    target = estimate(replace(seen_at(0.02, 0.3).seen, time_s=10.0), None, None, first)
    assert target.bearing.rate > 0
    gimbal, yaws_rad = Gimbal(ENDLESS), []
    for k in range(33):
        gimbal, aim = gimbal.aimed(target, LEVEL, AT_NORTH, 10.0 + k * STEP_S, BOTH_AXES)
        yaws_rad.append(aim.yaw_rad)
    assert yaws_rad[8] == pytest.approx(target.bearing_at(10.5))
    assert yaws_rad[7] < yaws_rad[8]
    assert set(yaws_rad[9:]) == {yaws_rad[8]}


def test_a_depression_that_grows_is_predicted_to_now() -> None:
    gimbal, rate_radps = Gimbal(ENDLESS), 0.2
    for k in range(80):
        now_s = 10.0 + k * STEP_S
        target = seen_at(0.0, rate_radps * (now_s - 0.2 - 10.0), now_s - 0.2)
        gimbal, aim = gimbal.aimed(target, LEVEL, AT_NORTH, now_s, BOTH_AXES)
    assert aim.pitch_rad == pytest.approx(-rate_radps * (now_s - 10.0), abs=0.005)


def test_another_target_begins_at_its_own_depression() -> None:
    gimbal, _, _ = Gimbal(ENDLESS, GimbalControl(10.0, Holder.US)).claimed(4, SEEN, 10.0, 10.0)
    for time_s in (10.0, 10.1):
        gimbal, _ = gimbal.aimed(seen_at(0.0, 1.2, time_s), LEVEL, AT_NORTH, time_s, BOTH_AXES)
    gimbal, _, _ = gimbal.claimed(5, SEEN, 10.0, 10.2)
    gimbal, _ = gimbal.aimed(seen_at(0.0, 0.2, 10.2), LEVEL, AT_NORTH, 10.2, BOTH_AXES)
    assert gimbal.depression == Rate(0.2)


# ----------------------------------------------------------------------------------------- in the controller
class GimbalCockpit(Cockpit):
    """With a gimbal that looks north and 30 degrees down, like the cockpit's fixed camera, and obeys nobody."""

    def __init__(self, config: str = CONFIG) -> None:
        super().__init__(config)
        self.holder = Holder.NOBODY
        self.pitch_rad, self.gimbal_yaw_rad = math.radians(-30), 0.0

    def _said(self) -> tuple[LinkEvent, ...]:
        said: dict[str, LinkEvent] = {
            "manager": ENDLESS,
            "control": GimbalControl(self.now_s, self.holder),
            "gimbal": GimbalAttitude(self.now_s, 0.0, self.pitch_rad, self.gimbal_yaw_rad, is_yaw_on_earth=True),
        }
        return (*super()._said(), *(event for name, event in said.items() if name not in self.muted))

    @property
    def order(self) -> GimbalOrder:
        return self.outputs[-1].gimbal


def test_the_gimbal_is_turned_and_the_vehicle_left_alone_before_anybody_engages() -> None:
    cockpit = GimbalCockpit().track()
    assert Claim.TAKE in [output.gimbal.claim for output in cockpit.outputs]
    assert all(output.gimbal.aim is None for output in cockpit.outputs)
    cockpit.holder = Holder.US
    outputs = cockpit.run(1.0)
    assert all(output.gimbal.aim is not None for output in outputs)
    assert {sent(output) for output in cockpit.outputs} == {None}
    assert cockpit.mode is Mode.TRACKING


def test_without_the_gimbals_attitude_at_the_frames_time_nothing_is_measured() -> None:
    cockpit = GimbalCockpit()
    cockpit.muted = {"gimbal"}
    cockpit.track()
    assert cockpit.outputs[-1].target is None
    cockpit.muted = set()
    cockpit.run(0.25)
    assert cockpit.outputs[-1].target is not None


@pytest.mark.parametrize("yaw_rad", [-2.0, 0.0, 0.4])
def test_the_vehicle_turns_its_nose_to_the_target_wherever_the_gimbal_looks(yaw_rad: float) -> None:
    cockpit = GimbalCockpit()
    cockpit.gimbal_yaw_rad = yaw_rad
    cockpit.track().step(Engage())
    cockpit.run(1.0)
    setpoint = cockpit.outputs[-1].setpoint
    assert setpoint is not None
    assert np.sign(setpoint.yaw_rate_radps) == np.sign(yaw_rad)
    assert setpoint.velocity_ned_mps == (0.0, 0.0, 0.0)


def test_another_station_that_takes_the_gimbal_has_it_at_once_and_the_operator_hears_it_once() -> None:
    cockpit = GimbalCockpit().track()
    cockpit.holder = Holder.US
    cockpit.run(0.5)
    cockpit.holder = Holder.OTHER
    outputs = cockpit.run(3.0)
    assert {output.gimbal for output in outputs} == {GimbalOrder(None, None)}
    assert cockpit.texts.count(TAKEN_OVER) == 1
    cockpit.holder = Holder.NOBODY
    assert {output.gimbal for output in cockpit.run(3.0)} == {GimbalOrder(None, None)}
    cockpit.step(Select(AHEAD))
    assert Claim.TAKE in [output.gimbal.claim for output in cockpit.run(1.5)]


def test_another_selection_keeps_the_gimbal() -> None:
    cockpit = GimbalCockpit().track()
    cockpit.holder = Holder.US
    cockpit.run(2.0)
    cockpit.muted = {"frames"}
    cockpit.step(Select(AHEAD))
    assert {output.gimbal for output in cockpit.run(1.0)} == {GimbalOrder(None, None)}  # nothing to look at yet
    cockpit.muted = set()
    assert cockpit.run(0.5)[-1].gimbal.aim is not None


def test_deselecting_gives_the_gimbal_up() -> None:
    cockpit = GimbalCockpit().track()
    cockpit.holder = Holder.US
    cockpit.run(2.0)
    cockpit.step(Deselect())
    assert cockpit.order == GimbalOrder(Claim.RELEASE, None)


def test_a_target_that_stays_lost_is_held_in_the_same_direction_and_then_given_up() -> None:
    cockpit = GimbalCockpit(CONFIG + "[loss]\ngive_up_after_s=5\n").track()
    cockpit.holder = Holder.US
    cockpit.run(1.0)
    cockpit.is_seen = False
    outputs = cockpit.run(6.0)
    aims = [output.gimbal.aim for output in outputs]
    assert len({*aims[10:70]}) == 1
    assert aims[70] is not None
    assert [output.gimbal for output in outputs[80:] if output.gimbal.claim] == [GimbalOrder(Claim.RELEASE, None)]
    assert aims[-1] is None


FOLLOWED = CONFIG.replace("spotlight", "follow").replace("mount_pitch_deg=-30", "mount_pitch_deg=-30\nmount_yaw_deg=90")


def test_a_target_at_the_upper_border_is_followed_as_fast_as_any_other() -> None:
    """A fixed camera would have to be kept from leaning; the gimbal looks up by itself."""
    cockpit = GimbalCockpit(FOLLOWED).track()
    cockpit.step(Engage())
    cockpit.pitch_rad = math.radians(-45)
    cockpit.box = Box(305, 2, 31, 23)
    outputs = cockpit.run(2.0)
    assert speed_mps(outputs[-1]) > 0.5
    assert not any("leaning" in note for output in outputs for note in output.notes)


def test_a_steep_look_is_not_too_close_before_the_gimbals_end() -> None:
    cockpit = GimbalCockpit(FOLLOWED)
    cockpit.pitch_rad = math.radians(-65)
    cockpit.track().step(Engage())
    assert not any("too close" in note for output in cockpit.run(1.0) for note in output.notes)
    cockpit.pitch_rad = math.radians(-82)
    assert any("too close" in note for output in cockpit.run(1.0) for note in output.notes)


@pytest.mark.parametrize("yaw_rad", [-0.3, 0.3])
def test_a_lost_target_is_searched_for_on_the_side_on_which_the_gimbal_saw_it(yaw_rad: float) -> None:
    cockpit = GimbalCockpit(FOLLOWED + "[loss]\nsearch_after_s=2\n")
    cockpit.gimbal_yaw_rad = yaw_rad
    cockpit.track().step(Engage())
    cockpit.is_seen = False
    output = cockpit.run(3.0)[-1]
    assert output.mode is Mode.SEARCHING
    assert output.setpoint is not None
    assert np.sign(output.setpoint.yaw_rate_radps) == np.sign(yaw_rad)


def test_a_target_that_stands_is_expected_where_the_gimbals_picture_has_it() -> None:
    cockpit = GimbalCockpit()
    cockpit.gimbal_yaw_rad = 1.0
    output = cockpit.track().outputs[-1]
    assert output.expected is not None
    assert output.expected.xy == pytest.approx(AHEAD.center_xy, abs=0.5)
    cockpit.gimbal_yaw_rad = 1.1  # turned right: what stands is further left
    cockpit.muted = {"frames"}
    output = cockpit.step()
    assert output.expected is not None
    assert output.expected.xy[0] < AHEAD.center_xy[0] - 30


def test_after_a_reboot_the_gimbals_old_attitudes_count_no_more() -> None:
    cockpit = GimbalCockpit().track()
    cockpit.muted = {"gimbal"}
    last = cockpit.outputs[-1].target
    for k in range(4):
        cockpit.step(events=(Rebooted(cockpit.now_s),) * (k == 0), dt_s=1 / 64)
    assert cockpit.outputs[-1].target == last


def test_an_operator_hears_that_there_is_no_gimbal() -> None:
    cockpit = GimbalCockpit()
    cockpit.muted = {"manager"}
    cockpit.track()
    assert any("No gimbal heard" in text for text in cockpit.texts)


def test_without_a_gimbal_in_the_configuration_its_events_change_nothing() -> None:
    with_events, without = GimbalCockpit(CAMERA).track(), Cockpit(CAMERA).track()
    assert repr(with_events.outputs) == repr(without.outputs)
