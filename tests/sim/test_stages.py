"""Every stage does what its description says, for any follower that keeps its distance behind the target."""

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest

from sim.camera import Truth, observe
from sim.stages import STAGE_NAMES, Stage, stage
from sim.world import Kind, Mover, Pose

STEP_S = 0.1
SEED = 7


@dataclass(frozen=True)
class Follower:
    """On a rope behind the target: turns towards it and moves along the line of sight only.

    reach, rise_m : its distance as a share of the start's, and its height above the start's.
    is_patient : whether it stands still while the target is hidden; else it knows better and goes on.
    fastest_mps : its greatest speed.
    """

    reach: float = 1.0
    rise_m: float = 0.0
    is_patient: bool = False
    fastest_mps: float = 20.0

    def seen(self, place: Stage, step_s: float = STEP_S) -> Iterator[tuple[float, Truth]]:
        """Time, and what it sees then."""
        position_m = np.subtract(place.start.pos_ned_m, (0.0, 0.0, self.rise_m))
        range_m = self.reach * math.dist(position_m[:2], target_ne_m(place, 0.0))
        yaw_rad = place.start.yaw_rad
        for time_s in np.arange(0.0, place.duration_s, step_s).tolist():
            truth = observe(place.world, place.camera, Pose(tuple(position_m.tolist()), yaw_rad=yaw_rad), time_s)
            yield time_s, truth
            if self.is_patient and truth.visible_share < 0.1:
                continue
            line_m = target_ne_m(place, time_s + step_s) - position_m[:2]
            way_m = float(np.hypot(*line_m)) - range_m
            if range_m:
                yaw_rad = math.atan2(line_m[1], line_m[0])
            towards = line_m / np.hypot(*line_m) if line_m.any() else line_m
            position_m[:2] += min(way_m, self.fastest_mps * step_s) * towards


FOLLOWERS = [Follower(reach, rise_m) for reach, rise_m in ((1.0, 0.0), (0.8, 3.0), (1.25, -2.0))]


def target_ne_m(place: Stage, time_s: float) -> np.ndarray:
    return np.array(place.target.motion.pose(time_s).pos_ned_m[:2])


def hidden_s(seen: Sequence[tuple[float, Truth]]) -> list[float]:
    """How long the target is hidden, each time."""
    groups = itertools.groupby(seen, key=lambda sight: sight[1].visible_share < 0.02)
    return [STEP_S * len(list(group)) for is_hidden, group in groups if is_hidden]


def distances_m(place: Stage, other: Mover, times_s: Sequence[float]) -> np.ndarray:
    return np.array([math.dist(target_ne_m(place, t), other.motion.pose(t).pos_ned_m[:2]) for t in times_s])


@pytest.mark.parametrize("name", STAGE_NAMES)
def test_target_is_well_in_view_at_the_start(name: str) -> None:
    place = stage(name, SEED)
    truth = observe(place.world, place.camera, place.start, 0.0)
    height, width = place.camera.size_hw
    assert truth.visible_share == 1.0
    assert truth.box is not None
    assert abs(truth.box.center_xy[0] - width / 2) < width / 8
    # below the middle, as a vehicle that flies fast leans forward; with room for one that brakes
    assert -height / 8 < truth.box.center_xy[1] - height / 2 < height / 4
    assert 30 < max(truth.box.w, truth.box.h) < 100
    assert 12 <= -place.start.pos_ned_m[2] <= 25


@pytest.mark.parametrize("name", STAGE_NAMES)
def test_stage_has_a_description_and_90_s(name: str) -> None:
    place = stage(name, SEED)
    assert place.name == name
    assert place.description
    assert place.duration_s >= 90


def test_seed_scatters_what_stands_beside_the_way_only() -> None:
    one, again, other = stage("straight", 7), stage("straight", 7), stage("straight", 8)
    assert one is again
    assert one.world.scenery.trees != other.world.scenery.trees
    assert one.target == other.target


