"""The state machine of the application: its modes, its events, and one table of what follows what.

Two things are kept apart. Not engaged, the vehicle is left alone: IDLE (no target), TRACKING (a target is held),
LOST (it was, and is looked for), READY (PX4 only: zero setpoints flow so that the pilot can select OFFBOARD).
Engaged, setpoints flow at the loop's rate: FOLLOWING while the target is seen; COASTING, HOLDING and SEARCHING
are the ladder that is climbed while it is not; AWAITING stands still before a target that was found again late,
until the operator confirms it. LEAVING ends every engagement that ends by our own will: zero setpoints flow and
another flight mode is asked for until the autopilot has left ours, because an autopilot whose stream just
stops flies on for seconds.

OVERRIDE is the pilot's or the autopilot's will. It ends everything at once and nothing is sent after it; only
a new ENGAGE starts again. Every pair that can occur stands in the table; another one is a mistake of this code.
"""

from enum import Enum, auto

from companion.errors import IllegalTransitionError


class Mode(Enum):
    """What the application does."""

    IDLE = "idle"
    TRACKING = "tracking"
    LOST = "lost"
    READY = "ready"
    FOLLOWING = "following"
    COASTING = "coasting"
    HOLDING = "holding"
    SEARCHING = "searching"
    AWAITING = "awaiting"
    LEAVING = "leaving"

    @property
    def is_engaged(self) -> bool:
        """Whether the target may move the vehicle, now or without another word of the operator but ENGAGE."""
        return self in _ENGAGED

    @property
    def is_streaming(self) -> bool:
        """Whether setpoints are sent."""
        return self.is_engaged or self in {Mode.READY, Mode.LEAVING}


_ENGAGED = frozenset({Mode.FOLLOWING, Mode.COASTING, Mode.HOLDING, Mode.SEARCHING, Mode.AWAITING})


class Event(Enum):
    """What changes the mode."""

    SELECTED = auto()  # another target was chosen
    DESELECTED = auto()  # no target is chosen
    SEEN = auto()  # the target is measured, and may be followed
    SEEN_LATE = auto()  # the same after so long, or after a new choice, that the operator has to confirm
    MISSED = auto()  # it is not measured, or its frame is too old
    HOLD_DUE = auto()  # missed for so long that prediction ends
    SEARCH_DUE = auto()  # missed for so long that a look around is due
    GIVE_UP_DUE = auto()  # missed for so long that following ends
    PREPARE = auto()  # stream before the flight mode is selected
    EXPIRED = auto()  # that took too long
    ENGAGE = auto()
    DISENGAGE = auto()  # by the operator, or by a guard while the vehicle obeys us
    OVERRIDE = auto()  # the vehicle obeys us no more
    LEFT = auto()  # the flight mode that was asked for, or another one, is there


M, E = Mode, Event
TRANSITIONS: dict[Mode, dict[Event, Mode]] = {
    M.IDLE: {E.SEEN: M.TRACKING},
    M.TRACKING: {
        E.SELECTED: M.LOST,  # until the new target is seen
        E.DESELECTED: M.IDLE,
        E.MISSED: M.LOST,
        E.PREPARE: M.READY,
        E.ENGAGE: M.FOLLOWING,
    },
    M.LOST: {E.SELECTED: M.LOST, E.DESELECTED: M.IDLE, E.SEEN: M.TRACKING},
    M.READY: {
        E.SELECTED: M.LEAVING,
        E.DESELECTED: M.LEAVING,
        E.MISSED: M.LEAVING,
        E.EXPIRED: M.LEAVING,
        E.ENGAGE: M.FOLLOWING,
        E.DISENGAGE: M.LEAVING,
        E.OVERRIDE: M.TRACKING,
    },
    M.FOLLOWING: {
        E.SELECTED: M.HOLDING,
        E.DESELECTED: M.LEAVING,
        E.MISSED: M.COASTING,
        E.DISENGAGE: M.LEAVING,
        E.OVERRIDE: M.TRACKING,
    },
    M.COASTING: {
        E.SELECTED: M.HOLDING,
        E.DESELECTED: M.LEAVING,
        E.SEEN: M.FOLLOWING,
        E.SEEN_LATE: M.AWAITING,  # where the configuration confirms before it holds
        E.HOLD_DUE: M.HOLDING,
        E.DISENGAGE: M.LEAVING,
        E.OVERRIDE: M.LOST,
    },
    M.HOLDING: {
        E.SELECTED: M.HOLDING,
        E.DESELECTED: M.LEAVING,
        E.SEEN: M.FOLLOWING,
        E.SEEN_LATE: M.AWAITING,
        E.SEARCH_DUE: M.SEARCHING,
        E.GIVE_UP_DUE: M.LEAVING,
        E.DISENGAGE: M.LEAVING,
        E.OVERRIDE: M.LOST,
    },
    M.SEARCHING: {
        E.SELECTED: M.HOLDING,
        E.DESELECTED: M.LEAVING,
        E.SEEN: M.FOLLOWING,
        E.SEEN_LATE: M.AWAITING,
        E.GIVE_UP_DUE: M.LEAVING,
        E.DISENGAGE: M.LEAVING,
        E.OVERRIDE: M.LOST,
    },
    M.AWAITING: {
        E.SELECTED: M.HOLDING,
        E.DESELECTED: M.LEAVING,
        E.MISSED: M.HOLDING,
        E.GIVE_UP_DUE: M.LEAVING,
        E.ENGAGE: M.FOLLOWING,
        E.DISENGAGE: M.LEAVING,
        E.OVERRIDE: M.TRACKING,
    },
    M.LEAVING: {E.LEFT: M.LOST, E.OVERRIDE: M.LOST},
}
del M, E


def after(mode: Mode, event: Event) -> Mode:
    """Mode that follows `mode` on `event`.

    Raises
    ------
    IllegalTransitionError
        If the table has no such pair; nothing has changed then.
    """
    try:
        return TRANSITIONS[mode][event]
    except KeyError:
        raise IllegalTransitionError(f"mode {mode.name} has no transition on {event.name}") from None
