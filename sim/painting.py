"""Painting a view of the world: ground, still things, moving cars, sky. Functions change the frame given."""

import math

import cv2
import numpy as np

from mscf.arrays import Image, Real64
from sim.cover import cover_before, crown_in, silhouette, visible_things
from sim.ground import SHADOW_DARKENING, SHADOW_NE, Ground
from sim.sensor import blurred
from sim.shapes import Mesh
from sim.view import NEAREST_M, SUBPIXEL_BITS, View, Window
from sim.world import Scenery, Tree, World

_BARK_BGR = (42, 52, 60)
_SKY_BGR = (222, 212, 200)


def ground_picture(view: View, ground: Ground) -> Image:
    """The bare ground (H, W, 3), each row from the level of detail that fits its distance."""
    height, width = view.camera.size_hw
    frame = np.zeros((height, width, 3), np.uint8)
    ground_from_image = np.linalg.inv(view.camera.image_from_ground(view.pose))
    rays_down = np.linalg.inv(view.image_from_ned)  # pixel -> NED direction of unit depth
    rows = np.arange(height)
    directions = rays_down @ np.stack([np.full(height, (width - 1) / 2), rows, np.ones(height)])  # (3, H)
    sink = directions[2] / np.linalg.norm(directions, axis=0)
    # Ground resolution across the line of sight is f / depth; along it, it is shorter by the sine of the
    # depression. Their geometric mean decides: neither much blur across nor much aliasing along.
    px_per_m = view.camera.focal_px * np.maximum(directions[2], 1e-3) / max(-view.eye_ned_m[2], NEAREST_M)
    levels = ground.levels_for(px_per_m * np.sqrt(np.maximum(sink, 1e-3)))
    starts = np.flatnonzero(np.diff(levels, prepend=-1))
    for first, end in zip(starts, [*starts[1:], height], strict=True):
        level = int(levels[first])
        to_band = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, float(first)], [0.0, 0.0, 1.0]])
        cv2.warpPerspective(
            ground.levels[level],
            ground.pixels_from_ne(level) @ ground_from_image @ to_band,
            (width, int(end - first)),
            dst=frame[first:end],
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_WRAP,
        )
    return frame


def draw_still(frame: Image, view: View, ground: Ground, scenery: Scenery) -> None:
    """Paint houses, bridges, parked cars and trees, far to near."""
    height, width = view.camera.size_hw
    whole = Window(0, 0, width, height)
    for thing, shift_m in visible_things(view, scenery, whole):
        if isinstance(thing, Tree):
            part, crown = crown_in(view, thing, shift_m, whole, scenery.seed)
            if crown is not None:
                _draw_trunk(frame, view, thing, shift_m)
                cv2.copyTo(crown.image, crown.mask, part.of(frame))
        else:
            _draw_mesh(frame, whole, view, thing.moved(shift_m), ground)


def _draw_trunk(frame: Image, view: View, tree: Tree, shift_m: Real64) -> None:
    """A stroke from the ground into the crown. Too thin to count as cover: the truth knows crowns only."""
    foot = np.array([*tree.pos_ne_m, 0.0]) + shift_m
    ends_uv, depths_m = view.project(np.stack([foot, foot - (0.0, 0.0, tree.crown_center_m)]))
    if depths_m.min() < NEAREST_M:
        return
    thickness_px = max(round(0.14 * tree.crown_radius_m * view.camera.focal_px / depths_m[0]), 1)
    start, end = np.rint(ends_uv).astype(int).tolist()
    cv2.line(frame, start, end, _BARK_BGR, thickness_px, cv2.LINE_AA)


def _draw_mesh(image: Image, window: Window, view: View, mesh: Mesh, ground: Ground) -> None:
    """Paint the front faces of a mesh into `image`, which shows `window`."""
    points_uv, depths_m = view.project(mesh.vertices_m)
    if depths_m.min() < NEAREST_M:
        return
    points = window.subpixels(points_uv)
    for k in np.flatnonzero(view.shows_front(mesh)):
        face = mesh.faces[k]
        if mesh.is_textured[k]:
            _draw_textured(image, window, view, mesh, ground, index=int(k))
        else:
            cv2.fillConvexPoly(image, points[face], mesh.paint_bgr[k], cv2.LINE_AA, SUBPIXEL_BITS)


