import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.camera_model import CameraModel
from companion.config import FollowConfig
from companion.guidance import (
    BACK_OFF_MPS,
    MAX_PREDICTION_S,
    MIN_TIME_TO_CONTACT_S,
    Aim,
    Caution,
    Guided,
    Moving,
    follow_target,
    kept_in_view,
    overhead,
    spotlight,
    turn,
)
from companion.target import SIZE_TAU_S, Measurement, RangeFix, Rate, TargetEstimate
from companion.types import ZERO, Attitude, LocalState, Setpoint
from mscf import Box

steady = settings(max_examples=200, deadline=None, database=None, derandomize=True)

NOW_S = 10.0
FOLLOW = FollowConfig(mode="follow")
AIM = Aim(range_m=20.0, height_px=100.0, height_m=15.0, depression_rad=math.radians(30))
CAMERA = CameraModel((720, 1280), 900.0, (), (0.0, math.radians(-25), 0.0))


def measured(
    bearing_deg: float = 0.0,
    depression_deg: float = 30.0,
    height_px: float = 100.0,
    time_s: float = NOW_S,
    room_rad: float = 10.0,  # more than a vehicle can lean
) -> Measurement:
    bearing_rad, depression_rad = math.radians(bearing_deg), math.radians(depression_deg)
    flat = math.cos(depression_rad)
    ray = np.array([flat * math.cos(bearing_rad), flat * math.sin(bearing_rad), math.sin(depression_rad)])
    box = Box(600, 300, 40, height_px)
    return Measurement(time_s, box, bearing_rad, 0.0, depression_rad, depression_rad, room_rad, ray, True, 0.0)  # noqa: FBT003


def target_at(
    bearing_deg: float = 0.0,
    range_m: float | None = 20.0,
    *,
    turn_dps: float = 0.0,
    velocity_ne_mps: tuple[float, float] = (0.0, 0.0),
    height_px: float = 100.0,
    growth_per_s: float = 0.0,
    seen: Measurement | None = None,
    is_conflicting: bool = False,
) -> TargetEstimate:
    """A target seen from a vehicle that hovers at the origin of its local frame."""
    bearing_rad = math.radians(bearing_deg)
    fix = RangeFix(range_m, is_conflicting) if range_m is not None else None
    north = east = None
    if range_m is not None:
        north = Rate(range_m * math.cos(bearing_rad), velocity_ne_mps[0])
        east = Rate(range_m * math.sin(bearing_rad), velocity_ne_mps[1])
    return TargetEstimate(
        seen or measured(bearing_deg, height_px=height_px),
        Rate(bearing_rad, math.radians(turn_dps)),
        Rate(math.log(height_px), growth_per_s),
        fix,
        north,
        east,
    )


def headed(yaw_deg: float) -> Attitude:
    return Attitude(NOW_S, 0.0, 0.0, math.radians(yaw_deg), 0.0)


def hovering(pos_ned_m: tuple[float, float, float] = (0.0, 0.0, -15.0)) -> LocalState:
    return LocalState(NOW_S, pos_ned_m, (0.0, 0.0, 0.0))


def followed(
    target: TargetEstimate,
    yaw_deg: float = 0.0,
    *,
    aim: Aim = AIM,
    moving: Moving = Moving(),  # noqa: B008 - frozen
    follow: FollowConfig = FOLLOW,
    camera: CameraModel = CAMERA,
    now_s: float = NOW_S,
) -> Guided:
    return follow_target(target, aim, headed(yaw_deg), hovering(), camera, now_s, moving, follow)


def along(guided: Guided, bearing_deg: float) -> tuple[float, float]:
    """The wished velocity along a bearing and across it to the right, m/s."""
    north, east, _ = guided.wish.velocity_ned_mps
    c, s = math.cos(math.radians(bearing_deg)), math.sin(math.radians(bearing_deg))
    return north * c + east * s, east * c - north * s


