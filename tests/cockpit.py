"""A vehicle, a camera and an operator around a bare `Controller`, for tests: values only, steps of 1/16 s."""

import math
from copy import deepcopy
from dataclasses import replace
from functools import cache

from companion.config import parse
from companion.controller import Controller, ControlOutput
from companion.modes import Mode
from companion.types import (
    Attitude,
    Autopilot,
    ControlInput,
    Disengage,
    Engage,
    FlightMode,
    Heartbeat,
    HeightReading,
    Landed,
    LandedReading,
    LinkEvent,
    LocalState,
    OperatorCommand,
    RcChannels,
    Select,
    TrackSample,
)
from mscf import Box, TrackStatus

STEP_S = 1 / 16  # whole in binary: times that are reached are reached
SIZE_HW = (480, 640)
AHEAD = Box(300, 225, 40, 30)  # straight ahead, some 30 degrees below the horizon
CAMERA = "[camera]\nwidth_px=640\nheight_px=480\nfocal_px=554\nmount_pitch_deg=-30\nlatency_ms=0\n"
FOLLOW = CAMERA + '[follow]\nmode="follow"\n[loss]\nsearch_after_s=2\n'
ZERO = ((0.0, 0.0, 0.0), 0.0)


class Cockpit:
    """Flies level at 14 m, armed, in the mode in which it obeys, and sees a target ahead; tests change what they want.

    muted : names of what does not come any more: heartbeat, attitude, local, height, landed, rc, frames.
    is_seen : whether the tracker measures the target.
    """

    def __init__(self, config: str = FOLLOW, autopilot: Autopilot = Autopilot.ARDUPILOT) -> None:
        self.controller = Controller(parse(config))
        self.now_s = 100.0
        self.heartbeat = Heartbeat(
            0.0,
            autopilot,
            is_multicopter=True,
            mode=FlightMode.EXTERNAL,
            mode_name="",
            is_armed=True,
            has_failsafe=False,
        )
        self.landed = Landed.IN_AIR
        self.yaw_rad = 0.0
        self.height_m = 14.0
        self.velocity_ned_mps = (0.0, 0.0, 0.0)
        self.pwm_us = (1500, 1500, 1500, 1500)
        self.is_seen = True
        self.box = AHEAD
        self.confidence = 0.9
        self.muted: set[str] = set()
        self.is_sent = True  # whether the port takes what it is given
        self.inputs: list[ControlInput] = []
        self.outputs: list[ControlOutput] = []
        self._sample: TrackSample | None = None
        self._selection = 0

    @property
    def mode(self) -> Mode:
        return self.controller.mode

    @property
    def texts(self) -> list[str]:
        """All that was said so far."""
        return [text.text for output in self.outputs for text in output.texts]

    def fly(self, mode: FlightMode) -> None:
        """Be in a flight mode from the next heartbeat on."""
        self.heartbeat = replace(self.heartbeat, mode=mode)

    def step(
        self, *commands: OperatorCommand, events: tuple[LinkEvent, ...] = (), dt_s: float = STEP_S
    ) -> ControlOutput:
        """One step; `events` come before what the vehicle says."""
        self.now_s += dt_s
        if "frames" not in self.muted:
            self._sample = self._seen()
        return self.put(ControlInput(self.now_s, self._sample, (*events, *self._said()), commands, self.is_sent))

    def put(self, inputs: ControlInput) -> ControlOutput:
        """Hand any input to the controller."""
        self.inputs.append(inputs)
        output = self.controller.step(inputs)
        self._selection = output.selection.number
        self.outputs.append(output)
        return output

    def run(self, duration_s: float) -> list[ControlOutput]:
        """Steps for a time; what they decided."""
        return [self.step() for _ in range(round(duration_s / STEP_S))]

    def track(self) -> "Cockpit":
        self.step()
        self.step(Select(AHEAD))
        self.run(0.5)
        assert self.mode in {Mode.TRACKING, Mode.FOLLOWING}  # or by itself, where that is configured
        return self

    def engage(self) -> "Cockpit":
        """Follow, and move: the target has gone away to the right a little."""
        self.track().step(Engage())
        assert self.mode is Mode.FOLLOWING, self.texts
        self.box = Box(345, 194, 31, 23)
        self.run(1.0)
        return self

    def _said(self) -> tuple[LinkEvent, ...]:
        now_s = self.now_s
        events: dict[str, LinkEvent] = {
            "heartbeat": replace(self.heartbeat, time_s=now_s),
            "attitude": Attitude(now_s, 0.0, 0.0, self.yaw_rad, 0.0),
            "local": LocalState(now_s, (0.0, 0.0, -self.height_m), self.velocity_ned_mps),
            "height": HeightReading(now_s, self.height_m),
            "landed": LandedReading(now_s, self.landed),
            "rc": RcChannels(now_s, self.pwm_us),
        }
        return tuple(event for name, event in events.items() if name not in self.muted)

    def _seen(self) -> TrackSample:
        seq = self._sample.seq + 1 if self._sample is not None else 0
        nothing = TrackSample(seq, self.now_s - 0.02, self.now_s, SIZE_HW, self._selection)
        if self._selection == 0:
            return nothing
        status = TrackStatus.TRACKING if self.is_seen else TrackStatus.LOST
        return replace(
            nothing,
            status=status,
            is_measured=self.is_seen,
            box=self.box,
            confidence=self.confidence if self.is_seen else 0.1,
        )


def brought_to(mode: Mode, autopilot: Autopilot = Autopilot.ARDUPILOT) -> Cockpit:
    """A cockpit in one of the streaming modes, in the flight mode in which the vehicle obeys."""
    return deepcopy(_brought_to(mode, autopilot))


@cache
def _brought_to(mode: Mode, autopilot: Autopilot) -> Cockpit:
    if mode is Mode.READY:
        cockpit = Cockpit(autopilot=Autopilot.PX4)
        cockpit.heartbeat = replace(cockpit.heartbeat, is_armed=False)
        cockpit.fly(FlightMode.HOLD)
        cockpit.step()
        cockpit.heartbeat = replace(cockpit.heartbeat, is_armed=True)
        cockpit.track().step(Engage())
        cockpit.run(1.5)
        cockpit.fly(FlightMode.EXTERNAL)
        cockpit.run(0.125)
    else:
        cockpit = Cockpit(autopilot=autopilot).engage()
        if mode is Mode.LEAVING:
            cockpit.step(Disengage())
        elif mode is not Mode.FOLLOWING:
            cockpit.is_seen = False
            cockpit.run({Mode.COASTING: 0.3, Mode.HOLDING: 1.0, Mode.SEARCHING: 2.5, Mode.AWAITING: 4.0}[mode])
            cockpit.is_seen = mode is Mode.AWAITING
            if cockpit.is_seen:
                cockpit.run(0.125)
    assert cockpit.mode is mode, (cockpit.mode, cockpit.texts)
    return cockpit


def sent(output: ControlOutput) -> tuple[tuple[float, float, float], float] | None:
    """Velocity and yaw rate that go out."""
    setpoint = output.setpoint
    return None if setpoint is None else (setpoint.velocity_ned_mps, setpoint.yaw_rate_radps)


def speed_mps(output: ControlOutput) -> float:
    """Length of the velocity that goes out; 0 where nothing does."""
    return math.hypot(*output.setpoint.velocity_ned_mps) if output.setpoint is not None else 0.0
