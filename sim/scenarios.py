"""The scenarios: who flies what, what happens to them, and what has to come of it.

A scenario is a stage, a configuration, a script of the operator's, the pilot's and fate's acts, and checks. Every
scenario flies with both autopilots. The checks look at the truth, not at what the application believes.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

from pymavlink.dialects.v20 import common as mavlink

from companion.config import Config, parse
from companion.follower import Step
from companion.modes import Mode
from companion.types import Disengage, Engage, OperatorCommand, Select
from sim.ardupilot import ArduCopter
from sim.autopilot import FakeAutopilot, Personality
from sim.camera import Truth
from sim.external import ExternalAutopilot
from sim.eyes import Eyes
from sim.loop import OUR_CLOCK_S, Faults, Loop, Watcher
from sim.px4 import Px4
from sim.stages import FORWARD_CAMERA, Stage, stage
from sim.trace import Trace
from sim.wind import CALM, Wind

AUTOPILOTS: dict[str, type[Personality]] = {"ardupilot": ArduCopter, "px4": Px4}
EXTERNAL_MODE: dict[type[Personality], str] = {ArduCopter: "GUIDED", Px4: "OFFBOARD"}
PILOT_MODE: dict[type[Personality], str] = {ArduCopter: "LOITER", Px4: "POSCTL"}
SELECT_S = 1.0
ENGAGE_S = 2.0
AGAIN_S = 1.0  # an operator who was refused tries again
SELECT_OFFBOARD_S = 1.3  # a pilot's reaction to "select OFFBOARD"
WAIT_S = 6.0  # until the target sets off: the longer of the two ways to engage, PX4's, takes that long
STATION = (255, 190)  # system and component of another station
STEADY_S = 16.0  # from here on a follower has settled


class Desk(Protocol):
    """What an operator, a pilot or fate has in hand; the loop in virtual time is one, a run in real time another."""

    commands: list[OperatorCommand]  # orders for the application
    faults: Faults

    @property
    def autopilot(self) -> FakeAutopilot | ExternalAutopilot: ...
    @property
    def personality(self) -> type[Personality]: ...
    @property
    def time_s(self) -> float: ...
    @property
    def mode(self) -> str: ...  # of the application
    @property
    def truth(self) -> Truth: ...  # of a frame taken now


@dataclass(frozen=True, slots=True)
class Act:
    """Something that happens at a time."""

    time_s: float
    name: str
    do: Callable[[Desk], None]


@dataclass(frozen=True, slots=True)
class Verdict:
    """What came of a check: a figure and its limits, infinite where there is none.

    unreached_s : when what it looks at would have begun, where the run was over before; None: it has begun.
    """

    name: str
    is_passed: bool
    value: float
    least: float
    most: float
    unit: str
    unreached_s: float | None = None

    @property
    def measured(self) -> str:
        """The figure for the eye; never rounded to the other side of a limit."""
        if self.unreached_s is not None:
            return f"not reached: begins at {self.unreached_s:g} s"
        if math.isnan(self.value):
            return "no figure"
        for digits in range(3, 12):
            text = f"{self.value:.{digits}g}"
            if (self.least <= float(text) <= self.most) is self.is_passed:
                break
        return f"{text} {self.unit}".strip()

    @property
    def wanted(self) -> str:
        """The limits for the eye."""
        ends = [f"at least {self.least:g}"] * math.isfinite(self.least)
        ends += [f"at most {self.most:g}"] * math.isfinite(self.most)
        return f"{' and '.join(ends)} {self.unit}".strip()


@dataclass(frozen=True, slots=True)
class Check:
    """A claim about a run: a figure of the trace from a time on, and its limits, in `unit`."""

    name: str
    unit: str
    figure: Callable[[Trace], float]
    least: float = -math.inf
    most: float = math.inf
    start_s: float = 0.0

    def judge(self, trace: Trace) -> Verdict:
        """Whether the figure lies within the limits; one that is not a number, or of nothing yet, does not."""
        if self.start_s > 0 and not trace.between(self.start_s):
            return Verdict(
                self.name,
                is_passed=False,
                value=math.nan,
                least=self.least,
                most=self.most,
                unit=self.unit,
                unreached_s=self.start_s,
            )
        value = self.figure(trace)
        is_passed = self.least <= value <= self.most
        return Verdict(self.name, is_passed, value, self.least, self.most, self.unit)


@dataclass(frozen=True, slots=True)
class Scenario:
    """A flight to be flown and judged."""

    name: str
    description: str
    stage: str
    duration_s: float
    checks: tuple[Check, ...]
    follow: str = "follow"
    settings: str = ""  # further TOML
    acts: tuple[Act, ...] = ()
    wind: Wind = CALM
    gain: Callable[[float], float] = lambda _: 1.0
    engage_s: float = ENGAGE_S  # from when on the operator wants to engage
    confirms: bool = False  # the operator confirms a target that was found again late
    engages: bool = True
    frame_hw: tuple[int, int] | None = None  # of the camera, which sees as wide as the stage's; None: the stage's own

    def place(self, seed: int) -> Stage:
        """Where it is flown; `seed` scatters what is of no account."""
        place = stage(self.stage, 7 + seed)
        if self.frame_hw is None:
            return place
        focal_px = place.camera.focal_px * self.frame_hw[1] / place.camera.size_hw[1]
        return replace(place, camera=replace(place.camera, size_hw=self.frame_hw, focal_px=focal_px))

    @property
    def moves_sticks(self) -> bool:
        """Whether it needs the pilot's transmitter."""
        return any(act.do is _sticks for act in self.acts)

    def config(self, place: Stage) -> Config:
        """Configuration of the application in this scenario."""
        camera = place.camera
        text = (
            f"[camera]\nwidth_px = {camera.size_hw[1]}\nheight_px = {camera.size_hw[0]}\n"
            f"focal_px = {camera.focal_px}\nmount_pitch_deg = {math.degrees(camera.mount_pitch_rad):.3f}\n"
            f'latency_ms = 20\n[follow]\nmode = "{self.follow}"\n'
            f"approach_gain_per_s = 0.5\nretreat_gain_per_s = 0.7\n{self.settings}"
            f'[control]\nsocket = ""\n'
        )
        return parse(text)