# ------------------------------------------------------------------------------------------- turning
@pytest.mark.parametrize("yaw_deg", [0, 90, 179, -179, -60])
@pytest.mark.parametrize("mount_yaw_deg", [0, 90, -30, 180])
@pytest.mark.parametrize("aside_deg", [10, -10, 100, -100])
def test_the_nose_turns_to_the_side_on_which_the_camera_sees_the_target(
    yaw_deg: float, mount_yaw_deg: float, aside_deg: float
) -> None:
    target = target_at(yaw_deg + mount_yaw_deg + aside_deg)
    rate_radps, is_moving = turn(target, headed(yaw_deg), math.radians(mount_yaw_deg), NOW_S, Moving(), FOLLOW)
    assert rate_radps == pytest.approx(FOLLOW.yaw_gain_per_s * math.radians(aside_deg))
    assert is_moving


@pytest.mark.parametrize(
    ("error_deg", "was_moving", "is_moving"),
    [
        (1.9, False, False),
        (2.1, False, True),
        (1.1, True, True),
        (0.9, True, False),
        (-2.1, False, True),
        (-1.1, True, True),
    ],
)
def test_the_dead_zone_is_left_at_its_width_and_entered_at_half_of_it(
    error_deg: float,
    was_moving: bool,  # noqa: FBT001
    is_moving: bool,  # noqa: FBT001
) -> None:
    rate_radps, moving = turn(target_at(error_deg), headed(0), 0.0, NOW_S, Moving(yaw=was_moving), FOLLOW)
    assert moving is is_moving
    assert rate_radps == pytest.approx(FOLLOW.yaw_gain_per_s * math.radians(error_deg) if is_moving else 0.0)


@pytest.mark.parametrize("turn_dps", [15.0, -15.0])
def test_the_targets_own_turning_is_fed_forward_in_the_dead_zone_too(turn_dps: float) -> None:
    rate_radps, _ = turn(target_at(0.0, turn_dps=turn_dps), headed(0), 0.0, NOW_S, Moving(), FOLLOW)
    assert math.degrees(rate_radps) == pytest.approx(0.8 * turn_dps)
    none = replace(FOLLOW, yaw_feed_forward=0.0)
    assert turn(target_at(0.0, turn_dps=turn_dps), headed(0), 0.0, NOW_S, Moving(), none) == (0.0, False)


def test_the_bearing_is_predicted_to_now_with_the_same_share_of_its_rate() -> None:
    target = target_at(10.0, turn_dps=20.0)
    rate_radps, _ = turn(target, headed(0), 0.0, NOW_S + 0.25, Moving(), FOLLOW)
    assert math.degrees(rate_radps) == pytest.approx(1.2 * (10 + 0.8 * 20 * 0.25) + 0.8 * 20)


@pytest.mark.parametrize(
    ("age_s", "turns"), [(0.0, True), (0.45, True), (MAX_PREDICTION_S, True), (0.51, False), (60, False)]
)
def test_a_prediction_turns_the_nose_for_half_a_second_and_no_longer(age_s: float, turns: bool) -> None:  # noqa: FBT001
    rate_radps, is_moving = turn(target_at(20.0, turn_dps=5.0), headed(0), 0.0, NOW_S + age_s, Moving(yaw=True), FOLLOW)
    assert (rate_radps > 0, is_moving) == (turns, turns)
    assert turns or rate_radps == 0


def test_spotlight_turns_and_never_moves() -> None:
    for range_m in (3.0, 20.0, 90.0, None):
        guided = spotlight(target_at(25.0, range_m, growth_per_s=1.0), headed(0), 0.0, NOW_S, Moving(), FOLLOW)
        assert guided.wish.velocity_ned_mps == (0, 0, 0)
        assert guided.wish.yaw_rate_radps == pytest.approx(1.2 * math.radians(25))
        assert guided.moving == Moving(yaw=True)


# ------------------------------------------------------------------------------------------- following
@pytest.mark.parametrize("bearing_deg", [0, 45, 90, 135, 180, -90, -45])
@pytest.mark.parametrize(("range_m", "speed_mps"), [(30, 3.5), (22, 0.7), (18, -1.2), (10, -6.0)])
def test_a_target_too_far_is_approached_and_one_too_near_is_left_along_the_line_of_sight(
    bearing_deg: float, range_m: float, speed_mps: float
) -> None:
    guided = followed(target_at(bearing_deg, range_m), bearing_deg)
    assert along(guided, bearing_deg) == pytest.approx((speed_mps, 0.0), abs=1e-9)
    assert guided.wish.velocity_ned_mps[2] == 0
    assert guided.wish.yaw_rate_radps == pytest.approx(0, abs=1e-9)
    assert guided.cautions == ()


