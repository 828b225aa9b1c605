"""The film of a run: what the camera saw, with the application's view of it, beside a map of who is where.

Every picture has a head with the figures of the moment, the onboard view below it, and the map to the right.
"""

import math
from collections import deque
from collections.abc import Callable
from itertools import product

import cv2
import numpy as np
import numpy.typing as npt

from companion.modes import Mode
from mscf import Box
from mscf.arrays import Image, Real64
from sim.ground import ground_of
from sim.stages import Stage
from sim.trace import Moment
from sim.view import SUBPIXEL_BITS, Camera, View, subpixels
from sim.wind import CALM, Wind
from sim.world import ColorBgr, Pose, Scenery

# A colour a mode: blue while the vehicle is left alone, green while all is well, then warmer step by step.
MODE_COLORS_BGR: dict[str, ColorBgr] = {
    "idle": (176, 168, 160),
    "tracking": (255, 170, 80),
    "lost": (200, 130, 150),
    "ready": (205, 200, 60),
    "following": (90, 210, 70),
    "coasting": (40, 215, 250),
    "holding": (30, 150, 255),
    "searching": (190, 110, 255),
    "awaiting": (255, 110, 150),
    "leaving": (70, 70, 255),
}
UNKNOWN_BGR: ColorBgr = (200, 200, 200)  # of a mode that is not ours
TARGET_BGR: ColorBgr = (60, 140, 255)
VEHICLE_BGR: ColorBgr = (255, 220, 120)
SETPOINT_BGR: ColorBgr = (255, 120, 255)
WHITE: ColorBgr = (255, 255, 255)
_GRAY: ColorBgr = (160, 156, 152)
_AMBER: ColorBgr = (80, 200, 255)
_DARK: ColorBgr = (34, 30, 28)

HEAD_PX = 60
SIDE_PX = 480  # height of the onboard view, and both sides of the map
TEXT_S = 3.0  # for which a message to the operator stays
OLD_FRAME_S = 0.5  # from here on the picture says that it is not of now

Pixels = npt.NDArray[np.int32]  # (..., 2), column and row

_FONT = cv2.FONT_HERSHEY_SIMPLEX
_ENGAGED = {mode.value for mode in Mode if mode.is_engaged}
_PLAN_PX_PER_M = 5.0
_PLAN_COUNT = 3  # coarser copies, each half of the one before
_DIMMED = 0.55  # brightness of the map's ground
_REACH_M = 70.0  # the camera's view is drawn so far
_NEAR_M, _FAR_M = 40.0, 320.0  # from the map's middle to its edges, at least and at most
_LEAD_S = 3.0  # the setpoint's arrow ends where it leads within this time
_TRAIL_STEP_M = 0.5
_TRAIL_COUNT = 4000  # two kilometres
_FARTHEST_PX = 16000.0
_SCALE_BARS_M = (10, 20, 50, 100, 200)


