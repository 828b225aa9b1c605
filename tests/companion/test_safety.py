import dataclasses
import math
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.config import LimitsConfig
from companion.safety import MAX_STEP_S, RESPONSE_S, Place, SafeSetpoint, held_back_by, limit, stop
from companion.types import ZERO, Setpoint

LIMITS = LimitsConfig()
MIDDLE = Place(height_m=20.0, from_engagement_ne_m=(0.0, 0.0))
STEP_S = 0.05
RIGHT = 1 + 1e-12  # rounding of a norm
steady = settings(max_examples=100, deadline=None, database=None, derandomize=True)

anything = st.floats(allow_nan=True, allow_infinity=True)
places = st.builds(
    Place,
    st.none() | st.floats(-10, 200) | anything,
    st.none() | st.tuples(st.floats(-300, 300), st.floats(-300, 300)) | st.tuples(anything, anything),
)
wishes = st.builds(
    Setpoint,
    st.tuples(anything, anything, anything) | st.tuples(*[st.floats(-20, 20)] * 3),
    st.floats(-5, 5) | anything,
)
envelopes = st.builds(
    LimitsConfig,
    speed_mps=st.floats(0.2, 20),
    climb_mps=st.floats(0.1, 5),
    descent_mps=st.floats(0.1, 3),
    yaw_rate_dps=st.floats(5, 180),
    acceleration_mps2=st.floats(0.2, 5),
    yaw_acceleration_dps2=st.floats(10, 360),
    floor_m=st.floats(1, 50),
    ceiling_m=st.floats(51, 1000),
    radius_m=st.floats(5, 5000),
)
steps = st.tuples(wishes, places, st.floats(-0.1, 0.5) | anything)


def assert_inside(safe: SafeSetpoint, place: Place, limits: LimitsConfig) -> None:
    """The envelope: what is promised of a setpoint whatever came before."""
    north, east, down = safe.velocity_ned_mps
    assert all(map(math.isfinite, (north, east, down, safe.yaw_rate_radps)))
    assert math.hypot(north, east) <= limits.speed_mps * RIGHT
    assert -limits.climb_mps <= down <= limits.descent_mps
    assert abs(safe.yaw_rate_radps) <= math.radians(limits.yaw_rate_dps)
    if place.height_m is None:
        assert down == 0
    elif place.height_m <= limits.floor_m:
        assert down <= 0
    elif place.height_m >= limits.ceiling_m:
        assert down >= 0
    if place.from_engagement_ne_m is None:
        assert (north, east) == (0, 0)
        return
    distance_m = math.hypot(*place.from_engagement_ne_m)
    if 1e-3 <= distance_m < math.inf:
        out = [part / distance_m for part in place.from_engagement_ne_m]
        outwards_mps = max(north * out[0] + east * out[1], 0.0)
        to_stand_m = outwards_mps * RESPONSE_S + outwards_mps**2 / (2 * limits.acceleration_mps2)
        assert to_stand_m <= max(limits.radius_m - distance_m, 0) * (1 + 1e-9) + 1e-6
    elif not distance_m < math.inf:
        assert (north, east) == (0, 0)


def assert_grown_slowly(safe: SafeSetpoint, before: SafeSetpoint, limits: LimitsConfig, dt_s: float) -> None:
    """The slew: nothing grows faster; the envelope and a stop may shorten at once."""
    step_s = min(max(dt_s, 0.0), MAX_STEP_S) if math.isfinite(dt_s) else 0.0
    grown_mps = limits.acceleration_mps2 * step_s + 1e-9
    assert math.hypot(*safe.velocity_ned_mps[:2]) <= math.hypot(*before.velocity_ned_mps[:2]) + grown_mps
    assert abs(safe.velocity_ned_mps[2]) <= abs(before.velocity_ned_mps[2]) + grown_mps
    turned_radps = math.radians(limits.yaw_acceleration_dps2) * step_s + 1e-9
    assert abs(safe.yaw_rate_radps) <= abs(before.yaw_rate_radps) + turned_radps


@steady
@given(envelopes, st.lists(steps, max_size=8))
def test_no_sequence_of_wishes_leaves_the_envelope_or_grows_faster_than_the_slew(
    limits: LimitsConfig, sequence: list[tuple[Setpoint, Place, float]]
) -> None:
    before = None
    for wish, place, dt_s in sequence:
        safe = limit(wish, before, place, limits, dt_s)
        assert_inside(safe, place, limits)
        assert_grown_slowly(safe, before or stop(), limits, dt_s)
        before = safe