def test_at_its_range_in_the_middle_nothing_is_wished() -> None:
    assert followed(target_at(0.0, 20.0)) == Guided(ZERO, Moving())


@pytest.mark.parametrize(
    ("range_m", "was_moving", "is_moving"),
    [
        (20.9, False, False),
        (21.1, False, True),
        (20.6, True, True),
        (20.4, True, False),
        (18.9, False, True),
        (19.4, True, True),
    ],
)
def test_the_range_has_a_dead_zone_of_a_share_of_itself(
    range_m: float,
    was_moving: bool,  # noqa: FBT001
    is_moving: bool,  # noqa: FBT001
) -> None:
    guided = followed(target_at(0.0, range_m), moving=Moving(range=was_moving))
    assert guided.moving.range is is_moving
    assert (along(guided, 0)[0] != 0) is is_moving


@pytest.mark.parametrize("mount_yaw_deg", [0, 90, -120])
@pytest.mark.parametrize("aside_deg", [20, -20, 29.9])
def test_an_approach_is_slower_aside(mount_yaw_deg: float, aside_deg: float) -> None:
    camera = replace(CAMERA, mount_rpy_rad=(0.0, math.radians(-25), math.radians(mount_yaw_deg)))
    guided = followed(target_at(aside_deg + mount_yaw_deg, 30.0), camera=camera)
    ahead = along(guided, aside_deg + mount_yaw_deg)
    assert ahead == pytest.approx((3.5 * math.cos(math.radians(aside_deg)), 0.0), abs=1e-9)
    assert guided.cautions == ()


@pytest.mark.parametrize("aside_deg", [30.1, -30.1, 90, 179, -150])
def test_beyond_thirty_degrees_there_is_no_approach_but_a_retreat(aside_deg: float) -> None:
    fleeing = target_at(
        aside_deg, 30.0, velocity_ne_mps=(math.cos(math.radians(aside_deg)), math.sin(math.radians(aside_deg)))
    )
    far, near = followed(fleeing), followed(target_at(aside_deg, 10.0))
    assert far.wish.velocity_ned_mps == (0, 0, 0)
    assert Caution.TURN_FIRST in far.cautions
    assert far.wish.yaw_rate_radps * aside_deg > 0
    assert along(near, aside_deg) == pytest.approx((-6.0, 0.0), abs=1e-9)
    assert near.cautions == ()


@pytest.mark.parametrize("bearing_deg", [0, 120])
def test_the_targets_speed_along_the_line_of_sight_is_fed_forward(bearing_deg: float) -> None:
    c, s = math.cos(math.radians(bearing_deg)), math.sin(math.radians(bearing_deg))
    for speed_mps, across_mps in ((2.0, 0.0), (-2.0, 0.0), (1.0, 3.0)):
        velocity = speed_mps * c - across_mps * s, speed_mps * s + across_mps * c
        guided = followed(target_at(bearing_deg, 20.0, velocity_ne_mps=velocity), bearing_deg)
        assert along(guided, bearing_deg) == pytest.approx((0.8 * speed_mps, 0.0), abs=1e-9)


def test_the_range_is_that_of_places_predicted_to_now() -> None:
    target = target_at(0.0, 20.0, velocity_ne_mps=(4.0, 0.0))
    local = LocalState(NOW_S - 0.1, (-0.1, 0.0, -15.0), (-5.0, 0.0, 0.0))
    guided = follow_target(target, AIM, headed(0), local, CAMERA, NOW_S + 0.2, Moving(), FOLLOW)
    error_m = (20 + 4 * 0.2) - (-0.1 - 5 * 0.3) - 20
    assert along(guided, 0)[0] == pytest.approx(0.35 * error_m + 0.8 * 4)


def test_without_a_position_of_the_target_its_range_at_the_frame_counts() -> None:
    target = replace(target_at(0.0, 26.0), north=None, east=None)
    assert along(followed(target), 0)[0] == pytest.approx(0.35 * 6)


