"""The pilot's transmitter: sticks that end everything, and an optional switch that gives orders."""

from dataclasses import dataclass, field
from enum import Enum, auto

from companion.config import RcConfig
from companion.types import Deselect, Disengage, Engage, OperatorCommand, RcChannels, Select

CENTRE_US = 1500
STICK_HOLD_S = 0.2  # a stick must be away from its centre for so long
SWITCH_HOLD_S = 0.2  # a switch must rest in a position for so long: a flick through the middle selects nothing
_ROUNDING_S = 1e-9  # of a difference of times: a step of the loop that falls on the limit counts
_LOW_US, _HIGH_US = 1300, 1700
_DEAD_US = 800  # below: no signal


@dataclass(frozen=True, slots=True)
class StickGuard:
    """Whether the pilot holds a stick; roll, pitch and yaw only, as throttle rests anywhere."""

    since_s: float | None = None  # when a stick left its centre
    is_held: bool = False

    def after(self, rc: RcChannels | None, config: RcConfig, now_s: float) -> "StickGuard":
        """Guard with the newest channels taken in."""
        channels = (config.roll_channel, config.pitch_channel, config.yaw_channel)
        pwm_us = [rc.pwm_us[n - 1] for n in channels if n <= len(rc.pwm_us)] if rc is not None else []
        if not any(abs(us - CENTRE_US) > config.stick_guard_us for us in pwm_us if us > _DEAD_US):
            return StickGuard()
        since_s = now_s if self.since_s is None else self.since_s
        return StickGuard(since_s, now_s - since_s >= STICK_HOLD_S - _ROUNDING_S)


class _Position(Enum):
    OFF = auto()
    SELECT = auto()
    ENGAGE = auto()


@dataclass(frozen=True, slots=True)
class RcSwitch:
    """A switch, of three positions (off, select the middle, engage) or two. Only its movements are orders.

    Where it rests when the application starts means nothing: after a restart nobody has engaged.
    """

    position: _Position | None = None  # in force
    candidate: _Position | None = None  # seen, not yet long enough
    since_s: float = 0.0
    is_live: bool = True  # whether there is a signal
    commands: tuple[OperatorCommand, ...] = field(default=())  # of the last movement

    def after(self, rc: RcChannels | None, config: RcConfig, now_s: float) -> "RcSwitch":
        """Switch with the newest channels taken in; its `commands` are those of this moment."""
        number = config.switch_channel
        pwm_us = rc.pwm_us[number - 1] if rc is not None and 0 < number <= len(rc.pwm_us) else 0
        if pwm_us <= _DEAD_US:
            return RcSwitch(self.position, is_live=False)
        seen = _Position.OFF if pwm_us < _LOW_US else _Position.ENGAGE if pwm_us > _HIGH_US else _Position.SELECT
        if seen is self.position:
            return RcSwitch(self.position)
        if seen is not self.candidate:
            return RcSwitch(self.position, seen, now_s)
        if now_s - self.since_s < SWITCH_HOLD_S - _ROUNDING_S:
            return RcSwitch(self.position, seen, self.since_s)
        return RcSwitch(seen, commands=_orders(self.position, seen, config))

    @property
    def is_on(self) -> bool:
        """Whether it rests where it engages, as far as is known."""
        return self.is_live and self.position is _Position.ENGAGE


def _orders(before: _Position | None, now: _Position, config: RcConfig) -> tuple[OperatorCommand, ...]:
    if before is None:
        return ()
    if now is _Position.ENGAGE:
        return (Engage(),)
    if config.switch == "engage":  # the target is selected elsewhere, and stays
        return (Disengage(),) if before is _Position.ENGAGE else ()
    if now is _Position.OFF:
        return (Disengage(), Deselect())
    return (Disengage(),) if before is _Position.ENGAGE else (Select(None),)