@steady
@given(envelopes, envelopes, st.lists(steps, min_size=2, max_size=4))
def test_even_a_setpoint_made_under_wider_limits_leads_into_the_envelope(
    wide: LimitsConfig, limits: LimitsConfig, sequence: list[tuple[Setpoint, Place, float]]
) -> None:
    before = None
    for wish, place, dt_s in sequence:
        safe = limit(wish, before, place, limits, dt_s)
        assert_inside(safe, place, limits)
        before = limit(wish, before, place, wide, dt_s)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_setpoint_far_outside_narrower_limits_is_cut_to_them_at_once(sign: int) -> None:
    wide = LimitsConfig(speed_mps=20, climb_mps=5, descent_mps=3, yaw_rate_dps=180, acceleration_mps2=5)
    before = None
    for _ in range(50):
        before = limit(Setpoint((0.0, sign * 20.0, sign * 5.0), sign * 3.0), before, MIDDLE, wide, 0.2)
    safe = limit(Setpoint((0.0, sign * 20.0, sign * 5.0), sign * 3.0), before, MIDDLE, LIMITS, STEP_S)
    assert_inside(safe, MIDDLE, LIMITS)


@steady
@given(envelopes, st.lists(st.tuples(wishes, st.floats(0, 0.5)), max_size=8))
def test_far_from_the_envelope_no_step_is_longer_than_the_slew(
    limits: LimitsConfig, sequence: list[tuple[Setpoint, float]]
) -> None:
    height_m = (limits.floor_m + limits.ceiling_m) / 2
    before = stop()
    for wish, dt_s in sequence:
        safe = limit(wish, before, Place(height_m, (0.0, 0.0)), limits, dt_s)
        if not all(map(math.isfinite, (*wish.velocity_ned_mps, wish.yaw_rate_radps))):
            assert safe == stop()
        else:
            step_s = min(dt_s, MAX_STEP_S)
            moved = [a - b for a, b in zip(safe.velocity_ned_mps, before.velocity_ned_mps, strict=True)]
            assert math.hypot(*moved[:2]) <= limits.acceleration_mps2 * step_s + 1e-9
            assert abs(moved[2]) <= limits.acceleration_mps2 * step_s + 1e-9
            turned_radps = abs(safe.yaw_rate_radps - before.yaw_rate_radps)
            assert turned_radps <= math.radians(limits.yaw_acceleration_dps2) * step_s + 1e-9
        before = safe


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_one_number_that_is_not_finite_stops_all(bad: float) -> None:
    before = limit(Setpoint((3.0, 0.0, 0.3), 0.5), None, MIDDLE, LIMITS, STEP_S)
    wish = Setpoint((1.0, 1.0, 0.1), 0.1)
    for at in range(3):
        velocity = [1.0, 1.0, 0.1]
        velocity[at] = bad
        spoilt = Setpoint((velocity[0], velocity[1], velocity[2]), 0.1)
        assert limit(spoilt, before, MIDDLE, LIMITS, STEP_S) == stop()
    assert limit(Setpoint((1.0, 1.0, 0.1), bad), before, MIDDLE, LIMITS, STEP_S) == stop()
    assert limit(wish, before, MIDDLE, LIMITS, bad) == stop()
    assert limit(wish, before, Place(bad, (0.0, 0.0)), LIMITS, STEP_S) == stop()
    assert limit(wish, before, Place(20.0, (0.0, bad)), LIMITS, STEP_S) == stop()


@pytest.mark.parametrize("huge", [1e300, 1e308, 1.79e308])
def test_a_huge_wish_is_the_fastest_in_its_direction(huge: float) -> None:
    safe = None
    for _ in range(200):
        safe = limit(Setpoint((huge, -huge, huge), -huge), safe, MIDDLE, LIMITS, STEP_S)
    assert safe is not None
    side = LIMITS.speed_mps / math.sqrt(2)
    assert safe.velocity_ned_mps == pytest.approx((side, -side, LIMITS.descent_mps))
    assert safe.yaw_rate_radps == pytest.approx(-math.radians(LIMITS.yaw_rate_dps))


def test_a_place_too_far_to_be_measured_is_outside_the_radius() -> None:
    place = Place(20.0, (1.5e308, 1.5e308))
    assert limit(Setpoint((5.0, 5.0, 0.0), 0.0), None, place, LIMITS, STEP_S).velocity_ned_mps == (0, 0, 0)


