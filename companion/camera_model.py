"""From a pixel to a direction over the ground, and back; the attitudes that this needs.

Chain: pixel -> camera axes (forward, right, down; undistorted) -> body FRD by the mount -> level frame by roll and
pitch -> azimuth and depression; with the yaw, earth bearing. All rotations are Rz(yaw) Ry(pitch) Rx(roll).
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np

from companion.config import Config
from companion.types import Attitude
from mscf.arrays import Real64

Quaternion = tuple[float, float, float, float]  # (w, x, y, z)

HISTORY_S = 2.0  # longer than any frame is useful
MAX_ATTITUDE_GAP_S = 0.3  # between two attitudes, over which nothing is interpolated, and beyond the last one
_VERTICAL = 1e-4  # cosine of a pitch at which roll and yaw are one


def wrapped(angle_rad: float) -> float:
    """The angle in -pi..pi."""
    return math.remainder(angle_rad, math.tau)


def rotation(roll_rad: float, pitch_rad: float, yaw_rad: float) -> Real64:
    """(3, 3) that takes FRD coordinates of a body to the frame in which it has these angles."""
    (c_r, s_r), (c_p, s_p), (c_y, s_y) = ((math.cos(a), math.sin(a)) for a in (roll_rad, pitch_rad, yaw_rad))
    return np.array(
        [
            [c_y * c_p, c_y * s_p * s_r - s_y * c_r, c_y * s_p * c_r + s_y * s_r],
            [s_y * c_p, s_y * s_p * s_r + c_y * c_r, s_y * s_p * c_r - c_y * s_r],
            [-s_p, c_p * s_r, c_p * c_r],
        ]
    )


def angles(frame_from_body: Real64) -> tuple[float, float, float]:
    """Roll, pitch and yaw of a rotation (3, 3), the inverse of `rotation`; straight up or down the roll counts as 0."""
    pitch_rad = math.asin(min(max(-float(frame_from_body[2, 0]), -1.0), 1.0))
    if math.hypot(frame_from_body[2, 1], frame_from_body[2, 2]) < _VERTICAL:
        return 0.0, pitch_rad, math.atan2(-frame_from_body[0, 1], frame_from_body[1, 1])
    roll_rad = math.atan2(frame_from_body[2, 1], frame_from_body[2, 2])
    return roll_rad, pitch_rad, math.atan2(frame_from_body[1, 0], frame_from_body[0, 0])


def quaternion(roll_rad: float, pitch_rad: float, yaw_rad: float) -> Quaternion:
    """(w, x, y, z) of `rotation`: Rz(yaw) Ry(pitch) Rx(roll)."""
    turned = product(
        (math.cos(yaw_rad / 2), 0.0, 0.0, math.sin(yaw_rad / 2)),
        (math.cos(pitch_rad / 2), 0.0, math.sin(pitch_rad / 2), 0.0),
    )
    return product(turned, (math.cos(roll_rad / 2), math.sin(roll_rad / 2), 0.0, 0.0))


def product(first: Quaternion, second: Quaternion) -> Quaternion:
    """Hamilton's product: the second rotation, then the first."""
    a, b, c, d = first
    w, x, y, z = second
    return (
        a * w - b * x - c * y - d * z,
        a * x + b * w + c * z - d * y,
        a * y - b * z + c * w + d * x,
        a * z + b * y - c * x + d * w,
    )


def on_the_way(first: Quaternion, second: Quaternion, share: float) -> Quaternion:
    """Rotation after a share of the shortest turn from one to another; above 1 that turn goes on at its rate.

    K. Shoemake, "Animating Rotation with Quaternion Curves", SIGGRAPH 1985.
    """
    w, x, y, z = product((first[0], -first[1], -first[2], -first[3]), second)
    sine = math.sqrt(x * x + y * y + z * z)
    if sine == 0:
        return first
    half_rad = math.atan2(sine, abs(w)) * share
    # q and -q are one rotation: the nearer one counts; beyond a full turn the sine has a sign of its own
    scale = math.copysign(1.0, w) * math.sin(half_rad) / sine
    return product(first, (math.cos(half_rad), scale * x, scale * y, scale * z))


