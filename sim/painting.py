"""Painting a view of the world: ground, still things, moving cars, sky. Functions change the frame given."""

import itertools
import math

import cv2
import numpy as np

from mscf.arrays import Image, Real64
from sim.cover import MeshSight, StillSight, TreeSight, cover_before, crown_in, silhouette
from sim.ground import SHADOW_DARKENING, SHADOW_NE, Ground
from sim.sensor import blurred
from sim.shapes import Mesh
from sim.view import NEAREST_M, SUBPIXEL_BITS, Subpixels, View, Window, subpixels

_NO_GROUND = -1
_COLUMNS_PER_TILT = 20  # columns where the horizon falls by the width of the frame, which are the most
_BARK_BGR = (42, 52, 60)
# Bluer and darker with the height above the horizon, 0 to 1 in units of depth.
_SKY_TABLE = np.rint(
    np.array((222, 212, 200)) * (1 - 0.35 * np.linspace(0, 1, 256)[:, None, None]) ** np.array([0.3, 0.8, 1.2])
).astype(np.uint8)  # (256, 1, 3)


def ground_picture(view: View, ground: Ground) -> Image:
    """The bare ground (H, W, 3), each row from the level of detail that fits its distance."""
    height, width = view.camera.size_hw
    frame = np.zeros((height, width, 3), np.uint8)
    down = view.ned_from_image[2]
    # Where the horizon is tilted the frame is cut into columns narrow enough for rows of one distance.
    tilt = abs(float(down[0])) / max(abs(float(down[1])), 1e-9)
    edges = np.linspace(0, width, math.ceil(min(max(_COLUMNS_PER_TILT * tilt, 1.0), _COLUMNS_PER_TILT)) + 1)
    for left, right in itertools.pairwise(np.rint(edges).astype(int).tolist()):
        _paint_column(frame, view, ground, left, right)
    return frame


def _paint_column(frame: Image, view: View, ground: Ground, left: int, right: int) -> None:
    """Paint the ground into the columns from `left` to `right`."""
    height = len(frame)
    middle = np.stack([np.full(height, (left + right - 1) / 2), np.arange(height), np.ones(height)])
    directions = view.ned_from_image @ middle  # (3, H), of unit depth
    sink = directions[2] / np.linalg.norm(directions, axis=0)
    # Ground resolution across the line of sight is f / depth; along it, it is shorter by the sine of the
    # depression. Their geometric mean decides: neither much blur across nor much aliasing along.
    px_per_m = view.camera.focal_px * np.maximum(directions[2], 1e-3) / view.height_m
    levels = ground.levels_for(px_per_m * np.sqrt(np.maximum(sink, 1e-3)))
    slope = abs(float(view.ned_from_image[2, 0])) * (right - left) / 2
    levels[directions[2] + slope < 0] = _NO_GROUND  # all of the row is sky
    starts = np.flatnonzero(np.diff(levels, prepend=_NO_GROUND - 1)).tolist()
    for first, end in itertools.pairwise([*starts, height]):
        level = int(levels[first])
        if level == _NO_GROUND:
            continue
        to_band = np.array([[1.0, 0.0, float(left)], [0.0, 1.0, float(first)], [0.0, 0.0, 1.0]])
        _warp(ground, level, view.ground_from_image() @ to_band, frame[first:end, left:right], view.eye_ned_m[:2])


def _warp(ground: Ground, level: int, ground_from_pixel: Real64, picture: Image, near_ne_m: Real64) -> None:
    """Fill `picture` from a level of the ground, given the homography from its pixels to north, east in m.

    `near_ne_m` is a place near to what it shows: OpenCV counts an image's pixels with 16 bits, so a far tile
    is looked up at home.
    """
    height, width = picture.shape[:2]
    to_home = np.eye(3)
    to_home[:2, 2] = -np.round(near_ne_m / ground.tile_m) * ground.tile_m
    cv2.warpPerspective(
        ground.levels[level],
        ground.pixels_from_ne(level) @ to_home @ ground_from_pixel,
        (width, height),
        dst=picture,
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_WRAP,
    )


