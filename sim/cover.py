"""What shows in a view and what hides what: still things and movers as a view sees them, and their silhouettes."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
import numpy.typing as npt

from mscf.arrays import Image, Real64
from sim.foliage import Crown, crowns
from sim.shapes import Mesh, bridge_meshes, house_mesh, mover_mesh
from sim.view import NEAREST_M, SUBPIXEL_BITS, Subpixels, View, Window, subpixels
from sim.world import Mover, Scenery, Tree

_EDGE_ON_M = 1e-6
_LARGEST_CROWN_PX = 512  # wide pictures of crowns are made in parts


@dataclass(frozen=True, eq=False, slots=True)
class MeshSight:
    """A solid shape as a view shows it.

    vertices_m : its vertices where this view sees them (V, 3), NED; those of `mesh` but for whole tiles.
    points : its vertices in the frame (V, 2), void where nearer than `NEAREST_M` to the image plane.
    bounds : the least column and row of its points, then the greatest ones, in subpixels.
    front : the faces that turn towards the camera, in painting order.
    is_cut : whether some vertices are void.
    distance_m : from the camera to its nearest vertex.
    """

    view: View
    mesh: Mesh
    vertices_m: Real64
    points: Subpixels
    bounds: tuple[int, int, int, int]
    front: list[int]
    is_cut: bool
    distance_m: float

    @classmethod
    def of(cls, view: View, mesh: Mesh) -> "MeshSight":
        """How `view` sees one mesh, NED."""
        return _mesh_sights(view, [mesh], np.zeros((1, 3)))[0]

    def may_show_in(self, window: Window) -> bool:
        """Whether some of it may lie in a window: its points do not all lie on one side."""
        if self.is_cut:
            return True
        left, top, right, bottom = (bound / (1 << SUBPIXEL_BITS) for bound in self.bounds)
        return (
            window.left - 1 < right
            and left < window.left + window.width
            and window.top - 1 < bottom
            and top < window.top + window.height
        )

    def outlines(self, window: Window) -> Iterator[tuple[int, Subpixels]]:
        """The front faces, each with its corners (K, 2) in a window."""
        if self.is_cut:
            for face in self.front:
                corners = subpixels(self.view.outline(self.vertices_m[self.mesh.faces[face]]))
                if len(corners):
                    yield face, corners - window.origin
            return
        points = self.points - window.origin
        for face in self.front:
            yield face, points[self.mesh.faces[face]]


@dataclass(frozen=True, eq=False, slots=True)
class TreeSight:
    """A tree as a view shows it: where its crown and its middle (u, v), and its foot, are in the frame."""

    tree: Tree
    crown: Window
    crown_uv: Real64
    foot_uv: Real64
    foot_depth_m: float


StillSight = MeshSight | TreeSight


@dataclass(frozen=True, eq=False, slots=True)
class _StillThings:
    """Solid shapes, then trees, of a tile, with a bounding ball each: `centers_m` (N, 3), `radii_m` (N,)."""

    meshes: tuple[Mesh, ...]
    trees: tuple[Tree, ...]
    centers_m: Real64
    radii_m: Real64


@lru_cache(maxsize=2)
def _still_things(scenery: Scenery) -> _StillThings:
    """All still things of a tile, solid shapes painted for full sun; made once per scenery."""
    meshes = [house_mesh(house) for house in scenery.houses]
    for bridge in scenery.bridges:
        meshes += bridge_meshes(bridge, scenery.tile_m)
    meshes += [mesh_in_world(car, 0.0) for car in scenery.parked]
    meshes = [mesh.lit(sunlight=1.0) for mesh in meshes]
    centers_m = [mesh.vertices_m.mean(axis=0) for mesh in meshes]
    radii_m = [float(np.linalg.norm(m.vertices_m - c, axis=1).max()) for m, c in zip(meshes, centers_m, strict=True)]
    centers_m += [np.array([*tree.pos_ne_m, -tree.crown_center_m]) for tree in scenery.trees]
    radii_m += [tree.crown_radius_m for tree in scenery.trees]
    return _StillThings(
        tuple(meshes), scenery.trees, np.array(centers_m).reshape(-1, 3), np.array(radii_m, dtype=float)
    )


def still_in_view(view: View, scenery: Scenery, window: Window) -> list[StillSight]:
    """Still things that may show in a window, far to near, each in the copy of the tile that is nearest."""
    still = _still_things(scenery)
    # The copy of each thing nearest to a place ahead: the camera sees further forward than back.
    ahead_m = view.forward_ned * scenery.tile_m / 3
    shifts_m = np.round((view.eye_ned_m + ahead_m - still.centers_m) / scenery.tile_m) * scenery.tile_m
    shifts_m[:, 2] = 0.0
    centers_m = still.centers_m + shifts_m
    shown = np.flatnonzero(view.may_show(centers_m, still.radii_m, window))
    distances_m = np.linalg.norm(centers_m[shown] - view.eye_ned_m, axis=1)
    shown = shown[np.argsort(-distances_m, kind="stable")]

    mesh_count = len(still.meshes)
    is_mesh = shown < mesh_count
    sights: dict[int, StillSight] = {}
    if is_mesh.any():
        meshes = [still.meshes[k] for k in shown[is_mesh].tolist()]
        sights |= zip(shown[is_mesh].tolist(), _mesh_sights(view, meshes, shifts_m[shown[is_mesh]]), strict=True)
    sights |= _tree_sights(view, still, shown[~is_mesh], shifts_m)
    return [sights[k] for k in shown.tolist() if k in sights]


def _mesh_sights(view: View, meshes: list[Mesh], shifts_m: Real64) -> list[MeshSight]:
    """How `view` sees shapes, each at a shift (M, 3); in one go, as mesh by mesh takes most of a frame's time."""
    counts = np.array([len(mesh.vertices_m) for mesh in meshes], dtype=np.intp)
    ends = np.cumsum(counts)
    starts = ends - counts
    vertices_m = np.concatenate([mesh.vertices_m for mesh in meshes]) + np.repeat(shifts_m, counts, axis=0)
    points_uv, depths_m = view.project(vertices_m)
    points = subpixels(points_uv)
    offsets_m = vertices_m - view.eye_ned_m
    lows, highs = np.minimum.reduceat(points, starts).tolist(), np.maximum.reduceat(points, starts).tolist()
    is_cut = np.minimum.reduceat(depths_m, starts) < NEAREST_M
    distances_m = np.sqrt(np.minimum.reduceat(np.einsum("ij,ij->i", offsets_m, offsets_m), starts))

    normals = np.concatenate([mesh.normals for mesh in meshes])
    anchors = np.concatenate([mesh.anchors + start for mesh, start in zip(meshes, starts, strict=True)])
    # A face whose plane the eye is in shows nothing and has no texture map.
    is_front = np.einsum("ij,ij->i", normals, offsets_m[anchors]) < -_EDGE_ON_M
    fronts = np.split(is_front, np.cumsum([len(mesh.faces) for mesh in meshes])[:-1])
    return [
        MeshSight(
            view,
            mesh,
            vertices_m[starts[k] : ends[k]],
            points[starts[k] : ends[k]],
            (*lows[k], *highs[k]),
            np.flatnonzero(fronts[k]).tolist(),
            bool(is_cut[k]),
            float(distances_m[k]),
        )
        for k, mesh in enumerate(meshes)
    ]