class Operator:
    """Selects the target, engages, selects OFFBOARD where PX4 waits for it; reacts to what the application says."""

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario
        self._has_selected = False
        self._asked_s = -math.inf
        self._ready_s: float | None = None
        self._has_engaged = False
        self._acts = list(scenario.acts)

    def act(self, desk: Desk) -> None:
        """Do what is due."""
        while self._acts and desk.time_s >= self._acts[0].time_s:
            self._acts.pop(0).do(desk)
        if not self._has_selected and desk.time_s >= SELECT_S:
            box = desk.truth.box
            if box is not None:
                self._has_selected = True
                desk.commands.append(Select(box))
        if self._scenario.engages:
            self._engage(desk)

    def _engage(self, desk: Desk) -> None:
        mode = Mode(desk.mode)
        if mode.is_engaged and mode is not Mode.AWAITING:
            self._has_engaged = True
        wants = mode is Mode.AWAITING and self._scenario.confirms
        if not self._has_engaged:
            wants = wants or (mode is Mode.TRACKING and desk.time_s >= self._scenario.engage_s)
            external = EXTERNAL_MODE[desk.personality]
            if mode is Mode.READY:
                self._ready_s = desk.time_s if self._ready_s is None else self._ready_s
                if desk.autopilot.mode_name == external:
                    wants = True
                elif desk.time_s - self._ready_s >= SELECT_OFFBOARD_S:
                    desk.autopilot.select_mode(external)
        if wants and desk.time_s - self._asked_s >= AGAIN_S:
            self._asked_s = desk.time_s
            desk.commands.append(Engage())


