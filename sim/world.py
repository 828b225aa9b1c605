"""What is where: poses, scripted motions, and the still and moving things of a scene. Values only.

World frame: NED in metres, ground plane at down = 0. Body frame: FRD (forward, right, down). Angles follow
the aerospace order yaw, pitch, roll; pitch is positive nose up, yaw positive from north to east.

The still scenery is one square tile that repeats without end in both directions, so that no flight and no
target can leave the world.
"""

import math
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from mscf.arrays import Real64

ColorBgr = tuple[int, int, int]

# Unit vector towards the sun: from the south-west, 47 degrees above the horizon.
SUN_ELEVATION_RAD = math.radians(47.0)
SUN_AZIMUTH_RAD = math.radians(236.0)
SUN_NED = (
    math.cos(SUN_ELEVATION_RAD) * math.cos(SUN_AZIMUTH_RAD),
    math.cos(SUN_ELEVATION_RAD) * math.sin(SUN_AZIMUTH_RAD),
    -math.sin(SUN_ELEVATION_RAD),
)

TILE_STEP_M = 40.0  # the ground's finest grain repeats at this distance


@dataclass(frozen=True, slots=True)
class Pose:
    """Position and attitude of a body."""

    pos_ned_m: tuple[float, float, float]
    roll_rad: float = 0.0
    pitch_rad: float = 0.0
    yaw_rad: float = 0.0

    def moved(
        self, dt_s: float, velocity_ned_mps: tuple[float, float, float], pitch_rate_radps: float, yaw_rate_radps: float
    ) -> "Pose":
        """Where it is `dt_s` later; the roll stays."""
        north_m, east_m, down_m = (p + v * dt_s for p, v in zip(self.pos_ned_m, velocity_ned_mps, strict=True))
        return replace(
            self,
            pos_ned_m=(north_m, east_m, down_m),
            pitch_rad=self.pitch_rad + pitch_rate_radps * dt_s,
            yaw_rad=self.yaw_rad + yaw_rate_radps * dt_s,
        )

    def ned_from_body(self) -> Real64:
        """Rotation matrix (3, 3) that takes FRD body coordinates to NED: Rz(yaw) Ry(pitch) Rx(roll)."""
        c_r, s_r = math.cos(self.roll_rad), math.sin(self.roll_rad)
        c_p, s_p = math.cos(self.pitch_rad), math.sin(self.pitch_rad)
        c_y, s_y = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        return np.array(
            [
                [c_y * c_p, c_y * s_p * s_r - s_y * c_r, c_y * s_p * c_r + s_y * s_r],
                [s_y * c_p, s_y * s_p * s_r + c_y * c_r, s_y * s_p * c_r - c_y * s_r],
                [-s_p, c_p * s_r, c_p * c_r],
            ]
        )


@dataclass(frozen=True, slots=True)
class Motion:
    """Scripted way on the ground: a path of straights and arcs, and a speed along it.

    segments : (length in m, curvature in 1/m, positive to the right), in order. After the last one the
        path goes on straight, before the first one it came straight.
    speeds : (time in s, speed in m/s), times ascending; linear between the knots, constant outside.
    """

    start_ne_m: tuple[float, float]
    start_yaw_rad: float = 0.0
    segments: tuple[tuple[float, float], ...] = ()
    speeds: tuple[tuple[float, float], ...] = ((0.0, 0.0),)

    def distance_m(self, time_s: float) -> float:
        """Way travelled since time 0, in m; negative before it."""
        return self._way_m(time_s) - self._way_m(0.0)

    def _way_m(self, time_s: float) -> float:
        """Way travelled since the first knot, in m: trapezoids are exact, the speed is linear in pieces."""
        (then_s, then_mps), way_m = self.speeds[0], 0.0
        if time_s <= then_s:
            return (time_s - then_s) * then_mps
        for knot_s, knot_mps in (*self.speeds[1:], (math.inf, self.speeds[-1][1])):
            if time_s < knot_s:
                # Linear up to the next knot; constant after the last one, whose slope is 0 / infinity.
                now_mps = then_mps + (knot_mps - then_mps) * (time_s - then_s) / (knot_s - then_s)
                return way_m + (time_s - then_s) * (then_mps + now_mps) / 2
            way_m += (knot_s - then_s) * (then_mps + knot_mps) / 2
            then_s, then_mps = knot_s, knot_mps
        return math.nan  # no time reaches infinity

    def speed_mps(self, time_s: float) -> float:
        """Speed along the path, in m/s."""
        knots_s, speeds_mps = zip(*self.speeds, strict=True)
        return float(np.interp(time_s, knots_s, speeds_mps))

    def velocity_ned_mps(self, time_s: float) -> tuple[float, float, float]:
        """Velocity in m/s: the speed along the path's direction."""
        speed_mps, yaw_rad = self.speed_mps(time_s), self.pose(time_s).yaw_rad
        return (speed_mps * math.cos(yaw_rad), speed_mps * math.sin(yaw_rad), 0.0)

    def pose(self, time_s: float) -> Pose:
        """Pose on the ground at `time_s`."""
        (north_m, east_m), yaw_rad = self.start_ne_m, self.start_yaw_rad
        left_m = self.distance_m(time_s)
        for length_m, curvature in (*self.segments, (math.inf, 0.0)):
            step_m = min(left_m, length_m)
            half_turn_rad = curvature * step_m / 2
            # Chord of the arc, which is the way itself on a straight.
            chord_m = step_m * (math.sin(half_turn_rad) / half_turn_rad if half_turn_rad else 1.0)
            north_m += chord_m * math.cos(yaw_rad + half_turn_rad)
            east_m += chord_m * math.sin(yaw_rad + half_turn_rad)
            yaw_rad += 2 * half_turn_rad
            left_m -= step_m
            if left_m <= 0:
                break
        return Pose((north_m, east_m, 0.0), yaw_rad=yaw_rad)