class Film:
    """The pictures of one run, in order.

    Parameters
    ----------
    stage : whose ground is the map's.
    scenario_name, autopilot_name : as they are shown.
    camera : of the onboard view.
    wind : shown on the map unless it is calm.
    radius_m : within which the vehicle must stay around the place of engagement; None: not drawn.
    """

    def __init__(
        self,
        stage: Stage,
        scenario_name: str,
        autopilot_name: str,
        camera: Camera,
        wind: Wind = CALM,
        *,
        radius_m: float | None = None,
    ) -> None:
        self._names = scenario_name, autopilot_name
        self._camera = camera
        self._columns = tuple(round(x * self.size_hw[1] / 1120) for x in (14, 196, 382, 550, 634, 800, 960, 1056))
        self._empty_head = self._blank_head()
        self._map = _Map(stage, camera, wind, radius_m)
        self._texts: deque[tuple[float, str]] = deque(maxlen=4)

    @property
    def view_hw(self) -> tuple[int, int]:
        """Size of the onboard view in px: the camera's shape, the map's height."""
        height, width = self._camera.size_hw
        return SIDE_PX, 2 * round(SIDE_PX * width / height / 2)  # even, as H.264 wants it

    @property
    def size_hw(self) -> tuple[int, int]:
        """Size of a picture in px."""
        return HEAD_PX + SIDE_PX, self.view_hw[1] + SIDE_PX

    def frame(self, moment: Moment, image: Image | None) -> Image:
        """The next picture.

        Parameters
        ----------
        moment : later than the last one; what is None or not finite is left out.
        image : (H, W, 3) BGR or (H, W) uint8, the frame that the moment's boxes belong to; None: there is none.

        Returns
        -------
        (*size_hw, 3) BGR uint8. The same moments and images give the same pictures, to the bit.
        """
        while self._texts and moment.time_s - self._texts[0][0] > TEXT_S:
            self._texts.popleft()
        self._texts.extend((moment.time_s, text) for text in moment.texts)
        picture = np.empty((*self.size_hw, 3), np.uint8)
        columns = self.view_hw[1]
        picture[:HEAD_PX] = self._head(moment)
        picture[HEAD_PX:, :columns] = self._view(moment, image)
        picture[HEAD_PX:, columns:] = self._map.frame(moment)
        cv2.line(picture, (columns, HEAD_PX), (columns, HEAD_PX + SIDE_PX), _DARK, 2)
        return picture

    def _blank_head(self) -> Image:
        """What of the head stays."""
        head = np.full((HEAD_PX, self.size_hw[1], 3), _DARK, np.uint8)
        scenario, autopilot = self._names
        labels = ("scenario", autopilot, "mode", "time", "confidence", "range (true)", "speed", "height")
        for x, label in zip(self._columns, labels, strict=True):
            _plain(head, label, (x, 21), _GRAY, 0.38)
        _plain(head, scenario.replace("_", " "), (self._columns[0], 46), WHITE, 0.52)
        return head

    def _head(self, moment: Moment) -> Image:
        head = self._empty_head.copy()
        _, flight, mode, time, confidence, distance, speed, height = self._columns
        color = mode_color(moment.mode)
        true = _said(moment.true_range_m, "")
        values = (
            (flight, f"{moment.flight_mode or '-'}{'' if moment.is_armed else ', disarmed'}"),
            (time, _said(moment.time_s, "s")),
            (confidence, _said(moment.confidence, "", 2)),
            (distance, f"{_said(moment.range_m, '')} ({true}) m"),
            (speed, _said(moment.speed_mps, "m/s")),
            (height, _said(moment.height_m, "m", 0)),
        )
        for x, value in values:
            _plain(head, value, (x, 46), WHITE, 0.52)
        cv2.rectangle(head, (mode, 28), (mode + 140, 52), color, cv2.FILLED)
        _plain(head, moment.mode.upper(), (mode + 9, 46), _DARK, 0.52)
        if math.isfinite(moment.confidence):
            left = confidence + 50
            width = round(100 * min(max(moment.confidence, 0.0), 1.0))
            cv2.rectangle(head, (left, 34), (left + 100, 46), (90, 84, 80), cv2.FILLED)
            cv2.rectangle(head, (left, 34), (left + width, 46), color, cv2.FILLED)
        return head

    def _view(self, moment: Moment, image: Image | None) -> Image:
        rows, cols = self.view_hw
        if image is None:
            view = np.full((rows, cols, 3), (58, 52, 48), np.uint8)
            _text(view, "no picture: boxes only", (12, 42), _GRAY, 0.45)
        else:
            view = np.repeat(image[..., None], 3, axis=2) if image.ndim == 2 else image.copy()
            if view.shape[:2] != (rows, cols):
                view = np.asarray(cv2.resize(view, (cols, rows), interpolation=cv2.INTER_AREA), np.uint8)
        scale = cols / self._camera.size_hw[1], rows / self._camera.size_hw[0]
        _cross(view)
        _text(view, "thin white: the true box", (12, 20), (220, 220, 220), 0.38)
        if moment.box is not None and moment.box.is_finite:
            color = mode_color(moment.mode)
            x, y = _rectangle(view, moment.box, scale, color, 3)
            label = f"{moment.mode} {_said(moment.confidence, '', 2)}"
            _text(view, label, (min(max(x, 4), cols - 9 * len(label)), y - 8 if y > 24 else 20), color, 0.48)
        if moment.truth is not None and moment.truth.is_finite:
            _rectangle(view, moment.truth, scale, WHITE, 1)
        lines = [(text, WHITE) for _, text in self._texts] + [(note, _AMBER) for note in moment.notes]
        if moment.frame_age_s is not None and moment.frame_age_s > OLD_FRAME_S:
            lines.append((f"this picture is {moment.frame_age_s:.1f} s old", _AMBER))
        _captions(view, lines)
        return view