@pytest.mark.parametrize(("height_px", "direction"), [(80, 1), (100, 0), (125, -1)])
@pytest.mark.parametrize("aim", [replace(AIM, range_m=None), AIM])
def test_where_no_range_is_known_the_size_is_kept(height_px: float, direction: int, aim: Aim) -> None:
    guided = followed(target_at(0.0, None, height_px=height_px), aim=aim)
    gain_per_s = {1: 0.35, 0: 0.0, -1: 0.6}[direction]
    assert along(guided, 0)[0] == pytest.approx(gain_per_s * 20 * math.log(100 / height_px))
    assert guided.cautions == (Caution.RANGE_UNKNOWN,)


def test_engaged_without_a_range_the_size_is_kept_even_when_one_is_found_later() -> None:
    guided = followed(target_at(0.0, 90.0, velocity_ne_mps=(3.0, 0.0)), aim=replace(AIM, range_m=None))
    assert guided.wish == ZERO
    assert guided.cautions == (Caution.RANGE_UNKNOWN,)


def test_a_size_that_is_cut_off_is_no_reason_to_approach() -> None:
    small, large = target_at(0.0, None, height_px=50), target_at(0.0, None, height_px=200)
    cut = [replace(one, seen=replace(one.seen, is_size_valid=False)) for one in (small, large)]
    assert followed(cut[0]).wish == ZERO
    assert along(followed(cut[1]), 0)[0] < 0


# ------------------------------------------------------------------------------------------- caution
@pytest.mark.parametrize(("range_m", "speed_mps"), [(60.0, 0.0), (10.0, -6.0)])
def test_where_sources_disagree_only_a_retreat_is_left(range_m: float, speed_mps: float) -> None:
    fleeing = target_at(0.0, range_m, is_conflicting=True)
    follow = replace(FOLLOW, vertical_gain_per_s=1.0)
    guided = followed(fleeing, aim=replace(AIM, depression_rad=0.2), follow=follow)
    assert guided.wish.velocity_ned_mps == pytest.approx((speed_mps, 0.0, 0.0))
    assert guided.cautions == (Caution.RANGE_CONFLICT,)
    climbing = followed(fleeing, aim=replace(AIM, depression_rad=1.0), follow=follow)
    assert climbing.wish.velocity_ned_mps[2] < 0


@pytest.mark.parametrize(("height_px", "is_close"), [(503, False), (505, True), (720, True)])
def test_a_box_of_seven_tenths_of_the_frame_backs_off(height_px: float, is_close: bool) -> None:  # noqa: FBT001
    guided = followed(target_at(0.0, 60.0, height_px=height_px))
    assert guided.cautions == ((Caution.TOO_CLOSE,) if is_close else ())
    assert along(guided, 0)[0] == pytest.approx(-BACK_OFF_MPS if is_close else 0.35 * 40)


@pytest.mark.parametrize(
    ("mount_deg", "focal_px", "foot_deg", "is_close"),
    [
        # atan(0.4 * 720 / 900) is 17.74 degrees below the boresight
        (0, 900, 17.7, False),
        (0, 900, 17.8, True),
        (-25, 900, 42.7, False),
        (-25, 900, 42.8, True),
        (10, 900, 7.7, False),
        (10, 900, 7.8, True),
        (-60, 900, 77.8, True),
        # a wide lens on a steep mount sees past the nadir: the foot never gets so low
        (-60, 400, 79.9, False),
        (-60, 400, 80.1, True),
        (-75, 900, 80.1, True),
    ],
)
def test_a_foot_at_nine_tenths_of_a_level_frame_backs_off(
    mount_deg: float,
    focal_px: float,
    foot_deg: float,
    is_close: bool,  # noqa: FBT001
) -> None:
    camera = CameraModel((720, 1280), focal_px, (), (0.0, math.radians(mount_deg), 0.0))
    seen = replace(measured(), foot_depression_rad=math.radians(foot_deg))
    guided = followed(target_at(0.0, 60.0, seen=seen), camera=camera)
    assert (guided.cautions == (Caution.TOO_CLOSE,)) is is_close
    assert (along(guided, 0)[0] == -BACK_OFF_MPS) is is_close