class Kind(Enum):
    """What a mover is, with its length, width and height in m."""

    SALOON = (4.4, 1.8, 1.45)
    VAN = (5.4, 2.0, 2.5)
    PEDESTRIAN = (0.5, 0.5, 1.75)


@dataclass(frozen=True, slots=True)
class Mover:
    """A car or a person; stands if its motion has no speed.

    The middle of its plan is at `motion.pose`, on the ground.
    """

    motion: Motion
    color_bgr: ColorBgr
    kind: Kind = Kind.SALOON


@dataclass(frozen=True, slots=True)
class Tree:
    """A round crown; `variety` chooses one of the foliage pictures."""

    pos_ne_m: tuple[float, float]
    crown_center_m: float
    crown_radius_m: float
    variety: int = 0


@dataclass(frozen=True, slots=True)
class House:
    """Rectangular house with a gabled roof, its ridge along the length; heights above ground."""

    pos_ne_m: tuple[float, float]
    yaw_rad: float
    length_m: float
    width_m: float
    eaves_m: float
    ridge_m: float
    wall_bgr: ColorBgr
    roof_bgr: ColorBgr


@dataclass(frozen=True, slots=True)
class Bridge:
    """A viaduct along east through the whole tile; its deck looks like the road at `like_north_m`."""

    north_m: float
    width_m: float
    underside_m: float
    thickness_m: float
    like_north_m: float


@dataclass(frozen=True, slots=True)
class Road:
    """Straight two-lane road through the whole tile, along north (at east `offset_m`) or along east."""

    is_northward: bool
    offset_m: float
    width_m: float = 7.0

    @property
    def yaw_rad(self) -> float:
        """Direction of the road."""
        return 0.0 if self.is_northward else math.pi / 2

    def place_ne_m(self, along_m: float, across_m: float) -> tuple[float, float]:
        """North and east of a place `along_m` from the tile's middle and `across_m` from the road's."""
        sideways_m = self.offset_m + across_m
        return (along_m, sideways_m) if self.is_northward else (sideways_m, along_m)


class Surface(Enum):
    """What a plot of land is covered with."""

    WHEAT = "wheat"
    GREEN_CROP = "green crop"
    MEADOW = "meadow"
    PARKING = "parking"
    GRAVEL = "gravel"
    PAVING = "paving"


@dataclass(frozen=True, slots=True)
class Plot:
    """Rectangle of one surface; `length_m` is along its yaw."""

    center_ne_m: tuple[float, float]
    length_m: float
    width_m: float
    yaw_rad: float
    surface: Surface


@dataclass(frozen=True, slots=True, eq=False)
class Scenery:
    """All that stands still, on a square tile centred on the origin that repeats every `tile_m`.

    `tile_m` must be a multiple of 40 m, so that the ground's grain fits on it. What is `parked` casts the
    shadow of a saloon.

    Compared by identity, which makes it a cheap key for what is painted from it.
    """

    seed: int
    tile_m: float = 240.0
    roads: tuple[Road, ...] = ()
    plots: tuple[Plot, ...] = ()
    trees: tuple[Tree, ...] = ()
    houses: tuple[House, ...] = ()
    bridges: tuple[Bridge, ...] = ()
    parked: tuple[Mover, ...] = ()

    def __post_init__(self) -> None:
        if self.tile_m <= 0 or self.tile_m % TILE_STEP_M:
            raise ValueError(f"tile_m is {self.tile_m}, must be a positive multiple of {TILE_STEP_M} m")


@dataclass(frozen=True, slots=True)
class World:
    """A scenery, the one mover that is the target (None: an empty street), and the other traffic."""

    scenery: Scenery
    target: Mover | None
    traffic: tuple[Mover, ...] = ()