# ------------------------------------------------------------------------------------------------ figures
def _bearing_p95_deg(trace: Trace) -> float:
    errors = sorted(abs(m.bearing_error_rad) for m in trace.between(STEADY_S) if m.mode == "following")
    return math.degrees(errors[int(0.95 * (len(errors) - 1))]) if errors else math.nan


def _engaged_range_m(trace: Trace) -> float:
    first_s = trace.first("following")
    return trace.between(first_s)[0].true_range_m if first_s is not None else math.nan


def _worst_range_ratio(trace: Trace) -> float:
    """Largest deviation of the range from that at engagement, as a ratio of at least 1."""
    wanted_m = _engaged_range_m(trace)
    ratios = [m.true_range_m / wanted_m for m in trace.between(STEADY_S) if m.mode == "following"]
    return max((max(ratio, 1 / ratio) for ratio in ratios), default=math.nan)


def _following_share(trace: Trace) -> float:
    return trace.share("following", STEADY_S)


def _wrong_share(trace: Trace) -> float:
    """Share of the following moments in which the box is not on the target."""
    following = [m for m in trace.moments if m.mode == "following" and m.box is not None]
    return sum((m.iou or 0.0) < 0.1 for m in following) / max(len(following), 1)


def _top_setpoint_mps(trace: Trace) -> float:
    return max((math.hypot(*m.setpoint_ned_mps[:2]) for m in trace.moments if m.setpoint_ned_mps), default=0.0)


def _least_distance_m(trace: Trace) -> float:
    return min(math.dist(m.pose.pos_ned_m, m.target_ned_m) for m in trace.moments)


def _farthest_m(trace: Trace) -> float:
    """Farthest from where it was engaged that the vehicle was told to move; what stands may drift."""
    first_s = trace.first("following")
    if first_s is None:
        return math.nan
    flown = trace.between(first_s)
    told = [m for m in flown if any(m.setpoint_ned_mps or ())]
    return max((math.dist(m.pose.pos_ned_m[:2], flown[0].pose.pos_ned_m[:2]) for m in told), default=math.nan)


def _followed_to_m(trace: Trace) -> float:
    """True range of the last moment that was followed."""
    followed = [m for m in trace.moments if m.mode == "following"]
    return followed[-1].true_range_m if followed else math.nan


def _height_span_m(trace: Trace) -> float:
    heights = [m.height_m for m in trace.moments]
    return max(heights) - min(heights)


def _setpoints_outside(trace: Trace) -> float:
    """Setpoints that are not zero although the target may not move the vehicle."""
    moving = {"following", "coasting", "searching"}
    return sum(
        m.mode not in moving and m.setpoint_ned_mps is not None and (any(m.setpoint_ned_mps) or bool(m.yaw_rate_radps))
        for m in trace.moments
    )


def _seconds_in(mode: str) -> Callable[[Trace], float]:
    return lambda trace: trace.share(mode, 0.0) * (trace.moments[-1].time_s + 0.05)


def _ends_in(*modes: str) -> Callable[[Trace], float]:
    return lambda trace: float(trace.moments[-1].mode in modes)


def _ends_in_flight_mode(*modes: str) -> Callable[[Trace], float]:
    return lambda trace: float(trace.moments[-1].flight_mode in modes)


def _off_middle(start_s: float, end_s: float, quantile: float = 0.95) -> Callable[[Trace], float]:
    """How far the target is from the middle of the picture, as a share of its height; NaN where it is not in it."""

    def figure(trace: Trace) -> float:
        height, width = FORWARD_CAMERA.size_hw
        boxes = [m.truth for m in trace.between(start_s, end_s)]
        if not boxes or None in boxes:
            return math.nan
        off = sorted(math.dist(box.center_xy, (width / 2, height / 2)) / height for box in boxes if box is not None)
        return off[int(quantile * (len(off) - 1))]

    return figure


def _setpoints_before(time_s: float) -> Callable[[Trace], float]:
    return lambda trace: sum(m.setpoint_ned_mps is not None for m in trace.between(0.0, time_s))


