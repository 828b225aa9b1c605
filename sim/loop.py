"""The closed loop in virtual time: world -> camera -> tracker -> controller -> MAVLink -> autopilot -> world.

Everything between the camera and the bytes is flight code; the two ends are simulated. Time is counted in ticks of
1/60 s: the camera takes a frame every second tick, the command loop steps every third, as 30 frames/s and
20 Hz do. The same arguments give the same run, to the bit.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from companion.config import Config
from companion.follower import Follower, Step
from companion.modes import Mode
from companion.types import OperatorCommand, Selection, TrackSample
from mscf.arrays import Image
from sim.autopilot import FakeAutopilot, Personality, Start
from sim.camera import Truth, observe
from sim.eyes import Exposure, Eyes, Sight
from sim.gimbal import Gimbal
from sim.stages import Stage
from sim.trace import Moment
from sim.wind import CALM, Wind
from sim.world import Pose

if TYPE_CHECKING:
    from mscf import Expected

TICKS_PER_S = 60
FRAME_TICKS = 2
CONTROL_TICKS = 3
RAMP_S = 3.0  # in which the world's movers come up to speed
OUR_CLOCK_S = 1000.0  # our clock's reading at the start: nobody may take it for the autopilot's
PROCESSING_S = 0.015  # of the tracker, on the vehicle

Watcher = Callable[[Moment, Image | None], None]


@dataclass(frozen=True, slots=True)
class Faults:
    """What is broken now."""

    is_camera_dead: bool = False
    is_camera_frozen: bool = False  # delivers the last picture again, with new stamps
    is_link_cut: bool = False  # nothing gets through, either way
    is_app_stopped: bool = False  # as by SIGSTOP


def world_time_s(time_s: float, wait_s: float) -> float:
    """Time of the world's movers, which set off after `wait_s` and come up to speed within `RAMP_S`."""
    since_s = max(time_s - wait_s, 0.0)
    if wait_s <= 0:
        return since_s
    return since_s**2 / (2 * RAMP_S) if since_s < RAMP_S else since_s - RAMP_S / 2


def gimbal_of(stage: Stage) -> Gimbal | None:
    """The gimbal of a stage's drone as it begins."""
    return Gimbal(stage.camera.mount_pitch_rad, stage.start.yaw_rad) if stage.has_gimbal else None


