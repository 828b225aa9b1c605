"""Pinhole projection: the camera, the camera at a pose, and windows of its picture plane.

Pixel coordinates (u, v) have integer pixel centres. Optical axes: u to the right, v down, depth along the
axis.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from mscf.arrays import Image, Real64
from sim.world import Pose

NEAREST_M = 1.0  # nothing closer to the image plane is drawn
LOWEST_M = 0.3  # above the ground: where the camera of a vehicle that stands is
SUBPIXEL_BITS = 4  # of fixed-point coordinates

Subpixels = npt.NDArray[np.int32]

_FARTHEST_PX = 1e6

# FRD of the camera -> optical axes (right, down, forward).
_OPTICAL_FROM_FRD = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])


@dataclass(frozen=True, slots=True)
class Camera:
    """Pinhole camera, fixed to its vehicle.

    The mount angles turn the body's axes (FRD) into the camera's own, in the order and signs of a `Pose`: all
    zero looks along the nose, a pitch of -90 degrees looks straight down with the top of the picture forward.
    """

    size_hw: tuple[int, int] = (720, 1280)
    focal_px: float = 900.0
    mount_pitch_rad: float = math.radians(-35.0)
    mount_yaw_rad: float = 0.0
    mount_roll_rad: float = 0.0
    exposure_s: float = 1 / 120
    noise_std: float = 2.6  # of the gray levels

    def optical_from_ned(self, pose: Pose) -> Real64:
        """Rotation (3, 3) from NED to the optical axes (right, down, forward) of a camera at `pose`."""
        mount = Pose((0, 0, 0), self.mount_roll_rad, self.mount_pitch_rad, self.mount_yaw_rad)
        return np.asarray(_OPTICAL_FROM_FRD @ mount.ned_from_body().T @ pose.ned_from_body().T)

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


class View:
    """A camera at a pose, never below `LOWEST_M`, with the matrices that every projection needs."""

    def __init__(self, camera: Camera, pose: Pose) -> None:
        north_m, east_m, down_m = pose.pos_ned_m
        optical_from_ned = camera.optical_from_ned(pose)
        self.camera = camera
        self.eye_ned_m = np.array([north_m, east_m, min(down_m, -LOWEST_M)])
        self.forward_ned = optical_from_ned[2]  # optical axis, unit vector
        # (3, 3), for offsets from the eye, and back: a pixel (u, v, 1) -> its ray at unit depth
        self.image_from_ned = camera.matrix() @ optical_from_ned
        self.ned_from_image = np.linalg.inv(self.image_from_ned)

    @property
    def height_m(self) -> float:
        """Of the camera above the ground."""
        return float(-self.eye_ned_m[2])

    def ground_from_image(self) -> Real64:
        """Homography (3, 3) from pixels (u, v, 1) to homogeneous ground points (north, east, 1) in m."""
        north_m, east_m, _ = self.eye_ned_m
        onto_ground = np.array([[self.height_m, 0.0, north_m], [0.0, self.height_m, east_m], [0.0, 0.0, 1.0]])
        return np.asarray(onto_ground @ self.ned_from_image)

    def project(self, points_ned_m: Real64) -> tuple[Real64, Real64]:
        """As `Camera.project`."""
        homogeneous = (points_ned_m - self.eye_ned_m) @ self.image_from_ned.T
        return homogeneous[:, :2] / np.maximum(homogeneous[:, 2:], NEAREST_M), homogeneous[:, 2]

    def distance_m(self, point_ned_m: Real64) -> float:
        """From the camera to a point (3,)."""
        return float(np.linalg.norm(point_ned_m - self.eye_ned_m))

    def outline(self, corners_m: Real64) -> Real64:
        """Pixels (K', 2) of the part of a flat polygon (K, 3) that is not nearer than `NEAREST_M`; may be empty."""
        depths_m = (corners_m - self.eye_ned_m) @ self.forward_ned
        kept_m: list[Real64] = []
        for k, depth_m in enumerate(depths_m):
            before_m = depths_m[k - 1]
            if (depth_m < NEAREST_M) != (before_m < NEAREST_M):  # the side from the corner before it is cut
                share = (NEAREST_M - before_m) / (depth_m - before_m)
                kept_m.append(corners_m[k - 1] + share * (corners_m[k] - corners_m[k - 1]))
            if depth_m >= NEAREST_M:
                kept_m.append(corners_m[k])
        return self.project(np.array(kept_m).reshape(-1, 3))[0]

    def frame(self) -> "Window":
        """The whole frame."""
        height, width = self.camera.size_hw
        return Window(0, 0, width, height)

    def may_show(self, centers_m: Real64, radii_m: Real64, window: "Window") -> npt.NDArray[np.bool_]:
        """Which balls (N, 3), (N,) reach into the pyramid of what a window shows."""
        u, v, depth = self.image_from_ned
        right, bottom = window.left + window.width, window.top + window.height
        # Inward normals of the sides, a pixel outside of the outermost pixel centres.
        normals = np.stack(
            [u - (window.left - 1) * depth, right * depth - u, v - (window.top - 1) * depth, bottom * depth - v]
        )
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        offsets_m = centers_m - self.eye_ned_m
        is_inside = (offsets_m @ normals.T > -radii_m[:, None]).all(axis=1)
        return np.asarray(is_inside & (offsets_m @ self.forward_ned > NEAREST_M - radii_m))


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

    @property
    def origin(self) -> Subpixels:
        """Its first pixel (2,) among the `subpixels` of the frame."""
        return np.array([self.left, self.top], dtype=np.int32) << SUBPIXEL_BITS


def subpixels(points_uv: Real64) -> Subpixels:
    """Fixed-point pixels, as OpenCV's drawing functions take them; cut where 32 bits would not hold them."""
    return np.asarray(np.rint(np.clip(points_uv, -_FARTHEST_PX, _FARTHEST_PX) * 2**SUBPIXEL_BITS), dtype=np.int32)