def draw_still(frame: Image, view: View, ground: Ground, still: list[StillSight], seed: int) -> None:
    """Paint houses, bridges, parked cars and trees, far to near."""
    whole = view.frame()
    for sight in still:
        if isinstance(sight, TreeSight):
            part, crown = crown_in(sight, whole, seed)
            if crown is not None:
                _draw_trunk(frame, view, sight)
                cv2.copyTo(crown.image, crown.mask, part.of(frame))
        else:
            _draw_mesh(frame, whole, sight, ground)


def _draw_trunk(frame: Image, view: View, sight: TreeSight) -> None:
    """A stroke from the ground into the crown. Too thin to count as cover: the truth knows crowns only."""
    if sight.foot_depth_m < NEAREST_M:
        return
    thickness_px = max(round(0.14 * sight.tree.crown_radius_m * view.camera.focal_px / sight.foot_depth_m), 1)
    start, end = np.rint([sight.foot_uv, sight.crown_uv]).astype(int).tolist()
    cv2.line(frame, start, end, _BARK_BGR, thickness_px, cv2.LINE_AA)


def _draw_mesh(image: Image, window: Window, sight: MeshSight, ground: Ground) -> None:
    """Paint the front faces of a shape into `image`, which shows `window`."""
    mesh = sight.mesh
    for face, corners in sight.outlines(window):
        if mesh.is_textured[face]:
            _draw_textured(image, window, sight, ground, face, corners)
        else:
            cv2.fillConvexPoly(image, corners, mesh.paint_bgr[face], cv2.LINE_AA, SUBPIXEL_BITS)


def _draw_textured(
    image: Image, window: Window, sight: MeshSight, ground: Ground, face: int, corners: Subpixels
) -> None:
    """Paint a face with the ground texture of its plan; `corners` (K, 2) is its outline in `window`."""
    view, mesh = sight.view, sight.mesh
    col, row, width, height = (size >> SUBPIXEL_BITS for size in cv2.boundingRect(corners))
    part = Window(col - 1, row - 1, width + 4, height + 4).in_frame(image.shape[:2])
    if part.is_empty:
        return
    corners_m = sight.vertices_m[mesh.faces[face]]
    level = int(ground.levels_for(view.camera.focal_px / view.distance_m(corners_m.mean(axis=0)) * 0.8))
    # The plane of the face, (s, t, 1) -> a point of it, once as the eye sees it and once in plan.
    span_m = np.stack([corners_m[1] - corners_m[0], corners_m[-1] - corners_m[0], corners_m[0]], axis=1)  # (3, 3)
    plan_m = span_m.copy()
    plan_m[:2, 2] += mesh.texture_shift_ne_m
    plan_m[2] = (0.0, 0.0, 1.0)
    span_m[:, 2] -= view.eye_ned_m
    left, top = float(window.left + part.left), float(window.top + part.top)
    to_part = np.array([[1.0, 0.0, left], [0.0, 1.0, top], [0.0, 0.0, 1.0]])
    picture = np.empty((part.height, part.width, 3), np.uint8)
    _warp(ground, level, plan_m @ np.linalg.inv(view.image_from_ned @ span_m) @ to_part, picture, plan_m[:2, 2])
    cv2.convertScaleAbs(picture, dst=picture, alpha=mesh.light[face])
    mask = np.zeros((part.height, part.width), np.uint8)
    cv2.fillConvexPoly(mask, corners - part.origin, 255, cv2.LINE_8, SUBPIXEL_BITS)
    cv2.copyTo(picture, mask, part.of(image))


