"""The controller: everything that is known goes in, what may be sent comes out. No clock, log or I/O.

`Controller.step` reads from top to bottom: take in what happened, ask whether the pilot has the vehicle, look at the
target, change the mode, guide, limit. Inputs from the pilot, the autopilot, the operator or the camera never
make it raise.
"""

import math
from dataclasses import dataclass, field, replace
from typing import assert_never

from companion.camera_model import AttitudeHistory, CameraModel, wrapped
from companion.config import Config
from companion.engagement import Reason, refusals
from companion.gimbal import Gimbal, GimbalHistory, mounted
from companion.guidance import (
    MAX_PREDICTION_S,
    Aim,
    Guided,
    Moving,
    follow_target,
    kept_in_view,
    overhead,
    spotlight,
    turn,
)
from companion.hearing import Hearing, ResumeGuard
from companion.landing import landing_target
from companion.modes import TRANSITIONS, Event, Mode, after
from companion.safety import Place, SafeSetpoint, held_back_by, limit, stop
from companion.target import (
    RangeReference,
    TargetEstimate,
    estimate,
    expected,
    is_speck,
    measure,
    range_fix,
    range_from_above,
    relearned,
)
from companion.transmitter import RcSwitch, StickGuard
from companion.types import (
    ZERO,
    Attitude,
    Autopilot,
    ControlInput,
    Deselect,
    Disengage,
    Engage,
    FlightMode,
    GimbalAim,
    GimbalAttitude,
    GimbalOrder,
    Heartbeat,
    Landed,
    LandedReading,
    LandingTarget,
    LinkEvent,
    LocalState,
    ModeAnswer,
    OperatorCommand,
    RcChannels,
    Rebooted,
    Select,
    Selection,
    Setpoint,
    SetpointInForce,
    Severity,
    Text,
    TrackSample,
)
from companion.vehicle_state import MAX_POSITION_AGE_S, MAX_RANGEFINDER_AGE_S, VehicleState, jump_ne_m
from mscf import Box, Expected

MAX_FRAME_AGE_S = 0.3
MAX_QUIET_S = 2.0  # since the last heartbeat: two have been lost, nothing moves until the third
MAX_BLINK_S = 0.15  # for which frames without a measurement are no loss: the last box is not old yet
READY_FOR_S = 20.0  # how long zero setpoints flow for a pilot who is to select OFFBOARD
REQUEST_EVERY_S = 1.0  # a flight mode that does not come is asked for again
ABANDONED_S = 1.5  # after which a heartbeat is no old one that was waiting somewhere
STREAM_GAP_S = 0.5  # without setpoints, after which PX4 (which wants more than 2 Hz) may leave OFFBOARD
SILENCE_S = 1.0  # of the link, after which PX4 has left OFFBOARD: the default of COM_OF_LOSS_T
NOTHING_SELECTED = Selection(0, None)
NOTHING_ORDERED = GimbalOrder(None, None)
LEAST_GIMBAL_PITCH_RAD = -math.pi / 2  # before its manager has said more
_MODE_OF = {"hold": FlightMode.HOLD, "rtl": FlightMode.RTL, "land": FlightMode.LAND}


@dataclass(frozen=True, slots=True)
class ControlOutput:
    """What a step decided.

    setpoint : to be sent now; None: nothing is sent.
    request : a flight mode to ask for now.
    selection : for vision, always the one in force.
    expected : where the target should be in the newest frame, and how large, for a search; None: no idea.
    notes : why the vehicle does not move as the law says, in the operator's words.
    texts : lines for the operator, on a change.
    gimbal : for the gimbal's manager, now.
    landing : of a frame that has just been measured, where the configuration wants it told.
    """

    mode: Mode
    setpoint: SafeSetpoint | None
    request: FlightMode | None
    selection: Selection
    expected: Expected | None
    notes: tuple[str, ...]
    texts: tuple[Text, ...]
    target: TargetEstimate | None
    gimbal: GimbalOrder = NOTHING_ORDERED
    landing: LandingTarget | None = None


