"""A gimbal that carries the camera: where it looked at a frame's time, who may turn it, and where it is to look.

It is turned only while we have its primary control, which is taken where nobody has it and never taken from anybody.
The direction to look in is the target's on earth, so that neither the gimbal's own motion nor the vehicle's is in the
loop: a gimbal that is slow is late, and does not swing.
"""

import math
from dataclasses import dataclass, replace

from companion.camera_model import AttitudeHistory, CameraModel, angles, rotation, wrapped
from companion.config import GimbalConfig
from companion.guidance import MAX_PREDICTION_S
from companion.target import BEARING_TAU_S, MAX_GAP_S, Rate, TargetEstimate
from companion.types import (
    Attitude,
    Claim,
    GimbalAim,
    GimbalAttitude,
    GimbalControl,
    GimbalManager,
    Holder,
    LinkEvent,
    Rebooted,
)

MAX_CONTROL_AGE_S = 1.5  # of the manager's word on who has it; it is asked for five times a second
MAX_AHEAD_S = 0.1  # of a frame before the newest attitude of the gimbal
STEEP_RAD = math.radians(60.0)
CLAIM_EVERY_S = 1.0  # an order whose effect does not show is given again
MAX_PAUSE_S = 0.5  # in aiming, after which it begins from where the gimbal looks
TAKEN_OVER = "Gimbal taken over by another station: let go"
IN_USE = "Gimbal in use by another station: not turned"


class GimbalHistory:
    """Where the camera looked in the last two seconds, to be asked for a frame's time."""

    def __init__(self) -> None:
        self._attitudes = AttitudeHistory()
        self._is_yaw_on_earth = False

    def add(self, attitude: GimbalAttitude) -> None:
        """Take in an attitude; with another frame of its yaw the history begins anew."""
        if attitude.is_yaw_on_earth is not self._is_yaw_on_earth:
            self._attitudes.clear()
            self._is_yaw_on_earth = attitude.is_yaw_on_earth
        before = self._attitudes.newest
        gap_s = attitude.time_s - before.time_s if before is not None else 0.0
        turned_rad = wrapped(attitude.yaw_rad - before.yaw_rad) if before is not None else 0.0
        # looking straight down, yaw and roll stand for one another: their noise is no rate
        has_rate = 0 < gap_s <= MAX_AHEAD_S and abs(attitude.pitch_rad) < STEEP_RAD
        rate_radps = turned_rad / gap_s if has_rate else 0.0
        self._attitudes.add(
            Attitude(attitude.time_s, attitude.roll_rad, attitude.pitch_rad, attitude.yaw_rad, rate_radps)
        )

    def clear(self) -> None:
        """Forget all: the clock of what was told began anew."""
        self._attitudes.clear()

    def at(self, time_s: float, vehicle: Attitude) -> Attitude | None:
        """Attitude of the camera on earth at a time, interpolated; None where none is near.

        Parameters
        ----------
        vehicle : attitude at the same time, for a yaw that is told from the nose.
        """
        newest = self._attitudes.newest
        if newest is None or time_s - newest.time_s > MAX_AHEAD_S:
            return None
        found = self._attitudes.at(time_s)
        if found is None or self._is_yaw_on_earth:
            return found
        return replace(found, yaw_rad=wrapped(found.yaw_rad + vehicle.yaw_rad))


def mounted(camera: CameraModel, gimbal: Attitude, vehicle: Attitude) -> CameraModel:
    """The camera as the gimbal holds it in the vehicle's body when both have these attitudes on earth."""
    ned_from_body = rotation(vehicle.roll_rad, vehicle.pitch_rad, vehicle.yaw_rad)
    ned_from_camera = rotation(gimbal.roll_rad, gimbal.pitch_rad, gimbal.yaw_rad)
    return camera.mounted(angles(ned_from_body.T @ ned_from_camera))


