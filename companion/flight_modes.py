"""Flight modes of both autopilots: their numbers, their words, and what they mean for us.

Numbers: MAVLink's HEARTBEAT.custom_mode as ArduCopter and PX4 define it.
"""

from companion.types import Autopilot, FlightMode

# ArduCopter's mode numbers (COPTER_MODE of the MAVLink dialect ardupilotmega)
_COPTER: dict[int, tuple[FlightMode, str]] = {
    0: (FlightMode.OTHER, "STABILIZE"),
    1: (FlightMode.OTHER, "ACRO"),
    2: (FlightMode.OTHER, "ALT_HOLD"),
    3: (FlightMode.OTHER, "AUTO"),
    4: (FlightMode.EXTERNAL, "GUIDED"),
    5: (FlightMode.PILOT, "LOITER"),
    6: (FlightMode.RTL, "RTL"),
    7: (FlightMode.OTHER, "CIRCLE"),
    9: (FlightMode.LAND, "LAND"),
    16: (FlightMode.OTHER, "POSHOLD"),
    17: (FlightMode.HOLD, "BRAKE"),
    18: (FlightMode.OTHER, "THROW"),
    21: (FlightMode.RTL, "SMART_RTL"),
}
# PX4's (main mode, sub mode), bytes 2 and 3 of custom_mode
_PX4: dict[tuple[int, int], tuple[FlightMode, str]] = {
    (1, 0): (FlightMode.OTHER, "MANUAL"),
    (2, 0): (FlightMode.OTHER, "ALTCTL"),
    (3, 0): (FlightMode.PILOT, "POSCTL"),
    (4, 2): (FlightMode.OTHER, "AUTO.TAKEOFF"),
    (4, 3): (FlightMode.HOLD, "AUTO.LOITER"),
    (4, 4): (FlightMode.OTHER, "AUTO.MISSION"),
    (4, 5): (FlightMode.RTL, "AUTO.RTL"),
    (4, 6): (FlightMode.LAND, "AUTO.LAND"),
    (5, 0): (FlightMode.OTHER, "ACRO"),
    (6, 0): (FlightMode.EXTERNAL, "OFFBOARD"),
    (7, 0): (FlightMode.OTHER, "STABILIZED"),
}
_COPTER_NUMBER = {
    FlightMode.HOLD: 17,
    FlightMode.PILOT: 5,
    FlightMode.RTL: 6,
    FlightMode.LAND: 9,
}
_PX4_NUMBER = {
    FlightMode.HOLD: (4, 3),
    FlightMode.PILOT: (3, 0),
    FlightMode.RTL: (4, 5),
    FlightMode.LAND: (4, 6),
}


def flight_mode(autopilot: Autopilot, custom_mode: int) -> tuple[FlightMode, str]:
    """What a heartbeat's custom_mode means, and the autopilot's word for it."""
    if autopilot is Autopilot.ARDUPILOT:
        return _COPTER.get(custom_mode, (FlightMode.OTHER, f"mode {custom_mode}"))
    main, sub = custom_mode >> 16 & 255, custom_mode >> 24 & 255
    return _PX4.get((main, sub), (FlightMode.OTHER, f"mode {main}.{sub}"))


def request_numbers(autopilot: Autopilot, mode: FlightMode) -> tuple[float, float]:
    """Parameters 2 and 3 of MAV_CMD_DO_SET_MODE.

    Raises
    ------
    ValueError
        For EXTERNAL and OTHER: the application only ever asks to leave the mode in which it is obeyed.
    """
    if mode not in _COPTER_NUMBER:
        raise ValueError(f"flight mode {mode.name} is never asked for")
    if autopilot is Autopilot.ARDUPILOT:
        return float(_COPTER_NUMBER[mode]), 0.0
    main, sub = _PX4_NUMBER[mode]
    return float(main), float(sub)
