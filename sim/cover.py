"""What hides what: the still things of a scenery, their silhouettes, and the cover before a car."""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from mscf.arrays import Image, Real64
from sim.foliage import Crown, crowns
from sim.shapes import Mesh, bridge_meshes, car_mesh, house_mesh
from sim.view import NEAREST_M, SUBPIXEL_BITS, View, Window
from sim.world import Car, Scenery, Tree, World


@dataclass(frozen=True, eq=False, slots=True)
class _StillThings:
    """Solid shapes and trees of a tile, with a bounding ball each: `centers_m` (N, 3), `radii_m` (N,)."""

    things: tuple[Mesh | Tree, ...]
    centers_m: Real64
    radii_m: Real64


@lru_cache(maxsize=2)
def still_things(scenery: Scenery) -> _StillThings:
    """All still things of a tile, solid shapes painted for full sun; made once per scenery."""
    meshes = [house_mesh(house) for house in scenery.houses]
    for bridge in scenery.bridges:
        meshes += bridge_meshes(bridge, scenery.tile_m)
    meshes += [car_in_world(car, 0.0) for car in scenery.parked]
    meshes = [mesh.lit(sunlight=1.0) for mesh in meshes]
    centers_m = [mesh.vertices_m.mean(axis=0) for mesh in meshes]
    radii_m = [float(np.linalg.norm(m.vertices_m - c, axis=1).max()) for m, c in zip(meshes, centers_m, strict=True)]
    centers_m += [np.array([*tree.pos_ne_m, -tree.crown_center_m]) for tree in scenery.trees]
    radii_m += [tree.crown_radius_m for tree in scenery.trees]
    return _StillThings((*meshes, *scenery.trees), np.array(centers_m).reshape(-1, 3), np.array(radii_m, dtype=float))


def visible_things(view: View, scenery: Scenery, window: Window) -> list[tuple[Mesh | Tree, Real64]]:
    """Still things that may show in a window, far to near, each with its shift (3,) to the nearest tile."""
    still = still_things(scenery)
    # The copy of each thing nearest to a place ahead: the camera sees further forward than back.
    ahead_m = view.forward_ned * scenery.tile_m / 3
    shifts_m = np.round((view.eye_ned_m + ahead_m - still.centers_m) / scenery.tile_m) * scenery.tile_m
    shifts_m[:, 2] = 0.0
    centers_m = still.centers_m + shifts_m
    centers_uv, depths_m = view.project(centers_m)
    # 1.2: the picture of a ball off the axis is a little longer than f r / depth.
    radii_px = 1.2 * view.camera.focal_px * still.radii_m / np.maximum(depths_m, NEAREST_M)
    u, v = centers_uv.T
    is_near = (depths_m > still.radii_m + NEAREST_M) & (
        (u + radii_px > window.left)
        & (u - radii_px < window.left + window.width)
        & (v + radii_px > window.top)
        & (v - radii_px < window.top + window.height)
    )
    distances_m = np.linalg.norm(centers_m - view.eye_ned_m, axis=1)
    order = np.flatnonzero(is_near)[np.argsort(-distances_m[is_near], kind="stable")]
    return [(still.things[k], shifts_m[k]) for k in order]


def car_in_world(car: Car, time_s: float) -> Mesh:
    """Shape of a car where it is at `time_s`, NED."""
    return car_mesh(car.color_bgr).placed(car.motion.pose(time_s))


def silhouette(view: View, mesh: Mesh, window: Window) -> Image:
    """Mask of a mesh in a window (h, w), 255 inside."""
    mask = np.zeros((window.height, window.width), np.uint8)
    points = window.subpixels(view.project(mesh.vertices_m)[0])
    for k in np.flatnonzero(view.shows_front(mesh)):
        cv2.fillConvexPoly(mask, points[mesh.faces[k]], 255, cv2.LINE_8, SUBPIXEL_BITS)
    return mask


def cover_before(view: View, world: World, mesh: Mesh, rivals: list[Mesh], window: Window) -> Image:
    """Mask (h, w) of all that hides `mesh` in a window: still things and nearer cars.

    Every line of sight goes down to the ground, so of two things that share a pixel the one whose nearest
    point is nearer hides the other.
    """
    mask = np.zeros((window.height, window.width), np.uint8)
    middle_m = mesh.vertices_m.mean(axis=0)
    distance_m = view.distance_m(middle_m)
    for thing, shift_m in visible_things(view, world.scenery, window):
        if isinstance(thing, Tree):
            part, crown = crown_in(view, thing, shift_m, window, world.scenery.seed)
            if crown is not None:
                target = part.of(mask)
                np.maximum(target, crown.mask, out=target)
        elif np.linalg.norm(thing.vertices_m + shift_m - view.eye_ned_m, axis=1).min() < distance_m:
            np.maximum(mask, silhouette(view, thing.moved(shift_m), window), out=mask)
    for rival in rivals:
        if view.distance_m(rival.vertices_m.mean(axis=0)) < distance_m:
            np.maximum(mask, silhouette(view, rival, window), out=mask)
    return mask


def crown_in(view: View, tree: Tree, shift_m: Real64, window: Window, seed: int) -> tuple[Window, Crown | None]:
    """The part of a tree's crown that falls in a window: where (relative to the window), and its picture."""
    center = np.array([[*tree.pos_ne_m, -tree.crown_center_m]]) + shift_m
    ((u, v),), (depth_m,) = view.project(center)
    side = max(round(2 * view.camera.focal_px * tree.crown_radius_m / depth_m), 2)
    left, top = round(u - side / 2) - window.left, round(v - side / 2) - window.top
    part = Window(left, top, side, side).in_frame((window.height, window.width))
    if part.is_empty:
        return part, None
    crown = crowns(seed)[tree.variety]
    cut = Window(part.left - left, part.top - top, part.width, part.height)
    image = cv2.resize(crown.image, (side, side), interpolation=cv2.INTER_LINEAR)
    mask = cv2.resize(crown.mask, (side, side), interpolation=cv2.INTER_LINEAR)
    mask = cv2.threshold(cut.of(np.asarray(mask, np.uint8)), 127, 255, cv2.THRESH_BINARY)[1]
    return part, Crown(cut.of(np.asarray(image, np.uint8)), np.asarray(mask, np.uint8))