@pytest.mark.parametrize("share", [0.99, 1.01])
def test_a_contact_in_less_than_so_many_seconds_backs_off(share: float) -> None:
    growth_per_s = share / (MIN_TIME_TO_CONTACT_S + 2 * SIZE_TAU_S)
    guided = followed(target_at(0.0, 60.0, growth_per_s=growth_per_s))
    assert guided.cautions == ((Caution.CLOSING_FAST,) if share > 1 else ())
    assert (along(guided, 0)[0] == -BACK_OFF_MPS) is (share > 1)


def test_backing_off_is_no_slower_than_the_law() -> None:
    assert along(followed(target_at(0.0, 10.0, height_px=600)), 0)[0] == pytest.approx(-6.0)


@pytest.mark.parametrize("bearing_deg", [0, 100])
def test_backing_off_leads_away_from_the_target_wherever_the_nose_points(bearing_deg: float) -> None:
    guided = followed(target_at(bearing_deg, 20.0, height_px=600))
    assert along(guided, bearing_deg) == pytest.approx((-BACK_OFF_MPS, 0.0), abs=1e-9)


def test_what_was_seen_too_long_ago_moves_nothing() -> None:
    target, late_s = target_at(20.0, 60.0), NOW_S + MAX_PREDICTION_S + 0.01
    assert followed(target, now_s=late_s) == Guided(ZERO, Moving(), (Caution.TOO_OLD,))
    above = overhead(target, AIM, hovering(), 20.0, late_s, Moving(), FOLLOW)
    assert above == Guided(ZERO, Moving(), (Caution.TOO_OLD,))


# ------------------------------------------------------------------------------------------- height
@pytest.mark.parametrize(
    ("depression_deg", "sign"),
    [
        (40, 1),  # the target is lower than it was: the vehicle is too high and sinks
        (30, 0),
        (20, -1),
    ],
)
def test_the_height_brings_the_target_back_to_its_depression_only_where_that_is_asked_for(
    depression_deg: float, sign: int
) -> None:
    target = target_at(0.0, 20.0, seen=measured(depression_deg=depression_deg))
    assert followed(target).wish.velocity_ned_mps[2] == 0
    down_mps = followed(target, follow=replace(FOLLOW, vertical_gain_per_s=0.5)).wish.velocity_ned_mps[2]
    rise_m = 20 * (math.tan(math.radians(depression_deg)) - math.tan(math.radians(30)))
    assert down_mps == pytest.approx(0.5 * rise_m, abs=1e-9)
    assert np.sign(round(down_mps, 6)) == sign


def test_without_a_range_the_height_is_held() -> None:
    target = target_at(0.0, None, seen=measured(depression_deg=60))
    assert followed(target, follow=replace(FOLLOW, vertical_gain_per_s=0.5)).wish.velocity_ned_mps[2] == 0


@pytest.mark.parametrize("danger", [{"height_px": 600.0}, {"growth_per_s": 1.0}])
def test_nobody_sinks_while_backing_off_but_may_climb(danger: dict[str, float]) -> None:
    follow = replace(FOLLOW, vertical_gain_per_s=0.5)
    for aim_deg, is_climbing in ((10, False), (60, True)):
        aim = replace(AIM, depression_rad=math.radians(aim_deg))
        guided = followed(target_at(0.0, 20.0, **danger), aim=aim, follow=follow)  # type: ignore[arg-type]
        assert (guided.wish.velocity_ned_mps[2] < 0) is is_climbing
        assert guided.wish.velocity_ned_mps[2] <= 0


# ------------------------------------------------------------------------------------------- from above
def above(target: TargetEstimate, *, height_m: float = 20.0, moving: Moving = Moving(), gain: float = 0.0) -> Guided:  # noqa: B008
    follow = FollowConfig(mode="overhead", vertical_gain_per_s=gain)
    return overhead(target, replace(AIM, height_m=20.0), hovering(), height_m, NOW_S, moving, follow)


@pytest.mark.parametrize("bearing_deg", [0, 90, 180, -90, 33])
def test_overhead_moves_over_the_target_whatever_the_heading_and_does_not_turn(bearing_deg: float) -> None:
    guided = above(target_at(bearing_deg, 6.0, turn_dps=30.0))
    assert along(guided, bearing_deg) == pytest.approx((0.35 * 6, 0), abs=1e-9)
    assert guided.wish.yaw_rate_radps == 0
    assert guided.wish.velocity_ned_mps[2] == 0


