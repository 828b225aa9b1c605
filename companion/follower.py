"""The application without its edges: bytes, track samples and orders in; bytes, selections and texts out.

The command loop on the vehicle and the simulator's loop both drive this one class, each with its own time.
"""

import math
from collections import deque
from dataclasses import dataclass
from importlib.metadata import version

from companion.camera_protocol import CameraProtocol
from companion.codec import ATTITUDE_HZ, MavlinkCodec
from companion.config import Config
from companion.controller import Controller, ControlOutput
from companion.engagement import Reason
from companion.gimbal_protocol import GimbalProtocol
from companion.ground_command import GroundCommands
from companion.modes import Mode
from companion.parameters import WANTED, advice
from companion.safety import stop
from companion.signing import Signing
from companion.types import (
    Attitude,
    AutopilotText,
    ControlInput,
    Heartbeat,
    HeightReading,
    LandedReading,
    LinkEvent,
    LocalState,
    OperatorCommand,
    Parameter,
    RcChannels,
    Rebooted,
    Select,
    Severity,
    Text,
    TrackSample,
)
from companion.vehicle_state import VehicleState
from companion.wire import Wire
from mscf import Box

HEARTBEAT_EVERY_S = 1.0
RATE_CHECK_EVERY_S = 5.0
NEEDED = frozenset({LocalState, HeightReading, LandedReading, RcChannels})  # without which little can be done
MIN_RATE_SHARE = 0.6  # of a rate that was asked for; below, it is asked for again
TEXT_EVERY_S = 1.0  # of what is no change of state
PARAMETER_EVERY_S = 2.0  # a parameter that does not come is asked for again, so often:
PARAMETER_TRIES = 5
_TOLD = {
    Mode.IDLE: Text(Severity.INFO, "No target selected"),
    Mode.TRACKING: Text(Severity.INFO, "Target tracked"),
    Mode.LOST: Text(Severity.NOTICE, "Target not seen"),
    Mode.FOLLOWING: Text(Severity.NOTICE, "Target seen again: following"),
    Mode.SEARCHING: Text(Severity.NOTICE, "Target lost: looking around"),
}


@dataclass(frozen=True, slots=True)
class Step:
    """What one step of the loop did."""

    inputs: ControlInput
    control: ControlOutput
    vehicle: VehicleState
    received: tuple[bytes, ...]  # messages that have come
    sent: tuple[bytes, ...]  # messages for the port
    texts: tuple[Text, ...]  # for the log: what the operator is told
    autopilot_texts: tuple[AutopilotText, ...]  # for the log: what the autopilot said

    @property
    def data(self) -> bytes:
        """For the port."""
        return b"".join(self.sent)


@dataclass(frozen=True, slots=True)
class FailedStep:
    """What a step was given whose controller raised: nothing was decided."""

    inputs: ControlInput
    received: tuple[bytes, ...]  # messages that have come
    raised: str  # class and text of the exception


class StepError(RuntimeError):
    """The controller raised: a mistake of this code, which ends the run; with it goes what the record needs."""

    def __init__(self, failed: FailedStep) -> None:
        super().__init__(failed)  # and nothing else: the simulator hands it from process to process
        self.failed = failed

    def __str__(self) -> str:
        return f"the controller raised {self.failed.raised}"


def described(error: Exception) -> str:
    """Class and text of an exception, in a line."""
    return " ".join(f"{type(error).__name__}: {error}".split())


