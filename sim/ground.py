"""The picture of the ground: one tileable plan view with shadows and roofs in it, and its coarser copies.

Plan view: column = east, row = north, both growing, the tile's centre at (0, 0) m; `pixels_from_ne` converts.
Roof and bridge surfaces are painted at their own plan place, which the solid shape always hides from view.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
import numpy.typing as npt

from mscf.arrays import Image, Real, Real64
from sim.shapes import ROOF_OVERHANG_M
from sim.world import SUN_AZIMUTH_RAD, SUN_ELEVATION_RAD, ColorBgr, House, Plot, Road, Scenery, Surface

# Brightness (R, C) from north (R, 1) and east (1, C) in m and the coarse noise (R, C).
Pattern = Callable[[Real, Real, Real], Real]

FINEST_PX_PER_M = 12.0
LEVELS_PER_OCTAVE = 2  # half octaves: the border between two levels stays invisible
LEVEL_COUNT = 10
SHADOW_DARKENING = (0.42, 0.49, 0.53)  # per BGR channel: skylight is blue

_SUBPIXEL_BITS = 4
# Ground shift per metre of height, (north, east), from a thing to its shadow.
SHADOW_NE = (
    -math.cos(SUN_AZIMUTH_RAD) / math.tan(SUN_ELEVATION_RAD),
    -math.sin(SUN_AZIMUTH_RAD) / math.tan(SUN_ELEVATION_RAD),
)


@dataclass(frozen=True, eq=False, slots=True)
class Ground:
    """Plan views of a scenery, fine to coarse.

    levels : images (S, S, 3) uint8 BGR, each 1/sqrt(2) of the one before.
    px_per_m : resolution of each level.
    sunlight : (S', S') float32, 1 in the sun to 0 in full shadow, 2 px/m.
    """

    tile_m: float
    levels: tuple[Image, ...]
    px_per_m: tuple[float, ...]
    sunlight: Real

    @staticmethod
    def levels_for(wanted_px_per_m: npt.ArrayLike) -> npt.NDArray[np.intp]:
        """Index of the level next to each wanted resolution, in half octaves."""
        octaves = np.log2(FINEST_PX_PER_M / np.asarray(wanted_px_per_m, float))
        return np.asarray(np.clip(np.rint(LEVELS_PER_OCTAVE * octaves), 0, LEVEL_COUNT - 1), dtype=np.intp)

    def pixels_from_ne(self, level: int) -> Real64:
        """Affine map (3, 3) from (north, east, 1) in m to (column, row, 1), pixel centres integer."""
        scale, size = self.px_per_m[level], self.levels[level].shape[0]
        return np.array([[0.0, scale, size / 2 - 0.5], [scale, 0.0, size / 2 - 0.5], [0.0, 0.0, 1.0]])

    def sunlight_at(self, pos_ne_m: tuple[float, float]) -> float:
        """Share of sunlight on the ground at a place, mean over about 3 m, 0..1."""
        size = self.sunlight.shape[0]
        offsets_m = np.array([-1.5, -0.5, 0.5, 1.5])
        rows, cols = (
            np.floor((center_m + offsets_m + self.tile_m / 2) * size / self.tile_m).astype(int) % size
            for center_m in pos_ne_m
        )
        return float(self.sunlight[np.ix_(rows, cols)].mean())


@lru_cache(maxsize=2)
def ground_of(scenery: Scenery) -> Ground:
    """Paint the ground of `scenery`; takes a second or two, hence the cache."""
    painter = _Painter(scenery)
    shadow = painter.paint()
    levels, px_per_m = [painter.canvas], [FINEST_PX_PER_M]
    for k in range(1, LEVEL_COUNT):
        size = round(painter.size / 2 ** (k / LEVELS_PER_OCTAVE))
        source = levels[max(k - LEVELS_PER_OCTAVE, 0)]
        levels.append(np.asarray(cv2.resize(source, (size, size), interpolation=cv2.INTER_AREA), np.uint8))
        px_per_m.append(size / scenery.tile_m)
    size = round(2 * scenery.tile_m)
    shade = cv2.resize(shadow, (size, size), interpolation=cv2.INTER_AREA)
    sunlight: Real = np.asarray(1 - shade / 255, dtype=np.float32)
    for level in levels:
        level.setflags(write=False)
    sunlight.setflags(write=False)
    return Ground(scenery.tile_m, tuple(levels), tuple(px_per_m), sunlight)


def tileable_noise(rng: np.random.Generator, size: int, cells: int) -> Real:
    """Smooth noise (size, size) of unit deviation at the `cells` x `cells` knots; wraps around seamlessly."""
    step, pad = size // cells, 2
    knots = np.pad(rng.standard_normal((cells, cells), dtype=np.float32), pad, mode="wrap")
    field = cv2.resize(knots, None, fx=step, fy=step, interpolation=cv2.INTER_CUBIC)
    return np.asarray(field[pad * step : pad * step + size, pad * step : pad * step + size], np.float32)


class _Painter:
    """The canvas while it is painted; lives only inside `ground_of`."""

    def __init__(self, scenery: Scenery) -> None:
        self.scenery = scenery
        self.size = round(scenery.tile_m * FINEST_PX_PER_M)
        ticks_m = (np.arange(self.size) + 0.5) / FINEST_PX_PER_M - scenery.tile_m / 2
        self.ticks_m: Real = ticks_m.astype(np.float32)
        self.rng = np.random.default_rng((scenery.seed, 2))
        finest = self.size // 2
        octave = {n: tileable_noise(self.rng, self.size, n) for n in (8, 30, 120, 480, finest)}
        self.fine = octave[finest] * 0.75 + octave[480] * 0.6 + octave[120] * 0.3
        self.coarse = octave[8] * 0.6 + octave[30] * 0.6 + octave[120] * 0.35
        self.canvas: Image = np.zeros((self.size, self.size, 3), np.uint8)

    def paint(self) -> Image:
        """Fill the canvas; returns the shadow mask (S, S), 255 in full shadow."""
        scenery = self.scenery
        self._cover(None, (66, 106, 100), grain=0.13, blend_bgr=(80, 122, 124))
        for plot in scenery.plots:
            self._plot(plot)
        for road in scenery.roads:  # all pavements below all carriageways: junctions come out right
            self._cover(self._strip(road, road.width_m + 3.6), (134, 144, 148), grain=0.07, edge_m=0.15)
        for road in scenery.roads:
            self._cover(self._strip(road, road.width_m), (108, 110, 111), grain=0.06, blend_bgr=(118, 121, 122))
        for road in scenery.roads:
            self._wear(road)
        for road in scenery.roads:
            self._markings(road)
        shadow = self._shadow()
        for channel, darkening in enumerate(SHADOW_DARKENING):
            light = cv2.LUT(shadow, np.round(255 - darkening * np.arange(256)).astype(np.uint8))
            self.canvas[..., channel] = cv2.multiply(self.canvas[..., channel], light, scale=1 / 255)
        for house in scenery.houses:  # after the shadows: roofs lie above them
            self._roof(house)
        return shadow

    def _pixels(self, points_ne_m: npt.ArrayLike) -> Real64:
        """(K, 2) north, east in m -> (K, 2) column, row."""
        return (np.asarray(points_ne_m, float)[:, ::-1] + self.scenery.tile_m / 2) * FINEST_PX_PER_M - 0.5

    def _polygon(self, mask: Image, points_ne_m: npt.ArrayLike, value: int = 255) -> None:
        cv2.fillPoly(mask, [_subpixels(self._pixels(points_ne_m))], value, cv2.LINE_AA, _SUBPIXEL_BITS)

    def _cover(
        self,
        points_ne_m: npt.ArrayLike | None,
        color_bgr: ColorBgr,
        *,
        grain: float,
        blend_bgr: ColorBgr | None = None,
        edge_m: float = 0.0,
        pattern: Pattern | None = None,
    ) -> None:
        """Cover a polygon (None: everything) with a grainy colour.

        `blend_bgr` is a second colour that takes over where the coarse noise is high; `pattern` is added to
        the brightness; `edge_m` frays the outline.
        """
        rows = cols = slice(0, self.size)
        alpha: Real | None = None
        if points_ne_m is not None:
            corners = self._pixels(points_ne_m)
            low = np.clip(np.floor(corners.min(axis=0)).astype(int) - 8, 0, self.size)
            high = np.clip(np.ceil(corners.max(axis=0)).astype(int) + 8, 0, self.size)
            rows, cols = slice(low[1], high[1]), slice(low[0], high[0])
            mask = np.zeros((high[1] - low[1], high[0] - low[0]), np.uint8)
            cv2.fillPoly(mask, [_subpixels(corners - low)], 255, cv2.LINE_AA, _SUBPIXEL_BITS)
            alpha = np.asarray(mask / 255, dtype=np.float32)
            if edge_m:
                soft = cv2.GaussianBlur(alpha, (0, 0), edge_m * FINEST_PX_PER_M)
                frayed = (soft - 0.5) * 3 + 0.5 + 0.5 * self.fine[rows, cols]
                alpha = np.asarray(np.clip(frayed, 0, 1), dtype=np.float32)
        coarse = self.coarse[rows, cols]
        mix = np.clip(0.5 + 0.5 * coarse, 0, 1)
        light = 1 + grain * self.fine[rows, cols]
        if pattern is not None:
            light += pattern(self.ticks_m[rows, None], self.ticks_m[None, cols], coarse)
        for channel in range(3):
            color = color_bgr[channel] + mix * ((blend_bgr or color_bgr)[channel] - color_bgr[channel])
            value = color * light
            if alpha is not None:
                below = self.canvas[rows, cols, channel]
                value = below + alpha * (value - below)
            self.canvas[rows, cols, channel] = np.clip(value, 0, 255)

    def _plot(self, plot: Plot) -> None:
        outline = _rectangle(plot.center_ne_m, plot.length_m, plot.width_m, plot.yaw_rad)
        if plot.surface in {Surface.WHEAT, Surface.GREEN_CROP}:
            is_ripe = plot.surface is Surface.WHEAT
            first, second = ((118, 162, 176), (104, 144, 158)) if is_ripe else ((62, 104, 88), (74, 122, 110))
            self._cover(outline, first, grain=0.11, blend_bgr=second, edge_m=0.3, pattern=_drill_rows(plot))
        elif plot.surface is Surface.MEADOW:
            self._cover(outline, (70, 124, 118), grain=0.13, blend_bgr=(82, 138, 148), edge_m=1.0)
        elif plot.surface is Surface.GRAVEL:
            self._cover(outline, (132, 150, 158), grain=0.12, blend_bgr=(112, 132, 140), edge_m=0.25)
        elif plot.surface is Surface.PAVING:
            self._cover(outline, (128, 138, 146), grain=0.06, blend_bgr=(138, 150, 156))
        else:
            self._cover(outline, (100, 102, 102), grain=0.06, blend_bgr=(112, 115, 114))
            north_m, east_m = plot.center_ne_m
            for side in (-1, 1) if plot.width_m > 20 else ():
                for row_m in (side * (plot.width_m / 2 - 5.0), side * 0.15):
                    for bay_m in np.arange(-plot.length_m / 2 + 1, plot.length_m / 2, 2.6):
                        start = (north_m + bay_m, east_m + row_m)
                        self._stroke([start, (start[0], start[1] + side * 4.8)], 0.1)

    def _strip(self, road: Road, width_m: float) -> list[tuple[float, float]]:
        half, far = width_m / 2, self.scenery.tile_m / 2 + 1.0
        return [road.place_ne_m(*corner) for corner in ((-far, -half), (-far, half), (far, half), (far, -half))]

    def _stroke(
        self, points_ne_m: Sequence[tuple[float, float]], width_m: float, bgr: ColorBgr = (200, 206, 208)
    ) -> None:
        """A painted line between two points."""
        (n_0, e_0), (n_1, e_1) = points_ne_m
        length = math.hypot(n_1 - n_0, e_1 - e_0)
        off_n, off_e = -(e_1 - e_0) / length * width_m / 2, (n_1 - n_0) / length * width_m / 2
        corners = [
            (n_0 + off_n, e_0 + off_e), (n_1 + off_n, e_1 + off_e),
            (n_1 - off_n, e_1 - off_e), (n_0 - off_n, e_0 - off_e),
        ]  # fmt: skip
        cv2.fillConvexPoly(self.canvas, _subpixels(self._pixels(corners)), bgr, cv2.LINE_AA, _SUBPIXEL_BITS)

    def _markings(self, road: Road) -> None:
        """Dashed centre line, solid edge lines, and a zebra crossing before each junction."""
        half, edge_m = self.scenery.tile_m / 2, road.width_m / 2 - 0.25
        junctions = [r.offset_m for r in self.scenery.roads if r.is_northward is not road.is_northward]

        def draw(along_m: float, across_m: float, length_m: float, width_m: float) -> None:
            ends = [road.place_ne_m(along, across_m) for along in (along_m, along_m + length_m)]
            self._stroke(ends, width_m)

        def is_free(along_m: float, room_m: float) -> bool:
            return all(abs(along_m - junction) > room_m for junction in junctions)

        for along_m in np.arange(-half, half):
            if along_m % 8 == 0 and is_free(along_m + 1.5, 13.0):
                draw(along_m, 0.0, 3.0, 0.15)
            if is_free(along_m + 0.5, 7.0):
                draw(along_m, -edge_m, 1.0, 0.12)
                draw(along_m, edge_m, 1.0, 0.12)
        for start_m in (start_m for j in junctions for start_m in (j - 11.0, j + 7.5)):
            for across_m in np.arange(-edge_m + 0.35, edge_m, 1.0):
                draw(start_m, across_m, 3.5, 0.5)

    def _wear(self, road: Road) -> None:
        """Repaired patches, cracks and the darker wheel tracks of a road."""
        half = self.scenery.tile_m / 2
        for _ in range(26):
            center = road.place_ne_m(self.rng.uniform(-half, half), self.rng.uniform(-2.6, 2.6))
            length_m, width_m = self.rng.uniform(1.0, 7.0), self.rng.uniform(0.5, 1.8)
            shade = int(self.rng.integers(84, 130))
            yaw_rad = 0.0 if road.is_northward else math.pi / 2
            self._cover(_rectangle(center, length_m, width_m, yaw_rad), (shade, shade + 1, shade + 1), grain=0.06)
        for lane_m in (-2.55, -1.1, 1.1, 2.55):
            ends = self._pixels([road.place_ne_m(along_m, lane_m) for along_m in (-half, half)])
            mask = np.zeros((self.size, self.size), np.uint8)
            start, end = np.rint(ends).astype(int).tolist()
            cv2.line(mask, start, end, 255, round(0.45 * FINEST_PX_PER_M))
            mask = np.asarray(cv2.GaussianBlur(mask, (0, 0), 3), np.uint8)
            rows, cols = (slice(int(v.min()), int(v.max()) + 1) for v in np.nonzero(mask))
            darkened = self.canvas[rows, cols] * (1 - 0.10 / 255 * mask[rows, cols, None])
            self.canvas[rows, cols] = np.round(darkened)
        for _ in range(30):
            start_m = np.array([self.rng.uniform(-half, half), self.rng.uniform(-3.2, 3.2)])
            steps_m = start_m + np.cumsum(self.rng.normal(0, 0.22, (12, 2)), axis=0)
            crack = _subpixels(self._pixels([road.place_ne_m(along, across) for along, across in steps_m]))
            cv2.polylines(
                self.canvas,
                [crack],
                isClosed=False,
                color=(88, 89, 90),
                lineType=cv2.LINE_AA,
                shift=_SUBPIXEL_BITS,
            )

    def _shadow(self) -> Image:
        """Shadows of everything that stands still, (S, S), 255 in full shadow."""
        mask = np.zeros((self.size, self.size), np.uint8)
        lean = np.array(SHADOW_NE)
        for tree in self.scenery.trees:
            center = np.array(tree.pos_ne_m) + lean * tree.crown_center_m
            col, row = np.round(self._pixels([center])[0]).astype(int).tolist()
            radius = tree.crown_radius_m * FINEST_PX_PER_M
            angle = 90 - math.degrees(math.atan2(lean[1], lean[0]))
            cv2.ellipse(mask, (col, row), (round(radius * 1.2), round(radius * 0.95)), angle, 0, 360, 255, -1)
        # Light falls through the leaves at the rim.
        leafy = cv2.GaussianBlur(mask, (0, 0), 4).astype(np.float32) / 255 + 0.16 * self.fine
        mask = (np.clip((leafy - 0.35) * 3, 0, 1) * 240).astype(np.uint8)
        solids = np.zeros_like(mask)
        for house in self.scenery.houses:
            base = _rectangle(house.pos_ne_m, house.length_m, house.width_m, house.yaw_rad)
            ridge = _rectangle(house.pos_ne_m, house.length_m, 0.0, house.yaw_rad) + lean * house.ridge_m
            self._polygon(solids, _hull([base, base + lean * house.eaves_m, ridge]))
        for bridge in self.scenery.bridges:
            road = Road(is_northward=False, offset_m=bridge.north_m + lean[0] * bridge.underside_m)
            self._polygon(solids, self._strip(road, bridge.width_m + 1.0))
        for car in self.scenery.parked:
            pose = car.motion.pose(0.0)
            base = _rectangle(pose.pos_ned_m[:2], 4.3, 1.75, pose.yaw_rad)
            cabin = _rectangle(pose.pos_ned_m[:2], 2.2, 1.3, pose.yaw_rad) + lean * 1.4
            self._polygon(solids, _hull([base, base + lean * 0.8, cabin]))
        return np.asarray(np.maximum(mask, cv2.GaussianBlur(solids, (0, 0), 1.5)), np.uint8)

    def _roof(self, house: House) -> None:
        """Tiles in courses 0.4 m apart along the slope, and the ridge."""
        cos, sin = math.cos(house.yaw_rad), math.sin(house.yaw_rad)

        def courses(north: Real, east: Real, _coarse: Real) -> Real:
            across = (east - house.pos_ne_m[1]) * cos - (north - house.pos_ne_m[0]) * sin
            return np.asarray(0.09 * np.sin(across * (2 * np.pi / 0.4)), np.float32)

        length_m, width_m = house.length_m + 2 * ROOF_OVERHANG_M, house.width_m + 2 * ROOF_OVERHANG_M
        outline = _rectangle(house.pos_ne_m, length_m, width_m, house.yaw_rad)
        self._cover(outline, house.roof_bgr, grain=0.1, pattern=courses)
        (north_m, east_m), half = house.pos_ne_m, house.length_m / 2
        ends = [(north_m + end * cos, east_m + end * sin) for end in (-half, half)]
        self._stroke(ends, 0.3, house.roof_bgr)


def _drill_rows(plot: Plot) -> Pattern:
    """Drilling rows 0.9 m apart, and a pair of tractor tracks every 15 m."""
    cos, sin = math.cos(plot.yaw_rad), math.sin(plot.yaw_rad)

    def brightness(north: Real, east: Real, coarse: Real) -> Real:
        across = (east - plot.center_ne_m[1]) * cos - (north - plot.center_ne_m[0]) * sin + 0.12 * coarse
        from_middle = np.abs(np.mod(across, 15.0) - 7.5)
        tracks = np.exp(-(((from_middle - 0.9) / 0.22) ** 2))
        return np.asarray(0.07 * np.sin(across * (2 * np.pi / 0.9)) - 0.2 * tracks, np.float32)

    return brightness


def _subpixels(points_px: Real64) -> npt.NDArray[np.int32]:
    """Fixed-point coordinates as OpenCV's drawing functions take them."""
    return np.asarray(np.rint(points_px * 2**_SUBPIXEL_BITS), dtype=np.int32)


def _rectangle(center_ne_m: Sequence[float], length_m: float, width_m: float, yaw_rad: float) -> Real64:
    """Corners (4, 2) of a rectangle, north and east in m; `length_m` along `yaw_rad`."""
    along = np.array([math.cos(yaw_rad), math.sin(yaw_rad)]) * length_m / 2
    across = np.array([-math.sin(yaw_rad), math.cos(yaw_rad)]) * width_m / 2
    return np.asarray(center_ne_m[:2]) + np.stack([along + across, along - across, -along - across, across - along])


def _hull(rings_ne_m: Sequence[Real64]) -> Real64:
    """Convex hull (K, 2) of several point sets."""
    points = np.concatenate(rings_ne_m).astype(np.float32)
    return np.asarray(cv2.convexHull(points)[:, 0], float)