def _moved_before(time_s: float) -> Callable[[Trace], float]:
    def figure(trace: Trace) -> float:
        start, *later = trace.between(0.0, time_s)
        return max(math.dist(start.pose.pos_ned_m, m.pose.pos_ned_m) for m in later)

    return figure


def _times_said(text: str) -> Callable[[Trace], float]:
    return lambda trace: sum(text in line for line in trace.texts)


def _streaming_after(time_s: float) -> Callable[[Trace], float]:
    return lambda trace: sum(m.setpoint_ned_mps is not None for m in trace.between(time_s))


def _speed_after(time_s: float) -> Callable[[Trace], float]:
    return lambda trace: max(m.speed_mps for m in trace.between(time_s))


def _said(text: str) -> Callable[[Trace], float]:
    return lambda trace: float(any(text in line for line in trace.texts))


def _lost_or_following(trace: Trace) -> float:
    """Whether the run ended well either way: no third thing is honest."""
    return float(trace.moments[-1].mode == "following" or any("Target lost" in text for text in trace.texts))


def _off_centre_m(trace: Trace) -> float:
    """95th percentile of the distance between the vehicle and the place above the target."""
    off = sorted(m.true_range_m for m in trace.between(STEADY_S) if m.mode == "following")
    return off[int(0.95 * (len(off) - 1))] if off else math.nan


SAFE = (
    Check("setpoints within the speed limit", "m/s", _top_setpoint_mps, most=10.0001),
    Check("setpoints that move while the target must not", "", _setpoints_outside, most=0),
)
KEEPS = (
    *SAFE,
    Check("time following, once settled", "", _following_share, least=0.97, start_s=STEADY_S),
    Check("box off the target while following", "", _wrong_share, most=0.02),
    Check("bearing error, 95 %", "deg", _bearing_p95_deg, most=8, start_s=STEADY_S),
    Check("range over that at engagement, worst", "", _worst_range_ratio, most=1.5, start_s=STEADY_S),
    Check("height changes by", "m", _height_span_m, most=2),
)
# who brakes for a car that stops raises the nose, and the box touches the frame's lower border for a moment
STOPS = tuple(replace(check, least=0.95) if check.figure is _following_share else check for check in KEEPS)
HIDES = (
    *SAFE,
    Check("time following, once settled", "", _following_share, least=0.75, start_s=STEADY_S),
    Check("box off the target while following", "", _wrong_share, most=0.03),
    Check("bearing error, 95 %", "deg", _bearing_p95_deg, most=10, start_s=STEADY_S),
    Check("follows at the end", "", _ends_in("following"), least=1),
)
_LIMITS = "[limits]\nspeed_mps = 10\nacceleration_mps2 = 2\nradius_m = 5000\n"


def _broken(**faults: bool) -> Callable[[Desk], None]:
    def do(desk: Desk) -> None:
        desk.faults = replace(desk.faults, **faults)

    return do


def _sticks(desk: Desk) -> None:
    desk.autopilot.set_sticks(roll=0.5)


def _pilot_mode(desk: Desk) -> None:
    desk.autopilot.select_mode(PILOT_MODE[desk.personality])


def _mode_back(desk: Desk) -> None:
    desk.autopilot.select_mode(EXTERNAL_MODE[desk.personality])


def _configured(system: int, component: int) -> Callable[[Desk], None]:
    """Another station asks for the gimbal's control, or gives it up."""

    def do(desk: Desk) -> None:
        station = mavlink.MAVLink(None, srcSystem=STATION[0], srcComponent=STATION[1])
        number = mavlink.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE
        message = mavlink.MAVLink_command_long_message(1, 1, number, 0, system, component, -1, -1, 0, 0, 0)
        desk.autopilot.receive(message.pack(station))

    return do