def _tree_sights(
    view: View, still: _StillThings, shown: npt.NDArray[np.intp], shifts_m: Real64
) -> dict[int, StillSight]:
    """Trees whose crown's middle is ahead of the camera."""
    centers_m = still.centers_m[shown] + shifts_m[shown]
    feet_m = centers_m * (1.0, 1.0, 0.0)
    centers_uv, depths_m = view.project(centers_m)
    feet_uv, foot_depths_m = view.project(feet_m)
    first_tree = len(still.meshes)
    sights: dict[int, StillSight] = {}
    for k, (u, v), depth_m, foot_uv, foot_depth_m in zip(
        shown.tolist(), centers_uv, depths_m, feet_uv, foot_depths_m, strict=True
    ):
        if depth_m > NEAREST_M:
            tree = still.trees[k - first_tree]
            side = max(round(2 * view.camera.focal_px * tree.crown_radius_m / depth_m), 2)
            crown = Window(round(u - side / 2), round(v - side / 2), side, side)
            sights[k] = TreeSight(tree, crown, np.array([u, v]), foot_uv, float(foot_depth_m))
    return sights


def mesh_in_world(mover: Mover, time_s: float) -> Mesh:
    """Shape of a mover where it is at `time_s`, NED."""
    return mover_mesh(mover.kind, mover.color_bgr).placed(mover.motion.pose(time_s))


