"""The picture of the ground: one tileable plan view with shadows and roofs in it, and its coarser copies.

Plan view: column = east, row = north, both growing, the tile's centre at (0, 0) m; `pixels_from_ne` converts.
Roof and bridge surfaces are painted at their own plan place, which the solid shape always hides from view.

The plan is large, 17 MB for the village: it is painted strip by strip, so that no float array of its size
ever exists.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
import numpy.typing as npt

from mscf.arrays import Image, Real, Real64
from sim.world import SUN_AZIMUTH_RAD, SUN_ELEVATION_RAD, TILE_STEP_M, ColorBgr, House, Plot, Road, Scenery, Surface

# Brightness (R, C) from north (R, 1) and east (1, C) in m and the coarse noise (R, C).
Pattern = Callable[[Real, Real, Real], Real]

FINEST_PX_PER_M = 10.0
LEVELS_PER_OCTAVE = 2  # half octaves: the border between two levels stays invisible
LEVEL_COUNT = 10
SHADOW_DARKENING = (0.42, 0.49, 0.53)  # per BGR channel: skylight is blue

_STRIP_PX = 64  # height of a strip: its floats fit into a processor's cache
_COARSENESS = 5  # pixels of the canvas per pixel of the coarse noise
_SUBPIXEL_BITS = 4
# Two colours that alternate, the strength of the grain, and how far in m the edge is frayed.
_SURFACES: dict[Surface, tuple[ColorBgr, ColorBgr, float, float]] = {
    Surface.WHEAT: ((118, 162, 176), (104, 144, 158), 0.11, 0.3),
    Surface.GREEN_CROP: ((62, 104, 88), (74, 122, 110), 0.11, 0.3),
    Surface.MEADOW: ((70, 124, 118), (82, 138, 148), 0.13, 1.0),
    Surface.GRAVEL: ((132, 150, 158), (112, 132, 140), 0.12, 0.25),
    Surface.PAVING: ((128, 138, 146), (138, 150, 156), 0.06, 0.0),
    Surface.PARKING: ((100, 102, 102), (112, 115, 114), 0.06, 0.0),
}
# Ground shift per metre of height, (north, east), from a thing to its shadow.
SHADOW_NE = (
    -math.cos(SUN_AZIMUTH_RAD) / math.tan(SUN_ELEVATION_RAD),
    -math.sin(SUN_AZIMUTH_RAD) / math.tan(SUN_ELEVATION_RAD),
)


@dataclass(frozen=True, eq=False, slots=True)
class Ground:
    """Plan views of a scenery, fine to coarse.

    levels : images (S, S, 3) uint8 BGR, each 1/sqrt(2) of the one before.
    shade : (S', S') uint8, 0 in the sun to 255 in full shadow, 1 px/m.
    """

    tile_m: float
    levels: tuple[Image, ...]
    shade: Image

    @staticmethod
    def levels_for(wanted_px_per_m: npt.ArrayLike) -> npt.NDArray[np.intp]:
        """Index of the level next to each wanted resolution, in half octaves."""
        octaves = np.log2(FINEST_PX_PER_M / np.asarray(wanted_px_per_m, float))
        return np.asarray(np.clip(np.rint(LEVELS_PER_OCTAVE * octaves), 0, LEVEL_COUNT - 1), dtype=np.intp)

    def pixels_from_ne(self, level: int) -> Real64:
        """Affine map (3, 3) from (north, east, 1) in m to (column, row, 1), pixel centres integer."""
        size = self.levels[level].shape[0]
        scale = size / self.tile_m
        return np.array([[0.0, scale, size / 2 - 0.5], [scale, 0.0, size / 2 - 0.5], [0.0, 0.0, 1.0]])

    def sunlight_at(self, pos_ne_m: tuple[float, float]) -> float:
        """Share of sunlight on the ground at a place, mean over 3 m, 0..1."""
        row, col = ((center_m / self.tile_m + 0.5) % 1 * self.shade.shape[0] - 0.5 for center_m in pos_ne_m)
        return 1.0 - float(cv2.getRectSubPix(self.shade, (3, 3), (col, row)).mean()) / 255


@lru_cache(maxsize=1)
def ground_of(scenery: Scenery) -> Ground:
    """Paint the ground of `scenery`; takes half a second and 35 MB, hence the cache of one."""
    finest, shade = _Painter(scenery).paint()
    levels = [finest]
    for k in range(1, LEVEL_COUNT):
        size = round(len(finest) / 2 ** (k / LEVELS_PER_OCTAVE))
        source = levels[max(k - LEVELS_PER_OCTAVE, 0)]
        levels.append(np.asarray(cv2.resize(source, (size, size), interpolation=cv2.INTER_AREA), np.uint8))
    for picture in (*levels, shade):
        picture.setflags(write=False)
    return Ground(scenery.tile_m, tuple(levels), shade)


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
        # Grains of 0.2 and 0.7 m repeat every TILE_STEP_M; clouds of 3, 10 and 40 m every tile.
        side = round(TILE_STEP_M * FINEST_PX_PER_M)
        self.grain = 0.75 * tileable_noise(self.rng, side, side // 2) + 0.6 * tileable_noise(self.rng, side, side // 8)
        side, steps = self.size // _COARSENESS, round(scenery.tile_m / TILE_STEP_M)
        octaves = ((0.6, 1), (0.6, 4), (0.4, 16))
        self.clouds: Real = np.sum([w * tileable_noise(self.rng, side, n * steps) for w, n in octaves], axis=0)
        self.canvas: Image = np.zeros((self.size, self.size, 3), np.uint8)

    def paint(self) -> tuple[Image, Image]:
        """The canvas, filled, and the shade at 1 px/m."""
        scenery, whole_m = self.scenery, self.scenery.tile_m + 2  # beyond the border: no edge along it
        self._cover(_rectangle((0, 0), whole_m, whole_m), (66, 106, 100), grain=0.13, blend_bgr=(80, 122, 124))
        for plot in scenery.plots:
            self._plot(plot)
        strips = [(road, road.place_ne_m(0.0, 0.0), whole_m) for road in scenery.roads]
        for road, center, length_m in strips:  # all pavements below all carriageways: junctions come out right
            outline = _rectangle(center, length_m, road.width_m + 3.6, road.yaw_rad)
            self._cover(outline, (134, 144, 148), grain=0.07, edge_m=0.15)
        for road, center, length_m in strips:
            outline = _rectangle(center, length_m, road.width_m, road.yaw_rad)
            self._cover(outline, (108, 110, 111), grain=0.06, blend_bgr=(118, 121, 122), pattern=_wheel_tracks(road))
        for road in scenery.roads:
            self._patches(road)
        for road in scenery.roads:
            self._markings(road)
        shadow = self._shadow()
        darkening = np.multiply.outer(np.arange(256), SHADOW_DARKENING)[:, None]  # (256, 1, 3)
        table = np.round(255 - darkening).astype(np.uint8)
        for rows in _strips(0, self.size):
            light = cv2.LUT(cv2.merge([shadow[rows]] * 3), table)
            cv2.multiply(self.canvas[rows], light, dst=self.canvas[rows], scale=1 / 255)
        for house in scenery.houses:  # after the shadows: roofs lie above them
            self._roof(house)
        size = round(scenery.tile_m)
        return self.canvas, np.asarray(cv2.resize(shadow, (size, size), interpolation=cv2.INTER_AREA), np.uint8)

    def _pixels(self, points_ne_m: npt.ArrayLike) -> Real64:
        """(K, 2) north, east in m -> (K, 2) column, row."""
        return (np.asarray(points_ne_m, float)[:, ::-1] + self.scenery.tile_m / 2) * FINEST_PX_PER_M - 0.5

    def _noise(self, rows: slice, cols: slice) -> tuple[Real, Real]:
        """Fine and coarse noise (R, C) of a part of the canvas, each of about unit deviation."""
        places = np.arange(rows.start, rows.stop), np.arange(cols.start, cols.stop)
        grain = self.grain.take(places[0], axis=0, mode="wrap").take(places[1], axis=1, mode="wrap")
        # From pixel centres of the canvas to those of the clouds.
        x, y = ((first + 0.5) / _COARSENESS - 0.5 for first in (cols.start, rows.start))
        coarse = cv2.warpAffine(
            self.clouds,
            np.array([[1 / _COARSENESS, 0.0, x], [0.0, 1 / _COARSENESS, y]]),
            (len(places[1]), len(places[0])),
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_WRAP,
        )
        return grain + np.float32(0.4) * coarse, np.asarray(coarse, np.float32)

    def _cover(
        self,
        points_ne_m: npt.ArrayLike,
        color_bgr: ColorBgr,
        *,
        grain: float,
        blend_bgr: ColorBgr | None = None,
        edge_m: float = 0.0,
        pattern: Pattern | None = None,
    ) -> None:
        """Cover a polygon with a grainy colour.

        `blend_bgr` is a second colour that takes over where the coarse noise is high; `pattern` is added to
        the brightness; `edge_m` frays the outline.
        """
        corners = self._pixels(points_ne_m)
        margin = 2 + math.ceil(2 * edge_m * FINEST_PX_PER_M)
        left, top = np.clip(np.floor(corners.min(axis=0)).astype(int) - margin, 0, self.size).tolist()
        right, bottom = np.clip(np.ceil(corners.max(axis=0)).astype(int) + margin, 0, self.size).tolist()
        mask = np.zeros((bottom - top, right - left), np.uint8)
        cv2.fillPoly(mask, [_subpixels(corners - (left, top))], 255, cv2.LINE_AA, _SUBPIXEL_BITS)
        if edge_m:
            mask = np.asarray(cv2.GaussianBlur(mask, (0, 0), edge_m * FINEST_PX_PER_M), np.uint8)
        cols = slice(left, right)
        for rows in _strips(top, bottom):
            fine, coarse = self._noise(rows, cols)
            alpha = mask[rows.start - top : rows.stop - top] * np.float32(1 / 255)
            if edge_m:
                alpha = np.clip((alpha - 0.5) * 3 + 0.5 + 0.5 * fine, 0, 1)
            mix = np.clip(0.5 + 0.5 * coarse, 0, 1)
            light = 1 + grain * fine
            if pattern is not None:
                light += pattern(self.ticks_m[rows, None], self.ticks_m[None, cols], coarse)
            for channel, (first, second) in enumerate(zip(color_bgr, blend_bgr or color_bgr, strict=True)):
                below = self.canvas[rows, cols, channel]
                value = below + alpha * ((first + mix * (second - first)) * light - below)
                self.canvas[rows, cols, channel] = np.clip(value, 0, 255)

    def _plot(self, plot: Plot) -> None:
        outline = _rectangle(plot.center_ne_m, plot.length_m, plot.width_m, plot.yaw_rad)
        color_bgr, blend_bgr, grain, edge_m = _SURFACES[plot.surface]
        is_field = plot.surface in {Surface.WHEAT, Surface.GREEN_CROP}
        pattern = _drill_rows(plot) if is_field else None
        self._cover(outline, color_bgr, grain=grain, blend_bgr=blend_bgr, edge_m=edge_m, pattern=pattern)
        if plot.surface is Surface.PARKING and plot.width_m > 20:  # room for four rows of bays
            north_m, east_m = plot.center_ne_m
            for side in (-1, 1):
                for row_m in (side * (plot.width_m / 2 - 2.6), side * 2.55):
                    for bay_m in np.arange(-plot.length_m / 2 + 1, plot.length_m / 2, 2.6):
                        self._stroke((north_m + bay_m, east_m + row_m), 0.1, 4.8)

    def _stroke(
        self,
        center_ne_m: Sequence[float],
        length_m: float,
        width_m: float,
        yaw_rad: float = 0.0,
        color_bgr: ColorBgr = (200, 206, 208),
    ) -> None:
        """A painted line."""
        corners = _subpixels(self._pixels(_rectangle(center_ne_m, length_m, width_m, yaw_rad)))
        cv2.fillConvexPoly(self.canvas, corners, color_bgr, cv2.LINE_AA, _SUBPIXEL_BITS)

    def _markings(self, road: Road) -> None:
        """Dashed centre line, solid edge lines, and a zebra crossing before each junction."""
        half, edge_m = self.scenery.tile_m / 2, road.width_m / 2 - 0.25
        junctions = [r.offset_m for r in self.scenery.roads if r.is_northward is not road.is_northward]

        def draw(middle_m: float, across_m: float, length_m: float, width_m: float) -> None:
            self._stroke(road.place_ne_m(middle_m, across_m), length_m, width_m, road.yaw_rad)

        def is_free(along_m: float, room_m: float) -> bool:
            return all(abs(along_m - junction) > room_m for junction in junctions)

        for middle_m in np.arange(-half, half) + 0.5:
            if middle_m % 8 == 0.5 and is_free(middle_m + 1, 13.0):
                draw(middle_m + 1, 0.0, 3.0, 0.15)
            if is_free(middle_m, 7.0):
                draw(middle_m, -edge_m, 1.0, 0.12)
                draw(middle_m, edge_m, 1.0, 0.12)
        for middle_m in (junction + side * 9.25 for junction in junctions for side in (-1, 1)):
            for across_m in np.arange(-edge_m + 0.35, edge_m, 1.0):
                draw(middle_m, across_m, 3.5, 0.5)

    def _patches(self, road: Road) -> None:
        """Repaired patches of a road."""
        half = self.scenery.tile_m / 2
        for _ in range(20):
            center = road.place_ne_m(self.rng.uniform(-half, half), self.rng.uniform(-2.6, 2.6))
            length_m, width_m = self.rng.uniform(1.0, 7.0), self.rng.uniform(0.5, 1.8)
            shade = int(self.rng.integers(84, 130))
            outline = _rectangle(center, length_m, width_m, road.yaw_rad)
            self._cover(outline, (shade, shade + 1, shade + 1), grain=0.06)

    def _shadow(self) -> Image:
        """Shadows of everything that stands still, (S, S), 255 in full shadow."""
        mask = np.zeros((self.size, self.size), np.uint8)
        lean = np.array(SHADOW_NE)
        angle = 90 - math.degrees(math.atan2(lean[1], lean[0]))
        for tree in self.scenery.trees:
            center = np.array(tree.pos_ne_m) + lean * tree.crown_center_m
            col, row = np.round(self._pixels([center])[0]).astype(int).tolist()
            radius = tree.crown_radius_m * FINEST_PX_PER_M
            cv2.ellipse(mask, (col, row), (round(radius * 1.2), round(radius * 0.95)), angle, 0, 360, 255, -1)
        mask = np.asarray(cv2.GaussianBlur(mask, (0, 0), 4), np.uint8)
        for rows in _strips(0, self.size):  # light falls through the leaves at the rim
            fine, _ = self._noise(rows, slice(0, self.size))
            mask[rows] = np.clip(mask[rows] * np.float32(3 / 255) + 0.48 * fine - 1.05, 0, 1) * 240
        outlines = []
        for house in self.scenery.houses:
            base = _rectangle(house.pos_ne_m, house.length_m, house.width_m, house.yaw_rad)
            ridge = _rectangle(house.pos_ne_m, house.length_m, 0.0, house.yaw_rad) + lean * house.ridge_m
            outlines.append(_hull([base, base + lean * house.eaves_m, ridge]))
        for bridge in self.scenery.bridges:
            center = np.array([bridge.north_m, 0.0]) + lean * bridge.underside_m
            outlines.append(_rectangle(center, self.scenery.tile_m * 2, bridge.width_m + 1.0, math.pi / 2))
        for car in self.scenery.parked:
            pose = car.motion.pose(0.0)
            base = _rectangle(pose.pos_ned_m[:2], 4.3, 1.75, pose.yaw_rad)
            cabin = _rectangle(pose.pos_ned_m[:2], 2.2, 1.3, pose.yaw_rad) + lean * 1.4
            outlines.append(_hull([base, base + lean * 0.8, cabin]))
        for outline in outlines:
            cv2.fillPoly(mask, [_subpixels(self._pixels(outline))], 255, cv2.LINE_AA, _SUBPIXEL_BITS)
        return np.asarray(cv2.GaussianBlur(mask, (0, 0), 1.5), np.uint8)

    def _roof(self, house: House) -> None:
        """Tiles in courses 0.4 m apart along the slope, and the ridge."""
        cos, sin = math.cos(house.yaw_rad), math.sin(house.yaw_rad)

        def courses(north: Real, east: Real, _coarse: Real) -> Real:
            across = (east - house.pos_ne_m[1]) * cos - (north - house.pos_ne_m[0]) * sin
            return np.asarray(0.09 * np.sin(across * (2 * np.pi / 0.4)), np.float32)

        outline = _rectangle(house.pos_ne_m, house.length_m, house.width_m, house.yaw_rad)
        self._cover(outline, house.roof_bgr, grain=0.1, pattern=courses)
        self._stroke(house.pos_ne_m, house.length_m, 0.3, house.yaw_rad, house.roof_bgr)


def _strips(first: int, end: int) -> Iterator[slice]:
    """The rows from `first` to `end`, in strips."""
    return (slice(top, min(top + _STRIP_PX, end)) for top in range(first, end, _STRIP_PX))


def _wheel_tracks(road: Road) -> Pattern:
    """Darker where the wheels of both lanes roll, 1.1 and 2.55 m off the middle."""

    def brightness(north: Real, east: Real, _coarse: Real) -> Real:
        across = (east if road.is_northward else north) - road.offset_m
        return np.asarray(-0.1 * np.exp(-(((np.abs(np.abs(across) - 1.825) - 0.725) / 0.25) ** 2)), np.float32)

    return brightness


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


def _rectangle(center_ne_m: Sequence[float] | Real64, length_m: float, width_m: float, yaw_rad: float = 0.0) -> Real64:
    """Corners (4, 2) of a rectangle, north and east in m; `length_m` along `yaw_rad`."""
    along = np.array([math.cos(yaw_rad), math.sin(yaw_rad)]) * length_m / 2
    across = np.array([-math.sin(yaw_rad), math.cos(yaw_rad)]) * width_m / 2
    return np.asarray(center_ne_m[:2]) + np.stack([along + across, along - across, -along - across, across - along])


def _hull(rings_ne_m: Sequence[Real64]) -> Real64:
    """Convex hull (K, 2) of several point sets."""
    points = np.concatenate(rings_ne_m).astype(np.float32)
    return np.asarray(cv2.convexHull(points)[:, 0], float)
