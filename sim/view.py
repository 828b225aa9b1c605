"""Pinhole projection: the camera, the camera at a pose, and windows of its picture plane.

Pixel coordinates (u, v) have integer pixel centres. Optical axes: u to the right, v down, depth along the
axis.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from mscf.arrays import Image, Real64
from sim.shapes import Mesh
from sim.world import Pose

NEAREST_M = 1.0  # nothing closer to the image plane is drawn
SUBPIXEL_BITS = 4  # of fixed-point coordinates

# FRD of the camera -> optical axes (right, down, forward).
_OPTICAL_FROM_FRD = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])


@dataclass(frozen=True, slots=True)
class Camera:
    """Pinhole camera, fixed to its vehicle, looking forward and `mount_pitch_rad` up (negative: down)."""

    size_hw: tuple[int, int] = (720, 1280)
    focal_px: float = 900.0
    mount_pitch_rad: float = math.radians(-35.0)
    exposure_s: float = 1 / 120
    noise_std: float = 2.6  # of the gray levels

    def optical_from_ned(self, pose: Pose) -> Real64:
        """Rotation (3, 3) from NED to the optical axes (right, down, forward) of a camera at `pose`."""
        body_from_camera = Pose((0, 0, 0), pitch_rad=self.mount_pitch_rad).ned_from_body()
        return np.asarray(_OPTICAL_FROM_FRD @ body_from_camera.T @ pose.ned_from_body().T)

    def matrix(self) -> Real64:
        """Intrinsic matrix K (3, 3): optical axes -> homogeneous (u, v, 1)."""
        height, width = self.size_hw
        f = self.focal_px
        return np.array([[f, 0.0, (width - 1) / 2], [0.0, f, (height - 1) / 2], [0.0, 0.0, 1.0]])

    def project(self, pose: Pose, points_ned_m: npt.ArrayLike) -> tuple[Real64, Real64]:
        """Pixels (N, 2) as (u, v), and depths (N,) in m, of points (N, 3).

        Points nearer than `NEAREST_M` to the image plane, or behind it, get the pixel of that depth: look at
        the depth before using one.
        """
        return View(self, pose).project(np.asarray(points_ned_m, dtype=np.float64))

    def image_from_ground(self, pose: Pose) -> Real64:
        """Homography (3, 3) from ground points (north, east, 1) in m to homogeneous (u, v, 1)."""
        rotation = self.optical_from_ned(pose)
        columns = [rotation[:, 0], rotation[:, 1], -rotation @ np.array(pose.pos_ned_m)]
        return np.asarray(self.matrix() @ np.stack(columns, axis=1))


class View:
    """A camera at a pose, with the matrices that every projection needs."""

    def __init__(self, camera: Camera, pose: Pose) -> None:
        self.camera = camera
        self.pose = pose
        self.eye_ned_m = np.array(pose.pos_ned_m)
        self.forward_ned = camera.optical_from_ned(pose)[2]  # optical axis, unit vector
        # (3, 3), for offsets from the eye
        self.image_from_ned = camera.matrix() @ camera.optical_from_ned(pose)

    def project(self, points_ned_m: Real64) -> tuple[Real64, Real64]:
        """As `Camera.project`."""
        homogeneous = (points_ned_m - self.eye_ned_m) @ self.image_from_ned.T
        return homogeneous[:, :2] / np.maximum(homogeneous[:, 2:], NEAREST_M), homogeneous[:, 2]

    def distance_m(self, point_ned_m: Real64) -> float:
        """From the camera to a point (3,)."""
        return float(np.linalg.norm(point_ned_m - self.eye_ned_m))

    def shows_front(self, mesh: Mesh) -> npt.NDArray[np.bool_]:
        """Which faces (F,) of a mesh turn towards the camera."""
        anchors_m = mesh.vertices_m[mesh.anchors]  # (F, 3)
        return np.asarray(np.sum(mesh.normals * (self.eye_ned_m - anchors_m), axis=1) > 0)


@dataclass(frozen=True, slots=True)
class Window:
    """Part of the picture plane in whole pixels, in or out of the frame."""

    left: int
    top: int
    width: int
    height: int

    @classmethod
    def around(cls, points_uv: Real64, margin_px: int) -> "Window":
        """Smallest window with a margin around points (N, 2)."""
        left, top = (int(v) for v in np.floor(points_uv.min(axis=0)) - margin_px)
        right, bottom = (int(v) for v in np.ceil(points_uv.max(axis=0)) + margin_px + 1)
        return cls(left, top, right - left, bottom - top)

    def in_frame(self, size_hw: tuple[int, int]) -> "Window":
        """The part of this window that lies in a frame; its size is 0 or less if there is none."""
        left, top = max(self.left, 0), max(self.top, 0)
        right, bottom = min(self.left + self.width, size_hw[1]), min(self.top + self.height, size_hw[0])
        return Window(left, top, right - left, bottom - top)

    @property
    def is_empty(self) -> bool:
        """Whether it holds no pixel."""
        return self.width <= 0 or self.height <= 0

    def of(self, frame: Image) -> Image:
        """View of the pixels of this window, which must lie in `frame`."""
        return frame[self.top : self.top + self.height, self.left : self.left + self.width]

    def subpixels(self, points_uv: Real64) -> npt.NDArray[np.int32]:
        """Fixed-point window coordinates, as OpenCV's drawing functions take them."""
        offsets = points_uv - (self.left, self.top)
        return np.asarray(np.rint(offsets * 2**SUBPIXEL_BITS), dtype=np.int32)