class _Map:
    """A plan of the ground around the vehicle and the target, north up."""

    def __init__(self, stage: Stage, camera: Camera, wind: Wind, radius_m: float | None) -> None:
        self._plans = _plans(stage.world.scenery)
        self._tile_m = stage.world.scenery.tile_m
        self._camera = camera
        self._has_gimbal = stage.has_gimbal
        self._wind = wind
        self._radius_m = radius_m
        self._middle_ne_m = stage.start.pos_ned_m[:2]
        self._engaged_ne_m: tuple[float, float] | None = None
        self._was_engaged = False
        self._vehicle_trail = _Trail()
        self._target_trail = _Trail()

    def frame(self, moment: Moment) -> Image:
        """(SIDE_PX, SIDE_PX, 3)."""
        vehicle, target = _place(moment.pose.pos_ned_m), _place(moment.target_ned_m)
        self._remember(moment, vehicle, target)
        half_m = self._aim(vehicle, target)
        px_per_m = SIDE_PX / (2 * half_m)
        picture = self._ground(px_per_m)

        def at(points_ne_m: npt.ArrayLike) -> Pixels:
            """North and east (..., 2) -> column and row (..., 2)."""
            offsets_m = np.subtract(points_ne_m, self._middle_ne_m)[..., ::-1] * (1, -1)
            return _pixels((SIDE_PX - 1) / 2 + offsets_m * px_per_m)

        if vehicle is not None:
            self._footprint(picture, moment.pose, at)
        if self._engaged_ne_m is not None:
            place = _xy(at(self._engaged_ne_m))
            cv2.drawMarker(picture, place, VEHICLE_BGR, cv2.MARKER_TILTED_CROSS, 10, 1, cv2.LINE_AA)
            if self._radius_m is not None:
                cv2.circle(picture, place, round(self._radius_m * px_per_m), _AMBER, 1, cv2.LINE_AA)
        for trail, color in ((self._target_trail, TARGET_BGR), (self._vehicle_trail, VEHICLE_BGR)):
            if trail.points:
                cv2.polylines(picture, [at(trail.points)], False, color, 2, cv2.LINE_AA)  # noqa: FBT003
        if target is not None:
            is_seen = moment.visible_share >= 0.1
            cv2.circle(picture, _xy(at(target)), 6, _DARK, cv2.FILLED, cv2.LINE_AA)
            cv2.circle(picture, _xy(at(target)), 5, TARGET_BGR, cv2.FILLED if is_seen else 2, cv2.LINE_AA)
        if vehicle is not None:
            if moment.setpoint_ned_mps is not None and all(map(math.isfinite, moment.setpoint_ned_mps)):
                north_m, east_m = (v * _LEAD_S for v in moment.setpoint_ned_mps[:2])
                if math.hypot(north_m, east_m) * px_per_m > 4:
                    foot, tip = _xy(at(vehicle)), _xy(at((vehicle[0] + north_m, vehicle[1] + east_m)))
                    cv2.arrowedLine(picture, foot, tip, SETPOINT_BGR, 2, cv2.LINE_AA, tipLength=0.25)
            _triangle(picture, _xy(at(vehicle)), moment.pose.yaw_rad)
        self._furniture(picture, px_per_m, moment.time_s)
        return picture

    def _remember(
        self, moment: Moment, vehicle: tuple[float, float] | None, target: tuple[float, float] | None
    ) -> None:
        is_engaged = moment.mode in _ENGAGED
        if is_engaged and not self._was_engaged:
            self._engaged_ne_m = vehicle
        self._was_engaged = is_engaged
        self._vehicle_trail.add(vehicle)
        self._target_trail.add(target)

    def _aim(self, vehicle: tuple[float, float] | None, target: tuple[float, float] | None) -> float:
        """Move the middle; from it to the edges in m."""
        places = [place for place in (vehicle, target) if place is not None]
        if places:
            north_m, east_m = np.mean(places, axis=0).tolist()
            self._middle_ne_m = north_m, east_m
        apart_m = math.dist(*places) if len(places) == 2 else 0.0
        return min(max(_NEAR_M, 0.7 * apart_m), _FAR_M)

    def _ground(self, px_per_m: float) -> Image:
        """The plan, north up, around the middle."""
        coarseness = round(math.log2(_PLAN_PX_PER_M / px_per_m))
        plan = self._plans[min(max(coarseness, 0), _PLAN_COUNT - 1)]
        plan_px_per_m = len(plan) / self._tile_m
        step = plan_px_per_m / px_per_m
        # The tile repeats: its copy nearest to the plan's own keeps the coordinates small.
        north_px, east_px = (plan_px_per_m * math.remainder(middle_m, self._tile_m) for middle_m in self._middle_ne_m)
        edge, middle = (len(plan) - 1) / 2, (SIDE_PX - 1) / 2
        to_plan = np.array([[step, 0.0, edge + east_px - step * middle], [0.0, -step, edge + north_px + step * middle]])
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        ground = cv2.warpAffine(plan, to_plan, (SIDE_PX, SIDE_PX), flags=flags, borderMode=cv2.BORDER_WRAP)
        return np.asarray(ground, np.uint8)

    def _footprint(self, picture: Image, pose: Pose, at: Callable[[npt.ArrayLike], Pixels]) -> None:
        if self._has_gimbal:  # where that looks, no moment says
            return
        outline_ne_m = footprint_ne_m(self._camera, pose)
        if not np.isfinite(outline_ne_m).all():
            return
        points = at(outline_ne_m)
        veil = picture.copy()
        cv2.fillPoly(veil, [points], WHITE, cv2.LINE_AA)
        cv2.addWeighted(veil, 0.2, picture, 0.8, 0.0, dst=picture)
        cv2.polylines(picture, [points], isClosed=True, color=(210, 210, 210), thickness=1, lineType=cv2.LINE_AA)

    def _furniture(self, picture: Image, px_per_m: float, time_s: float) -> None:
        """Scale, north, wind, and what the colours mean."""
        length_m = max((m for m in _SCALE_BARS_M if m * px_per_m <= 130), default=_SCALE_BARS_M[0])
        left, bottom = 14, SIDE_PX - 16
        right = left + round(length_m * px_per_m)
        for color, width in ((_DARK, 4), (WHITE, 2)):
            cv2.line(picture, (left, bottom), (right, bottom), color, width)
        _text(picture, f"{length_m} m", (left, bottom - 8), WHITE, 0.42)
        cv2.arrowedLine(picture, (SIDE_PX - 20, 44), (SIDE_PX - 20, 14), WHITE, 2, cv2.LINE_AA, tipLength=0.35)
        _text(picture, "N", (SIDE_PX - 26, 60), WHITE, 0.42)
        legend = [("vehicle", VEHICLE_BGR), ("target", TARGET_BGR), ("setpoint", SETPOINT_BGR)]
        legend += [("place of engagement", VEHICLE_BGR)] * (self._engaged_ne_m is not None)
        for k, (name, color) in enumerate(legend):
            row = 20 + 18 * k
            if name == "place of engagement":
                cv2.drawMarker(picture, (18, row - 4), color, cv2.MARKER_TILTED_CROSS, 9, 1, cv2.LINE_AA)
            else:
                cv2.line(picture, (13, row - 4), (24, row - 4), color, 3)
            _text(picture, name, (32, row), WHITE, 0.42)
        north_mps, east_mps = self._wind.velocity_ne_mps(time_s)
        speed_mps = math.hypot(north_mps, east_mps)
        if speed_mps > 0:
            along = np.array([east_mps, -north_mps]) / speed_mps * 22
            middle = np.array([SIDE_PX - 38, SIDE_PX - 52])
            foot, tip = _xy(_pixels(middle - along)), _xy(_pixels(middle + along))
            cv2.arrowedLine(picture, foot, tip, WHITE, 2, cv2.LINE_AA, tipLength=0.3)
            _text(picture, f"wind {speed_mps:.0f} m/s", (SIDE_PX - 96, SIDE_PX - 12), WHITE, 0.42)