@dataclass(frozen=True, slots=True)
class Gimbal:
    """What is known of the gimbal, and what it was told.

    selection : number of the one that it is turned for.
    spent : number of the one for which it was let go: it is taken again with the next one.
    depression : of the target, rad and rad/s, filtered at `depression_s`.
    told_pitch_rad, told_yaw_rad : on earth, at `told_s`.
    """

    manager: GimbalManager | None = None
    control: GimbalControl | None = None
    is_ours: bool = False
    selection: int | None = None
    spent: int | None = None
    asked_s: float = -math.inf
    depression: Rate | None = None
    depression_s: float = -math.inf
    told_pitch_rad: float = 0.0
    told_yaw_rad: float = 0.0
    told_s: float = -math.inf

    def after(self, event: LinkEvent) -> "Gimbal":
        """With an event taken in."""
        match event:
            case GimbalManager():
                return replace(self, manager=event)
            case GimbalControl():
                return replace(self, control=event)
            case Rebooted():
                return replace(self, control=None)
            case _:
                return self

    def claimed(
        self, selection: int | None, lost_s: float, give_up_after_s: float, now_s: float
    ) -> tuple["Gimbal", Claim | None, str]:
        """Whether it may be turned now (`is_ours`), what to ask of its manager, and a line for the operator or none.

        Parameters
        ----------
        selection : its number; None: nothing is selected.
        lost_s : since the target was measured; before it ever was, since it was selected.
        give_up_after_s : from which on it is lost for good.
        """
        # how one target moved says nothing of another
        same = replace(self, selection=selection, depression=self.depression if selection == self.selection else None)
        spent = self.spent
        if selection is not None and lost_s >= give_up_after_s:
            spent = selection
        is_wanted = selection is not None and selection != spent
        is_known = self.control is not None and now_s - self.control.time_s <= MAX_CONTROL_AGE_S
        if self.control is None or not is_known:
            return replace(same, is_ours=False, spent=spent), None, ""
        holder, text, claim = self.control.holder, "", None
        if is_wanted and holder is Holder.OTHER:
            spent, text = selection, TAKEN_OVER if self.is_ours else IN_USE
        elif holder is not Holder.OTHER and is_wanted is not (holder is Holder.US):
            claim = Claim.TAKE if is_wanted else Claim.RELEASE
        if claim is not None and now_s - self.asked_s < CLAIM_EVERY_S:
            claim = None
        asked_s = now_s if claim is not None else self.asked_s
        is_ours = is_wanted and holder is Holder.US
        return replace(same, is_ours=is_ours, spent=spent, asked_s=asked_s), claim, text

    def aimed(
        self, target: TargetEstimate, vehicle: Attitude, camera: Attitude, now_s: float, config: GimbalConfig
    ) -> tuple["Gimbal", GimbalAim]:
        """Turn towards where the target is predicted to be now, as fast as configured; hold where nothing is.

        The pitch is the one that brings the camera nearest to the target at the yaw that it has: towards what passes
        underneath it looks straight down while the yaw follows.

        Parameters
        ----------
        vehicle : attitude now. camera : attitude on earth that the gimbal told last.
        """
        after = self._watched(target)
        assert after.depression is not None
        pause_s = now_s - self.told_s
        is_going_on = 0 <= pause_s <= MAX_PAUSE_S
        pitch_rad = self.told_pitch_rad if is_going_on else camera.pitch_rad
        yaw_rad = self.told_yaw_rad if is_going_on else camera.yaw_rad
        has_yaw = config.axes == "pitch_yaw"
        if not has_yaw:
            yaw_rad = vehicle.yaw_rad
        most_rad = math.radians(config.rate_dps) * (pause_s if is_going_on else 0.0)
        age_s = now_s - target.seen.time_s
        if age_s <= MAX_PREDICTION_S:
            bearing_rad = target.bearing_at(now_s)
            depression_rad = after.depression.value + after.depression.rate * age_s
            if has_yaw:
                yaw_rad += _limited(self._yaw_error_rad(bearing_rad, yaw_rad, vehicle), most_rad)
            flat = math.cos(depression_rad) * math.cos(wrapped(bearing_rad - yaw_rad))
            pitch_rad += _limited(-math.atan2(math.sin(depression_rad), flat) - pitch_rad, most_rad)
        lowest_rad, highest_rad = self.manager.pitch_range_rad if self.manager else (-math.pi / 2, math.pi / 2)
        pitch_rad = min(max(pitch_rad, lowest_rad), highest_rad)
        yaw_rad = wrapped(yaw_rad)
        told = replace(after, told_pitch_rad=pitch_rad, told_yaw_rad=yaw_rad, told_s=now_s)
        if has_yaw and self.manager is not None and self.manager.can_lock_yaw:
            return told, GimbalAim(pitch_rad, yaw_rad, is_yaw_on_earth=True)
        return told, GimbalAim(pitch_rad, wrapped(yaw_rad - vehicle.yaw_rad), is_yaw_on_earth=False)

    def _watched(self, target: TargetEstimate) -> "Gimbal":
        """With the depression of a new measurement taken in."""
        seen = target.seen
        dt_s = seen.time_s - self.depression_s
        if dt_s == 0 and self.depression is not None:
            return self
        if self.depression is None or not 0 < dt_s <= MAX_GAP_S:
            return replace(self, depression=Rate(seen.depression_rad), depression_s=seen.time_s)
        depression = self.depression.after(seen.depression_rad, dt_s, BEARING_TAU_S)
        return replace(self, depression=depression, depression_s=seen.time_s)

    def _yaw_error_rad(self, bearing_rad: float, yaw_rad: float, vehicle: Attitude) -> float:
        """How far to turn; a gimbal with ends does not turn through what lies behind them."""
        ends = self.manager.yaw_range_rad if self.manager is not None else None
        if ends is None:
            return wrapped(bearing_rad - yaw_rad)
        wish_rad = min(max(wrapped(bearing_rad - vehicle.yaw_rad), ends[0]), ends[1])
        return wish_rad - wrapped(yaw_rad - vehicle.yaw_rad)


def _limited(angle_rad: float, most_rad: float) -> float:
    return min(max(angle_rad, -most_rad), most_rad)