@dataclass(frozen=True, slots=True)
class _State:
    """What the controller carries from step to step; replaced field by field, read by nobody else."""

    vehicle: VehicleState = field(default_factory=VehicleState)
    mode: Mode = Mode.IDLE
    selection: Selection = NOTHING_SELECTED
    sample: TrackSample | None = None  # newest of this selection
    measured_s: float = -math.inf  # capture of the newest in which the target was seen
    size_hw: tuple[int, int] | None = None  # of the newest frame of all
    target: TargetEstimate | None = None
    reference: RangeReference | None = None  # size to range, learned at engagement or configured
    aim: Aim | None = None
    engaged_at_ne_m: tuple[float, float] | None = None
    has_seen_other: bool = False  # a heartbeat that was disarmed, or in a mode that is not ours
    auto_done: bool = False  # this selection has engaged, by itself or not
    moving: Moving = field(default_factory=Moving)
    sent: SafeSetpoint | None = None
    sent_s: float = -math.inf
    must_confirm: bool = False
    chosen_s: float = -math.inf  # when this selection was made
    awaiting_s: float = -math.inf  # since when a confirmation is awaited
    ready_until_s: float = -math.inf
    is_switch_waiting: bool = False  # whether it is the transmitter's switch that made us READY
    leave_for: FlightMode = FlightMode.HOLD
    asked_s: float = -math.inf
    sticks: StickGuard = field(default_factory=StickGuard)
    switch: RcSwitch = field(default_factory=RcSwitch)
    guard: ResumeGuard = field(default_factory=ResumeGuard)
    hearing: Hearing = field(default_factory=Hearing)
    left_s: float = -math.inf  # when the last setpoint was sent of which it is known that it has left
    had_height: bool = False  # whether the autopilot said its height over take-off at engagement
    abandoned_s: float = math.inf  # when a PX4 was left to its own time-out without a word
    gimbal: Gimbal = field(default_factory=Gimbal)