class _Trail:
    """Where something was, a point a step."""

    def __init__(self) -> None:
        self.points: deque[tuple[float, float]] = deque(maxlen=_TRAIL_COUNT)

    def add(self, place_ne_m: tuple[float, float] | None) -> None:
        if place_ne_m is not None and (not self.points or math.dist(place_ne_m, self.points[-1]) >= _TRAIL_STEP_M):
            self.points.append(place_ne_m)


def mode_color(mode: str) -> ColorBgr:
    """Of a mode, BGR."""
    return MODE_COLORS_BGR.get(mode, UNKNOWN_BGR)


def footprint_ne_m(camera: Camera, pose: Pose, reach_m: float = _REACH_M) -> Real64:
    """Outline (K, 2) of the ground that a camera sees, north and east in m, no farther than `reach_m`."""
    view = View(camera, pose)
    height, width = camera.size_hw
    steps = np.linspace(0.0, 1.0, 9)[:-1]
    sides = ((0, 0, 1, 0), (1, 0, 0, 1), (1, 1, -1, 0), (0, 1, 0, -1))  # round the frame: from, towards
    outline = [((x + dx * s) * (width - 1), (y + dy * s) * (height - 1), 1.0) for x, y, dx, dy in sides for s in steps]
    rays = np.array(outline) @ view.ned_from_image.T  # (K, 3), at unit depth
    far = reach_m / np.maximum(np.hypot(rays[:, 0], rays[:, 1]), 1e-9)
    down = np.where(rays[:, 2] > 0, view.height_m / np.maximum(rays[:, 2], 1e-9), math.inf)
    return np.asarray(view.eye_ned_m[:2] + rays[:, :2] * np.minimum(far, down)[:, None])