def _station_aims(pitch_rad: float, yaw_rad: float) -> Callable[[Desk], None]:
    """Another station turns the gimbal to a direction on earth, and leaves it there."""

    def do(desk: Desk) -> None:
        station = mavlink.MAVLink(None, srcSystem=STATION[0], srcComponent=STATION[1])
        flags = mavlink.GIMBAL_MANAGER_FLAGS_YAW_LOCK
        q = (
            math.cos(pitch_rad / 2) * math.cos(yaw_rad / 2),
            -math.sin(pitch_rad / 2) * math.sin(yaw_rad / 2),
            math.sin(pitch_rad / 2) * math.cos(yaw_rad / 2),
            math.cos(pitch_rad / 2) * math.sin(yaw_rad / 2),
        )
        message = mavlink.MAVLink_gimbal_manager_set_attitude_message(1, 1, flags, 0, q, *[math.nan] * 3)
        desk.autopilot.receive(message.pack(station))

    return do


def _select_again(desk: Desk) -> None:
    if desk.truth.box is not None:
        desk.commands.append(Select(desk.truth.box))


def _cloud(time_s: float) -> float:
    """Brightness as clouds and a turn into the sun change it."""
    return 1.0 + 0.25 * math.sin(0.35 * time_s) - 0.4 * math.exp(-(((time_s - 24.0) / 1.0) ** 4))


