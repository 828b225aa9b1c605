"""What happened in a run: one moment per step of the command loop, and the figures that checks ask for."""

import math
from dataclasses import dataclass

from mscf import Box
from sim.world import Pose

Vector = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Moment:
    """State of the whole loop at one step; what the application does not tell is None.

    time_s : since the start of the run.
    pose, velocity_ned_mps : of the vehicle, true. target_ned_m : true place of the target on the ground.
    box, truth, visible_share : reported and true box of the newest frame the application has seen.
    setpoint_ned_mps, yaw_rate_radps : as sent; None: nothing was sent.
    frame_age_s : of that frame.
    """

    time_s: float
    mode: str
    flight_mode: str
    is_armed: bool
    pose: Pose
    velocity_ned_mps: Vector
    target_ned_m: Vector
    box: Box | None
    truth: Box | None
    visible_share: float
    status: str
    confidence: float
    threat: float
    frame_age_s: float | None
    setpoint_ned_mps: Vector | None
    yaw_rate_radps: float | None
    range_m: float | None  # as the application estimates it
    notes: tuple[str, ...] = ()
    texts: tuple[str, ...] = ()

    @property
    def true_range_m(self) -> float:
        """Horizontal distance to the target."""
        return math.dist(self.pose.pos_ned_m[:2], self.target_ned_m[:2])

    @property
    def bearing_error_rad(self) -> float:
        """From the nose to the target, positive where the target is to the right."""
        north_m, east_m = (t - p for t, p in zip(self.target_ned_m[:2], self.pose.pos_ned_m[:2], strict=True))
        return math.remainder(math.atan2(east_m, north_m) - self.pose.yaw_rad, math.tau)

    @property
    def height_m(self) -> float:
        """Above the ground."""
        return -self.pose.pos_ned_m[2]

    @property
    def speed_mps(self) -> float:
        """Over ground."""
        return math.hypot(*self.velocity_ned_mps[:2])

    @property
    def iou(self) -> float | None:
        """Of the reported and the true box; None where one of them is not there."""
        return self.box.iou(self.truth) if self.box is not None and self.truth is not None else None


@dataclass(frozen=True, slots=True)
class Trace:
    """The moments of a run, in order, one period of the command loop apart."""

    moments: tuple[Moment, ...]

    def between(self, start_s: float, end_s: float = math.inf) -> tuple[Moment, ...]:
        """Moments with `start_s` <= time < `end_s`."""
        return tuple(moment for moment in self.moments if start_s <= moment.time_s < end_s)

    def first(self, mode: str, after_s: float = 0.0) -> float | None:
        """Time of the first moment in a mode, not before `after_s`."""
        return next((m.time_s for m in self.moments if m.mode == mode and m.time_s >= after_s), None)

    def share(self, mode: str, start_s: float, end_s: float = math.inf) -> float:
        """Share of the moments in a span that are in a mode."""
        span = self.between(start_s, end_s)
        return sum(moment.mode == mode for moment in span) / max(len(span), 1)

    @property
    def texts(self) -> tuple[str, ...]:
        """All that the operator was told, in order."""
        return tuple(text for moment in self.moments for text in moment.texts)
