"""The other end of a fake autopilot's link, for tests: sends messages, lets time pass, keeps all that was said."""

import math
from collections.abc import Callable
from io import BytesIO
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from sim.autopilot import FakeAutopilot

VELOCITY_AND_YAW_RATE = 0x5C7
VELOCITY_ONLY = 3527


def velocity(
    forward: float = 0.0,
    right: float = 0.0,
    down: float = 0.0,
    yaw_rate_dps: float = 0.0,
    *,
    frame: int = mavlink.MAV_FRAME_BODY_NED,
    mask: int = VELOCITY_AND_YAW_RATE,
    system: int = 1,
    component: int = 1,
) -> Any:
    """SET_POSITION_TARGET_LOCAL_NED with a velocity in `frame`."""
    rest = (0.0, 0.0, 0.0, 0.0, math.radians(yaw_rate_dps))
    return mavlink.MAVLink_set_position_target_local_ned_message(
        0, system, component, frame, mask, 0.0, 0.0, 0.0, forward, right, down, *rest
    )


class GroundStation:
    """Component 191 of the vehicle's system, and everybody else who sends."""

    def __init__(self, autopilot: FakeAutopilot) -> None:
        self.autopilot = autopilot
        self.heard: list[tuple[float, Any]] = []  # time and message
        self._out = mavlink.MAVLink(BytesIO(), srcSystem=1, srcComponent=191)
        self._in = mavlink.MAVLink(BytesIO())

    def packed(self, message: Any) -> bytes:
        return bytes(message.pack(self._out))

    def send(self, message: Any) -> None:
        self.autopilot.receive(self.packed(message))

    def command(self, command: int, *params: float, component: int = 1) -> list[int]:
        """Results of all acknowledgements of a COMMAND_LONG; they come at once."""
        padded = (*params, *[0.0] * 7)[:7]
        self.send(mavlink.MAVLink_command_long_message(1, component, command, 0, *padded))
        before = len(self.heard)
        self._listen(0.0)
        return [message.result for _, message in self.heard[before:] if message.get_type() == "COMMAND_ACK"]

    def set_mode(self, *numbers: int) -> list[int]:
        return self.command(mavlink.MAV_CMD_DO_SET_MODE, 1, *numbers)

    def ask_for(self, msg_id: int, rate_hz: float) -> list[int]:
        return self.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, msg_id, 1e6 / rate_hz)

    def run(
        self,
        duration_s: float,
        setpoint: Any = None,
        *,
        rate_hz: float = 10.0,
        until: Callable[[FakeAutopilot], bool] | None = None,
    ) -> float:
        """Let time pass, with a stream of `setpoint` if one is given; the time that passed until `until` held."""
        start_s = self.autopilot.time_s
        next_s = start_s
        while self.autopilot.time_s < start_s + duration_s - 1e-6:
            if setpoint is not None and self.autopilot.time_s >= next_s - 1e-6:
                self.send(setpoint)
                next_s += 1 / rate_hz
            self._listen(0.02)
            if until is not None and until(self.autopilot):
                break
        return self.autopilot.time_s - start_s

    def of(self, kind: str, since_s: float = -math.inf) -> list[Any]:
        """All messages of one type, oldest first."""
        return [message for time_s, message in self.heard if message.get_type() == kind and time_s > since_s]

    def texts(self) -> list[str]:
        """All status texts, chunks put together."""
        texts: dict[tuple[int, int], str] = {}
        for index, message in enumerate(self.of("STATUSTEXT")):
            key = (message.id, 0) if message.id else (0, index)
            texts[key] = texts.get(key, "") + message.text
        return [*texts.values()]

    @property
    def speed_mps(self) -> float:
        """Horizontal speed of the vehicle, from the truth."""
        return math.hypot(*self.autopilot.velocity_ned_mps[:2])

    @property
    def body_mps(self) -> tuple[float, float, float]:
        """Velocity of the vehicle forward, right and down, from the truth."""
        north, east, down = self.autopilot.velocity_ned_mps
        c, s = math.cos(self.autopilot.pose.yaw_rad), math.sin(self.autopilot.pose.yaw_rad)
        return c * north + s * east, c * east - s * north, down

    @property
    def yaw_rate_dps(self) -> float:
        """Yaw rate of the vehicle in degrees per second, from the truth."""
        return math.degrees(self.autopilot.yaw_rate_radps)

    def _listen(self, dt_s: float) -> None:
        for message in self._in.parse_buffer(self.autopilot.step(dt_s)) or ():
            self.heard.append((self.autopilot.time_s, message))
