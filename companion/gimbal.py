"""A gimbal that carries the camera: where it looked at a frame's time, who may turn it, and where it is to look.

It is turned only while we have its primary control, which is taken where nobody has it and never taken from anybody.
The direction to look in is the target's on earth, so that neither the gimbal's own motion nor the vehicle's is in the
loop: a gimbal that is slow is late, and does not swing.
"""

import math
from dataclasses import dataclass, replace

from companion.camera_model import (
    MAX_ATTITUDE_GAP_S,
    AttitudeHistory,
    CameraModel,
    angles,
    on_the_way,
    product,
    quaternion,
    rotation,
    rotation_of,
    turn_between_rad,
    wrapped,
)
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
from mscf.arrays import Real64

MAX_CONTROL_AGE_S = 1.5  # of the manager's word on who has it; it is asked for five times a second
MAX_AHEAD_S = 0.1  # of a frame before the newest attitude of the gimbal
MIN_TURN_S = 0.02  # between two attitudes that tell how fast it turns: of nearer ones the noise would
MAX_TURN_RADPS = 10.0  # no gimbal that carries a camera is as fast: beyond, one of two attitudes is a jump
CLAIM_EVERY_S = 1.0  # an order whose effect does not show is given again
MAX_PAUSE_S = 0.5  # in aiming, after which it begins from where the gimbal looks
TAKEN_OVER = "Gimbal taken over by another station: let go"
IN_USE = "Gimbal in use by another station: not turned"


class GimbalHistory:
    """Where the camera looked in the last two seconds, to be asked for a frame's time.

    A gimbal looks straight down, where yaw and roll stand for one another and noise moves them by any amount: only the
    rotation that they make together counts, and between two it is the shortest turn.
    """

    def __init__(self) -> None:
        self._attitudes = AttitudeHistory()
        self._is_yaw_on_earth = False

    def add(self, attitude: GimbalAttitude) -> None:
        """Take in an attitude; with another frame of its yaw the history begins anew."""
        if attitude.is_yaw_on_earth is not self._is_yaw_on_earth:
            self._attitudes.clear()
            self._is_yaw_on_earth = attitude.is_yaw_on_earth
        self._attitudes.add(
            Attitude(attitude.time_s, attitude.roll_rad, attitude.pitch_rad, attitude.yaw_rad, yaw_rate_radps=0.0)
        )

    def clear(self) -> None:
        """Forget all: the clock of what was told began anew."""
        self._attitudes.clear()

    def at(self, time_s: float, vehicle: Attitude) -> Real64 | None:
        """Rotation (3, 3) from the camera's axes to NED at a time, interpolated; None where no attitude is near.

        Up to 0.1 s after the newest attitude, that one turned on as it turned last; unturned, where that was faster
        than any gimbal.

        Parameters
        ----------
        vehicle : attitude at the same time, for a yaw that is told from the nose.
        """
        found = self._around(time_s)
        if found is None:
            return None
        earlier, later = found
        span_s = later.time_s - earlier.time_s
        share = (time_s - earlier.time_s) / span_s if span_s > 0 else 0.0
        first, second = (quaternion(told.roll_rad, told.pitch_rad, told.yaw_rad) for told in found)
        if share > 1 and turn_between_rad(first, second) > MAX_TURN_RADPS * span_s:
            share = 1.0
        turned = on_the_way(first, second, share)
        if not self._is_yaw_on_earth:  # of the nose's frame only the yaw is the vehicle's: it is level
            turned = product(quaternion(0.0, 0.0, vehicle.yaw_rad), turned)
        return rotation_of(turned)

    def _around(self, time_s: float) -> tuple[Attitude, Attitude] | None:
        """Two attitudes whose turn leads through a time or on to it; twice the newest where its turn is not known."""
        found = self._attitudes.around(time_s)
        if found is None:
            return None
        earlier, later = found
        if later is not None:
            return (earlier, later) if later.time_s - earlier.time_s <= MAX_ATTITUDE_GAP_S else None
        newest = earlier
        if time_s - newest.time_s > MAX_AHEAD_S:
            return None
        before = self._attitudes.around(newest.time_s - MIN_TURN_S)
        if before is None or newest.time_s - before[0].time_s > MAX_ATTITUDE_GAP_S:
            return newest, newest
        return before[0], newest


def mounted(camera: CameraModel, ned_from_camera: Real64, vehicle: Attitude) -> CameraModel:
    """The camera as the gimbal holds it, by a rotation (3, 3), in the body of a vehicle with this attitude."""
    ned_from_body = rotation(vehicle.roll_rad, vehicle.pitch_rad, vehicle.yaw_rad)
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
        self, target: TargetEstimate, vehicle: Attitude, ned_from_camera: Real64, now_s: float, config: GimbalConfig
    ) -> tuple["Gimbal", GimbalAim]:
        """Turn towards where the target is predicted to be now, as fast as configured; hold where nothing is.

        The pitch is the one that brings the camera nearest to the target at the yaw that it has: towards what passes
        underneath it looks straight down while the yaw follows.

        Parameters
        ----------
        vehicle : attitude now. ned_from_camera : rotation (3, 3) by what the gimbal told last.
        """
        after = self._watched(target)
        assert after.depression is not None
        pause_s = now_s - self.told_s
        is_going_on = 0 <= pause_s <= MAX_PAUSE_S
        told_rad = self.told_pitch_rad, self.told_yaw_rad
        pitch_rad, yaw_rad = told_rad if is_going_on else _pitch_and_yaw(ned_from_camera)
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


def _pitch_and_yaw(ned_from_camera: Real64) -> tuple[float, float]:
    """Of a camera (3, 3) that is held without roll: its yaw is that of its right side, which is there straight down."""
    pitch_rad = math.asin(min(max(-float(ned_from_camera[2, 0]), -1.0), 1.0))
    return pitch_rad, math.atan2(-ned_from_camera[0, 1], ned_from_camera[1, 1])


def _limited(angle_rad: float, most_rad: float) -> float:
    return min(max(angle_rad, -most_rad), most_rad)