@pytest.mark.parametrize(
    ("off_m", "was_moving", "is_moving"),
    [(0.0, False, False), (0.9, False, False), (1.1, False, True), (0.6, True, True), (0.4, True, False)],
)
def test_overhead_has_a_dead_zone_of_a_share_of_the_height(
    off_m: float,
    was_moving: bool,  # noqa: FBT001
    is_moving: bool,  # noqa: FBT001
) -> None:
    guided = above(target_at(70.0, off_m), moving=Moving(range=was_moving))
    assert guided.moving == Moving(range=is_moving)
    assert (math.hypot(*guided.wish.velocity_ned_mps) > 0) is is_moving


def test_overhead_goes_with_the_target() -> None:
    guided = above(target_at(0.0, 0.0, velocity_ne_mps=(1.0, -2.0)))
    assert guided.wish.velocity_ned_mps == pytest.approx((0.8, -1.6, 0.0))


def test_overhead_reckons_with_places_predicted_to_now() -> None:
    target, follow = target_at(0.0, 6.0, velocity_ne_mps=(1.0, -2.0)), FollowConfig(mode="overhead")
    local = LocalState(NOW_S - 0.1, (1.0, 0.0, -20.0), (3.0, 1.0, 0.0))
    guided = overhead(target, AIM, local, 20.0, NOW_S + 0.2, Moving(), follow)
    off_m = 6 + 1 * 0.2 - (1 + 3 * 0.3), -2 * 0.2 - 1 * 0.3
    expected = 0.35 * off_m[0] + 0.8 * 1, 0.35 * off_m[1] - 0.8 * 2
    assert guided.wish.velocity_ned_mps[:2] == pytest.approx(expected)


@pytest.mark.parametrize(("height_m", "down_mps"), [(24.0, 2.0), (20.0, 0.0), (16.0, -2.0)])
def test_overhead_keeps_the_height_at_engagement_where_that_is_asked_for(height_m: float, down_mps: float) -> None:
    assert above(target_at(0.0, 0.0), height_m=height_m, gain=0.5).wish.velocity_ned_mps[2] == pytest.approx(down_mps)
    unknown = replace(AIM, height_m=None)
    follow = FollowConfig(mode="overhead", vertical_gain_per_s=0.5)
    guided = overhead(target_at(0.0, 0.0), unknown, hovering(), height_m, NOW_S, Moving(), follow)
    assert guided.wish.velocity_ned_mps[2] == 0


def test_overhead_stands_where_no_place_is_known() -> None:
    assert above(target_at(0.0, None)) == Guided(ZERO, Moving(), (Caution.RANGE_UNKNOWN,))


# ------------------------------------------------------------------------------------------- everything
wide = st.floats(-1e6, 1e6)
angles = st.floats(-math.pi, math.pi)
rates = st.builds(Rate, wide, wide)
targets = st.builds(
    TargetEstimate,
    st.builds(
        Measurement,
        st.floats(NOW_S - 1, NOW_S),
        st.builds(Box, wide, wide, st.floats(1e-3, 1e6), st.floats(1e-3, 1e6)),
        angles,
        angles,
        st.floats(-math.pi / 2, math.pi / 2),
        st.floats(-math.pi / 2, math.pi / 2),
        angles,
        st.just(np.array([1.0, 0.0, 0.0])),
        st.booleans(),
        st.floats(0, math.pi),
    ),
    rates,
    rates,
    st.none() | st.builds(RangeFix, st.floats(0, 1e6), st.booleans()),
    st.none() | rates,
    st.none() | rates,
)
aims = st.builds(Aim, st.none() | st.floats(0.0, 200), st.floats(1e-3, 1e4), st.none() | wide, st.floats(-1.57, 1.57))
locals_ = st.builds(LocalState, st.floats(NOW_S - 0.5, NOW_S), st.tuples(wide, wide, wide), st.tuples(wide, wide, wide))
follows = st.builds(
    FollowConfig,
    yaw_feed_forward=st.floats(0, 0.8),
    size_dead_zone_share=st.floats(0, 0.3),
    vertical_gain_per_s=st.sampled_from([0.0, 1.0]),
)
movings = st.builds(Moving, st.booleans(), st.booleans())