def _draw_textured(image: Image, window: Window, view: View, mesh: Mesh, ground: Ground, *, index: int) -> None:
    """Paint the quadrilateral face `index` with the ground texture of its plan."""
    corners_m = mesh.vertices_m[mesh.faces[index]]
    corners_uv = view.project(corners_m)[0]
    part = Window.around(corners_uv, margin_px=1).in_frame(view.camera.size_hw)
    if part.is_empty:
        return
    distance_m = view.distance_m(corners_m.mean(axis=0))
    level = int(ground.levels_for(view.camera.focal_px / distance_m * 0.8))
    plan_ne_m = corners_m[:, :2] + np.array(mesh.texture_shift_ne_m)
    plan = np.column_stack([plan_ne_m, np.ones(4)]) @ ground.pixels_from_ne(level).T
    origin = plan[:, :2].min(axis=0)  # float32 below: keep the numbers small
    fine = cv2.getPerspectiveTransform(
        (corners_uv - (part.left, part.top)).astype(np.float32), (plan[:, :2] - origin).astype(np.float32)
    )
    to_level = np.array([[1.0, 0.0, origin[0]], [0.0, 1.0, origin[1]], [0.0, 0.0, 1.0]])
    picture = cv2.warpPerspective(
        ground.levels[level],
        to_level @ fine,
        (part.width, part.height),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_WRAP,
    )
    picture = cv2.convertScaleAbs(picture, alpha=mesh.light[index])
    mask = np.zeros((part.height, part.width), np.uint8)
    cv2.fillConvexPoly(mask, part.subpixels(corners_uv), 255, cv2.LINE_8, SUBPIXEL_BITS)
    inside = Window(part.left - window.left, part.top - window.top, part.width, part.height)
    cv2.copyTo(picture, mask, inside.of(image))


def draw_moving(
    frame: Image, views: tuple[View, View], world: World, ground: Ground, meshes: tuple[Mesh, Mesh]
) -> None:
    """Composite a moving car with its shadow: blurred by its own motion, behind all that hides it.

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
    cv2.fillConvexPoly(shadow, window.subpixels(outline), 255, cv2.LINE_AA, SUBPIXEL_BITS)
    # Some sky is hidden from the ground under a car even where no sun falls.
    depth = np.array(SHADOW_DARKENING) * (0.35 + 0.65 * sunlight) / 255
    soft = cv2.GaussianBlur(shadow, (0, 0), 0.8)[..., None]
    layer = np.clip(place * (1 - soft * depth), 0, 255).astype(np.uint8)
    _draw_mesh(layer, window, view, mesh.lit(sunlight), ground)

    alpha = np.asarray(cv2.bitwise_or(shadow, silhouette(view, mesh, window)), np.uint8)
    alpha = blurred(np.asarray(cv2.dilate(alpha, np.ones((3, 3), np.uint8)), np.uint8), motion_px)
    hidden = blurred(cover_before(view, world, mesh, [], window), np.zeros(2))
    weight = (alpha.astype(np.float32) / 255 * (1 - hidden.astype(np.float32) / 255))[..., None]
    mixed = place * (1 - weight) + blurred(layer, motion_px) * weight
    place[...] = np.round(mixed)


def ground_motion_px(view: View, view_at_close: View) -> Real64:
    """Image motion (du, dv) of the ground at the middle of the picture during the exposure."""
    height, width = view.camera.size_hw
    down = np.linalg.inv(view.image_from_ned) @ np.array([(width - 1) / 2, (height - 1) / 2, 1.0])
    range_ = -view.eye_ned_m[2] / max(down[2], 0.05)  # in units of depth; 0.05 keeps it finite at the horizon
    point_ned_m = (view.eye_ned_m + range_ * down)[None]
    return np.asarray((view_at_close.project(point_ned_m)[0] - view.project(point_ned_m)[0])[0])


def add_sky(frame: Image, view: View) -> None:
    """Haze towards the horizon and sky above it; a camera that looks steeply down sees neither."""
    height, width = view.camera.size_hw
    down = np.linalg.inv(view.image_from_ned)[2]  # of a pixel's ray, in units of depth
    u, v = np.arange(width), np.arange(height)[:, None]
    haze_below = 0.10
    corners = down[0] * np.array([0, width]) + down[1] * np.array([[0], [height]]) + down[2]
    if corners.min() > haze_below:
        return
    sink = (down[0] * u + down[1] * v + down[2]).astype(np.float32)
    haze = np.clip(1 - sink / haze_below, 0, 1)[..., None]
    fade = np.clip(1 + 0.35 * sink, 0.6, 1)[..., None]  # bluer and darker with height
    sky = np.array(_SKY_BGR, np.float32) * fade ** np.array([0.3, 0.8, 1.2], np.float32)
    frame[...] = frame * (1 - haze) + sky * haze