# ------------------------------------------------------------------------------------------- what is sent
def test_a_wish_within_all_limits_is_reached_and_kept() -> None:
    wish = Setpoint((1.0, -2.0, 0.5), 0.4)
    safe = None
    for _ in range(100):
        safe = limit(wish, safe, MIDDLE, LIMITS, STEP_S)
    assert safe is not None
    assert safe.velocity_ned_mps == pytest.approx(wish.velocity_ned_mps)
    assert safe.yaw_rate_radps == pytest.approx(wish.yaw_rate_radps)


def test_speed_is_limited_as_a_vector_so_that_its_direction_stays() -> None:
    safe = None
    for _ in range(200):
        safe = limit(Setpoint((30.0, 40.0, 0.0), 0.0), safe, MIDDLE, LIMITS, STEP_S)
    assert safe is not None
    assert safe.velocity_ned_mps[:2] == pytest.approx((3.0, 4.0))


def test_from_standing_the_first_step_is_the_acceleration_times_the_time() -> None:
    safe = limit(Setpoint((5.0, 0.0, -1.0), 0.7), None, MIDDLE, LIMITS, 0.1)
    assert safe.velocity_ned_mps == pytest.approx((0.15, 0.0, -0.15))
    assert safe.yaw_rate_radps == pytest.approx(math.radians(9.0))


def test_a_stalled_loop_does_not_catch_up_and_a_clock_that_goes_back_moves_nothing() -> None:
    wish = Setpoint((5.0, 0.0, 0.0), 0.0)
    assert limit(wish, None, MIDDLE, LIMITS, 60.0) == limit(wish, None, MIDDLE, LIMITS, MAX_STEP_S)
    assert limit(wish, None, MIDDLE, LIMITS, -1.0) == stop()


def test_a_wish_to_stand_slows_down_by_the_slew_but_a_stop_stands_at_once() -> None:
    before = None
    for _ in range(100):
        before = limit(Setpoint((4.0, 0.0, 0.0), 0.0), before, MIDDLE, LIMITS, STEP_S)
    assert limit(ZERO, before, MIDDLE, LIMITS, STEP_S).velocity_ned_mps[0] == pytest.approx(4.0 - 1.5 * STEP_S)
    assert stop().velocity_ned_mps == (0, 0, 0)
    assert stop().yaw_rate_radps == 0


# ------------------------------------------------------------------------------------------- the envelope
@pytest.mark.parametrize(
    ("height_m", "climbs", "sinks"),
    [
        (None, False, False),
        (-3.0, True, False),
        (LIMITS.floor_m - 0.1, True, False),
        (LIMITS.floor_m, True, False),
        (LIMITS.floor_m + 0.1, True, True),
        (0.0, True, False),
        (LIMITS.ceiling_m - 0.1, True, True),
        (LIMITS.ceiling_m, False, True),
        (LIMITS.ceiling_m + 50, False, True),
    ],
)
def test_below_the_floor_nothing_sinks_and_above_the_ceiling_nothing_climbs(
    height_m: float | None,
    climbs: bool,  # noqa: FBT001 - a column of the table
    sinks: bool,  # noqa: FBT001
) -> None:
    place = Place(height_m, (0.0, 0.0))
    up = limit(Setpoint((0.0, 0.0, -1.0), 0.0), None, place, LIMITS, STEP_S)
    down = limit(Setpoint((0.0, 0.0, 1.0), 0.0), None, place, LIMITS, STEP_S)
    assert (up.velocity_ned_mps[2] < 0, down.velocity_ned_mps[2] > 0) == (climbs, sinks)


def test_sinking_ends_at_once_at_the_floor() -> None:
    before = limit(Setpoint((0.0, 0.0, 1.0), 0.0), None, MIDDLE, LIMITS, 0.2)
    assert before.velocity_ned_mps[2] > 0
    assert limit(Setpoint((0.0, 0.0, 1.0), 0.0), before, Place(5.0, (0.0, 0.0)), LIMITS, 0.2).velocity_ned_mps[2] == 0


def test_without_a_position_nothing_moves_sideways_but_the_nose_turns() -> None:
    safe = limit(Setpoint((5.0, 5.0, 0.0), 0.5), None, Place(20.0, None), LIMITS, STEP_S)
    assert safe.velocity_ned_mps == (0, 0, 0)
    assert safe.yaw_rate_radps > 0