class Follower:
    """Runs the controller on one vehicle's link.

    Parameters
    ----------
    config : a checked configuration.
    signing : of the link, where it is signed.
    """

    def __init__(self, config: Config, signing: Signing | None = None) -> None:
        self._config = config
        self._controller = Controller(config)
        link = config.link
        self._wire = Wire(link.system_id or 1, signing)
        self._codec = MavlinkCodec(self._wire, link.system_id, link.component_id, link.setpoint_frame)
        self._ground = GroundCommands(self._wire.sender(link.component_id), config.ground)
        self._gimbal = GimbalProtocol(self._wire.sender(link.component_id), config.gimbal, self._codec.clock)
        self._camera: CameraProtocol | None = None
        if config.ground.camera_component:
            sender = self._wire.sender(config.ground.camera_component)
            self._camera = CameraProtocol(sender, config, version("mscf-companion"))
        self._heartbeat_s = -math.inf
        self._rates_s = math.inf  # when they were asked for; not before an autopilot is there
        self._attitudes = 0  # since then
        self._heard: set[type] = set()  # kinds of events, since then
        self._low_rates = 0  # how often in a row they stayed low
        self._parameters_s = -math.inf
        self._parameter_tries = 0
        self._read: set[str] = set()  # parameters, since the autopilot began
        self._advised: set[str] = set()
        self._queue: deque[Text] = deque(maxlen=16)  # texts that can wait
        self._queued_s = -math.inf
        self._has_started = False
        self._mode = Mode.IDLE

    def step(
        self,
        now_s: float,
        data: bytes,
        track: TrackSample | None,
        commands: tuple[OperatorCommand, ...] = (),
        *,
        is_healthy: bool = True,
        is_sent: bool = True,
        notices: tuple[Text, ...] = (),
    ) -> Step:
        """One period of the command loop.

        Parameters
        ----------
        data : what the link has brought since the last step.
        track : the newest sample there is.
        commands : of the operator, since the last step.
        is_healthy : whether camera and tracker work; the heartbeat says so.
        is_sent : whether the port has taken the last step's bytes.
        notices : what else the operator is to be told.

        Raises
        ------
        StepError
            If the controller raises, which is a mistake of this code; what was to be sent until then leaves with
            `farewell`.
        """
        if now_s - self._heartbeat_s >= HEARTBEAT_EVERY_S:
            self._codec.send_time_request(now_s)  # before anything else: nothing that queues ahead delays its answer
        messages = self._wire.receive(data)
        events = (*self._codec.receive(messages, now_s), *self._gimbal.receive(messages, now_s))
        clicked = self._camera.receive(messages, track, now_s) if self._camera is not None else ()
        commands = (*self._at_start(track), *clicked, *commands, *self._ground.receive(messages, now_s))
        inputs = ControlInput(now_s, track, events, commands, is_sent)
        received = tuple(bytes(message.get_msgbuf()) for message in messages)
        try:
            output = self._controller.step(inputs)
        except Exception as error:
            raise StepError(FailedStep(inputs, received, described(error))) from error
        self._ground.after(output.mode)
        if self._camera is not None:
            self._camera.after(output, self._controller.vehicle, track, now_s)
        # the request first: after a gap a stream alone would bring PX4 back to OFFBOARD
        if output.request is not None:
            self._codec.send_mode_request(output.request)
        if output.setpoint is not None:
            self._codec.send_setpoint(output.setpoint, now_s)
        self._gimbal.send(output.gimbal, self._codec.autopilot, now_s)
        if output.landing is not None:
            self._codec.send_landing_target(output.landing)
        self._keep_up(events, now_s)
        self._tell(output)
        self._queue.extend(notices)
        texts = (*output.texts, *self._due_text(now_s))
        for text in texts:
            self._codec.send_text(text)
        if now_s - self._heartbeat_s >= HEARTBEAT_EVERY_S:
            self._heartbeat_s = now_s
            self._codec.send_heartbeat(is_active=output.mode.is_engaged, is_healthy=is_healthy)
            if self._camera is not None:
                self._camera.send_heartbeat(is_healthy=is_healthy)
        said = tuple(event for event in events if isinstance(event, AutopilotText))
        return Step(inputs, output, self._controller.vehicle, received, self._wire.drain(), texts, said)

    def farewell(self, now_s: float) -> tuple[bytes, ...]:
        """Messages to write when the process is asked to end: zero velocity three times, and the request to hold.

        Nothing where setpoints do not flow: the vehicle is not ours then.
        """
        is_streaming = self._controller.mode.is_streaming
        request = self._controller.shut_down()
        if is_streaming:
            for count in range(3):
                self._codec.send_setpoint(stop(), now_s + count / 1000)
        if request is not None:
            self._codec.send_mode_request(request)
            self._codec.send_text(Text(Severity.WARNING, f"Follow ended: {Reason.SHUTDOWN.value}"))
        self._gimbal.release()
        return self._wire.drain()

    def _tell(self, output: ControlOutput) -> None:
        """A change of mode that the controller has not spoken of; of several within a second, the last one."""
        if output.mode is self._mode:
            return
        self._mode = output.mode
        for word in _TOLD.values():
            while word in self._queue:
                self._queue.remove(word)
        if output.mode in _TOLD and not output.texts:
            self._queue.append(_TOLD[output.mode])

    def _at_start(self, track: TrackSample | None) -> tuple[OperatorCommand, ...]:
        """The configured selection, with the first frame."""
        if self._has_started or track is None:
            return ()
        self._has_started = True
        select = self._config.select
        if select.at_start == "nothing":
            return ()
        return (Select(Box(*select.box) if select.at_start == "box" else None),)

    def _keep_up(self, events: tuple[LinkEvent, ...], now_s: float) -> None:
        """Ask for telemetry and parameters, again where they do not come."""
        has_begun = any(isinstance(event, Rebooted) for event in events)
        is_there = self._codec.autopilot is not None
        if has_begun or (is_there and math.isinf(self._rates_s)):
            self._ask_rates(now_s)
            self._parameter_tries, self._read = 0, set()
        self._attitudes += sum(isinstance(event, Attitude) for event in events)
        self._heard.update(map(type, events))
        if now_s - self._rates_s >= RATE_CHECK_EVERY_S:
            wanted = ATTITUDE_HZ * (now_s - self._rates_s)
            is_low = self._attitudes < MIN_RATE_SHARE * wanted
            # a slow loop reads what a fast link brought: only the rate on the link counts
            self._low_rates = self._low_rates + 1 if is_low else 0
            if is_low or not self._heard.issuperset(NEEDED):  # one request that was lost would go unnoticed
                self._ask_rates(now_s)
                if self._low_rates > 1:
                    self._codec.send_stream_request()
            self._rates_s, self._attitudes, self._heard = now_s, 0, set()
        self._ask_parameters(events, now_s)

    def _ask_rates(self, now_s: float) -> None:
        self._codec.send_rate_requests()
        self._rates_s, self._attitudes = now_s, 0

    def _ask_parameters(self, events: tuple[LinkEvent, ...], now_s: float) -> None:
        """Read the parameters that matter once a start of the autopilot, and say what should be changed."""
        kind = self._codec.autopilot
        if kind is None:
            return
        self._read |= {event.name for event in events if isinstance(event, Parameter)}
        missing = [name for name in WANTED[kind] if name not in self._read]
        is_due = now_s - self._parameters_s >= PARAMETER_EVERY_S and self._parameter_tries < PARAMETER_TRIES
        if missing and is_due:
            self._parameters_s = now_s
            self._parameter_tries += 1
            for name in missing:
                self._codec.send_parameter_request(name)
        if any(isinstance(event, Parameter) for event in events):
            for line in advice(kind, self._controller.vehicle.parameters):
                if line not in self._advised:
                    self._advised.add(line)
                    self._queue.append(Text(Severity.NOTICE, line))

    def _due_text(self, now_s: float) -> tuple[Text, ...]:
        if not self._queue or now_s - self._queued_s < TEXT_EVERY_S:
            return ()
        self._queued_s = now_s
        return (self._queue.popleft(),)

    def is_connected(self, now_s: float) -> bool:
        """Whether an autopilot's heartbeat is fresh."""
        return self._controller.vehicle.is_alive(now_s)

    @property
    def heartbeat(self) -> Heartbeat | None:
        """The autopilot's last heartbeat."""
        return self._controller.vehicle.heartbeat