# ------------------------------------------------------------------------------------------ the frame's border
def wish_of(speed_mps: float, bearing_deg: float = 0.0) -> Guided:
    b = math.radians(bearing_deg)
    return Guided(Setpoint((speed_mps * math.cos(b), speed_mps * math.sin(b), 0.3), 0.2), Moving())


@pytest.mark.parametrize("bearing_deg", [0, 70, -160])
@pytest.mark.parametrize(
    ("room_deg", "before_mps", "wish_mps", "kept_mps"),
    [
        (3.0, 2.0, 4.0, 2.0),  # the reserve is reached: no faster
        (23.0, 2.0, 4.0, 2.0 + 9.81 / 2 * math.radians(20) * 0.1),
        (0.0, 2.0, 4.0, 2.0 - 9.81 / 2 * math.radians(3) * 0.1),  # slower, to lean less
        (-30.0, 0.1, 4.0, 0.0),  # never backwards for that
        (40.0, 2.0, 2.1, 2.1),  # enough room for so little
        (0.0, 2.0, 1.5, 1.5),
        (0.0, -1.0, -3.0, -3.0),  # backing off is not hindered
    ],
)
def test_the_speed_ahead_grows_only_while_there_is_room_above_the_target(
    bearing_deg: float, room_deg: float, before_mps: float, wish_mps: float, kept_mps: float
) -> None:
    seen = measured(bearing_deg, room_rad=math.radians(room_deg))
    before = wish_of(before_mps, bearing_deg).wish.velocity_ned_mps[:2]
    kept = kept_in_view(wish_of(wish_mps, bearing_deg), target_at(bearing_deg, seen=seen), before, NOW_S, 0.1, FOLLOW)
    assert along(kept, bearing_deg) == pytest.approx((kept_mps, 0.0), abs=1e-9)
    assert (kept.wish.velocity_ned_mps[2], kept.wish.yaw_rate_radps) == (0.3, 0.2)
    assert (Caution.LEANING in kept.cautions) is (wish_mps - kept_mps > 1.0)


@steady
@given(targets, aims, angles, locals_, st.floats(-1.57, 0.8), angles, movings, follows)
def test_no_finite_input_gives_a_wish_that_is_not_finite_or_an_approach_against_the_rules(
    target: TargetEstimate,
    aim: Aim,
    yaw_rad: float,
    local: LocalState,
    mount_pitch_rad: float,
    mount_yaw_rad: float,
    moving: Moving,
    follow: FollowConfig,
) -> None:
    attitude = Attitude(NOW_S, 0.0, 0.0, yaw_rad, 0.0)
    camera = CameraModel((720, 1280), 900.0, (), (0.0, mount_pitch_rad, mount_yaw_rad))
    looked = spotlight(target, attitude, mount_yaw_rad, NOW_S, moving, follow)
    kept = follow_target(target, aim, attitude, local, camera, NOW_S, moving, follow)
    kept = kept_in_view(kept, target, (1.0, -1.0), NOW_S, 0.05, follow)
    hung = overhead(target, aim, local, 20.0, NOW_S, moving, follow)
    for guided in (looked, kept, hung):
        assert np.isfinite([*guided.wish.velocity_ned_mps, guided.wish.yaw_rate_radps]).all()
    assert looked.wish.yaw_rate_radps == kept.wish.yaw_rate_radps
    ahead = along(kept, math.degrees(target.bearing_at(NOW_S, follow.yaw_feed_forward)))[0]
    careful = {Caution.RANGE_CONFLICT, Caution.TOO_CLOSE, Caution.CLOSING_FAST}
    if not careful.isdisjoint(kept.cautions):
        assert ahead <= 1e-6 * math.hypot(*kept.wish.velocity_ned_mps[:2])
        assert kept.wish.velocity_ned_mps[2] <= 0
    if {Caution.TOO_CLOSE, Caution.CLOSING_FAST} & set(kept.cautions):
        assert ahead <= -BACK_OFF_MPS * (1 - 1e-6)
    if Caution.TOO_OLD in kept.cautions:
        assert kept.wish == hung.wish == ZERO