@pytest.mark.parametrize("bearing_deg", [0, 45, 137, 180, 270])
def test_flown_as_sent_the_radius_is_reached_at_a_crawl_and_never_passed(bearing_deg: float) -> None:
    limits = LimitsConfig(radius_m=40.0, speed_mps=7.0)
    out = math.cos(math.radians(bearing_deg)), math.sin(math.radians(bearing_deg))
    place, safe, speeds = (0.0, 0.0), None, []
    for _ in range(1200):
        safe = limit(Setpoint((9 * out[0], 9 * out[1], 0.0), 0.0), safe, Place(20.0, place), limits, STEP_S)
        north, east, _ = safe.velocity_ned_mps
        place = place[0] + north * STEP_S, place[1] + east * STEP_S
        speeds.append(math.hypot(north, east))
        assert math.hypot(*place) <= 40.0 + 0.01
    assert max(speeds) == pytest.approx(7.0)
    assert speeds[-1] < 0.1
    assert math.hypot(*place) > 39.5
    # sampled, the curve asks for the limit of acceleration, and for twice that in the step in which it is met
    braking = sorted(a - b for a, b in pairwise(speeds))
    assert braking[-1] <= 2 * 1.5 * STEP_S
    assert braking[-10] <= 1.1 * 1.5 * STEP_S


def test_outside_the_radius_only_the_way_back_and_along_is_open() -> None:
    place = Place(20.0, (200.0, 0.0))
    for wish, open_ in (((3.0, 0.0), (0.0, 0.0)), ((-3.0, 0.0), (-0.3, 0.0)), ((0.0, 3.0), (0.0, 0.3))):
        safe = limit(Setpoint((*wish, 0.0), 0.0), None, place, LIMITS, 0.2)
        assert safe.velocity_ned_mps[:2] == pytest.approx(open_)


def test_at_the_very_place_of_engagement_every_direction_is_open() -> None:
    safe = limit(Setpoint((3.0, 0.0, 0.0), 0.0), None, Place(20.0, (1e-4, 0.0)), LIMITS, 0.2)
    assert safe.velocity_ned_mps[0] == pytest.approx(0.3)


# ------------------------------------------------------------------------------------------- who makes them
def test_nobody_else_can_make_a_setpoint_that_may_be_sent() -> None:
    with pytest.raises(TypeError, match=r"only safety\.limit and safety\.stop make a SafeSetpoint"):
        SafeSetpoint((1.0, 0.0, 0.0), 0.0, object())
    with pytest.raises(TypeError, match="mint"):
        SafeSetpoint((1.0, 0.0, 0.0), 0.0)  # type: ignore[call-arg]
    with pytest.raises(ValueError, match="mint"):
        dataclasses.replace(stop(), velocity_ned_mps=(9.0, 0.0, 0.0))  # type: ignore[call-arg]
    with pytest.raises(dataclasses.FrozenInstanceError):
        stop().yaw_rate_radps = 9.0  # type: ignore[misc]


@pytest.mark.parametrize(
    ("velocity_ned_mps", "place", "edges"),
    [
        ((3.0, 0.0, 0.0), MIDDLE, ()),
        ((3.0, 0.0, 0.0), Place(20.0, (149.9, 0.0)), ("at limits.radius_m",)),
        ((-3.0, 0.0, 0.0), Place(20.0, (149.9, 0.0)), ()),
        ((0.0, 3.0, 0.0), Place(20.0, (149.9, 0.0)), ()),
        ((0.0, 0.0, 0.5), Place(5.0, (0.0, 0.0)), ("at limits.floor_m",)),
        ((0.0, 0.0, -0.5), Place(5.0, (0.0, 0.0)), ()),
        ((0.0, 0.0, -0.5), Place(60.0, (0.0, 0.0)), ("at limits.ceiling_m",)),
        ((0.0, 0.0, 0.5), Place(60.0, (0.0, 0.0)), ()),
        ((3.0, 0.0, 0.5), Place(4.0, (200.0, 0.0)), ("at limits.radius_m", "at limits.floor_m")),
    ],
)
def test_the_operator_is_told_which_edge_holds_a_wish_back(
    velocity_ned_mps: tuple[float, float, float], place: Place, edges: tuple[str, ...]
) -> None:
    assert held_back_by(Setpoint(velocity_ned_mps, 0.0), place, LIMITS) == edges


@steady
@given(wishes, places)
def test_no_wish_makes_the_edges_raise(wish: Setpoint, place: Place) -> None:
    assert isinstance(held_back_by(wish, place, LIMITS), tuple)