def test_unknown_stage_is_refused_with_the_known_ones() -> None:
    with pytest.raises(ValueError, match="no stage is named 'moon', only straight, turning"):
        stage("moon", SEED)


@pytest.mark.parametrize(
    ("name", "least_mps", "greatest_mps"),
    [
        ("straight", 4.0, 6.0),
        ("turning", 4.0, 4.0),
        ("sharp_turns", 4.0, 5.0),
        ("stop_and_go", 0.0, 5.0),
        ("occluder", 5.0, 5.0),
        ("long_occlusion", 0.0, 5.0),
        ("distractors", 4.0, 4.0),
        ("pedestrian", 1.2, 1.5),
        ("overhead", 2.0, 3.0),
        ("departure", 4.0, 16.0),
        ("approach", 2.0, 4.0),
    ],
)
def test_target_has_the_speeds_of_the_description(name: str, least_mps: float, greatest_mps: float) -> None:
    place = stage(name, SEED)
    speeds_mps = [place.target.motion.speed_mps(t) for t in np.arange(0.0, place.duration_s, 0.25)]
    assert (min(speeds_mps), max(speeds_mps)) == pytest.approx((least_mps, greatest_mps))


@pytest.mark.parametrize("follower", FOLLOWERS)
@pytest.mark.parametrize("name", sorted({*STAGE_NAMES} - {"occluder", "long_occlusion"}))
def test_nothing_hides_the_target_where_nothing_is_meant_to(name: str, follower: Follower) -> None:
    for time_s, truth in follower.seen(stage(name, SEED), step_s=0.5):
        assert truth.visible_share > 0.95, time_s


@pytest.mark.parametrize("seed", [1, 8])
@pytest.mark.parametrize("name", ["turning", "approach", "pedestrian"])
def test_another_seed_hides_the_target_no_more(name: str, seed: int) -> None:
    for time_s, truth in Follower().seen(stage(name, seed), step_s=0.5):
        assert truth.visible_share > 0.95, time_s


@pytest.mark.parametrize("is_patient", [False, True])
@pytest.mark.parametrize("follower", FOLLOWERS)
def test_occluder_hides_the_target_twice_for_about_a_second(follower: Follower, *, is_patient: bool) -> None:
    place = replace(stage("occluder", SEED), duration_s=70.0)
    spans_s = hidden_s(list(replace(follower, is_patient=is_patient).seen(place)))
    assert len(spans_s) == 2
    longest_s = 3.5 if is_patient else 2.0  # seen from a place that stands, the way behind it is longer
    assert all(0.75 < span_s < longest_s for span_s in spans_s)


@pytest.mark.parametrize("is_patient", [False, True])
@pytest.mark.parametrize("follower", FOLLOWERS)
def test_long_occlusion_hides_the_target_once_for_more_than_3_s(follower: Follower, *, is_patient: bool) -> None:
    place = replace(stage("long_occlusion", SEED), duration_s=40.0)
    seen = list(replace(follower, is_patient=is_patient).seen(place))
    (span_s,) = hidden_s(seen)
    assert 4.0 < span_s < 9.5
    assert seen[-1][1].visible_share == 1.0


def test_long_occlusion_is_the_only_one_of_its_stage() -> None:
    assert len(hidden_s(list(Follower().seen(stage("long_occlusion", SEED), step_s=0.5)))) == 1


def test_target_turns_right_and_left_by_right_angles_and_half_turns() -> None:
    place = stage("sharp_turns", SEED)
    yaws_rad = [place.target.motion.pose(t).yaw_rad for t in np.arange(0.0, place.duration_s, 0.1)]
    steps_rad = np.diff(yaws_rad)
    assert steps_rad[steps_rad > 0].sum() == pytest.approx(math.pi / 2)
    assert -steps_rad[steps_rad < 0].sum() == pytest.approx(2.5 * math.pi)
    assert np.abs(steps_rad).max() / 0.1 < math.radians(30)  # a follower can turn as fast as that


