"""Solid shapes as lists of flat faces: cars, houses, bridges.

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
from sim.world import SUN_NED, Bridge, ColorBgr, House, Pose

CAR_LENGTH_M, CAR_WIDTH_M, CAR_HEIGHT_M = 4.4, 1.8, 1.45

GLASS_BGR = (62, 54, 46)
TYRE_BGR = (30, 29, 28)
CONCRETE_BGR = (142, 150, 154)


@dataclass(frozen=True, eq=False, slots=True)
class Mesh:
    """Flat faces in painting order.

    vertices_m : (V, 3), NED or body FRD.
    faces : vertex indices of each of the F faces.
    anchors : (F,), one vertex index of each face.
    normals : (F, 3), outward.
    colors_bgr : (F, 3), under full light.
    is_textured : per face, whether it wears the ground texture of its own plan (roofs, bridge decks).
    texture_shift_ne_m : from the plan of a textured face to the place whose texture it wears.
    light, paint_bgr : brightness and shaded colour per face; empty until `lit`.
    """

    vertices_m: Real64
    faces: tuple[npt.NDArray[np.intp], ...]
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

    def moved(self, offset_ned_m: Real64) -> "Mesh":
        """The mesh shifted by `offset_ned_m`, (3,)."""
        return replace(self, vertices_m=self.vertices_m + offset_ned_m) if offset_ned_m.any() else self


class _Builder:
    """Collects faces; the only mutable thing here, and it does not leave this module."""

    def __init__(self) -> None:
        self.vertices: list[Real64] = []
        self.faces: list[npt.NDArray[np.intp]] = []
        self.normals: list[Real64] = []
        self.colors: list[ColorBgr] = []
        self.is_textured: list[bool] = []

    def add_face(self, corners_m: Real64, inside_m: Real64, color_bgr: ColorBgr, *, is_textured: bool = False) -> None:
        """Add a flat polygon, (K, 3); its normal points away from `inside_m`, (3,)."""
        normal = np.cross(corners_m[1] - corners_m[0], corners_m[2] - corners_m[0])
        normal *= math.copysign(1.0, normal @ (corners_m[0] - inside_m)) / np.linalg.norm(normal)
        start = sum(map(len, self.vertices))
        self.vertices.append(corners_m)
        self.faces.append(np.arange(start, start + len(corners_m)))
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
            np.array([face[0] for face in self.faces]),
            np.stack(self.normals),
            np.array(self.colors, dtype=float),
            tuple(self.is_textured),
        )


def _pane(u_0: float, u_1: float, v_0: float, v_1: float) -> list[tuple[float, float]]:
    """Corners of a rectangle."""
    return [(u_0, v_0), (u_1, v_0), (u_1, v_1), (u_0, v_1)]


def _ring(plan_xy_m: Sequence[tuple[float, float]], height_m: float) -> Real64:
    """Ring (K, 3) of plan points at one height above ground."""
    return np.array([(x, y, -height_m) for x, y in plan_xy_m])


@cache
def car_mesh(color_bgr: ColorBgr) -> Mesh:
    """A saloon in body coordinates, standing on down = 0 with its middle at the origin."""
    builder = _Builder()
    length, width = CAR_LENGTH_M / 2, CAR_WIDTH_M / 2
    plan = [
        (length, -0.62), (length, 0.62), (length - 0.45, width), (0.35 - length, width),
        (-length, 0.68), (-length, -0.68), (0.35 - length, -width), (length - 0.45, -width),
    ]  # fmt: skip
    lower = _ring(plan, 0.28)
    # The belt line falls towards the bonnet: still one plane.
    upper = np.array([(0.97 * x, 0.94 * y, -(0.88 - 0.045 * x)) for x, y in plan])
    turns = np.linspace(0, 2 * np.pi, 8, endpoint=False)
    wheels = [[(u + 0.10 * math.cos(a), 0.05 + 0.5 * math.sin(a)) for a in turns] for u in (0.12, 0.84)]
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
    roof = _ring([(0.25, -0.6), (0.25, 0.6), (-1.15, 0.6), (-1.15, -0.6)], CAR_HEIGHT_M)
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
