"""The built-in flight: a drone follows a car through the village, with all that makes following hard."""

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property
from pathlib import Path

import numpy as np

from mscf.arrays import Image
from mscf.geometry import Box
from sim.camera import Camera, Truth, observe, render
from sim.scenery import village
from sim.world import Motion, Mover, Pose, World

TARGET_BGR = (112, 70, 52)  # a dark blue
RIVAL_BGR = (104, 72, 58)  # nearly the same

# North in the right lane, brake, turn right at the crossing, accelerate east.
TARGET_MOTION = Motion(
    (-76.0, 1.9),
    segments=((99.5, 0.0), (8.0 * math.pi / 2, 1 / 8.0), (5.0, 0.0)),
    speeds=((0.0, 10.0), (7.6, 10.0), (10.0, 3.6), (12.6, 4.6), (14.5, 9.0)),
)
# South in the other lane; meets the target at about 7.3 s.
RIVAL_MOTION = Motion((90.0, -1.9), math.pi, speeds=((0.0, 11.5),))
# Out of the crossing road's far end, westwards, behind the target's turn.
THIRD_MOTION = Motion((35.9, 120.0), -math.pi / 2, speeds=((0.0, 7.0), (9.0, 9.0)))

_FOLLOW_SPAN_S = 1.6  # the drone follows the car's path averaged over this much time


class SyntheticFlight:
    """A sequence of frames with their truth; the same one on every iteration.

    Parameters
    ----------
    frame_count : number of frames; fewer than 450 are the first ones of the same flight.
    size_hw : of a frame in pixels; the field of view is that of 1280 pixels in width at any size.
    frames_per_s : frame rate.
    seed : of the scattered things, the shaking and the noise.

    Raises
    ------
    ValueError
        If an argument is out of range.
    """

    name = "synthetic flight"
    files: tuple[Path, ...] = ()  # nothing is read

    def __init__(
        self,
        frame_count: int = 450,
        size_hw: tuple[int, int] = (720, 1280),
        frames_per_s: float = 30.0,
        seed: int = 7,
    ) -> None:
        if frame_count < 1:
            raise ValueError(f"frame_count is {frame_count}, must be at least 1")
        if not (min(size_hw) >= 16 and max(size_hw) <= 8192):
            raise ValueError(f"size_hw is {size_hw}, both must be in 16..8192 pixels")
        if not (math.isfinite(frames_per_s) and frames_per_s > 0):
            raise ValueError(f"frames_per_s is {frames_per_s}, must be finite and above 0")
        if seed < 0:
            raise ValueError(f"seed is {seed}, must be at least 0")
        self.frame_count = frame_count
        self.size_hw = size_hw
        self.frames_per_s = frames_per_s
        self.seed = seed
        self.camera = Camera(size_hw, focal_px=900.0 * size_hw[1] / 1280)
        traffic = (Mover(RIVAL_MOTION, RIVAL_BGR), Mover(THIRD_MOTION, (176, 180, 182)))
        self.world = World(village(seed), Mover(TARGET_MOTION, TARGET_BGR), traffic)
        self._shake = _Shake(seed)

    def __len__(self) -> int:
        return self.frame_count

    def __iter__(self) -> Iterator[Image]:
        for index in range(self.frame_count):
            yield self.frame(index)

    def frame(self, index: int) -> Image:
        """Frame `index`, (H, W, 3) uint8 BGR."""
        time_s = index / self.frames_per_s
        image, _ = render(
            self.world,
            self.camera,
            self.pose(time_s),
            time_s,
            pose_at_close=self.pose(time_s + self.camera.exposure_s),
            exposure_gain=exposure_gain(time_s),
        )
        return image

    @cached_property
    def _truths(self) -> tuple[Truth, ...]:
        times_s = [index / self.frames_per_s for index in range(self.frame_count)]
        return tuple(observe(self.world, self.camera, self.pose(t), t) for t in times_s)

    @property
    def truth(self) -> tuple[Box | None, ...]:
        """True box of the target per frame, 0-based; None where it is outside the frame."""
        return tuple(truth.box for truth in self._truths)

    @property
    def visible_share(self) -> tuple[float, ...]:
        """Share of the target per frame that nothing hides, 0..1."""
        return tuple(truth.visible_share for truth in self._truths)

    def pose(self, time_s: float) -> Pose:
        """Pose of the drone: behind the car's smoothed path, circling it slowly, coming down and closer."""
        offsets_s = np.linspace(-1, 1, 9) * _FOLLOW_SPAN_S
        weights = np.cos(np.linspace(-1, 1, 9) * math.pi / 2.2)
        places = np.array([TARGET_MOTION.pose(time_s + dt).pos_ned_m[:2] for dt in offsets_s])
        north_m, east_m = np.average(places, axis=0, weights=weights)

        descent = _smooth_step((time_s - 1.0) / 12.0)
        height_m = 41.0 - 15.0 * descent
        reach_m = 60.0 - 27.0 * descent
        # Bearing from the car to the drone: from the south-west round to the south-east.
        bearing_rad = math.radians(205.0 - 32.0 * _smooth_step((time_s - 2.0) / 13.0))
        position = (
            float(north_m) + reach_m * math.cos(bearing_rad),
            float(east_m) + reach_m * math.sin(bearing_rad),
            -height_m,
        )
        look_down_rad = math.atan2(height_m, reach_m)
        aimed = Pose(
            position,
            pitch_rad=-look_down_rad - self.camera.mount_pitch_rad,
            yaw_rad=bearing_rad - math.pi,
        )
        return self._shake.added_to(aimed, time_s)


def exposure_gain(time_s: float) -> float:
    """Slow drift, and one dip by 45 % for about a second, as when the sun gets into the lens."""
    dip = 0.5 * math.exp(-(((time_s - 9.4) / 0.45) ** 4))
    return 1.14 + 0.04 * math.sin(0.9 * time_s) - dip


def _smooth_step(share: float) -> float:
    """0 below 0, 1 above 1, with zero slope at both."""
    share = min(max(share, 0.0), 1.0)
    return share * share * (3 - 2 * share)


class _Shake:
    """Attitude errors of a drone in light wind: a few sines per axis, from slow drift to vibration."""

    # (roll, pitch, yaw) in degrees at each frequency in Hz. The product bounds the image motion.
    AMPLITUDES_DEG = ((1.3, 1.2, 2.4), (0.8, 0.4, 0.5), (0.25, 0.2, 0.2), (0.05, 0.04, 0.04))
    FREQUENCIES_HZ = (0.13, 0.55, 1.7, 6.0)

    def __init__(self, seed: int) -> None:
        self._phases_rad = np.random.default_rng((seed, 6)).uniform(0, 2 * np.pi, (4, 3))

    def added_to(self, pose: Pose, time_s: float) -> Pose:
        turns_rad = 2 * np.pi * np.array(self.FREQUENCIES_HZ)[:, None] * time_s
        waves = np.sin(turns_rad + self._phases_rad)  # (4, 3)
        roll, pitch, yaw = np.radians((np.array(self.AMPLITUDES_DEG) * waves).sum(axis=0)).tolist()
        return replace(
            pose,
            roll_rad=pose.roll_rad + roll,
            pitch_rad=pose.pitch_rad + pitch,
            yaw_rad=pose.yaw_rad + yaw,
        )