def _plans(scenery: Scenery) -> tuple[Image, ...]:
    """The ground with crowns and viaducts on it, dimmed, fine to coarse; north grows downwards, as in `Ground`."""
    ground = ground_of(scenery)
    level = int(ground.levels_for(_PLAN_PX_PER_M))
    plan = ground.levels[level].copy()
    to_pixels = ground.pixels_from_ne(level)
    px_per_m = len(plan) / scenery.tile_m
    for tree, *tile in product(scenery.trees, (-1, 0, 1), (-1, 0, 1)):  # one at the border shows on both sides
        place_ne_m = np.add(tree.pos_ne_m, np.multiply(tile, scenery.tile_m))
        center = _xy(_pixels((to_pixels @ (*place_ne_m, 1.0))[:2]))
        for share, color in ((1.0, (44, 78, 58)), (0.6, (58, 98, 74))):
            cv2.circle(plan, center, round(share * tree.crown_radius_m * px_per_m), color, cv2.FILLED, cv2.LINE_AA)
    for bridge in scenery.bridges:
        norths_m = (bridge.north_m - bridge.width_m / 2, bridge.north_m + bridge.width_m / 2)
        rows = [round(float((to_pixels @ (north_m, 0.0, 1.0))[1])) for north_m in norths_m]
        cv2.rectangle(plan, (0, rows[0]), (len(plan), rows[1]), (150, 150, 146), cv2.FILLED)
        for row in rows:
            cv2.line(plan, (0, row), (len(plan), row), (210, 210, 206), 2)
    plans = [np.asarray(cv2.convertScaleAbs(plan, alpha=_DIMMED), np.uint8)]
    for _ in range(_PLAN_COUNT - 1):
        size = len(plans[-1]) // 2
        plans.append(np.asarray(cv2.resize(plans[-1], (size, size), interpolation=cv2.INTER_AREA), np.uint8))
    return tuple(plans)