SCENARIOS: dict[str, Scenario] = {
    scenario.name: scenario
    for scenario in (
        Scenario("straight", "a car drives along a road", "straight", 45, KEEPS, settings=_LIMITS),
        Scenario("turning", "a car drives two wide bends", "turning", 70, KEEPS, settings=_LIMITS),
        Scenario(
            "sharp_turn",
            "a car turns at a crossing within 3 s and shows another side: the tracker must say that it is lost",
            "sharp_turns",
            45,
            (
                *SAFE,
                Check("box off the target while following", "", _wrong_share, most=0.03),
                Check("nearest the target came", "m", _least_distance_m, least=10),
                Check("says that it is lost, or follows at the end", "", _lost_or_following, least=1),
            ),
            settings=_LIMITS,
        ),
        Scenario("stop_and_go", "a car brakes, stands and goes on", "stop_and_go", 60, STOPS, settings=_LIMITS),
        Scenario("pedestrian", "a person walks", "pedestrian", 45, KEEPS, settings=_LIMITS),
        Scenario(
            "gusts",
            "a car in wind of 3 m/s with gusts",
            "straight",
            45,
            KEEPS,
            settings=_LIMITS,
            wind=Wind((-2.0, 2.2), gust_mps=1.0, seed=3),
        ),
        Scenario("exposure", "clouds and the sun in the lens", "straight", 45, KEEPS, settings=_LIMITS, gain=_cloud),
        Scenario(
            "occlusion",
            "a car passes under a viaduct, hidden for more than a second",
            "occluder",
            60,
            HIDES,
            settings=_LIMITS,
        ),
        Scenario(
            "long_occlusion",
            "a car stops under a viaduct for seconds: it is found again and confirmed by the operator, or given up",
            "long_occlusion",
            60,
            (
                *SAFE,
                Check("time holding, searching or waiting", "s", _seconds_in("holding"), least=0.5),
                Check("box off the target while following", "", _wrong_share, most=0.03),
                Check("says that it is lost, or follows at the end", "", _lost_or_following, least=1),
            ),
            settings=_LIMITS,
            confirms=True,
        ),
        Scenario(
            "distractors",
            "look-alikes meet, cross and overtake",
            "distractors",
            75,
            (
                *SAFE,
                Check("box off the target while following", "", _wrong_share, most=0.05),
                Check("bearing error, 95 %", "deg", _bearing_p95_deg, most=10, start_s=STEADY_S),
            ),
            settings=_LIMITS,
        ),
        Scenario(
            "overhead",
            "a camera that looks down keeps above a slow car",
            "overhead",
            45,
            (
                *SAFE,
                Check("time following, once settled", "", _following_share, least=0.97, start_s=STEADY_S),
                Check("off the place above the target, 95 %", "m", _off_centre_m, most=4, start_s=STEADY_S),
                Check("height changes by", "m", _height_span_m, most=2),
            ),
            follow="overhead",
            settings=_LIMITS,
        ),
        Scenario(
            "spotlight",
            "the drone stays and keeps its nose on a car that drives past",
            "passing",
            26,
            (
                *SAFE,
                Check("time following, once settled", "", _following_share, least=0.9, start_s=STEADY_S),
                Check("horizontal setpoint", "m/s", _top_setpoint_mps, most=0),
                Check("bearing error, 95 %", "deg", _bearing_p95_deg, most=8, start_s=STEADY_S),
            ),
            follow="spotlight",
            settings=_LIMITS,
        ),
        Scenario(
            "approach",
            "a car turns round and comes towards the drone",
            "approach",
            50,
            (*SAFE, Check("nearest the target came", "m", _least_distance_m, least=10)),
            settings=_LIMITS,
        ),
        Scenario(
            "departure",
            "a car drives off faster than the drone may follow: it ends at its radius, or gives up and holds",
            "departure",
            75,
            (
                *SAFE,
                Check("farthest from the engagement, told to move", "m", _farthest_m, least=50, most=151),
                Check("range up to which it believes the box, which is a speck by then", "m", _followed_to_m, most=270),
                Check("speed at the end", "m/s", _speed_after(74.0), most=0.7, start_s=74.0),
            ),
            settings=_LIMITS.replace("speed_mps = 10", "speed_mps = 6").replace("radius_m = 5000", "radius_m = 150"),
        ),
        Scenario(
            "sticks",
            "the pilot moves a stick in flight: the drone is handed over",
            "straight",
            35,
            (
                *SAFE,
                Check("setpoints more than 3 s after the stick", "", _streaming_after(23.0), most=0, start_s=23.0),
                Check("flown by the pilot at the end", "", _ends_in_flight_mode("LOITER", "POSCTL"), least=1),
                Check("says why", "", _said("sticks moved"), least=1),
            ),
            settings=_LIMITS,
            acts=(Act(20.0, "roll stick", _sticks),),
        ),
        Scenario(
            "mode_switch",
            "the pilot selects another flight mode and later ours again: nothing moves without a new engage",
            "straight",
            40,
            (
                *SAFE,
                Check("setpoints 1.3 s after the mode was left", "", _streaming_after(21.3), most=0, start_s=21.3),
                Check("says why", "", _said("flight mode left"), least=1),
            ),
            settings=_LIMITS,
            acts=(Act(20.0, "pilot's mode", _pilot_mode), Act(28.0, "our mode again", _mode_back)),
        ),
        Scenario(
            "camera_loss",
            "the camera is unplugged for two seconds in flight",
            "straight",
            45,
            (
                *SAFE,
                Check("time holding", "s", _seconds_in("holding"), least=0.5),
                Check("follows at the end", "", _ends_in("following"), least=1),
                Check("box off the target while following", "", _wrong_share, most=0.03),
            ),
            settings=_LIMITS,
            acts=(
                Act(20.0, "unplugged", _broken(is_camera_dead=True)),
                Act(22.0, "back", _broken(is_camera_dead=False)),
            ),
        ),
        Scenario(
            "camera_frozen",
            "the camera delivers one picture again and again for two seconds",
            "straight",
            45,
            (*SAFE, Check("nearest the target came", "m", _least_distance_m, least=10)),
            settings=_LIMITS,
            acts=(
                Act(20.0, "frozen", _broken(is_camera_frozen=True)),
                Act(22.0, "alive", _broken(is_camera_frozen=False)),
            ),
        ),
        Scenario(
            "link_loss",
            "the link is cut for five seconds in flight: the application does not resume by itself",
            "straight",
            45,
            (
                *SAFE,
                Check("speed after the autopilot's own time-out", "m/s", _speed_after(40.0), most=0.5, start_s=40.0),
                Check("setpoints after the link came back", "", _streaming_after(25.0), most=0, start_s=25.0),
            ),
            settings=_LIMITS,
            acts=(
                Act(20.0, "cut", _broken(is_link_cut=True)),
                Act(25.0, "back", _broken(is_link_cut=False)),
            ),
        ),
        Scenario(
            "disengage",
            "the operator disengages in flight: the drone holds",
            "straight",
            35,
            (
                *SAFE,
                Check("speed 8 s later", "m/s", _speed_after(28.0), most=0.7, start_s=28.0),
                Check("setpoints 4 s later", "", _streaming_after(24.0), most=0, start_s=24.0),
                Check("holds at the end", "", _ends_in_flight_mode("BRAKE", "AUTO.LOITER"), least=1),
            ),
            settings=_LIMITS,
            acts=(Act(20.0, "disengage", lambda desk: desk.commands.append(Disengage())),),
        ),
        Scenario(
            "gimbal",
            "a car drives past, nearly underneath: the gimbal follows it before anybody engages, another station takes "
            "the gimbal for a while, and gets it",
            "under",
            40,
            (
                *SAFE,
                Check(
                    "off the picture's middle before engaging, 95 %", "", _off_middle(4.0, 17.0), most=0.1, start_s=4.0
                ),
                Check("setpoints before engaging", "", _setpoints_before(17.0), most=0),
                Check("moved before engaging", "m", _moved_before(17.0), most=0.3),
                Check(
                    "off the middle in the other station's hands, least",
                    "",
                    _off_middle(25.5, 30.0, 0.0),
                    least=0.15,
                    start_s=25.5,
                ),
                Check("says once that it lets go", "", _times_said("Gimbal taken over"), least=1, most=1),
                Check(
                    "off the middle after another selection, 95 %", "", _off_middle(32.0, 40.0), most=0.1, start_s=32.0
                ),
                Check("horizontal setpoint", "m/s", _top_setpoint_mps, most=0),
                Check("follows at the end", "", _ends_in("following"), least=1),
            ),
            follow="spotlight",
            confirms=True,
            settings=_LIMITS + '[gimbal]\naxes = "pitch_yaw"\n',
            engage_s=17.0,
            acts=(
                Act(24.0, "another station takes the gimbal", _configured(*STATION)),
                Act(24.5, "and turns it", _station_aims(math.radians(-8.0), math.radians(-10.0))),
                Act(28.5, "gives it up", _configured(-3, -3)),
                Act(30.0, "selects again", _select_again),
            ),
        ),
    )
}
DEMO = "occlusion"