class Loop:
    """One vehicle, one application, one world.

    Parameters
    ----------
    stage, personality, config : who plays.
    eyes : what the application sees with.
    wait_s : for which the target and the traffic stand before they set off: an operator needs time.
    delay_s : from the exposure of a frame to the moment its sample reaches the command loop.
    telemetry_delay_s : by which the autopilot's messages come late.
    mode : of the autopilot at the start; None: as it flies without orders.
    gain : brightness of the picture at a time.
    watcher : is shown every moment with the newest frame.
    recorder : is given every step of the application.
    """

    def __init__(
        self,
        stage: Stage,
        personality: type[Personality],
        config: Config,
        eyes: Eyes,
        *,
        seed: int = 0,
        wind: Wind = CALM,
        wait_s: float = 0.0,
        delay_s: float | None = None,
        telemetry_delay_s: float = 0.0,
        mode: str | None = None,
        parameters: dict[str, float] | None = None,
        gain: Callable[[float], float] = lambda _: 1.0,
        watcher: Watcher | None = None,
        recorder: Callable[[Step], None] | None = None,
    ) -> None:
        self.stage = stage
        self.personality = personality
        self.autopilot = FakeAutopilot(
            personality,
            start=Start(pos_ned_m=stage.start.pos_ned_m, yaw_rad=stage.start.yaw_rad, mode=mode),
            seed=seed,
            wind=wind,
            parameters=parameters or {},
            gimbal=gimbal_of(stage),
        )
        self.follower = Follower(config)
        self.faults = Faults()
        self.commands: list[OperatorCommand] = []  # given by the operator, taken by the next step
        self.moments: list[Moment] = []
        self.step: Step | None = None  # the last one
        self._config = config
        self._eyes = eyes
        self._latency_s = config.camera.latency_ms / 1000
        self._delay_s = self._latency_s + PROCESSING_S if delay_s is None else delay_s
        self._telemetry_delay_s = telemetry_delay_s
        self._wait_s = wait_s
        self._gain = gain
        self._watcher = watcher
        self._recorder = recorder
        self._tick = 0
        self._seq = 0
        self._under_way: deque[tuple[float, Sight]] = deque()  # samples and when they arrive
        self._arrived: Sight | None = None
        self._telemetry: deque[tuple[float, bytes]] = deque()
        self._selection = Selection(0, None)
        self._expected: Expected | None = None
        self._exposure: Exposure | None = None

    @property
    def time_s(self) -> float:
        """Virtual time since the start."""
        return self._tick / TICKS_PER_S

    @property
    def mode(self) -> str:
        """Mode of the application after its last step."""
        return self.step.control.mode.value if self.step is not None else Mode.IDLE.value

    @property
    def world_s(self) -> float:
        """Time of the world's movers."""
        return world_time_s(self.time_s, self._wait_s)

    @property
    def truth(self) -> Truth:
        """Truth of a frame taken now."""
        return observe(self.stage.world, self.stage.carried_camera, self.autopilot.camera_pose, self.world_s)

    def run(self, until_s: float, act: Callable[["Loop"], None] | None = None) -> None:
        """Go on until a time; `act` is called before every step of the command loop."""
        while self.time_s < until_s:
            if act is not None and self._tick % CONTROL_TICKS == 0:
                act(self)
            self.tick()

    def tick(self) -> None:
        """One tick of everything."""
        now_s = self.time_s
        data = self.autopilot.step(1 / TICKS_PER_S)
        if not self.faults.is_link_cut:
            self._telemetry.append((now_s + self._telemetry_delay_s, data))
        if self._tick % FRAME_TICKS == 0 and not self.faults.is_camera_dead and not self.faults.is_app_stopped:
            self._expose(now_s)
        while self._under_way and self._under_way[0][0] <= now_s + 1e-9:
            self._arrived = self._under_way.popleft()[1]
        if self._tick % CONTROL_TICKS == 0 and not self.faults.is_app_stopped:
            self._control(now_s)
        self._tick += 1

    def _expose(self, now_s: float) -> None:
        pose = self.autopilot.camera_pose
        exposure = Exposure(self._seq, now_s, self.world_s, pose, self._pose_at_close(pose), self._gain(now_s))
        captured_s = OUR_CLOCK_S + now_s + self._latency_s
        if self.faults.is_camera_frozen and self._exposure is not None:
            exposure = replace(self._exposure, seq=self._seq)
        self._exposure = exposure
        self._seq += 1
        sight = self._eyes.see(exposure, captured_s, self._selection, self._expected)
        sample = replace(sight.sample, finished_s=captured_s + PROCESSING_S)
        self._under_way.append((now_s + self._delay_s, replace(sight, sample=sample)))

    def _pose_at_close(self, pose: Pose) -> Pose:
        """The camera's pose when the shutter closes, by the vehicle's speed and its own rates."""
        autopilot = self.autopilot
        return pose.moved(self.stage.camera.exposure_s, autopilot.velocity_ned_mps, *autopilot.camera_rates_radps)

    def _control(self, now_s: float) -> None:
        data = b""
        while self._telemetry and self._telemetry[0][0] <= now_s + 1e-9:
            data += self._telemetry.popleft()[1]
        sample = self._arrived.sample if self._arrived is not None else None
        commands, self.commands = tuple(self.commands), []
        step = self.follower.step(OUR_CLOCK_S + now_s, data, sample, commands)
        self.step = step
        if self._recorder is not None:
            self._recorder(step)
        self._selection = step.control.selection
        self._expected = step.control.expected
        if not self.faults.is_link_cut:
            self.autopilot.receive(step.data)
        moment = self._moment(now_s, step, sample)
        self.moments.append(moment)
        if self._watcher is not None:
            self._watcher(moment, self._arrived.image if self._arrived is not None else None)

    def _moment(self, now_s: float, step: Step, sample: TrackSample | None) -> Moment:
        control, autopilot = step.control, self.autopilot
        truth = self._arrived.truth if self._arrived is not None else Truth(None, 0.0)
        setpoint, target = control.setpoint, control.target
        return Moment(
            now_s,
            control.mode.value,
            autopilot.mode_name,
            autopilot.is_armed,
            autopilot.pose,
            autopilot.velocity_ned_mps,
            self.stage.target.motion.pose(self.world_s).pos_ned_m,
            sample.box if sample is not None else None,
            truth.box,
            truth.visible_share,
            sample.status.name.lower() if sample is not None and sample.status is not None else "none",
            sample.confidence if sample is not None else 0.0,
            sample.threat if sample is not None else 0.0,
            OUR_CLOCK_S + now_s - sample.captured_s if sample is not None else None,
            setpoint.velocity_ned_mps if setpoint is not None else None,
            setpoint.yaw_rate_radps if setpoint is not None else None,
            target.fix.range_m if target is not None and target.fix is not None else None,
            control.notes,
            tuple(text.text for text in step.texts),
        )
