"""Solid shapes as lists of flat faces: cars, people, houses, bridges.

A shape is built of convex parts, lowest first. Seen from above, painting its front faces in list order
hides what has to be hidden, so no depth buffer is needed.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import numpy.typing as npt

from mscf.arrays import Real64
from sim.world import SUN_NED, Bridge, ColorBgr, House, Kind, Pose

GLASS_BGR = (62, 54, 46)
TYRE_BGR = (30, 29, 28)
TROUSERS_BGR = (70, 52, 44)
SKIN_BGR = (122, 150, 190)
HAIR_BGR = (40, 52, 66)
CONCRETE_BGR = (142, 150, 154)


@dataclass(frozen=True, eq=False, slots=True)
class Mesh:
    """Flat faces in painting order.

    vertices_m : (V, 3), NED or body FRD.
    faces : the vertices of each of the F faces.
    anchors : (F,), the first vertex of each face.
    normals : (F, 3), outward.
    colors_bgr : (F, 3), under full light.
    is_textured : per face, whether it wears the ground texture of its own plan (roofs, bridge decks).
    texture_shift_ne_m : from the plan of a textured face to the place whose texture it wears.
    light, paint_bgr : brightness and shaded colour per face; empty until `lit`.
    """

    vertices_m: Real64
    faces: tuple[slice, ...]
    anchors: npt.NDArray[np.intp]
    normals: Real64
    colors_bgr: Real64
    is_textured: tuple[bool, ...]
    texture_shift_ne_m: tuple[float, float] = (0.0, 0.0)
    light: tuple[float, ...] = ()
    paint_bgr: tuple[Sequence[float], ...] = ()

    def placed(self, pose: Pose) -> "Mesh":
        """The mesh, given in body coordinates, at `pose` in the world."""
        rotation = pose.ned_from_body()
        vertices_ned_m = self.vertices_m @ rotation.T + np.array(pose.pos_ned_m)
        return replace(self, vertices_m=vertices_ned_m, normals=self.normals @ rotation.T)

    def lit(self, sunlight: float) -> "Mesh":
        """The mesh with its paint: under the sky and `sunlight` 0..1 of the sun."""
        facing = np.maximum(self.normals @ np.array(SUN_NED), 0.0)
        light = 0.46 - 0.10 * self.normals[:, 2] + 0.58 * sunlight * facing
        paint_bgr = np.minimum(self.colors_bgr * light[:, None], 255).tolist()
        return replace(self, light=tuple(light.tolist()), paint_bgr=tuple(paint_bgr))


class _Builder:
    """Collects faces; the only mutable thing here, and it does not leave this module."""

    def __init__(self) -> None:
        self.vertices: list[Real64] = []
        self.faces: list[slice] = []
        self.normals: list[Real64] = []
        self.colors: list[ColorBgr] = []
        self.is_textured: list[bool] = []

    def add_face(self, corners_m: Real64, inside_m: Real64, color_bgr: ColorBgr, *, is_textured: bool = False) -> None:
        """Add a flat polygon, (K, 3); its normal points away from `inside_m`, (3,)."""
        normal = np.cross(corners_m[1] - corners_m[0], corners_m[2] - corners_m[0])
        normal *= math.copysign(1.0, normal @ (corners_m[0] - inside_m)) / np.linalg.norm(normal)
        start = sum(map(len, self.vertices))
        self.vertices.append(corners_m)
        self.faces.append(slice(start, start + len(corners_m)))
        self.normals.append(normal)
        self.colors.append(color_bgr)
        self.is_textured.append(is_textured)

    def add_prism(
        self,
        lower_m: Real64,
        upper_m: Real64,
        color_bgr: ColorBgr,
        *,
        decals: Sequence[tuple[int, Sequence[tuple[float, float]], ColorBgr]] = (),
        top: str = "plain",
    ) -> None:
        """Add the solid between two rings (K, 3) of equal length; `top` is plain, textured or open.

        A decal, such as a window or a lamp, is (side, corner points (u, v), colour); u goes from 0 to 1 along
        the side, v upwards.
        """
        inside_m = (lower_m.mean(axis=0) + upper_m.mean(axis=0)) / 2
        for side in range(len(lower_m)):
            after = (side + 1) % len(lower_m)
            quad_m = np.stack([lower_m[side], lower_m[after], upper_m[after], upper_m[side]])
            self.add_face(quad_m, inside_m, color_bgr)
            for decal_side, points_uv, decal_bgr in decals:
                if decal_side == side:
                    u, v = np.array(points_uv).T[:, :, None]  # (K, 1) each
                    low_m = (1 - u) * quad_m[0] + u * quad_m[1]
                    high_m = (1 - u) * quad_m[3] + u * quad_m[2]
                    self.add_face((1 - v) * low_m + v * high_m, inside_m, decal_bgr)
        if top != "open":
            self.add_face(upper_m, inside_m, color_bgr, is_textured=top == "textured")

    def mesh(self) -> Mesh:
        return Mesh(
            np.concatenate(self.vertices),
            tuple(self.faces),
            np.array([face.start for face in self.faces]),
            np.stack(self.normals),
            np.array(self.colors, dtype=float),
            tuple(self.is_textured),
        )


def _pane(u_0: float, u_1: float, v_0: float, v_1: float) -> list[tuple[float, float]]:
    """Corners of a rectangle."""
    return [(u_0, v_0), (u_1, v_0), (u_1, v_1), (u_0, v_1)]


def _wheel(u: float, radius_u: float, radius_v: float) -> list[tuple[float, float]]:
    """Corners of a wheel on the side of a car."""
    turns = np.linspace(0, 2 * np.pi, 8, endpoint=False)
    return [(u + radius_u * math.cos(a), 0.05 + radius_v * math.sin(a)) for a in turns]


def _ring(plan_xy_m: Sequence[tuple[float, float]], height_m: float) -> Real64:
    """Ring (K, 3) of plan points at one height above ground."""
    return np.array([(x, y, -height_m) for x, y in plan_xy_m])


@cache
def mover_mesh(kind: Kind, color_bgr: ColorBgr) -> Mesh:
    """A mover in body coordinates, standing on down = 0 with its middle at the origin."""
    make = {Kind.SALOON: _saloon, Kind.VAN: _van, Kind.PEDESTRIAN: _pedestrian}[kind]
    return make(color_bgr)


def _saloon(color_bgr: ColorBgr) -> Mesh:
    builder = _Builder()
    length, width = Kind.SALOON.value[0] / 2, Kind.SALOON.value[1] / 2
    plan = [
        (length, -0.62), (length, 0.62), (length - 0.45, width), (0.35 - length, width),
        (-length, 0.68), (-length, -0.68), (0.35 - length, -width), (length - 0.45, -width),
    ]  # fmt: skip
    lower = _ring(plan, 0.28)
    # The belt line falls towards the bonnet: still one plane.
    upper = np.array([(0.97 * x, 0.94 * y, -(0.88 - 0.045 * x)) for x, y in plan])
    wheels = [_wheel(u, 0.10, 0.5) for u in (0.12, 0.84)]
    mirrored = [[(1 - u, v) for u, v in wheel] for wheel in wheels]
    builder.add_prism(
        lower,
        upper,
        color_bgr,
        decals=[
            *((2, wheel, TYRE_BGR) for wheel in wheels),
            *((6, wheel, TYRE_BGR) for wheel in mirrored),
            (0, _pane(0.02, 0.24, 0.55, 0.9), (225, 232, 232)),
            (0, _pane(0.76, 0.98, 0.55, 0.9), (225, 232, 232)),
            (0, _pane(0.28, 0.72, 0.2, 0.6), (38, 36, 36)),
            (4, _pane(0.0, 0.2, 0.55, 0.85), (40, 34, 150)),
            (4, _pane(0.8, 1.0, 0.55, 0.85), (40, 34, 150)),
            (4, _pane(0.36, 0.64, 0.35, 0.55), (205, 210, 210)),
        ],
    )
    cabin = [(0.98, -0.78), (0.98, 0.78), (-1.8, 0.78), (-1.8, -0.78)]
    base = np.array([(x, y, -(0.88 - 0.045 * x)) for x, y in cabin])
    roof = _ring([(0.25, -0.6), (0.25, 0.6), (-1.15, 0.6), (-1.15, -0.6)], Kind.SALOON.value[2])
    builder.add_prism(
        base,
        roof,
        color_bgr,
        decals=[
            (0, _pane(0.05, 0.95, 0.06, 0.94), GLASS_BGR),
            (2, _pane(0.06, 0.94, 0.12, 0.92), GLASS_BGR),
            (1, _pane(0.10, 0.50, 0.1, 0.88), GLASS_BGR),
            (1, _pane(0.54, 0.90, 0.1, 0.88), GLASS_BGR),
            (3, _pane(0.10, 0.46, 0.1, 0.88), GLASS_BGR),
            (3, _pane(0.50, 0.90, 0.1, 0.88), GLASS_BGR),
        ],
    )
    return builder.mesh()


def _van(color_bgr: ColorBgr) -> Mesh:
    """A box with a short sloping nose."""
    builder = _Builder()
    length, width, height_m = Kind.VAN.value[0] / 2, Kind.VAN.value[1] / 2, Kind.VAN.value[2]
    plan = [(length, -width), (length, width), (-length, width), (-length, -width)]
    wheels = [_wheel(u, 0.075, 0.35) for u in (0.16, 0.80)]
    mirrored = [[(1 - u, v) for u, v in wheel] for wheel in wheels]
    builder.add_prism(
        _ring(plan, 0.3),
        _ring(plan, 1.1),
        color_bgr,
        decals=[
            *((1, wheel, TYRE_BGR) for wheel in wheels),
            *((3, wheel, TYRE_BGR) for wheel in mirrored),
            (0, _pane(0.02, 0.2, 0.4, 0.75), (225, 232, 232)),
            (0, _pane(0.8, 0.98, 0.4, 0.75), (225, 232, 232)),
            (2, _pane(0.0, 0.08, 0.5, 1.0), (40, 34, 150)),
            (2, _pane(0.92, 1.0, 0.5, 1.0), (40, 34, 150)),
        ],
    )
    base = [(length, -width), (length, width), (-length, width), (-length, -width)]
    roof = [(length - 1.1, -0.9), (length - 1.1, 0.9), (-length, 0.9), (-length, -0.9)]
    builder.add_prism(
        _ring(base, 1.1),
        _ring(roof, height_m),
        color_bgr,
        decals=[
            (0, _pane(0.06, 0.94, 0.1, 0.8), GLASS_BGR),
            (1, _pane(0.08, 0.26, 0.15, 0.7), GLASS_BGR),
            (3, _pane(0.74, 0.92, 0.15, 0.7), GLASS_BGR),
            (2, _pane(0.1, 0.46, 0.4, 0.85), GLASS_BGR),
            (2, _pane(0.54, 0.9, 0.4, 0.85), GLASS_BGR),
        ],
    )
    return builder.mesh()


def _pedestrian(color_bgr: ColorBgr) -> Mesh:
    """Legs in the middle of a step, a torso with its arms, a head."""
    builder = _Builder()
    for front_m, left_m in ((0.25, -0.2), (0.0, 0.02)):
        foot = _pane(front_m - 0.25, front_m, left_m, left_m + 0.18)
        hip = _pane(-0.1, 0.1, left_m, left_m + 0.18)
        builder.add_prism(_ring(foot, 0.0), _ring(hip, 0.85), TROUSERS_BGR)
    builder.add_prism(
        _ring(_pane(-0.13, 0.13, -0.22, 0.22), 0.8), _ring(_pane(-0.12, 0.12, -0.25, 0.25), 1.45), color_bgr
    )
    turns = np.linspace(0, 2 * np.pi, 6, endpoint=False)
    ring = [(0.1 * math.cos(a), 0.09 * math.sin(a)) for a in turns]
    builder.add_prism(_ring(ring, 1.45), _ring(ring, 1.68), SKIN_BGR)
    builder.add_prism(
        _ring(ring, 1.68), _ring([(0.7 * x, 0.7 * y) for x, y in ring], Kind.PEDESTRIAN.value[2]), HAIR_BGR
    )
    return builder.mesh()


def house_mesh(house: House) -> Mesh:
    """A house in the world, NED."""
    builder = _Builder()
    x, y = house.length_m / 2, house.width_m / 2
    plan = [(x, -y), (x, y), (-x, y), (-x, -y)]
    floors = max(1, round(house.eaves_m / 2.9))
    windows = []
    for side, side_m in enumerate((house.width_m, house.length_m) * 2):
        count = max(1, int(side_m / 2.6))
        for floor in range(floors):
            for i in range(count):
                mid, low = (i + 0.5) / count, (floor + 0.32) / floors
                half = 0.55 / side_m
                windows.append((side, _pane(mid - half, mid + half, low, low + 0.45 / floors), (78, 70, 62)))
    builder.add_prism(_ring(plan, 0.0), _ring(plan, house.eaves_m), house.wall_bgr, decals=windows, top="open")
    inside = np.array([0.0, 0.0, -house.eaves_m])
    for end in (x, -x):
        gable = np.array([(end, -y, -house.eaves_m), (end, y, -house.eaves_m), (end, 0.0, -house.ridge_m)])
        builder.add_face(gable, inside, house.wall_bgr)
    for across in (-y, y):
        eaves, ridge = _ring([(x, across), (-x, across)], house.eaves_m), _ring([(-x, 0.0), (x, 0.0)], house.ridge_m)
        builder.add_face(np.concatenate([eaves, ridge]), inside, house.roof_bgr, is_textured=True)
    return builder.mesh().placed(Pose((*house.pos_ne_m, 0.0), yaw_rad=house.yaw_rad))


def bridge_meshes(bridge: Bridge, tile_m: float, piece_m: float = 20.0) -> list[Mesh]:
    """The pieces of a viaduct in the world, NED, each `piece_m` long, and its pillars, every second piece."""
    low_m, high_m, half = bridge.underside_m, bridge.underside_m + bridge.thickness_m, bridge.width_m / 2
    builder = _Builder()
    plan = _pane(-half, half, -piece_m / 2, piece_m / 2)
    builder.add_prism(_ring(plan, low_m), _ring(plan, high_m), CONCRETE_BGR, top="textured")
    for edge in (half - 0.3, -half):  # parapets; the northern one first, as most cameras look north
        plan = _pane(edge, edge + 0.3, -piece_m / 2, piece_m / 2)
        builder.add_prism(_ring(plan, high_m), _ring(plan, high_m + 0.9), CONCRETE_BGR)
    low = _ring(_pane(-half, half, -piece_m / 2, piece_m / 2), low_m)
    builder.add_face(low, np.array([0.0, 0.0, -high_m]), CONCRETE_BGR)  # last: seen from below only
    piece, builder = builder.mesh(), _Builder()
    plan = _pane(-half * 0.6, half * 0.6, -0.6, 0.6)
    builder.add_prism(_ring(plan, 0.0), _ring(plan, low_m), CONCRETE_BGR, top="open")
    pillar = builder.mesh()

    meshes = []
    for k in range(round(tile_m / piece_m)):
        place = Pose((bridge.north_m, (k + 0.5) * piece_m - tile_m / 2, 0.0))
        # The middle pieces look like the road half a tile away: no junction, which is in the tile's middle.
        shift_east_m = tile_m / 2 if abs(place.pos_ned_m[1]) < tile_m / 4 else 0.0
        shift_ne_m = (bridge.like_north_m - bridge.north_m, shift_east_m)
        meshes.append(replace(piece.placed(place), texture_shift_ne_m=shift_ne_m))
        if k % 2 == 0:
            meshes.append(pillar.placed(place))
    return meshes
