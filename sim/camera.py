"""The camera of the simulation: pictures of a world, and the true box of the target in them.

Pixel coordinates (u, v) have integer pixel centres; a `Box` counts area, so its edges lie half a pixel
further out.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from mscf.arrays import Image
from mscf.geometry import Box
from sim.cover import MeshSight, StillSight, cover_before, mesh_in_world, silhouette, still_in_view
from sim.ground import ground_of
from sim.painting import add_sky, draw_moving, draw_still, ground_motion_px, ground_picture
from sim.sensor import blurred, developed
from sim.shapes import Mesh
from sim.view import NEAREST_M, Camera, View, Window
from sim.world import Pose, World

__all__ = ["Camera", "Truth", "observe", "render"]


@dataclass(frozen=True, slots=True)
class Truth:
    """The target in one picture.

    box : extent of its body, clipped to the frame, 0-based; None where it is outside.
    visible_share : share of its silhouette that lies in the frame and that nothing hides, 0..1.
    """

    box: Box | None
    visible_share: float


def observe(world: World, camera: Camera, pose: Pose, time_s: float) -> Truth:
    """Truth of the picture that `render` would give, from geometry alone."""
    return _truth(View(camera, pose), None, world, time_s)


def _truth(view: View, still: list[StillSight] | None, world: World, time_s: float) -> Truth:
    """`still` are the things in view, None if nobody has looked yet."""
    if world.target is None:
        return Truth(None, 0.0)
    mesh = mesh_in_world(world.target, time_s)
    box = _box_in_frame(view, mesh)
    if box is None:
        return Truth(None, 0.0)
    window = Window.around(view.project(mesh.vertices_m)[0], margin_px=1)
    if still is None:
        still = still_in_view(view, world.scenery, window)
    body = silhouette(MeshSight.of(view, mesh), window)
    rivals = [mesh_in_world(mover, time_s) for mover in world.traffic]
    cover = cover_before(view, still, world.scenery.seed, mesh, rivals, window)
    seen = cv2.bitwise_and(body, cv2.bitwise_not(cover))
    height, width = view.camera.size_hw
    frame_area = np.zeros_like(seen)
    frame_area[max(-window.top, 0) : height - window.top, max(-window.left, 0) : width - window.left] = 255
    in_frame = cv2.countNonZero(cv2.bitwise_and(seen, frame_area))
    return Truth(box, in_frame / max(cv2.countNonZero(body), 1))


def render(
    world: World,
    camera: Camera,
    pose: Pose,
    time_s: float,
    *,
    pose_at_close: Pose | None = None,
    exposure_gain: float = 1.0,
    noise_time_s: float | None = None,
) -> tuple[Image, Truth]:
    """Picture of the world at `time_s`, and the truth in it.

    Parameters
    ----------
    pose : of the vehicle when the shutter opens.
    pose_at_close : of the vehicle `camera.exposure_s` later, for the motion blur; None if it stands still.
    exposure_gain : brightness, 1 is the normal exposure.
    noise_time_s : chooses the noise; None: `time_s`. A world that stands still is seen with fresh noise all the same.

    Returns
    -------
    ndarray of shape (H, W, 3), uint8 BGR, and its `Truth`. Same arguments, same picture, to the bit.
    """
    view = View(camera, pose)
    view_at_close = View(camera, pose_at_close or pose)
    ground = ground_of(world.scenery)
    seed = world.scenery.seed
    still = still_in_view(view, world.scenery, view.frame())
    frame = ground_picture(view, ground)
    add_sky(frame, view)
    draw_still(frame, view, ground, still, seed)
    frame = blurred(frame, ground_motion_px(view, view_at_close))
    truth = _truth(view, still, world, time_s)

    movers = world.traffic if world.target is None else (world.target, *world.traffic)
    meshes = [(mesh_in_world(mover, time_s), mesh_in_world(mover, time_s + camera.exposure_s)) for mover in movers]
    meshes.sort(key=lambda pair: -view.distance_m(pair[0].vertices_m.mean(axis=0)))
    for pair in meshes:
        draw_moving(frame, (view, view_at_close), still, seed, ground, pair)
    noise_s = time_s if noise_time_s is None else noise_time_s
    return developed(frame, seed, noise_s, exposure_gain, camera.noise_std), truth


def _box_in_frame(view: View, mesh: Mesh) -> Box | None:
    points_uv, depths_m = view.project(mesh.vertices_m)
    if depths_m.min() < NEAREST_M:
        return None
    height, width = view.camera.size_hw
    # Pixel centres are integers, a Box counts area: its edges are at the pixel borders, hence the half.
    left, top = np.maximum(points_uv.min(axis=0) + 0.5, 0.0)
    right, bottom = np.minimum(points_uv.max(axis=0) + 0.5, (width, height))
    if right <= left or bottom <= top:
        return None
    return Box(float(left), float(top), float(right - left), float(bottom - top))
