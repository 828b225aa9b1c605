"""Whether the autopilot hears us: two signs, one for each kind, folded from what it says. Values only."""

from dataclasses import dataclass, replace

from companion.types import Autopilot, FlightMode, Heartbeat, SetpointInForce

DEAF_S = 2.0  # for which an ArduCopter steers by zero while it is told to move: it does not hear
DEAF_MPS = 0.5  # a setpoint that is less says nothing
_FAILSAFE_MODES = frozenset({FlightMode.RTL, FlightMode.LAND})  # which PX4 goes on to by itself


@dataclass(frozen=True, slots=True)
class Hearing:
    """ArduCopter steers by zero once our setpoints have not come for GUID_TIMEOUT, and would go on by the next one."""

    deaf_since_s: float | None = None  # when it steered by zero for the first time, though told to move
    is_deaf: bool = False

    def after(self, in_force: SetpointInForce, told_mps: float) -> "Hearing":
        """Hearing with the setpoint in force taken in, while ours is of `told_mps`."""
        if told_mps <= DEAF_MPS or any(in_force.velocity_ned_mps):
            return Hearing()
        if self.deaf_since_s is None:
            return Hearing(in_force.time_s)
        return replace(self, is_deaf=in_force.time_s - self.deaf_since_s >= DEAF_S)


@dataclass(frozen=True, slots=True)
class ResumeGuard:
    """PX4: a stream that resumes after a gap brings OFFBOARD back by itself, unless a mode was commanded meanwhile.

    Who starts in the air does not know whether an earlier run of ours left such a gap. PX4 says yes to every
    request before it says no: only its last answer and the heartbeat after it tell that it holds on command.
    """

    is_up: bool = False  # PX4 may have left OFFBOARD by failsafe: our stream alone would bring it back
    is_answered: bool = False  # the last answer to a request for a mode, since then, was yes
    heard: FlightMode | None = None  # of the last heartbeat, of either kind

    def raised(self) -> "ResumeGuard":
        """Guard after a gap of ours, or what may have been one."""
        return replace(self, is_up=True, is_answered=False)

    def after(self, heartbeat: Heartbeat, *, has_gap: bool, requested: FlightMode | None) -> "ResumeGuard":
        """Guard with a heartbeat taken in.

        Parameters
        ----------
        has_gap : whether our stream stops, or does not leave.
        requested : the mode that we ask for at this time.
        """
        is_px4 = heartbeat.autopilot is Autopilot.PX4
        guard = self._of_px4(heartbeat, has_gap=has_gap, requested=requested) if is_px4 else self
        return replace(guard, heard=heartbeat.mode)

    def _of_px4(self, heartbeat: Heartbeat, *, has_gap: bool, requested: FlightMode | None) -> "ResumeGuard":
        mode = heartbeat.mode
        is_external = mode is FlightMode.EXTERNAL
        if self.heard is None:
            is_up = heartbeat.is_armed and not is_external
            return self.raised() if is_up else replace(self, is_up=False, is_answered=False)
        if self.heard is FlightMode.EXTERNAL and not is_external:
            # PX4's heartbeat says CRITICAL while one of its failsafes acts: its own time-out, where we are not heard
            is_failsafe = heartbeat.has_failsafe or (mode in _FAILSAFE_MODES and mode is not requested)
            return self.raised() if has_gap or is_failsafe else self
        is_chosen = mode is not self.heard and mode not in _FAILSAFE_MODES
        is_commanded = is_chosen or (self.is_answered and mode is FlightMode.HOLD)
        return replace(self, is_up=False) if is_commanded else self