def fly(
    scenario: Scenario,
    autopilot: str,
    eyes_of: Callable[[Stage], Eyes],
    *,
    seed: int = 0,
    watcher: Watcher | None = None,
    recorder: Callable[[Step], None] | None = None,
    farewell: Callable[[float, Sequence[bytes]], None] | None = None,
) -> tuple[Trace, tuple[Verdict, ...]]:
    """Fly a scenario in virtual time, and judge it.

    Parameters
    ----------
    autopilot : a key of `AUTOPILOTS`.
    eyes_of : makes what the application sees with, for a stage.
    watcher : is shown every moment with the newest frame.
    recorder : is given every step of the application.
    farewell : is given the time of its last messages, and them.
    """
    place = scenario.place(seed)
    loop = Loop(
        place,
        AUTOPILOTS[autopilot],
        scenario.config(place),
        eyes_of(place),
        seed=seed,
        wind=scenario.wind,
        wait_s=WAIT_S,
        mode="GUIDED" if autopilot == "ardupilot" else None,
        gain=scenario.gain,
        watcher=watcher,
        recorder=recorder,
    )
    loop.run(scenario.duration_s, Operator(scenario).act)
    if farewell is not None:
        end_s = OUR_CLOCK_S + loop.time_s
        farewell(end_s, loop.follower.farewell(end_s))
    trace = Trace(tuple(loop.moments))
    return trace, tuple(check.judge(trace) for check in scenario.checks)
