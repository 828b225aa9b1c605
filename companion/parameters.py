"""The autopilot's parameters that decide what happens when the stream stops, and what to say of their values."""

from companion.types import Autopilot

WANTED: dict[Autopilot, tuple[str, ...]] = {
    Autopilot.ARDUPILOT: ("GUID_TIMEOUT", "GUID_OPTIONS", "FS_OPTIONS"),
    Autopilot.PX4: ("COM_OF_LOSS_T", "COM_OBL_RC_ACT", "COM_RC_OVERRIDE", "MAN_OVERRIDE_SPD"),
}
_IGNORE_PILOT_YAW = 4  # bit of GUID_OPTIONS
_CONTINUE_GUIDED_ON_RC_LOSS = 4  # bit of FS_OPTIONS
_STICKS_END_OFFBOARD = 2  # bit 1 of COM_RC_OVERRIDE
_HOLD_ON_LOSS = 5  # of COM_OBL_RC_ACT


def advice(autopilot: Autopilot, parameters: dict[str, float]) -> tuple[str, ...]:
    """What to change, a line each, for the parameters that are known; empty where all is well.

    Sources: the parameter references of ArduCopter and PX4 1.16; what happens at the values was measured on
    ArduCopter 4.7.0-dev and PX4 of April 2026.
    """
    found = []
    get = parameters.get
    if autopilot is Autopilot.ARDUPILOT:
        timeout_s = get("GUID_TIMEOUT")
        if timeout_s is not None and timeout_s > 1.0:
            found.append(
                f"GUID_TIMEOUT = {timeout_s:g}: if this computer dies the vehicle flies on for {timeout_s:g} s; set 1"
            )
        guided = get("GUID_OPTIONS")
        if guided is not None and int(guided) & _IGNORE_PILOT_YAW:
            found.append(f"GUID_OPTIONS = {int(guided)}: the yaw stick turns nothing in GUIDED; clear bit 2 (4)")
        options = get("FS_OPTIONS")
        if options is not None and int(options) & _CONTINUE_GUIDED_ON_RC_LOSS:
            found.append(f"FS_OPTIONS = {int(options)}: without the transmitter it stays in GUIDED; clear bit 2 (4)")
        return tuple(found)
    loss_s = get("COM_OF_LOSS_T")
    if loss_s is not None and loss_s > 1.0:
        found.append(f"COM_OF_LOSS_T = {loss_s:g}: if this computer dies the vehicle flies on for {loss_s:g} s; set 1")
    action = get("COM_OBL_RC_ACT")
    if action is not None and int(action) != _HOLD_ON_LOSS:
        found.append(f"COM_OBL_RC_ACT = {int(action)}: set 5 (Hold), so that the vehicle stands when the stream stops")
    override = get("COM_RC_OVERRIDE")
    if override is not None and not int(override) & _STICKS_END_OFFBOARD:
        found.append(
            f"COM_RC_OVERRIDE = {int(override)}: sticks do not end OFFBOARD; set 3, or rely on rc.stick_guard_us"
        )
    speed = get("MAN_OVERRIDE_SPD")  # from 1.18 on, instead of COM_RC_OVERRIDE
    if speed is not None and speed < 0:
        found.append(f"MAN_OVERRIDE_SPD = {speed:g}: sticks do not end OFFBOARD; set the default, 0 or more")
    return tuple(found)