def _place(pos_ned_m: tuple[float, float, float]) -> tuple[float, float] | None:
    """North and east, None where one is not known."""
    north_m, east_m, _ = pos_ned_m
    return (north_m, east_m) if math.isfinite(north_m) and math.isfinite(east_m) else None


def _triangle(picture: Image, center_xy: tuple[int, int], yaw_rad: float) -> None:
    """The vehicle, its tip along the yaw; a disc where that is not known."""
    if not math.isfinite(yaw_rad):
        cv2.circle(picture, center_xy, 6, VEHICLE_BGR, cv2.FILLED, cv2.LINE_AA)
        return
    forward = np.array([math.sin(yaw_rad), -math.cos(yaw_rad)])
    right = np.array([-forward[1], forward[0]])
    corners = [12 * forward, -8 * forward + 8 * right, -4 * forward, -8 * forward - 8 * right]
    points = subpixels(np.array(corners) + center_xy)
    cv2.fillPoly(picture, [points], VEHICLE_BGR, cv2.LINE_AA, SUBPIXEL_BITS)
    cv2.polylines(picture, [points], True, _DARK, 1, cv2.LINE_AA, SUBPIXEL_BITS)  # noqa: FBT003 - by position only


def _rectangle(view: Image, box: Box, scale_xy: tuple[float, float], color: ColorBgr, width_px: int) -> tuple[int, int]:
    """Draw a box of the camera's frame, and return where its top left corner is in the view."""
    corners = np.array([[box.x, box.y], [box.x + box.w - 1, box.y + box.h - 1]]) * scale_xy
    first, last = (_xy(corner) for corner in _pixels(corners))
    cv2.rectangle(view, first, last, color, width_px, cv2.LINE_AA)
    return first


def _cross(view: Image) -> None:
    """Where the optical axis points."""
    col, row = (view.shape[1] - 1) // 2, (view.shape[0] - 1) // 2
    for dx, dy in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        cv2.line(view, (col + 4 * dx, row + 4 * dy), (col + 14 * dx, row + 14 * dy), (235, 235, 235), 1)


def _captions(view: Image, lines: list[tuple[str, ColorBgr]]) -> None:
    """Lines of text on a darkened strip at the lower edge."""
    if not lines:
        return
    top = len(view) - 20 * len(lines) - 12
    strip = view[top:]
    cv2.convertScaleAbs(strip, dst=strip, alpha=0.45)
    for k, (text, color) in enumerate(lines):
        _text(view, text, (12, top + 21 + 20 * k), color, 0.48)


def _text(picture: Image, text: str, origin_xy: tuple[int, int], color: ColorBgr, size: float) -> None:
    """One line on a picture; dark under light, which is legible on any ground."""
    cv2.putText(picture, _ascii(text), origin_xy, _FONT, size, (0, 0, 0), 3, cv2.LINE_AA)
    _plain(picture, text, origin_xy, color, size)


def _plain(picture: Image, text: str, origin_xy: tuple[int, int], color: ColorBgr, size: float) -> None:
    """One line on an even ground."""
    cv2.putText(picture, _ascii(text), origin_xy, _FONT, size, color, 1, cv2.LINE_AA)


def _ascii(text: str) -> str:
    """What OpenCV's font can draw."""
    return text.encode("ascii", "replace").decode()


def _said(value: float | None, unit: str, digits: int = 1) -> str:
    """A figure with its unit, or a dash where it is not known."""
    return f"{value:.{digits}f} {unit}".strip() if value is not None and math.isfinite(value) else "-"


def _pixels(points: npt.ArrayLike) -> Pixels:
    """The nearest whole pixels, cut where OpenCV's fixed-point coordinates would overflow."""
    return np.asarray(np.rint(np.clip(points, -_FARTHEST_PX, _FARTHEST_PX)), dtype=np.int32)


def _xy(point: Pixels) -> tuple[int, int]:
    """One point, as OpenCV wants it."""
    return int(point[0]), int(point[1])