def turn_between_rad(first: Quaternion, second: Quaternion) -> float:
    """Angle of the shortest turn from one to another, 0..pi."""
    w, x, y, z = product((first[0], -first[1], -first[2], -first[3]), second)
    return 2 * math.atan2(math.sqrt(x * x + y * y + z * z), abs(w))


def rotation_of(q: Sequence[float]) -> Real64 | None:
    """Rotation (3, 3) of a quaternion (w, x, y, z); None where it is none."""
    norm = math.sqrt(sum(value * value for value in q))
    if not 0.9 < norm < 1.1:  # NaN and infinity, too
        return None
    w, x, y, z = (value / norm for value in q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


@dataclass(frozen=True)
class CameraModel:
    """Pinhole camera with OpenCV's distortion, fixed to the vehicle; on a gimbal, as it is mounted at one moment.

    size_hw : of a frame, px. focal_px : the same for both axes; the principal point is the frame's middle.
    mount_rpy_rad : of the camera in the body, FRD; pitch -90 degrees looks straight down.
    """

    size_hw: tuple[int, int]
    focal_px: float
    distortion: tuple[float, ...] = ()
    mount_rpy_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @classmethod
    def of(cls, config: Config, size_hw: tuple[int, int]) -> "CameraModel":
        """Model of the configured camera for frames of `size_hw`, which a driver may have chosen otherwise."""
        camera = config.camera
        mount = tuple(math.radians(a) for a in (camera.mount_roll_deg, camera.mount_pitch_deg, camera.mount_yaw_deg))
        scale = size_hw[1] / camera.width_px
        return cls(size_hw, config.focal_px * scale, camera.distortion, (mount[0], mount[1], mount[2]))

    @property
    def fov_deg(self) -> tuple[float, float]:
        """Fields of view across and down, degrees, without the lens's distortion."""
        height, width = self.size_hw
        across_rad, down_rad = (2 * math.atan(side / 2 / self.focal_px) for side in (width, height))
        return math.degrees(across_rad), math.degrees(down_rad)

    def mounted(self, rpy_rad: tuple[float, float, float]) -> "CameraModel":
        """The same camera, mounted otherwise."""
        return replace(self, mount_rpy_rad=rpy_rad)

    @cached_property
    def _body_from_camera(self) -> Real64:
        return rotation(*self.mount_rpy_rad)

    @cached_property
    def _matrix(self) -> Real64:
        height, width = self.size_hw
        f = self.focal_px
        return np.array([[f, 0.0, (width - 1) / 2], [0.0, f, (height - 1) / 2], [0.0, 0.0, 1.0]])

    def ray_frd(self, uv: tuple[float, float]) -> Real64:
        """Unit vector (3,) in body FRD through pixel (u, v), whose centre has integer coordinates.

        With distortion, a pixel outside the frame counts as the nearest one in it: the lens was measured there only,
        and its polynomial may turn back and call what is far outside the middle.
        """
        height, width = self.size_hw
        if self.distortion:
            inside = min(max(uv[0], 0.0), width - 1.0), min(max(uv[1], 0.0), height - 1.0)
            point = np.array([[inside]], dtype=np.float64)
            right, down = cv2.undistortPoints(point, self._matrix, np.array(self.distortion))[0, 0]
        else:
            right, down = (uv[0] - (width - 1) / 2) / self.focal_px, (uv[1] - (height - 1) / 2) / self.focal_px
        ray = self._body_from_camera @ np.array([1.0, right, down])
        return np.asarray(ray / np.linalg.norm(ray))

    def pixel(self, ray_frd: Real64) -> tuple[float, float] | None:
        """Pixel (u, v) of a direction (3,) in body FRD, in or out of the frame; None: behind the camera."""
        forward, right, down = (float(value) for value in self._body_from_camera.T @ ray_frd)
        if forward <= 1e-6:
            return None
        if self.distortion:
            point = np.array([[right / forward, down / forward, 1.0]])
            u, v = cv2.projectPoints(point, np.zeros(3), np.zeros(3), self._matrix, np.array(self.distortion))[0][0, 0]
            return float(u), float(v)
        height, width = self.size_hw
        u = self.focal_px * right / forward + (width - 1) / 2
        return u, self.focal_px * down / forward + (height - 1) / 2


@dataclass(frozen=True, slots=True)
class Direction:
    """Where something is seen from the vehicle: in the level frame, and on earth."""

    azimuth_rad: float  # from the nose to the right
    depression_rad: float  # below the horizon
    bearing_rad: float  # from north to the east, -pi..pi


def direction(ray_frd: Real64, attitude: Attitude) -> Direction:
    """Direction of a body ray (3,) at an attitude."""
    x, y, z = (float(value) for value in rotation(attitude.roll_rad, attitude.pitch_rad, 0.0) @ ray_frd)
    azimuth_rad = math.atan2(y, x)
    return Direction(azimuth_rad, math.atan2(z, math.hypot(x, y)), wrapped(azimuth_rad + attitude.yaw_rad))


def ray_to(ned: Real64, attitude: Attitude) -> Real64:
    """Unit vector (3,) in body FRD towards an offset (3,) in NED; the inverse of `direction`."""
    ray = rotation(attitude.roll_rad, attitude.pitch_rad, attitude.yaw_rad).T @ ned
    return np.asarray(ray / max(float(np.linalg.norm(ray)), 1e-9))


class AttitudeHistory:
    """The attitudes of the last two seconds, to be asked for the one at a frame's time."""

    def __init__(self) -> None:
        self._attitudes: deque[Attitude] = deque()

    @property
    def newest(self) -> Attitude | None:
        """The last one that came."""
        return self._attitudes[-1] if self._attitudes else None

    def add(self, attitude: Attitude) -> None:
        """Take in an attitude; one that is not newer than the last is dropped."""
        if self._attitudes and attitude.time_s <= self._attitudes[-1].time_s:
            return
        self._attitudes.append(attitude)
        while attitude.time_s - self._attitudes[0].time_s > HISTORY_S:
            self._attitudes.popleft()

    def clear(self) -> None:
        """Forget all: the autopilot began anew."""
        self._attitudes.clear()

    def around(self, time_s: float) -> tuple[Attitude, Attitude | None] | None:
        """The last one that is not later than a time, and the next one, if there is one; None where all are later."""
        later: Attitude | None = None
        for earlier in reversed(self._attitudes):
            if earlier.time_s <= time_s:
                return earlier, later
            later = earlier
        return None

    def at(self, time_s: float) -> Attitude | None:
        """Attitude at a time, interpolated; None where none is near.

        Up to 0.3 s after the newest one, that one turned on by its yaw rate: a frame may be newer than the link. Angle
        by angle, which is the rotation itself as long as a vehicle does not stand on its nose or tail.
        """
        found = self.around(time_s)
        if found is None:
            return None
        earlier, later = found
        if later is not None:
            return _between(earlier, later, time_s) if later.time_s - earlier.time_s <= MAX_ATTITUDE_GAP_S else None
        gap_s = time_s - earlier.time_s
        yaw_rad = wrapped(earlier.yaw_rad + gap_s * earlier.yaw_rate_radps)
        turned = Attitude(time_s, earlier.roll_rad, earlier.pitch_rad, yaw_rad, earlier.yaw_rate_radps)
        return turned if gap_s <= MAX_ATTITUDE_GAP_S else None


def _between(earlier: Attitude, later: Attitude, time_s: float) -> Attitude:
    share = (time_s - earlier.time_s) / (later.time_s - earlier.time_s)

    def mixed(first: float, second: float) -> float:
        return wrapped(first + share * wrapped(second - first))

    return Attitude(
        time_s,
        mixed(earlier.roll_rad, later.roll_rad),
        mixed(earlier.pitch_rad, later.pitch_rad),
        mixed(earlier.yaw_rad, later.yaw_rad),
        earlier.yaw_rate_radps + share * (later.yaw_rate_radps - earlier.yaw_rate_radps),
    )