def draw_moving(
    frame: Image,
    views: tuple[View, View],
    still: list[StillSight],
    seed: int,
    ground: Ground,
    meshes: tuple[Mesh, Mesh],
) -> None:
    """Composite a mover with its shadow: blurred by its own motion, behind all that hides it.

    `views` and `meshes` (NED) are those of the opening and of the closing shutter.
    """
    (view, view_at_close), (mesh, mesh_at_close) = views, meshes
    on_ground_m = mesh.vertices_m.copy()
    on_ground_m[:, :2] -= mesh.vertices_m[:, 2:] * np.array(SHADOW_NE)
    on_ground_m[:, 2] = 0.0
    points_uv, depths_m = view.project(mesh.vertices_m)
    if depths_m.min() < NEAREST_M:
        return
    shadow_uv = view.project(on_ground_m)[0]
    motion_px = (view_at_close.project(mesh_at_close.vertices_m)[0] - points_uv).mean(axis=0)
    margin_px = 3 + math.ceil(float(np.abs(motion_px).max()))
    window = Window.around(np.concatenate([points_uv, shadow_uv]), margin_px).in_frame(view.camera.size_hw)
    if window.is_empty:
        return
    place = window.of(frame)
    place_ne_m = mesh.vertices_m[:, :2].mean(axis=0)
    sunlight = ground.sunlight_at((float(place_ne_m[0]), float(place_ne_m[1])))

    outline = cv2.convexHull(shadow_uv.astype(np.float32))[:, 0].astype(np.float64)
    shadow = np.zeros(place.shape[:2], np.uint8)
    cv2.fillConvexPoly(shadow, subpixels(outline) - window.origin, 255, cv2.LINE_AA, SUBPIXEL_BITS)
    # Some sky is hidden from the ground under a mover even where no sun falls.
    depth = np.array(SHADOW_DARKENING) * (0.35 + 0.65 * sunlight) / 255
    soft = cv2.GaussianBlur(shadow, (0, 0), 0.8)[..., None]
    layer = np.clip(place * (1 - soft * depth), 0, 255).astype(np.uint8)
    sight = MeshSight.of(view, mesh.lit(sunlight))
    _draw_mesh(layer, window, sight, ground)

    alpha = np.asarray(cv2.bitwise_or(shadow, silhouette(sight, window)), np.uint8)
    alpha = blurred(np.asarray(cv2.dilate(alpha, np.ones((3, 3), np.uint8)), np.uint8), motion_px)
    hidden = blurred(cover_before(view, still, seed, mesh, [], window), np.zeros(2))
    weight = (alpha.astype(np.float32) / 255 * (1 - hidden.astype(np.float32) / 255))[..., None]
    mixed = place * (1 - weight) + blurred(layer, motion_px) * weight
    place[...] = np.round(mixed)


def ground_motion_px(view: View, view_at_close: View) -> Real64:
    """Image motion (du, dv) of the ground at the middle of the picture during the exposure."""
    height, width = view.camera.size_hw
    down = view.ned_from_image @ np.array([(width - 1) / 2, (height - 1) / 2, 1.0])
    range_ = view.height_m / max(down[2], 0.05)  # in units of depth; 0.05 keeps it finite at the horizon
    point_ned_m = (view.eye_ned_m + range_ * down)[None]
    return np.asarray((view_at_close.project(point_ned_m)[0] - view.project(point_ned_m)[0])[0])


def add_sky(frame: Image, view: View) -> None:
    """Haze over the ground towards the horizon and sky above it; a view steeply down has neither."""
    height, width = view.camera.size_hw
    down = view.ned_from_image[2]  # of a pixel's ray, in units of depth
    haze_below = 0.10
    ends = down[0] * np.array([0, width]) + (down[1] * np.arange(height) + down[2])[:, None]  # (H, 2)
    rows = np.flatnonzero(ends.min(axis=1) < haze_below)
    if not len(rows):
        return
    part = frame[rows[0] : rows[-1] + 1]
    across, along = down[0] * np.arange(width), down[1] * np.arange(rows[0], rows[-1] + 1) + down[2]
    sink = np.add.outer(along, across).astype(np.float32)
    haze = np.clip(1 - sink / np.float32(haze_below), 0, 1)
    above = cv2.convertScaleAbs(np.clip(sink, -1.0, 0.0), alpha=255)  # 0 at the horizon
    sky = cv2.LUT(cv2.merge([above] * 3), _SKY_TABLE)
    part[...] = cv2.blendLinear(part, sky, 1 - haze, haze)
