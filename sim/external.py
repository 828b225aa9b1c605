"""A real autopilot, in simulation or not, in the place of the fake one: ArduPilot's or PX4's own SITL on a link.

Bytes between it and the application pass through unchanged. The camera's pose is what it reports (ATTITUDE and
LOCAL_POSITION_NED, asked for as any ground station may), interpolated; the stage is laid out around the vehicle.
Nothing else that it does is relied on.
"""

import math
import time
from collections import deque
from collections.abc import Callable
from io import BytesIO
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from companion.camera_model import AttitudeHistory, wrapped
from companion.errors import LinkLostError
from companion.link import Link
from companion.types import Attitude
from sim.ardupilot import ArduCopter
from sim.autopilot import Personality
from sim.px4 import Px4
from sim.world import Pose

GCS_SYSTEM = 254  # not 255: whoever has a ground station beside this one shall see two
GCS_COMPONENT = 190
VIEW_DELAY_S = 0.04  # the picture shows the vehicle so long ago: between two reports, not after the last one
HEARD_S = 20.0  # to wait for a heartbeat
READY_S = 120.0  # to wait for arming to be accepted, and for the climb
ASK_EVERY_S = 1.0
_RATES_HZ = {
    mavlink.MAVLINK_MSG_ID_ATTITUDE: 50,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 30,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 5,
}
_KINDS: dict[int, type[Personality]] = {
    mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA: ArduCopter,
    mavlink.MAV_AUTOPILOT_PX4: Px4,
}