def silhouette(sight: MeshSight, window: Window) -> Image:
    """Mask of a shape in a window (h, w), 255 inside."""
    mask = np.zeros((window.height, window.width), np.uint8)
    for _, corners in sight.outlines(window):
        cv2.fillConvexPoly(mask, corners, 255, cv2.LINE_8, SUBPIXEL_BITS)
    return mask


def cover_before(
    view: View, still: list[StillSight], seed: int, mesh: Mesh, rivals: list[Mesh], window: Window
) -> Image:
    """Mask (h, w) of all that hides `mesh` in a window: still things and nearer movers.

    Every line of sight goes down to the ground, so of two things that share a pixel the one whose nearest
    point is nearer hides the other.
    """
    mask = np.zeros((window.height, window.width), np.uint8)
    distance_m = view.distance_m(mesh.vertices_m.mean(axis=0))
    for sight in still:
        if isinstance(sight, TreeSight):
            part, crown = crown_in(sight, window, seed)
            if crown is not None:
                target = part.of(mask)
                np.maximum(target, crown.mask, out=target)
        elif sight.distance_m < distance_m and sight.may_show_in(window):
            np.maximum(mask, silhouette(sight, window), out=mask)
    for rival in rivals:
        if view.distance_m(rival.vertices_m.mean(axis=0)) < distance_m:
            np.maximum(mask, silhouette(MeshSight.of(view, rival), window), out=mask)
    return mask


def crown_in(sight: TreeSight, window: Window, seed: int) -> tuple[Window, Crown | None]:
    """The part of a tree's crown that falls in a window: where (relative to the window), and its picture."""
    whole = sight.crown
    part = Window(whole.left - window.left, whole.top - window.top, whole.width, whole.height)
    cut = part.in_frame((window.height, window.width))
    if cut.is_empty:
        return cut, None
    crown = crowns(seed)[sight.tree.variety]
    inside = Window(cut.left - part.left, cut.top - part.top, cut.width, cut.height)
    image = _magnified(crown.image, whole.width, inside)
    mask = cv2.threshold(_magnified(crown.mask, whole.width, inside), 127, 255, cv2.THRESH_BINARY)[1]
    return cut, Crown(image, np.asarray(mask, np.uint8))


def _magnified(picture: Image, side: int, part: Window) -> Image:
    """A part of `picture` as it is when `side` pixels wide."""
    if side <= _LARGEST_CROWN_PX:
        return part.of(np.asarray(cv2.resize(picture, (side, side), interpolation=cv2.INTER_LINEAR), np.uint8))
    # Just before the camera: never the whole, which may have more pixels than there is memory.
    step = len(picture) / side
    first_col, first_row = (part.left + 0.5) * step - 0.5, (part.top + 0.5) * step - 0.5
    return np.asarray(
        cv2.warpAffine(
            picture,
            np.array([[step, 0.0, first_col], [0.0, step, first_row]]),
            (part.width, part.height),
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_REPLICATE,
        ),
        np.uint8,
    )