class Controller:
    """Decides, at the loop's rate, what the vehicle is told."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self._state = _State()
        self._attitudes = AttitudeHistory()
        self._has_gimbal = config.gimbal.axes != "none"
        self._gimbal_attitudes = GimbalHistory()
        self._camera: CameraModel | None = None
        self._landing: LandingTarget | None = None
        self._texts: list[Text] = []
        self._request: FlightMode | None = None

    @property
    def mode(self) -> Mode:
        """Mode after the last step."""
        return self._state.mode

    @property
    def vehicle(self) -> VehicleState:
        """What is known of the vehicle after the last step."""
        return self._state.vehicle

    def step(self, inputs: ControlInput) -> ControlOutput:
        """Take one step; never raises on anything that comes from outside."""
        now_s = inputs.now_s
        self._texts, self._request, self._landing = [], None, None
        if inputs.is_sent:
            self._change(left_s=self._state.sent_s)
        self._take_in(inputs.events, now_s)
        self._look(inputs.track, now_s)
        for command in inputs.commands:
            self._obey(command, now_s)
        for command in self._from_transmitter(inputs.events, now_s):
            self._obey(command, now_s, is_waiting=self._config.rc.switch == "engage")
        for command in self._by_itself(now_s):
            self._obey(command, now_s)
        self._ladder(now_s)
        wish, notes = self._guide(now_s)
        setpoint, edges = self._limited(wish, now_s)
        self._ask(now_s)
        gimbal = self._turn_gimbal(now_s) if self._has_gimbal else NOTHING_ORDERED
        state = self._state
        return ControlOutput(
            state.mode,
            setpoint,
            self._request,
            state.selection,
            self._expected(now_s),
            (*notes, *edges),
            tuple(self._texts),
            state.target,
            gimbal,
            self._landing,
        )

    def shut_down(self) -> FlightMode | None:
        """Disengage for good: the flight mode to ask for, where the vehicle obeys us."""
        state = self._state
        is_ours = state.mode.is_streaming and self._is_external()
        self._change(mode=Mode.IDLE, selection=Selection(state.selection.number + 1, None))
        if not is_ours:
            return None
        return state.leave_for if state.mode is Mode.LEAVING else FlightMode.HOLD

    # ------------------------------------------------------------------------------- what happened
    def _take_in(self, events: tuple[LinkEvent, ...], now_s: float) -> None:
        """Fold the link's events, and end what they end."""
        for event in events:
            if isinstance(event, Attitude):
                self._attitudes.add(event)
            if isinstance(event, GimbalAttitude):
                self._gimbal_attitudes.add(event)
            if isinstance(event, Rebooted):
                self._attitudes.clear()
                self._gimbal_attitudes.clear()
                self._override(Reason.REBOOTED)
                self._change(guard=replace(self._state.guard, heard=None))
            if isinstance(event, ModeAnswer):
                self._change(guard=replace(self._state.guard, is_answered=event.is_accepted))
            if isinstance(event, LocalState):
                self._watch_frame(event)
            if isinstance(event, SetpointInForce) and now_s - self._state.left_s <= STREAM_GAP_S:
                self._watch_obedience(event)  # after a stall of ours it has good reason to stand
            self._change(vehicle=self._state.vehicle.after(event), gimbal=self._state.gimbal.after(event))
            was_external = self._state.guard.heard is FlightMode.EXTERNAL
            if isinstance(event, Heartbeat):
                leave_for = self._state.leave_for if self._state.mode is Mode.LEAVING else None
                has_gap = now_s - self._state.left_s > STREAM_GAP_S
                self._change(guard=self._state.guard.after(event, has_gap=has_gap, requested=leave_for))
            if isinstance(event, Heartbeat | LandedReading):
                # each one: a mode that was left and came back since the last step was left
                self._hear_the_autopilot(was_external=was_external)
        self._hear_silence(now_s)
        self._hear_the_pilot(now_s)

    def _hear_the_autopilot(self, *, was_external: bool) -> None:
        """End what the vehicle's state ends, which before obeyed us or not."""
        state, vehicle, is_external = self._state, self._state.vehicle, self._is_external()
        if vehicle.heartbeat is not None and not (vehicle.heartbeat.is_armed and is_external):
            self._change(has_seen_other=True)
        if not state.mode.is_streaming:
            return
        if vehicle.heartbeat is not None and not vehicle.heartbeat.is_armed:
            self._override(Reason.DISARMED)
        elif vehicle.landed is not None and vehicle.landed.landed in {Landed.ON_GROUND, Landed.LANDING}:
            self._override(Reason.LANDED)
        elif not is_external and state.mode is Mode.LEAVING:
            self._event(Event.LEFT)
        elif not is_external and (state.mode is not Mode.READY or was_external):
            self._override(Reason.MODE_LEFT)

    def _hear_silence(self, now_s: float) -> None:
        """End what a silent link ends."""
        vehicle = self._state.vehicle
        if not self._state.mode.is_streaming:
            return
        if not vehicle.is_alive(now_s):
            self._override(Reason.NO_HEARTBEAT)
        elif self._is_px4() and vehicle.attitude is not None and now_s - vehicle.attitude.time_s > SILENCE_S:
            # it hears us no better: once the link is back, our stream would bring OFFBOARD back out of its failsafe
            self._abandon(Reason.LINK_SILENT, now_s)

    def _hear_the_pilot(self, now_s: float) -> None:
        """End what a stick, a failsafe or a stall of ours ends while the vehicle still obeys us."""
        vehicle = self._state.vehicle
        sticks = self._state.sticks.after(vehicle.rc, self._config.rc, now_s)
        self._change(sticks=sticks)
        if self._state.mode is Mode.LEAVING and sticks.is_held:
            self._change(leave_for=FlightMode.PILOT)
        if not self._state.mode.is_streaming:
            return
        gap_s = now_s - self._state.left_s
        is_leaving = self._state.mode is Mode.LEAVING
        if gap_s > STREAM_GAP_S:
            # nobody expects the vehicle to move on by itself after that; what was heard just now may have waited
            # as long as we did, and the pilot may have the vehicle since
            if self._is_px4() and gap_s > vehicle.parameters.get("COM_OF_LOSS_T", SILENCE_S):
                self._abandon(Reason.STALLED, now_s)
                return
            if not is_leaving:
                self._leave(Reason.STALLED, FlightMode.HOLD)
            if not self._is_px4():  # zero setpoints bring nobody back there: time to hear the mode first
                self._change(asked_s=now_s)
        elif is_leaving or not self._is_external():
            return
        elif sticks.is_held:
            self._leave(Reason.STICKS, FlightMode.PILOT)
            self._change(asked_s=now_s)  # the pilot may just have selected a mode: hear that first
        elif vehicle.heartbeat is not None and vehicle.heartbeat.has_failsafe:
            self._leave(Reason.FAILSAFE, FlightMode.HOLD)
        elif self._is_unplaced(now_s):
            self._leave(Reason.NO_POSITION, FlightMode.HOLD)

    def _is_unplaced(self, now_s: float) -> bool:
        """Whether the position has been missing for so long that nobody expects the vehicle to go on by itself."""
        local, longest_s = self._state.vehicle.local, MAX_POSITION_AGE_S + self._config.loss.confirm_after_s
        return self._state.mode.is_engaged and (local is None or now_s - local.time_s > longest_s)

    def _watch_frame(self, local: LocalState) -> None:
        """A local frame that jumps (a reset of the autopilot's estimator) takes what is kept in it along."""
        state, before = self._state, self._state.vehicle.local
        jump = jump_ne_m(before, local) if before is not None else None
        if jump is None:
            return
        if state.target is not None:
            self._change(target=replace(state.target, north=None, east=None))
        if state.engaged_at_ne_m is not None:
            north_m, east_m = state.engaged_at_ne_m
            self._change(engaged_at_ne_m=(north_m + jump[0], east_m + jump[1]))
        if state.mode.is_engaged:
            self._say(Severity.NOTICE, "Local position jumped: start shifted")

    def _watch_obedience(self, in_force: SetpointInForce) -> None:
        state = self._state
        if not state.mode.is_engaged or self._is_px4():  # which leaves OFFBOARD where it does not hear us
            return
        told_mps = math.hypot(*state.sent.velocity_ned_mps) if state.sent is not None else 0.0
        self._change(hearing=state.hearing.after(in_force, told_mps))
        if self._state.hearing.is_deaf:
            self._leave(Reason.NOT_OBEYED, FlightMode.HOLD)
            self._change(hearing=Hearing())

    def _override(self, reason: Reason) -> None:
        """The vehicle is not ours any more: end at once, send nothing."""
        if Event.OVERRIDE in TRANSITIONS[self._state.mode]:
            self._say(Severity.WARNING, f"Follow ended: {reason.value}")
            self._event(Event.OVERRIDE)
            self._change(sent=None)

    def _abandon(self, reason: Reason, now_s: float) -> None:
        """Send nothing more to a PX4 that has left OFFBOARD by its own time-out, or is about to."""
        self._override(reason)
        self._change(guard=self._state.guard.raised(), abandoned_s=now_s)

    def _leave(self, reason: Reason, towards: FlightMode) -> None:
        """End by our own will: stand, and ask the autopilot for another mode until it is there."""
        self._say(Severity.WARNING, f"Follow ended: {reason.value}")
        self._change(leave_for=towards, asked_s=-math.inf)
        self._event(Event.DISENGAGE)

    # ------------------------------------------------------------------------------- the target
    def _look(self, sample: TrackSample | None, now_s: float) -> None:
        """Take in the newest sample, and say whether the target is seen."""
        state = self._state
        if sample is not None:
            self._change(size_hw=sample.size_hw)
        if sample is not None and sample.selection == state.selection.number:
            is_new = state.sample is None or sample.seq != state.sample.seq
            if sample.fault and (state.sample is None or state.sample.fault != sample.fault):
                self._say(Severity.ERROR, f"Tracker: {sample.fault}")
            self._change(sample=sample)
            # a frame from the future would never grow old
            is_timely = state.measured_s < sample.captured_s <= now_s + MAX_FRAME_AGE_S
            is_box = sample.is_measured and sample.box is not None and _is_in_frame(sample.box, sample.size_hw)
            if is_new and is_timely and is_box:
                self._change(measured_s=sample.captured_s)
                self._measure(sample)
        mode = self._state.mode
        if state.selection.box is None:
            self._event(Event.DESELECTED, is_optional=True)
        elif not self._is_seen(now_s):
            # not engaged, a frame without the target is no loss yet
            if mode is Mode.FOLLOWING or not now_s - self._state.measured_s <= MAX_FRAME_AGE_S:
                if mode is Mode.READY:
                    self._say(Severity.WARNING, f"Not engaged: {Reason.NO_TARGET.value}")
                self._event(Event.MISSED, is_optional=True)
        elif self._state.must_confirm and mode in {Mode.COASTING, Mode.HOLDING, Mode.SEARCHING}:
            if math.isinf(self._state.awaiting_s):  # said once: a target that blinks would flood the operator
                self._say(Severity.NOTICE, "Target seen: engage to confirm")
                self._change(awaiting_s=now_s)
            self._event(Event.SEEN_LATE)
        else:
            self._event(Event.SEEN, is_optional=True)

    def _is_seen(self, now_s: float) -> bool:
        """Whether a frame that is not too old shows the target; engaged, whether it can be steered by too."""
        state = self._state
        longest_s = MAX_FRAME_AGE_S if state.sample is not None and state.sample.is_measured else MAX_BLINK_S
        if now_s - state.measured_s > longest_s:
            return False
        return not state.mode.is_engaged or self._steerable(now_s) is not None

    def _steerable(self, now_s: float) -> TargetEstimate | None:
        """The target's estimate where it is not too old to steer by, as it becomes without attitudes."""
        target, latency_s = self._state.target, self._config.camera.latency_ms / 1000
        is_fresh = target is not None and now_s - target.seen.time_s <= MAX_FRAME_AGE_S + latency_s
        return target if is_fresh else None

    def _measure(self, sample: TrackSample) -> None:
        state, config, box = self._state, self._config, sample.box
        assert box is not None  # measured
        if self._camera is None or self._camera.size_hw != sample.size_hw:
            self._camera = CameraModel.of(config, sample.size_hw)
        time_s = sample.captured_s - config.camera.latency_ms / 1000
        attitude = self._attitudes.at(time_s)
        camera = self._camera_at(attitude) if attitude is not None else None
        if attitude is None or camera is None:
            return
        seen = measure(camera, box, attitude, time_s)
        height_m = state.vehicle.height_over_ground_m(sample.captured_s)
        if config.follow.mode == "overhead":
            fix = range_from_above(seen, height_m)
        else:
            finder = state.vehicle.forward_range
            is_fresh = finder is not None and sample.captured_s - finder.time_s <= MAX_RANGEFINDER_AGE_S
            finder_m = finder.distance_m if finder is not None and is_fresh else None
            fix = range_fix(seen, height_m, self._reference(), finder_m)
            is_agreed = fix is not None and not fix.is_conflicting  # a conflict must not heal itself
            if state.reference is not None and state.target is not None and is_agreed:
                dt_s = time_s - state.target.seen.time_s
                self._change(reference=relearned(state.reference, seen, height_m, dt_s))
        local = state.vehicle.fresh_local(sample.captured_s)
        self._change(target=estimate(seen, fix, local, state.target))
        # engaged or not: whether anything comes of it is decided by the autopilot's flight mode
        if config.landing.send_target and sample.confidence >= config.engage.min_confidence:
            self._landing = landing_target(camera, seen, attitude, local, height_m)

    def _camera_at(self, attitude: Attitude) -> CameraModel | None:
        """The camera as it was mounted at an attitude's time; None where the gimbal has not told."""
        if self._camera is None or not self._has_gimbal:
            return self._camera
        gimbal = self._gimbal_attitudes.at(attitude.time_s, attitude)
        return mounted(self._camera, gimbal, attitude) if gimbal is not None else None

    def _turn_gimbal(self, now_s: float) -> GimbalOrder:
        """What the gimbal's manager is asked for, and where the camera is to look; whatever the vehicle does."""
        state = self._state
        selection = state.selection.number if state.selection.box is not None else None
        lost_s = now_s - (state.target.seen.time_s if state.target is not None else state.chosen_s)
        gimbal, claim, text = state.gimbal.claimed(selection, lost_s, self._config.loss.give_up_after_s, now_s)
        if text:
            self._say(Severity.WARNING, text)
        aim: GimbalAim | None = None
        vehicle = state.vehicle.fresh_attitude(now_s)
        newest = self._attitudes.newest
        camera = self._gimbal_attitudes.at(newest.time_s, newest) if newest is not None else None
        if gimbal.is_ours and state.target is not None and vehicle is not None and camera is not None:
            gimbal, aim = gimbal.aimed(state.target, vehicle, camera, now_s, self._config.gimbal)
        self._change(gimbal=gimbal)
        return GimbalOrder(claim, aim)

    def _reference(self) -> RangeReference | None:
        """What makes a size a range: the target's true height where it is configured, else what engagement taught."""
        height_m = self._config.follow.target_height_m
        if height_m and self._camera is not None:
            return RangeReference(self._camera.focal_px * height_m, 1.0)
        return self._state.reference

    # ------------------------------------------------------------------------------- the operator
    def _from_transmitter(self, events: tuple[LinkEvent, ...], now_s: float) -> tuple[OperatorCommand, ...]:
        if not self._config.rc.switch_channel or not any(isinstance(event, RcChannels) for event in events):
            return ()
        switch = self._state.switch.after(self._state.vehicle.rc, self._config.rc, now_s)
        self._change(switch=switch)
        return switch.commands

    def _by_itself(self, now_s: float) -> tuple[OperatorCommand, ...]:
        """Engage where that is configured and nothing forbids it: once a selection, or by the switch that waits."""
        state = self._state
        has_switch = state.switch.is_on and state.vehicle.has_transmitter(now_s)  # what a lost one said counts no more
        is_waiting = state.mode is Mode.READY and state.is_switch_waiting and has_switch
        if is_waiting and self._is_external():
            return () if self._refusals(now_s) else (Engage(),)  # the pilot has done both: the switch, then OFFBOARD
        if not self._config.engage.auto or state.auto_done or state.mode is not Mode.TRACKING:
            return ()
        if not state.has_seen_other:  # this process began while the vehicle obeyed: nobody has selected that mode since
            return ()
        return () if self._refusals(now_s) else (Engage(),)

    def _obey(self, command: OperatorCommand, now_s: float, *, is_waiting: bool = False) -> None:
        """Obey an order; `is_waiting`: where the flight mode is missing, it stands until that is selected."""
        state = self._state
        match command:
            case Select():
                self._select(command, now_s)
            case Deselect():
                self._change(selection=Selection(state.selection.number + 1, None), sample=None, target=None)
                if state.mode.is_engaged:
                    self._say(Severity.WARNING, f"Follow ended: {Reason.DESELECTED.value}")
                self._event(Event.DESELECTED, is_optional=True)
            case Disengage():
                self._change(auto_done=True)
                if state.mode.is_engaged or state.mode is Mode.READY:
                    self._leave(Reason.OPERATOR, FlightMode.HOLD)
                elif self._is_external() and math.isfinite(state.abandoned_s):
                    self._request = FlightMode.HOLD
            case Engage():
                self._engage(now_s, is_waiting=is_waiting)
            case _:
                assert_never(command)

    def _select(self, command: Select, now_s: float) -> None:
        state, box = self._state, command.box
        if box is None:
            size_hw = state.size_hw
            if size_hw is None:
                self._say(Severity.WARNING, "Select refused: no frame yet")
                return
            side = self._config.select.centre_share * size_hw[0]
            box = Box((size_hw[1] - side) / 2, (size_hw[0] - side) / 2, side, side)
        if not _is_sane(box):
            self._say(Severity.WARNING, "Select refused: not a box")
            return
        self._change(
            selection=Selection(state.selection.number + 1, box, command.is_point),
            sample=None,
            measured_s=-math.inf,
            target=None,
            reference=None,
            aim=None,
            must_confirm=True,
            auto_done=False,
            chosen_s=now_s,
            awaiting_s=-math.inf,
        )
        if state.mode.is_engaged:  # it stands until the operator confirms what the tracker has made of the new box
            self._say(Severity.NOTICE, "New target selected: holding")
        if self._has_gimbal and state.gimbal.manager is None:
            self._say(Severity.WARNING, "No gimbal heard: target cannot be measured")
        self._event(Event.SELECTED, is_optional=True)

    def _engage(self, now_s: float, *, is_waiting: bool) -> None:
        state = self._state
        against = self._refusals(now_s)
        if state.mode is Mode.FOLLOWING:
            return
        if not against:
            self._begin(now_s)
        elif against == (Reason.WRONG_MODE,) and self._is_px4() and state.mode is Mode.TRACKING:
            # PX4 takes OFFBOARD only while setpoints flow: let zero ones flow until the pilot has selected it
            self._change(ready_until_s=now_s + READY_FOR_S, leave_for=FlightMode.HOLD, asked_s=-math.inf)
            self._change(is_switch_waiting=is_waiting)
            self._event(Event.PREPARE)
            then = "OFFBOARD starts following" if is_waiting else "select OFFBOARD, then engage"
            self._say(Severity.NOTICE, f"Ready: {then}")
        elif set(against) == {Reason.WRONG_MODE, Reason.RESUME_GUARD} and state.guard.heard is FlightMode.HOLD:
            # nowhere else: neither the sticks nor a way home that somebody chose are for us to end
            self._request = FlightMode.HOLD
            self._say(Severity.NOTICE, "Asked PX4 for Hold: engage again")
        else:
            self._say(Severity.WARNING, "Engage refused: " + ", ".join(reason.value for reason in against))

    def _begin(self, now_s: float) -> None:
        """Engage: nothing forbids it."""
        state = self._state
        target, local = state.target, state.vehicle.fresh_local(now_s)
        assert target is not None  # _refusals has looked
        assert local is not None
        if state.mode is not Mode.AWAITING or state.aim is None or state.reference is None:
            fix, box = target.fix, target.seen.box
            wanted_m = self._config.follow.range_m or (fix.range_m if fix is not None else None)
            vehicle = state.vehicle
            height_m, is_over_ground = vehicle.height_over_ground_m(now_s), vehicle.is_over_ground(now_s)
            aim = Aim(wanted_m, box.h, height_m, target.seen.depression_rad, is_over_ground)
            slant_m = fix.range_m / max(math.cos(target.seen.depression_rad), 0.05) if fix is not None else None
            self._change(aim=aim, reference=RangeReference(slant_m, box.h) if slant_m is not None else None)
        if state.mode is not Mode.AWAITING or state.engaged_at_ne_m is None:
            self._change(engaged_at_ne_m=local.pos_ned_m[:2])
        self._change(
            must_confirm=False,
            awaiting_s=-math.inf,
            moving=Moving(),
            auto_done=True,
            leave_for=FlightMode.HOLD,
            asked_s=-math.inf,
            hearing=Hearing(),
        )
        if not state.vehicle.has_height(now_s):
            self._say(Severity.WARNING, "No height over take-off: that of local frame")
        self._change(had_height=state.vehicle.has_height(now_s), abandoned_s=math.inf)
        if not state.vehicle.has_transmitter(now_s):
            self._say(Severity.WARNING, "No transmitter seen: no stick guard")
        self._say(Severity.NOTICE, f"Following ({self._config.follow.mode})")
        self._event(Event.ENGAGE)

    def _refusals(self, now_s: float) -> tuple[Reason, ...]:
        state = self._state
        return refusals(
            state.mode,
            state.selection,
            state.sample,
            self._steerable(now_s),
            state.vehicle,
            self._config,
            now_s,
            is_stick_moved=state.sticks.since_s is not None,
            has_resume_guard=state.guard.is_up,
        )

    # ------------------------------------------------------------------------------- the ladder
    def _ladder(self, now_s: float) -> None:
        """Climb the ladder of loss by the time since the target was last measured."""
        state, loss = self._state, self._config.loss
        if state.mode is Mode.READY and now_s > state.ready_until_s:
            self._say(Severity.WARNING, f"Not engaged: {Reason.OFFBOARD_NOT_SELECTED.value}")
            self._event(Event.EXPIRED)
        last_s = state.target.seen.time_s if state.target is not None else state.chosen_s
        lost_s = now_s - last_s
        if state.mode is Mode.COASTING and lost_s >= loss.hold_after_s:
            self._say(Severity.WARNING, "Target lost: holding")
            self._event(Event.HOLD_DUE)
        if self._state.mode in {Mode.COASTING, Mode.HOLDING, Mode.SEARCHING} and lost_s > loss.confirm_after_s:
            self._change(must_confirm=True)
        # a new one that nobody has confirmed has no aim, and is nothing to turn the vehicle for
        is_search_due = state.aim is not None and loss.search_after_s and lost_s >= loss.search_after_s
        if self._state.mode is Mode.HOLDING and is_search_due:
            self._event(Event.SEARCH_DUE)
        is_searching = self._state.mode in {Mode.HOLDING, Mode.SEARCHING} and lost_s >= loss.give_up_after_s
        is_waiting = self._state.mode is Mode.AWAITING and now_s - self._state.awaiting_s >= loss.give_up_after_s
        if is_searching or is_waiting:
            why = Reason.LOST_TOO_LONG if is_searching else Reason.NOT_CONFIRMED
            self._say(Severity.ERROR, f"Follow ended: {why.value}")
            self._change(leave_for=_MODE_OF[loss.on_give_up], asked_s=-math.inf)
            self._event(Event.GIVE_UP_DUE)

    # ------------------------------------------------------------------------------- guidance
    def _guide(self, now_s: float) -> tuple[Setpoint, tuple[str, ...]]:
        """What is wished in this mode, and why it is not more."""
        state, config = self._state, self._config
        attitude, local = state.vehicle.fresh_attitude(now_s), state.vehicle.fresh_local(now_s)
        if not state.mode.is_engaged:
            return ZERO, ()
        if attitude is None:
            return ZERO, (Reason.NO_ATTITUDE.value,)
        if local is None:
            return ZERO, (Reason.NO_POSITION.value,)
        if self._is_quiet(now_s):
            return ZERO, ("heartbeat late",)
        if state.mode is Mode.SEARCHING:
            return Setpoint((0.0, 0.0, 0.0), self._search_rate(now_s)), ("target lost, searching",)
        if state.mode is Mode.HOLDING:
            return ZERO, ("target lost, holding" if state.target is not None else "new target selected, holding",)
        if state.mode not in {Mode.FOLLOWING, Mode.COASTING} or state.target is None or state.aim is None:
            return ZERO, ("waiting for confirmation",)
        camera = self._steering_camera()
        mount_yaw_rad = camera.mount_rpy_rad[2]
        if state.mode is Mode.COASTING:
            rate_radps, _ = turn(state.target, attitude, mount_yaw_rad, now_s, state.moving, config.follow)
            is_turning = config.follow.mode != "overhead"
            return Setpoint((0.0, 0.0, 0.0), rate_radps if is_turning else 0.0), ("target unsure, coasting",)
        guided = self._law(state.target, state.aim, attitude, local, camera, now_s)
        self._change(moving=guided.moving)
        return guided.wish, tuple(caution.value for caution in guided.cautions)

    def _law(
        self,
        target: TargetEstimate,
        aim: Aim,
        attitude: Attitude,
        local: LocalState,
        camera: CameraModel,
        now_s: float,
    ) -> Guided:
        follow, moving = self._config.follow, self._state.moving
        if follow.mode == "spotlight":
            return spotlight(target, attitude, camera.mount_rpy_rad[2], now_s, moving, follow)
        if follow.mode == "follow":
            guided = follow_target(target, aim, attitude, local, camera, now_s, moving, follow)
            if self._has_gimbal:  # which keeps the target in view however the vehicle leans
                return guided
            sent = self._state.sent or stop()
            return kept_in_view(guided, target, sent.velocity_ned_mps[:2], now_s, self._since_sent_s(now_s), follow)
        height_m = self._state.vehicle.height_over_ground_m(now_s) or 0.0
        is_other = aim.is_over_ground is not self._state.vehicle.is_over_ground(now_s)
        if is_other or not self._is_height_known(now_s):
            # another source measures from another place: no climbing by the difference
            aim = replace(aim, height_m=None)
        return overhead(target, aim, local, height_m, now_s, moving, follow)

    def _steering_camera(self) -> CameraModel:
        """The camera as the law has it; one on a gimbal looks along the nose, and loses no target above its lower end.

        What the gimbal does meanwhile is its own affair: the nose would turn away from the target with it.
        """
        assert self._camera is not None  # a target has been measured
        if not self._has_gimbal:
            return self._camera
        manager = self._state.gimbal.manager
        lowest_rad = manager.pitch_range_rad[0] if manager is not None else LEAST_GIMBAL_PITCH_RAD
        return self._camera.mounted((0.0, lowest_rad, 0.0))

    def _search_rate(self, now_s: float) -> float:
        """Slow turn towards the side on which the target was last seen, rad/s; one turn, no more."""
        target, loss = self._state.target, self._config.loss
        rate_radps = math.radians(loss.search_yaw_rate_dps)
        if target is None or (now_s - target.seen.time_s - loss.search_after_s) * rate_radps > math.tau:
            return 0.0
        if self._config.follow.mode == "overhead":  # a camera that looks down sees the same ground all the way round
            return 0.0
        mount_yaw_rad = 0.0 if self._has_gimbal else math.radians(self._config.camera.mount_yaw_deg)
        aside_rad = wrapped(target.seen.azimuth_rad - mount_yaw_rad)
        return math.copysign(rate_radps, aside_rad)

    def _limited(self, wish: Setpoint, now_s: float) -> tuple[SafeSetpoint | None, tuple[str, ...]]:
        """The wish as it may be sent in this mode, and which edges of the envelope hold it back."""
        state, vehicle = self._state, self._state.vehicle
        if not state.mode.is_streaming:
            self._change(sent=None)
            return None, ()
        is_old = state.target is None or now_s - state.target.seen.time_s > MAX_PREDICTION_S
        is_moving = state.mode is Mode.SEARCHING or (state.mode in {Mode.FOLLOWING, Mode.COASTING} and not is_old)
        edges: tuple[str, ...] = ()
        local, start = vehicle.fresh_local(now_s), state.engaged_at_ne_m
        is_blind = vehicle.fresh_attitude(now_s) is None or self._is_quiet(now_s)
        if not is_moving or is_blind or local is None or start is None:
            safe = stop()
        else:
            height_m = vehicle.height_m(now_s) if self._is_height_known(now_s) else None
            place = Place(height_m, (local.pos_ned_m[0] - start[0], local.pos_ned_m[1] - start[1]))
            dt_s = self._since_sent_s(now_s)
            edges = held_back_by(wish, place, self._config.limits)
            safe = limit(wish, state.sent, place, self._config.limits, dt_s)
        if state.sent is None:  # the stream begins: there was nothing that could have left
            self._change(left_s=now_s)
        self._change(sent=safe, sent_s=now_s)
        return safe, edges

    def _ask(self, now_s: float) -> None:
        """While leaving, ask for another flight mode once a second."""
        state = self._state
        heartbeat, is_due = state.vehicle.heartbeat, now_s - state.asked_s >= REQUEST_EVERY_S
        # a heartbeat from before says nothing of what the pilot has selected since
        is_known = heartbeat is not None and heartbeat.time_s > state.asked_s
        if state.mode is Mode.LEAVING and self._is_external() and is_due and is_known:
            self._change(asked_s=now_s)
            self._request = state.leave_for
        # its time-out is longer than was thought: it still flies on by our last word
        is_abandoned = heartbeat is not None and heartbeat.time_s > state.abandoned_s + ABANDONED_S
        if is_abandoned and not self._is_external():
            self._change(abandoned_s=math.inf)
        elif is_abandoned and is_due and not state.mode.is_streaming:
            self._change(asked_s=now_s)
            self._request = FlightMode.HOLD

    def _expected(self, now_s: float) -> Expected | None:
        """Where the target should be in a frame taken now; None without an idea, or behind the camera."""
        state, attitude = self._state, self._attitudes.newest
        camera = self._camera_at(attitude) if attitude is not None else None
        if state.target is None or attitude is None or camera is None:
            return None
        local, height_m = state.vehicle.fresh_local(now_s), state.vehicle.height_over_ground_m(now_s)
        return expected(state.target, camera, attitude, local, height_m, now_s)

    # ------------------------------------------------------------------------------- small change
    def _is_external(self) -> bool:
        heartbeat = self._state.vehicle.heartbeat
        return heartbeat is not None and heartbeat.mode is FlightMode.EXTERNAL

    def _since_sent_s(self, now_s: float) -> float:
        """Since the last setpoint; before the first one, a period of the loop."""
        return now_s - self._state.sent_s if self._state.sent is not None else 1 / self._config.loop.rate_hz

    def _is_height_known(self, now_s: float) -> bool:
        """Whether the height comes from where it came from at engagement."""
        return self._state.vehicle.has_height(now_s) is self._state.had_height

    def _is_quiet(self, now_s: float) -> bool:
        heartbeat = self._state.vehicle.heartbeat
        return heartbeat is None or now_s - heartbeat.time_s > MAX_QUIET_S

    def _is_px4(self) -> bool:
        heartbeat = self._state.vehicle.heartbeat
        return heartbeat is not None and heartbeat.autopilot is Autopilot.PX4

    def _event(self, event: Event, *, is_optional: bool = False) -> None:
        """Change the mode; an optional event is one that means nothing in some modes."""
        mode = self._state.mode
        if is_optional and event not in TRANSITIONS[mode]:
            return
        self._change(mode=after(mode, event))

    def _change(self, **changes: object) -> None:
        self._state = replace(self._state, **changes)  # type: ignore[arg-type]  # names are those of _State

    def _say(self, severity: Severity, text: str) -> None:
        self._texts.append(Text(severity, text))


def _is_sane(box: Box) -> bool:
    return box.is_finite and box.w > 0 and box.h > 0


def _is_in_frame(box: Box, size_hw: tuple[int, int]) -> bool:
    """Whether a measured box can be one: its middle in the frame, at most twice the frame in size, and no speck."""
    (u, v), (height, width) = box.center_xy, size_hw
    is_inside = 0 <= u <= width and 0 <= v <= height
    return box.is_finite and is_inside and 0 < box.w <= 2 * width and 0 < box.h <= 2 * height and not is_speck(box)