def test_bends_are_a_quarter_to_either_side_and_slow() -> None:
    place = stage("turning", SEED)
    yaws_rad = [place.target.motion.pose(t).yaw_rad for t in np.arange(0.0, place.duration_s, 0.1)]
    steps_rad = np.diff(yaws_rad)
    assert steps_rad[steps_rad > 0].sum() == pytest.approx(math.pi / 2)
    assert -steps_rad[steps_rad < 0].sum() == pytest.approx(math.pi / 2)
    assert np.abs(steps_rad).max() / 0.1 < math.radians(7)


def test_target_stands_four_times_for_6_s() -> None:
    place = stage("stop_and_go", SEED)
    times_s = np.arange(0.0, place.duration_s, 0.1)
    is_standing = [place.target.motion.speed_mps(t) < 1e-9 for t in times_s]
    spans_s = [0.1 * len(list(group)) for is_still, group in itertools.groupby(is_standing) if is_still]
    assert spans_s == pytest.approx([6.0] * 4, abs=0.15)


def test_three_that_look_like_the_target_come_close_to_it() -> None:
    place = stage("distractors", SEED)
    times_s = np.arange(0.0, place.duration_s, 0.1).tolist()
    gaps_m = [distances_m(place, other, times_s) for other in place.world.traffic]
    oncoming, crossing, overtaking = gaps_m
    assert oncoming.min() == pytest.approx(3.7, abs=0.1)
    assert 4.5 < crossing.min() < 8.0
    assert overtaking.min() == pytest.approx(3.7, abs=0.1)
    assert 0.1 * np.count_nonzero(overtaking < 5.0) > 4.0
    for other in place.world.traffic:
        assert other.kind is place.target.kind
        assert math.dist(other.color_bgr, place.target.color_bgr) < 15


def test_those_that_look_alike_do_not_run_into_anyone_in_view() -> None:
    place = stage("distractors", SEED)
    movers = (place.target, *place.world.traffic)
    for time_s in np.arange(0.0, place.duration_s, 0.1):
        places_ne_m = [np.array(mover.motion.pose(time_s).pos_ned_m[:2]) for mover in movers]
        for one, other in itertools.combinations(places_ne_m, 2):
            assert math.dist(one, other) > 2.0


def test_pedestrian_is_a_person_of_30_to_60_pixels() -> None:
    place = stage("pedestrian", SEED)
    assert place.target.kind is Kind.PEDESTRIAN
    heights = [truth.box.h for _, truth in Follower().seen(place, step_s=5.0) if truth.box is not None]
    assert len(heights) == 18
    assert min(heights) > 30
    assert max(heights) < 60


def test_overhead_camera_looks_straight_down_on_the_target() -> None:
    place = stage("overhead", SEED)
    for _, truth in Follower().seen(place, step_s=5.0):
        assert truth.box is not None
        assert truth.box.center_xy == pytest.approx((320.0, 240.0), abs=1.5)
        assert truth.box.h > 2 * truth.box.w


def test_departing_target_shrinks_to_nothing_for_a_slower_follower() -> None:
    seen = dict(Follower(fastest_mps=8.0).seen(stage("departure", SEED), step_s=0.5))
    first, later, last = (seen[time_s].box for time_s in (12.0, 60.0, 89.5))
    assert first is not None
    assert first.h > 30
    assert later is None or later.h < 8
    assert last is None or last.h < 4


def test_approaching_target_turns_round_and_passes_where_the_drone_was() -> None:
    place = stage("approach", SEED)
    drone_ne_m = target_ne_m(place, 15.0) - (23.0, 0.0)
    ranges_m = [math.dist(target_ne_m(place, t), drone_ne_m) for t in np.arange(15.0, 40.0, 0.5)]
    assert ranges_m[0] == pytest.approx(23.0)
    assert min(ranges_m) < 4.0
    assert place.target.motion.pose(40.0).yaw_rad == pytest.approx(-math.pi)
    assert target_ne_m(place, 85.0)[0] < drone_ne_m[0] - 80.0