class ExternalAutopilot:
    """An autopilot on a link, seen as `FakeAutopilot` is seen by a run in real time.

    Parameters
    ----------
    device : of the link, in the application's notation.
    say : is told what is waited for, and what somebody else has to do.
    is_ours : whether it is flown by command: armed, its modes selected, landed. Else somebody else does all that.
    """

    def __init__(self, device: str, baud: int, say: Callable[[str], None], *, is_ours: bool) -> None:
        self.is_ours = is_ours
        self._link = Link(device, baud)
        self._say = say
        self._wished_mode = ""
        self._port = BytesIO()
        self._mav = mavlink.MAVLink(self._port, GCS_SYSTEM, GCS_COMPONENT)
        self._parser = mavlink.MAVLink(None)
        self._parser.robust_parsing = True
        self._heartbeat: Any = None
        self._asked_s = -math.inf
        self._accepted: set[int] = set()  # commands that it has acknowledged
        self._attitudes = AttitudeHistory()
        self._places: deque[tuple[float, tuple[float, float, float], tuple[float, float, float]]] = deque(maxlen=100)
        self._offset_s = math.inf  # our clock less the autopilot's
        self._amsl_m = math.nan
        self._turn_rad, self._shift_ne_m = 0.0, (0.0, 0.0)  # from its local frame to the world

    # ------------------------------------------------------------------------ as a FakeAutopilot is seen
    @property
    def personality(self) -> type[Personality]:
        """Which kind it is, once it was heard."""
        assert self._heartbeat is not None
        return _KINDS[self._heartbeat.autopilot]

    @property
    def mode_name(self) -> str:
        """Its flight mode."""
        if self._heartbeat is None:
            return "none"
        numbers = {number: name for name, number in self.personality.MODES.items()}
        return numbers.get(self._heartbeat.custom_mode, f"mode {self._heartbeat.custom_mode}")

    @property
    def is_armed(self) -> bool:
        """Whether it says so."""
        return self._heartbeat is not None and bool(self._heartbeat.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)

    @property
    def pose(self) -> Pose:
        """Where it said it was, `VIEW_DELAY_S` ago, in the world."""
        then_s = time.monotonic() - VIEW_DELAY_S
        attitude = self._attitudes.at(then_s) or self._attitudes.newest
        place = self._place_at(then_s)
        if attitude is None or place is None:
            return Pose((0.0, 0.0, 0.0))
        north_m, east_m = self._turned(place[0], place[1])
        return Pose(
            (north_m + self._shift_ne_m[0], east_m + self._shift_ne_m[1], place[2]),
            attitude.roll_rad,
            attitude.pitch_rad,
            wrapped(attitude.yaw_rad + self._turn_rad),
        )

    @property
    def velocity_ned_mps(self) -> tuple[float, float, float]:
        """As it reported last, in the world."""
        if not self._places:
            return (0.0, 0.0, 0.0)
        north, east, down = self._places[-1][2]
        return (*self._turned(north, east), down)

    @property
    def yaw_rate_radps(self) -> float:
        """As it reported last."""
        return self._attitudes.newest.yaw_rate_radps if self._attitudes.newest is not None else 0.0

    @property
    def camera_pose(self) -> Pose:
        """As the vehicle's: the simulated camera is fixed to it."""
        return self.pose

    @property
    def camera_rates_radps(self) -> tuple[float, float]:
        """Rates of pitch, which is left out, and yaw."""
        return 0.0, self.yaw_rate_radps

    def receive(self, data: bytes) -> None:
        """Pass the application's bytes on."""
        self._link.write(data)

    def step(self, dt_s: float) -> bytes:
        """What has come from the autopilot; looked at, and for the application."""
        now_s = time.monotonic()
        data = self._link.read(now_s)
        for message in self._parser.parse_buffer(data) or ():
            self._hear(message, now_s)
        if now_s - self._asked_s >= ASK_EVERY_S:
            self._asked_s = now_s
            self._mav.heartbeat_send(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 0)
            if self._heartbeat is not None:
                for number, rate_hz in _RATES_HZ.items():
                    self._command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, number, 1e6 / rate_hz)
        self._flush()
        return data

    def select_mode(self, name: str) -> bool:
        """Ask for a flight mode, as a ground station does; where it is not ours, ask whoever flies it."""
        if not self.is_ours:
            if name != self._wished_mode:
                self._say(f"select {name} now")
            self._wished_mode = name
            return False
        number = self.personality.MODES[name]
        if self.personality is Px4:
            self._command(mavlink.MAV_CMD_DO_SET_MODE, 1, number >> 16 & 255, number >> 24 & 255)
        else:
            self._command(mavlink.MAV_CMD_DO_SET_MODE, 1, number)
        self._flush()
        return True

    def set_sticks(self, roll: float = 0.0, pitch: float = 0.0, throttle: float = 0.0, yaw: float = 0.0) -> None:
        """Nobody holds a real transmitter here.

        Raises
        ------
        LinkLostError
            Always: a scenario that moves sticks flies with the fake autopilots only.
        """
        raise LinkLostError("this scenario moves the pilot's sticks: it cannot be flown with --external")

    # ------------------------------------------------------------------------ the operator's side
    def connect(self) -> None:
        """Wait until the autopilot reports its state.

        Raises
        ------
        LinkLostError
            If none is heard within 20 s, or none that knows where it is within two minutes.
        """
        self._wait("an autopilot's heartbeat", HEARD_S, lambda: self._heartbeat is not None)
        # one that has just booted has to find its position first
        self._wait(
            "its position",
            READY_S,
            lambda: bool(self._places) and self._attitudes.newest is not None and math.isfinite(self._amsl_m),
        )

    def take_off(self, height_m: float) -> None:
        """Arm and climb, as an operator does with commands.

        Raises
        ------
        LinkLostError
            If it does not get there within two minutes each.
        """
        is_px4 = self.personality is Px4
        if not is_px4:
            self._wait("GUIDED", READY_S, lambda: self.mode_name == "GUIDED", lambda: self.select_mode("GUIDED"))
        self._wait(
            "arming",
            READY_S,
            lambda: self.is_armed,
            lambda: self._command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1),
        )
        # PX4 takes the altitude above the sea, ArduCopter that above home
        goal_m = self._amsl_m + height_m if is_px4 else height_m
        start_m = self._height_m()
        nan = math.nan if is_px4 else 0.0
        self._wait(
            f"the climb to {height_m:g} m",
            READY_S,
            lambda: abs(self._height_m() - start_m - height_m) < 1.0 and abs(self.velocity_ned_mps[2]) < 0.3,
            lambda: (
                None  # a second command would begin the take-off anew
                if mavlink.MAV_CMD_NAV_TAKEOFF in self._accepted
                else self._command(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, nan, nan, nan, goal_m)
            ),
        )

    def wait_airborne(self, height_m: float) -> None:
        """Wait until somebody else has flown it up.

        Raises
        ------
        LinkLostError
            If nobody does within two minutes.
        """
        self._wait(f"a height of {height_m:g} m (fly it there)", READY_S, lambda: self._height_m() > height_m - 1.5)

    def land(self) -> None:
        """Have it land, where it is.

        Raises
        ------
        LinkLostError
            If it does not begin to within 20 s.
        """
        mode = self.personality.LAND_MODE
        self._wait("landing", HEARD_S, lambda: self.mode_name == mode, lambda: self.select_mode(mode))

    def lay_out(self, start: Pose) -> None:
        """Let the vehicle's place and heading now be the stage's start."""
        self._turn_rad, self._shift_ne_m = 0.0, (0.0, 0.0)
        here = self.pose
        self._turn_rad = wrapped(start.yaw_rad - here.yaw_rad)
        north_m, east_m = self._turned(here.pos_ned_m[0], here.pos_ned_m[1])
        self._shift_ne_m = start.pos_ned_m[0] - north_m, start.pos_ned_m[1] - east_m

    def close(self) -> None:
        """Close the link."""
        self._link.close()

    # ------------------------------------------------------------------------ inside
    def _wait(
        self, what: str, limit_s: float, is_there: Callable[[], bool], ask: Callable[[], object] = lambda: None
    ) -> None:
        end_s, asked_s = time.monotonic() + limit_s, -math.inf
        self._say(f"waiting for {what}")
        while not is_there():
            now_s = time.monotonic()
            if now_s > end_s:
                raise LinkLostError(f"waited {limit_s:g} s for {what} in vain{self._why()}")
            if now_s - asked_s >= ASK_EVERY_S:
                asked_s = now_s
                ask()
            self.step(0.0)
            time.sleep(0.01)

    def _why(self) -> str:
        return f": {self._link.fault}" if self._link.fault else ""

    def _hear(self, message: Any, now_s: float) -> None:
        kind = message.get_type()
        if self._heartbeat is not None and message.get_srcSystem() != self._heartbeat.get_srcSystem():
            return
        if kind == "HEARTBEAT" and message.autopilot in _KINDS:
            self._heartbeat = message
        if self._heartbeat is None:
            return
        if kind == "COMMAND_ACK" and message.result == mavlink.MAV_RESULT_ACCEPTED:
            self._accepted.add(message.command)
        if kind == "GLOBAL_POSITION_INT":
            self._amsl_m = message.alt / 1000
        if kind not in {"ATTITUDE", "LOCAL_POSITION_NED"}:
            return
        # the smallest delay seen is taken for none
        self._offset_s = min(self._offset_s, now_s - message.time_boot_ms / 1000)
        time_s = message.time_boot_ms / 1000 + self._offset_s
        if kind == "ATTITUDE":
            self._attitudes.add(Attitude(time_s, message.roll, message.pitch, message.yaw, message.yawspeed))
        else:
            self._places.append((time_s, (message.x, message.y, message.z), (message.vx, message.vy, message.vz)))

    def _place_at(self, time_s: float) -> tuple[float, float, float] | None:
        """Position in its local frame, by the last report before that time and its velocity."""
        if not self._places:
            return None
        reported = next((entry for entry in reversed(self._places) if entry[0] <= time_s), self._places[0])
        gap_s = min(max(time_s - reported[0], 0.0), 0.5)
        north_m, east_m, down_m = (p + v * gap_s for p, v in zip(reported[1], reported[2], strict=True))
        return north_m, east_m, down_m

    def _height_m(self) -> float:
        return -self._places[-1][1][2] if self._places else 0.0

    def _turned(self, north: float, east: float) -> tuple[float, float]:
        c, s = math.cos(self._turn_rad), math.sin(self._turn_rad)
        return c * north - s * east, s * north + c * east

    def _command(self, command: int, *parameters: float) -> None:
        padded = [*map(float, parameters), *[0.0] * (7 - len(parameters))]
        system = self._heartbeat.get_srcSystem()
        self._mav.command_long_send(system, self._heartbeat.get_srcComponent(), command, 0, *padded)

    def _flush(self) -> None:
        self._link.write(self._port.getvalue())
        self._port.seek(0)
        self._port.truncate()
