"""The stages of the closed loop: worlds in which one target does one thing, and where the drone begins.

A target leads along the village's roads, on the right; what stands so near to its way that it might hide it is
taken down. A stage is judged by a follower that keeps its distance, not by one flight: what it promises holds
for any follower near the start's distance and height.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from types import MappingProxyType

import numpy as np

from sim.camera import Camera
from sim.scenery import CROSS_ROAD, VIADUCT, village
from sim.world import Bridge, ColorBgr, Kind, Motion, Mover, Pose, Scenery, World

LANE_M = 1.85  # from the middle of a road to that of a lane
PAVEMENT_M = 4.6  # to the middle of its pavement

# Pinhole of 72 degrees across 640 pixels; it looks over the target, as a vehicle that flies fast leans forward.
FORWARD_CAMERA = Camera((480, 640), focal_px=440.0, mount_pitch_rad=math.radians(-18.0))
NADIR_CAMERA = replace(FORWARD_CAMERA, mount_pitch_rad=math.radians(-90.0))

_TARGET_BGR: ColorBgr = (112, 70, 52)  # a dark blue
_ALIKE_BGR: ColorBgr = (104, 72, 58)  # nearly the same
_VAN_BGR: ColorBgr = (186, 192, 192)
_COAT_BGR: ColorBgr = (48, 40, 150)  # a red coat

_TREE_ROOM_M = 14.0  # beside the way, for sight from 12 m above it and higher
_HOUSE_ROOM_M = 14.0
_PARKED_ROOM_M = 8.0


@dataclass(frozen=True, slots=True)
class Stage:
    """A world with a target, and a drone that looks at it.

    description : what the target does, in a line.
    start : of the drone at time 0, level, its nose towards the target.
    duration_s : how long the description holds.
    has_gimbal : whether the camera is on one, which looks at the start as `camera` is mounted.
    """

    name: str
    description: str
    world: World
    camera: Camera
    start: Pose
    duration_s: float
    has_gimbal: bool = False

    @property
    def carried_camera(self) -> Camera:
        """The camera as it is mounted on what carries it: the vehicle, or the gimbal, whose axes are its own."""
        return replace(self.camera, mount_pitch_rad=0.0) if self.has_gimbal else self.camera

    @property
    def target(self) -> Mover:
        """The target, which every stage has."""
        assert self.world.target is not None
        return self.world.target


@cache
def stage(name: str, seed: int) -> Stage:
    """The stage of that name; `seed` scatters what is of no account.

    Raises
    ------
    ValueError
        If there is no stage of that name.
    """
    if name not in _BUILDERS:
        raise ValueError(f"no stage is named {name!r}, only {', '.join(STAGE_NAMES)}")
    return _BUILDERS[name](name, seed)


def _straight(name: str, seed: int) -> Stage:
    motion = Motion((-60.0, LANE_M), speeds=((0.0, 4.0), (20.0, 4.0), (30.0, 6.0), (60.0, 6.0), (70.0, 5.0)))
    van = Mover(Motion((60.0, -LANE_M), math.pi, speeds=((0.0, 6.0),)), _VAN_BGR, Kind.VAN)
    description = "drives along the main road at 4 to 6 m/s, in clear view, and meets a van"
    return _led(name, description, seed, Mover(motion, _TARGET_BGR), (van,))


def _turning(name: str, seed: int) -> Stage:
    quarter_m = 35.0 * math.pi / 2
    segments = ((50.0, 0.0), (quarter_m, 1 / 35.0), (40.0, 0.0), (quarter_m, -1 / 35.0))
    motion = Motion((-60.0, LANE_M), segments=segments, speeds=((0.0, 4.0),))
    description = "drives a wide bend to the right and one to the left, a quarter in 14 s each"
    return _led(name, description, seed, Mover(motion, _TARGET_BGR))


def _sharp_turns(name: str, seed: int) -> Stage:
    crossing_m = CROSS_ROAD.offset_m
    segments = (
        (50.0, 0.0),
        (8.0 * math.pi / 2, 1 / 8.0),  # right at the crossing
        (45.0, 0.0),
        (18.0 * math.pi, -1 / 18.0),  # back in a wide arc to the left
        (44.7, 0.0),
        (12.0 * math.pi / 2, -1 / 12.0),  # left into the main road, southwards
        (60.0, 0.0),
        (18.0 * math.pi, -1 / 18.0),  # and round again
    )
    start_ne_m = (crossing_m - LANE_M - 8.0 - segments[0][0], LANE_M)
    motion = Motion(start_ne_m, segments=segments, speeds=((0.0, 5.0), (7.0, 5.0), (9.0, 4.0)))
    description = "turns right at the crossing, round to the left, left into the main road, round again, at 4 to 5 m/s"
    return _led(name, description, seed, Mover(motion, _TARGET_BGR))


def _stop_and_go(name: str, seed: int) -> Stage:
    cycle = ((0.0, 5.0), (8.0, 5.0), (11.0, 0.0), (17.0, 0.0), (20.0, 5.0))
    speeds = tuple((time_s + start_s, speed_mps) for start_s in (0.0, 22.0, 44.0, 66.0) for time_s, speed_mps in cycle)
    motion = Motion((-60.0, LANE_M), speeds=speeds)
    description = "drives 5 m/s, brakes to a stand of 6 s and goes on, four times"
    return _led(name, description, seed, Mover(motion, _TARGET_BGR))


def _occluder(name: str, seed: int) -> Stage:
    motion = Motion((-100.0, LANE_M), speeds=((0.0, 5.0),))
    description = "drives at 5 m/s under two viaducts, wholly hidden for about a second by each"
    return _led(name, description, seed, Mover(motion, _TARGET_BGR), viaduct_width_m=5.0)


def _long_occlusion(name: str, seed: int) -> Stage:
    # Stands where the deck hides it from any camera that looks down at it by 25 to 45 degrees; later slowly
    # enough not to come to the next viaduct.
    stand_north_m = VIADUCT.north_m + 9.0
    brakes_s, stops_s = 14.0, 16.0
    goes_s = stops_s + 2.0
    motion = Motion(
        (stand_north_m - 5.0 * (brakes_s + stops_s) / 2, LANE_M),
        speeds=(
            (0.0, 5.0), (brakes_s, 5.0), (stops_s, 0.0), (goes_s, 0.0), (goes_s + 1.5, 5.0),
            (30.0, 5.0), (34.0, 2.0),
        ),
    )  # fmt: skip
    description = "stops for 2 s behind a broad viaduct, hidden for 4 to 9 s, and goes on"
    return _led(name, description, seed, Mover(motion, _TARGET_BGR), viaduct_width_m=10.0)


def _distractors(name: str, seed: int) -> Stage:
    motion = Motion((-100.0, LANE_M), speeds=((0.0, 4.0),))
    # Meets the target in the other lane after 12 s.
    oncoming = Motion((-100.0 + 12.0 * (4.0 + 6.0), -LANE_M), math.pi, speeds=((0.0, 6.0),))
    # Crosses its way from the right, 9 m before it, after 30 s.
    at_crossing_s = (CROSS_ROAD.offset_m + LANE_M - 9.0 - -100.0) / 4.0
    crossing = Motion((CROSS_ROAD.offset_m + LANE_M, LANE_M + 6.0 * at_crossing_s), -math.pi / 2, speeds=((0.0, 6.0),))
    # Comes from behind at 7 m/s, pulls out, stays beside it for 5 s and pulls in again before it.
    overtaking = Motion(
        (-100.0 - 180.0, LANE_M),
        segments=((370.0, 0.0), *_shift(-2 * LANE_M), (80.0, 0.0), *_shift(2 * LANE_M)),
        speeds=((0.0, 7.0), (59.0, 7.0), (61.0, 4.0), (66.0, 4.0), (68.0, 7.0)),
    )
    alike = tuple(Mover(other, _ALIKE_BGR) for other in (oncoming, crossing, overtaking))
    description = "drives at 4 m/s; one like it comes towards it, one crosses before it, one overtakes it slowly"
    return _led(name, description, seed, Mover(motion, _TARGET_BGR), alike)


def _pedestrian(name: str, seed: int) -> Stage:
    motion = Motion((-30.0, PAVEMENT_M), speeds=((0.0, 1.2), (30.0, 1.5), (60.0, 1.3)))
    walker = Mover(motion, _COAT_BGR, Kind.PEDESTRIAN)
    return _led(name, "a person walks along the pavement at 1.2 to 1.5 m/s", seed, walker, height_m=12.0, reach_m=18.0)


def _overhead(name: str, seed: int) -> Stage:
    motion = Motion((-60.0, LANE_M), speeds=((0.0, 2.0), (20.0, 3.0), (50.0, 3.0), (60.0, 2.0)))
    description = "drives along the main road at 2 to 3 m/s, seen from straight above"
    led = _led(name, description, seed, Mover(motion, _TARGET_BGR), height_m=25.0, reach_m=0.0)
    return replace(led, camera=NADIR_CAMERA)


def _departure(name: str, seed: int) -> Stage:
    motion = Motion((-60.0, LANE_M), speeds=((0.0, 4.0), (12.0, 4.0), (24.0, 16.0)))
    description = "drives at 4 m/s, then away at 16 m/s, until it is a speck for who does not follow as fast"
    return _led(name, description, seed, Mover(motion, _TARGET_BGR))


def _approach(name: str, seed: int) -> Stage:
    # Round to the left off the road, and back into the other lane.
    turn = ((5.0 * math.pi, -1 / 5.0), *_shift(-(10.0 - 2 * LANE_M)))
    motion = Motion(
        (-60.0, LANE_M),
        segments=((58.0, 0.0), *turn),
        speeds=((0.0, 4.0), (13.0, 4.0), (15.0, 2.0)),
    )
    description = "drives at 4 m/s, turns round after 17 s and comes towards the drone at 2 m/s"
    return _led(name, description, seed, Mover(motion, _TARGET_BGR))


def _passing(name: str, seed: int) -> Stage:
    motion = Motion((-60.0, LANE_M), speeds=((0.0, 3.5),))
    led = _led(name, "drives past, from the left to the right, at 3.5 m/s", seed, Mover(motion, _TARGET_BGR))
    north_m, east_m = -28.0, 35.0
    yaw_rad = math.atan2(LANE_M - east_m, motion.start_ne_m[0] - north_m)
    return replace(led, start=Pose((north_m, east_m, -14.0), yaw_rad=yaw_rad))


def _under(name: str, seed: int) -> Stage:
    motion = Motion((-60.0, LANE_M), speeds=((0.0, 4.0), (13.0, 4.0), (18.0, 2.0)))
    led = _led(name, "drives past at 4 m/s, nearly underneath, and on at 2 m/s", seed, Mover(motion, _TARGET_BGR))
    north_m, east_m, height_m = -30.0, 8.0, 16.0
    away_m = math.hypot(motion.start_ne_m[0] - north_m, LANE_M - east_m)
    yaw_rad = math.atan2(LANE_M - east_m, motion.start_ne_m[0] - north_m)
    return replace(
        led,
        camera=replace(FORWARD_CAMERA, mount_pitch_rad=-math.atan2(height_m, away_m)),
        start=Pose((north_m, east_m, -height_m), yaw_rad=yaw_rad),
        has_gimbal=True,
    )


def _led(
    name: str,
    description: str,
    seed: int,
    target: Mover,
    traffic: tuple[Mover, ...] = (),
    *,
    height_m: float = 14.0,
    reach_m: float = 23.0,
    viaduct_width_m: float | None = None,
) -> Stage:
    """A stage of 90 s whose drone begins `reach_m` behind the target, with nothing but viaducts in between."""
    duration_s = 90.0
    bridges = () if viaduct_width_m is None else (replace(VIADUCT, width_m=viaduct_width_m),)
    scenery = _cleared(village(seed), target.motion, duration_s, bridges)
    place = target.motion.pose(0.0)
    north_m, east_m, _ = place.pos_ned_m
    position = (
        north_m - reach_m * math.cos(place.yaw_rad),
        east_m - reach_m * math.sin(place.yaw_rad),
        -height_m,
    )
    start = Pose(position, yaw_rad=place.yaw_rad)
    return Stage(name, description, World(scenery, target, traffic), FORWARD_CAMERA, start, duration_s)


def _cleared(scenery: Scenery, motion: Motion, duration_s: float, bridges: tuple[Bridge, ...]) -> Scenery:
    """`scenery` with other bridges and without what might hide a target on its way, or stands in it."""
    times_s = np.arange(0.0, duration_s, 0.5)
    way_ne_m = np.array([motion.pose(time_s).pos_ned_m[:2] for time_s in times_s])

    def is_clear(pos_ne_m: tuple[float, float], room_m: float) -> bool:
        offsets_m = way_ne_m - pos_ne_m
        offsets_m -= np.round(offsets_m / scenery.tile_m) * scenery.tile_m
        return bool(np.hypot(*offsets_m.T).min() > room_m)

    return replace(
        scenery,
        bridges=bridges,
        trees=tuple(tree for tree in scenery.trees if is_clear(tree.pos_ne_m, _TREE_ROOM_M + tree.crown_radius_m)),
        houses=tuple(house for house in scenery.houses if is_clear(house.pos_ne_m, _HOUSE_ROOM_M + house.length_m / 2)),
        parked=tuple(car for car in scenery.parked if is_clear(car.motion.start_ne_m, _PARKED_ROOM_M)),
    )


def _shift(right_m: float, radius_m: float = 12.0) -> tuple[tuple[float, float], tuple[float, float]]:
    """Two arcs that lead onto a parallel way, `right_m` to the right of it."""
    turn_rad = math.acos(1 - abs(right_m) / (2 * radius_m))
    curvature = math.copysign(1 / radius_m, right_m)
    return (radius_m * turn_rad, curvature), (radius_m * turn_rad, -curvature)


_BUILDERS: Mapping[str, Callable[[str, int], Stage]] = MappingProxyType(
    {
        "straight": _straight,
        "turning": _turning,
        "sharp_turns": _sharp_turns,
        "stop_and_go": _stop_and_go,
        "occluder": _occluder,
        "long_occlusion": _long_occlusion,
        "distractors": _distractors,
        "pedestrian": _pedestrian,
        "overhead": _overhead,
        "departure": _departure,
        "approach": _approach,
        "passing": _passing,
        "under": _under,
    }
)
STAGE_NAMES: tuple[str, ...] = tuple(_BUILDERS)
