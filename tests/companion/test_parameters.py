import pytest

from companion.parameters import WANTED, advice
from companion.types import Autopilot

COPTER = {"GUID_TIMEOUT": 1.0, "GUID_OPTIONS": 0.0, "FS_OPTIONS": 0.0}
PX4 = {"COM_OF_LOSS_T": 1.0, "COM_OBL_RC_ACT": 5.0, "COM_RC_OVERRIDE": 3.0, "MAN_OVERRIDE_SPD": 1.0}
ADVISED = {Autopilot.ARDUPILOT: COPTER, Autopilot.PX4: PX4}


@pytest.mark.parametrize("autopilot", Autopilot)
def test_values_as_advised_give_no_advice_and_unknown_ones_neither(autopilot: Autopilot) -> None:
    assert advice(autopilot, ADVISED[autopilot]) == ()
    assert advice(autopilot, {}) == ()


@pytest.mark.parametrize(
    ("autopilot", "name", "value", "mend"),
    [
        (Autopilot.ARDUPILOT, "GUID_TIMEOUT", 3.0, "flies on for 3 s; set 1"),
        (Autopilot.ARDUPILOT, "GUID_TIMEOUT", 1.01, "set 1"),
        (Autopilot.ARDUPILOT, "GUID_TIMEOUT", 0.5, None),
        (Autopilot.ARDUPILOT, "GUID_OPTIONS", 4.0, "clear bit 2 (4)"),
        (Autopilot.ARDUPILOT, "GUID_OPTIONS", 128.0, None),
        (Autopilot.ARDUPILOT, "FS_OPTIONS", 4.0, "clear bit 2 (4)"),
        (Autopilot.ARDUPILOT, "FS_OPTIONS", 20.0, "clear bit 2 (4)"),
        (Autopilot.ARDUPILOT, "FS_OPTIONS", 16.0, None),
        (Autopilot.PX4, "COM_OF_LOSS_T", 2.0, "flies on for 2 s; set 1"),
        (Autopilot.PX4, "COM_OF_LOSS_T", 0.5, None),
        (Autopilot.PX4, "COM_OBL_RC_ACT", 0.0, "set 5 (Hold)"),
        (Autopilot.PX4, "COM_RC_OVERRIDE", 1.0, "set 3, or rely on rc.stick_guard_us"),
        (Autopilot.PX4, "COM_RC_OVERRIDE", 2.0, None),
        (Autopilot.PX4, "MAN_OVERRIDE_SPD", -1.0, "sticks do not end OFFBOARD"),
        (Autopilot.PX4, "MAN_OVERRIDE_SPD", 0.0, None),
    ],
)
def test_a_value_that_costs_safety_is_named_with_its_mend(
    autopilot: Autopilot, name: str, value: float, mend: str | None
) -> None:
    found = advice(autopilot, ADVISED[autopilot] | {name: value})
    assert len(found) == (mend is not None)
    for line in found:
        assert line.startswith(f"{name} = {value:g}: ")
        assert mend is not None
        assert mend in line
        assert len(line.splitlines()) == 1


@pytest.mark.parametrize("autopilot", Autopilot)
def test_every_parameter_that_is_asked_for_has_a_value_that_is_advised_against(autopilot: Autopilot) -> None:
    bad = {"COM_OBL_RC_ACT": 0.0, "COM_RC_OVERRIDE": 1.0, "MAN_OVERRIDE_SPD": -1.0}
    for name in WANTED[autopilot]:
        assert advice(autopilot, {name: bad.get(name, 4.0)}), name
    assert set(WANTED[autopilot]) == set(ADVISED[autopilot])


def test_parameters_of_the_other_autopilot_mean_nothing() -> None:
    assert advice(Autopilot.PX4, {"GUID_TIMEOUT": 5.0}) == ()
    assert advice(Autopilot.ARDUPILOT, {"COM_OBL_RC_ACT": 0.0}) == ()
