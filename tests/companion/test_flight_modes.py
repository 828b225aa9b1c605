import pytest

from companion.flight_modes import flight_mode, request_numbers
from companion.types import Autopilot, FlightMode

REQUESTED = (FlightMode.HOLD, FlightMode.PILOT, FlightMode.RTL, FlightMode.LAND)


def custom_mode(main: int, sub: int = 0) -> int:
    """PX4's, as the heartbeat carries it: main mode in byte 2, sub mode in byte 3."""
    return main << 16 | sub << 24


@pytest.mark.parametrize(
    ("autopilot", "number", "mode", "word"),
    [
        (Autopilot.ARDUPILOT, 0, FlightMode.OTHER, "STABILIZE"),
        (Autopilot.ARDUPILOT, 3, FlightMode.OTHER, "AUTO"),
        (Autopilot.ARDUPILOT, 4, FlightMode.EXTERNAL, "GUIDED"),
        (Autopilot.ARDUPILOT, 5, FlightMode.PILOT, "LOITER"),
        (Autopilot.ARDUPILOT, 6, FlightMode.RTL, "RTL"),
        (Autopilot.ARDUPILOT, 9, FlightMode.LAND, "LAND"),
        (Autopilot.ARDUPILOT, 17, FlightMode.HOLD, "BRAKE"),
        (Autopilot.ARDUPILOT, 20, FlightMode.OTHER, "mode 20"),  # GUIDED_NOGPS takes no velocities
        (Autopilot.ARDUPILOT, 4294967295, FlightMode.OTHER, "mode 4294967295"),
        (Autopilot.PX4, custom_mode(3), FlightMode.PILOT, "POSCTL"),
        (Autopilot.PX4, custom_mode(4, 3), FlightMode.HOLD, "AUTO.LOITER"),
        (Autopilot.PX4, custom_mode(4, 5), FlightMode.RTL, "AUTO.RTL"),
        (Autopilot.PX4, custom_mode(4, 6), FlightMode.LAND, "AUTO.LAND"),
        (Autopilot.PX4, custom_mode(6), FlightMode.EXTERNAL, "OFFBOARD"),
        (Autopilot.PX4, custom_mode(6) | 0xFFFF, FlightMode.EXTERNAL, "OFFBOARD"),  # the lower bytes are not used
        (Autopilot.PX4, custom_mode(3, 1), FlightMode.OTHER, "mode 3.1"),  # orbit: the sticks do not fly
        (Autopilot.PX4, custom_mode(9, 7), FlightMode.OTHER, "mode 9.7"),
        (Autopilot.PX4, 4, FlightMode.OTHER, "mode 0.0"),  # ArduCopter's GUIDED is nothing here
    ],
)
def test_a_heartbeats_number_means_a_mode_of_its_autopilot(
    autopilot: Autopilot, number: int, mode: FlightMode, word: str
) -> None:
    assert flight_mode(autopilot, number) == (mode, word)


@pytest.mark.parametrize("autopilot", Autopilot)
def test_exactly_one_number_means_that_we_are_obeyed(autopilot: Autopilot) -> None:
    numbers = (
        range(256) if autopilot is Autopilot.ARDUPILOT else [custom_mode(m, s) for m in range(32) for s in range(32)]
    )
    assert sum(flight_mode(autopilot, number)[0] is FlightMode.EXTERNAL for number in numbers) == 1


@pytest.mark.parametrize("autopilot", Autopilot)
@pytest.mark.parametrize("mode", REQUESTED)
def test_what_is_asked_for_is_what_the_heartbeat_will_say(autopilot: Autopilot, mode: FlightMode) -> None:
    main, sub = request_numbers(autopilot, mode)
    number = int(main) if autopilot is Autopilot.ARDUPILOT else custom_mode(int(main), int(sub))
    assert flight_mode(autopilot, number)[0] is mode


@pytest.mark.parametrize("autopilot", Autopilot)
@pytest.mark.parametrize("mode", [mode for mode in FlightMode if mode not in REQUESTED])
def test_the_mode_in_which_we_are_obeyed_is_never_asked_for(autopilot: Autopilot, mode: FlightMode) -> None:
    with pytest.raises(ValueError, match=f"flight mode {mode.name} is never asked for"):
        request_numbers(autopilot, mode)
