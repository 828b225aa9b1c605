"""What QGroundControl would show: its own sequence of messages, replayed against the application in the closed loop.

The sequence is that of QGroundControl 4.4 to 5.0, from its sources: `VehicleCameraControl` asks for the camera as soon
as its heartbeat comes; the rest follows at fixed times. A message that does not come within a second is asked for
again, by turns in the old way and in the new. A command whose answer does not come is sent again after three seconds,
with a higher confirmation.

It asks for the tracking status (511) after every track command only since pull request 13332, of August 2025.
"""

import math
from collections.abc import Callable
from io import BytesIO
from typing import TYPE_CHECKING, Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from companion.config import parse
from mscf import Box
from sim.eyes import TrueEyes
from sim.loop import Loop
from sim.scenarios import AUTOPILOTS, SCENARIOS, Operator
from sim.stages import stage

if TYPE_CHECKING:
    from companion.follower import Step

AGAIN_S = 3.0  # without an acknowledgement
TRIES = 3
INFORMATION_S = 1.0  # in which a message has to come
STORAGE_S, CAPTURE_S = 2.5, 2.75  # after the camera's information
DRAWING_US = 500_000
CLICK_PX = 20  # radius of a click on the displayed video
STREAM = 'stream_uri = "rtsp://10.0.0.2:8554/video"\n'
TRACK_POINT, TRACK_RECTANGLE, STOP_TRACKING, SET_INTERVAL, REQUEST = 2004, 2005, 2010, 511, 512
INFORMATION, SETTINGS, STORAGE, CAPTURE, STREAM_INFORMATION, STREAM_STATUS = 259, 260, 261, 262, 269, 270
IMAGE_STATUS = 275
MESSAGES = {
    "CAMERA_SETTINGS": SETTINGS,
    "STORAGE_INFORMATION": STORAGE,
    "CAMERA_CAPTURE_STATUS": CAPTURE,
    "VIDEO_STREAM_INFORMATION": STREAM_INFORMATION,
    "VIDEO_STREAM_STATUS": STREAM_STATUS,
}
# command and parameters: of which storage and stream, and that it is asked
OLD_REQUESTS: dict[int, tuple[int, ...]] = {
    SETTINGS: (522, 1),
    STORAGE: (525, 0, 1),
    CAPTURE: (527, 1),
    STREAM_INFORMATION: (2504, 1),
    STREAM_STATUS: (2505, 1),
}
IN_PROGRESS = 5
ANSWER_S = 0.2  # for a track command to be answered for good
ABOUT = (SET_INTERVAL, REQUEST)  # whose first parameter names a message
STANDS_S = 1000.0  # for so long does the target stand: longer than any flight here


class QGroundControl:
    """Its camera code and its screen, which shows the video undistorted, a pixel of the frame by a pixel.

    deaf_to : messages of these kinds get lost on their way here, so many times.
    asks_for_status : after every track command; older ones do not.
    """

    def __init__(self, system_id: int = 255) -> None:
        self.heard: list[tuple[float, Any]] = []  # of the camera
        self.sent: list[tuple[float, Any]] = []
        self.camera: Any = None  # CAMERA_INFORMATION
        self.results: list[tuple[int, int]] = []  # command and result
        self.deaf_to: dict[str, int] = {}
        self.asks_for_status = True
        self.is_tracking_enabled = False
        self._status: Any = None
        self._out = mavlink.MAVLink(BytesIO(), srcSystem=system_id, srcComponent=190)
        self._in = mavlink.MAVLink(BytesIO())
        # by command and the message that it is about: when it is sent again, tries, parameters
        self._waiting: dict[tuple[int, float], tuple[float, int, tuple[float, ...]]] = {}
        self._later: list[tuple[float, int]] = []  # messages to be asked for
        self._missing: dict[int, tuple[float, int]] = {}  # when they are asked for again, and how often they were
        self._asked_s = math.inf
        self._asked = 0
        self._packets: list[bytes] = []
        self._now_s = 0.0

    # ------------------------------------------------------------------------------------ what it shows
    @property
    def has_tracking_button(self) -> bool:
        return self.camera is not None and bool(self.camera.flags & (512 | 1024))

    @property
    def status(self) -> int:
        return self._status.tracking_status if self._status is not None else 0

    def box(self, *, is_old: bool = True) -> Box | None:
        """The box on the screen; an old version draws it where the status is 1 and nothing else."""
        said = self._status
        if said is None or not self.is_tracking_enabled or said.tracking_status == 0:
            return None
        if is_old and said.tracking_status != 1:
            return None
        width, height = self.camera.resolution_h, self.camera.resolution_v
        if said.tracking_mode == 2:
            left, top, right, bottom = said.rec_top_x, said.rec_top_y, said.rec_bottom_x, said.rec_bottom_y
            box = Box(left * width, top * height, (right - left) * width, (bottom - top) * height)
        else:
            half = (0.05 if not said.radius > 0 else said.radius) * width
            box = Box(said.point_x * width - half, said.point_y * height - half, 2 * half, 2 * half)
        return box if box.is_finite else None

    # ------------------------------------------------------------------------------------ what its operator does
    def drag(self, box: Box) -> None:
        width, height = self.camera.resolution_h, self.camera.resolution_v
        shares = (box.x / width, box.y / height, (box.x + box.w) / width, (box.y + box.h) / height)
        self._track(TRACK_RECTANGLE, *shares)

    def click(self, u: float, v: float) -> None:
        width, height = self.camera.resolution_h, self.camera.resolution_v
        self._track(TRACK_POINT, u / width, v / height, CLICK_PX / width)

    def stop(self) -> None:
        self._command(STOP_TRACKING)
        self._command(SET_INTERVAL, IMAGE_STATUS, -1)

    def ask_stream_status(self) -> None:
        """As it does when a stream is chosen."""
        self._ask(STREAM_STATUS)

    def _track(self, command: int, *params: float) -> None:
        self.is_tracking_enabled = True
        self._command(command, *params)
        if self.asks_for_status:
            self._command(SET_INTERVAL, IMAGE_STATUS, DRAWING_US)

    # ------------------------------------------------------------------------------------ the link
    def said(self, now_s: float) -> bytes:
        """Bytes for the vehicle: what is due by now."""
        self._now_s = now_s
        if self.camera is None and now_s - self._asked_s >= INFORMATION_S:
            self._ask_information()
        while self._later and self._later[0][0] <= now_s:
            self._ask(self._later.pop(0)[1])
        for number, (due_s, _) in [*self._missing.items()]:
            if now_s >= due_s:
                self._ask(number)
        for (command, about), (due_s, tries, params) in [*self._waiting.items()]:
            if now_s >= due_s:
                assert tries < TRIES, f"no answer to {command} {about:g}"
                self._send(command, tries, params)
        data, self._packets = b"".join(self._packets), []
        return data

    def hear(self, data: bytes, now_s: float) -> None:
        self._now_s = now_s
        for message in self._in.parse_buffer(data) or []:
            kind = message.get_type()
            if message.get_srcComponent() != 100:  # others are no camera for it
                continue
            if self.deaf_to.get(kind):
                self.deaf_to[kind] -= 1
                continue
            self.heard.append((now_s, message))
            self._missing.pop(MESSAGES.get(kind, 0), None)
            if kind == "HEARTBEAT" and math.isinf(self._asked_s):
                self._ask_information()
            elif kind == "COMMAND_ACK" and message.target_system == self._out.srcSystem:
                for key in [key for key in self._waiting if key[0] == message.command][:1]:
                    del self._waiting[key]
                self.results.append((message.command, message.result))
            elif kind == "CAMERA_INFORMATION" and self.camera is None:
                self._learn(message)
            elif kind == "CAMERA_TRACKING_IMAGE_STATUS":
                self._status = message

    def of(self, kind: str) -> list[tuple[float, Any]]:
        return [(time_s, message) for time_s, message in self.heard if message.get_type() == kind]

    def commands(self) -> list[tuple[int, float]]:
        """What was sent: the command, and the message that it is about or 0."""
        return [(m.command, m.param1 if m.command in ABOUT else 0) for _, m in self.sent]

    def answer_delays_s(self, command: int) -> list[float]:
        """From every command of a kind to its last answer."""
        sent_s = [time_s for time_s, m in self.sent if m.command == command]
        answers = [(time_s, m) for time_s, m in self.of("COMMAND_ACK") if m.command == command]
        answered_s = [time_s for time_s, m in answers if m.result != IN_PROGRESS]
        return [late - early for early, late in zip(sent_s, answered_s, strict=True)]

    def _ask(self, number: int) -> None:
        _, asked = self._missing.get(number, (0.0, 0))
        self._missing[number] = (self._now_s + INFORMATION_S, asked + 1)
        self._command(*(REQUEST, number) if asked % 2 == 0 else OLD_REQUESTS[number])

    def _ask_information(self) -> None:
        self._asked_s = self._now_s
        self._waiting.clear()
        is_new = self._asked % 2 == 0
        self._asked += 1
        self._command(*(REQUEST, INFORMATION) if is_new else (521, 1))

    def _learn(self, information: Any) -> None:
        self.camera = information
        now_s = self._now_s
        self._later += [(now_s, SETTINGS)] + [(now_s, STREAM_INFORMATION)] * bool(information.flags & 256)
        self._later += [(now_s + STORAGE_S, STORAGE), (now_s + CAPTURE_S, CAPTURE)]

    def _command(self, command: int, *params: float) -> None:
        self._send(command, 0, params)

    def _send(self, command: int, tries: int, params: tuple[float, ...]) -> None:
        about = params[0] if command in ABOUT else 0.0
        self._waiting[command, about] = (self._now_s + AGAIN_S, tries + 1, params)
        padded = (*params, *[0.0] * 7)[:7]
        message = mavlink.MAVLink_command_long_message(1, 100, command, tries, *padded)
        self.sent.append((self._now_s, message))
        self._packets.append(bytes(message.pack(self._out)))


Act = tuple[float, Callable[[QGroundControl, Box], None]]  # a time, and what the operator does to the target's box


class Flight:
    """The closed loop with a ground station on the application's link.

    `screens` are, for every step, the time, the box on the screen, the true one and how much of the target is visible.
    """

    def __init__(self, scenario: str, autopilot: str, ground: str = "", system_id: int = 255) -> None:
        self.scenario = SCENARIOS[scenario]
        place = stage(self.scenario.stage, 7)
        base = self.scenario.config(place)
        camera, follow = base.camera, base.follow
        config = parse(
            f"[camera]\nwidth_px = {camera.width_px}\nheight_px = {camera.height_px}\nfocal_px = {camera.focal_px}\n"
            f"mount_pitch_deg = {camera.mount_pitch_deg}\nlatency_ms = 20\n"
            f'[follow]\nmode = "{follow.mode}"\napproach_gain_per_s = 0.5\nretreat_gain_per_s = 0.7\n'
            f"[limits]\nspeed_mps = 8\nfloor_m = 3\nradius_m = 2000\n[ground]\n{ground}"
        )
        self.qgc = QGroundControl(system_id)
        self.screens: list[tuple[float, Box | None, Box | None, float]] = []
        self.steps: list[Step] = []
        self._place, self._autopilot, self._config = place, autopilot, config

    def fly(self, until_s: float, acts: list[Act], *, wait_s: float = STANDS_S, engages: bool = False) -> "Flight":
        operator = Operator(self.scenario)
        operator._has_selected = True  # by the ground station
        loop = Loop(
            self._place,
            AUTOPILOTS[self._autopilot],
            self._config,
            TrueEyes(self._place, 7),
            seed=7,
            wait_s=wait_s,
            mode="GUIDED" if self._autopilot == "ardupilot" else None,
            recorder=self.steps.append,
        )
        acts = [*acts]

        def act(loop: Loop) -> None:
            if loop.step is not None:
                self.qgc.hear(loop.step.data, loop.time_s)
                last = loop.moments[-1]
                self.screens.append((loop.time_s, self.qgc.box(), last.truth, last.visible_share))
            if engages:
                operator.act(loop)
            while acts and loop.time_s >= acts[0][0]:
                box = loop.truth.box
                assert box is not None
                acts.pop(0)[1](self.qgc, box)
            loop._telemetry.append((loop.time_s, self.qgc.said(loop.time_s)))

        loop.run(until_s, act)
        return self

    def drawn(self, from_s: float, to_s: float) -> list[Box | None]:
        return [box for time_s, box, _, _ in self.screens if from_s <= time_s < to_s]

    def overlaps(self, from_s: float, to_s: float) -> list[float]:
        """IoU of what is drawn with the truth."""
        pairs = [(box, truth) for time_s, box, truth, _ in self.screens if from_s <= time_s < to_s]
        return [box.iou(truth) if box is not None and truth is not None else 0.0 for box, truth in pairs]


def drag(qgc: QGroundControl, box: Box) -> None:
    qgc.drag(box)


def click(qgc: QGroundControl, box: Box) -> None:
    qgc.click(*box.center_xy)


def stop(qgc: QGroundControl, _: Box) -> None:
    qgc.stop()


both = pytest.mark.parametrize("autopilot", AUTOPILOTS)


@both
def test_the_whole_sequence_is_answered_and_the_box_is_on_the_target_until_it_is_stopped(autopilot: str) -> None:
    flight = Flight("straight", autopilot, STREAM).fly(14.0, [(4.0, click), (7.0, drag), (10.0, stop)])
    qgc = flight.qgc
    assert qgc.has_tracking_button
    assert qgc.commands() == [
        *((REQUEST, INFORMATION), (REQUEST, SETTINGS), (REQUEST, STREAM_INFORMATION)),
        *((REQUEST, STORAGE), (REQUEST, CAPTURE)),
        *((TRACK_POINT, 0), (SET_INTERVAL, IMAGE_STATUS)),
        *((TRACK_RECTANGLE, 0), (SET_INTERVAL, IMAGE_STATUS)),
        *((STOP_TRACKING, 0), (SET_INTERVAL, IMAGE_STATUS)),
    ]
    assert all(result == 0 for _, result in qgc.results)
    assert sorted(number for number, _ in qgc.results) == sorted(number for number, _ in qgc.commands())
    kinds = {message.get_type() for _, message in qgc.heard}
    assert kinds >= {"CAMERA_SETTINGS", "VIDEO_STREAM_INFORMATION", "STORAGE_INFORMATION", "CAMERA_CAPTURE_STATUS"}
    # a click shows a square as large as the target around its middle, a drag its very box
    assert not any(flight.drawn(0, 4.0))
    assert min(flight.overlaps(4.2, 7.0)) > 0.5
    assert min(flight.overlaps(7.2, 10.0)) > 0.7
    assert not any(flight.drawn(10.1, 14.0))
    assert qgc.status == 0


@both
def test_every_answer_comes_before_what_was_asked_for(autopilot: str) -> None:
    qgc = Flight("straight", autopilot, STREAM).fly(4.0, []).qgc
    answers = [message.get_type() for _, message in qgc.heard if message.get_type() != "HEARTBEAT"]
    assert answers[0::2] == ["COMMAND_ACK"] * 5
    assert answers[1::2] == [
        "CAMERA_INFORMATION",
        "CAMERA_SETTINGS",
        "VIDEO_STREAM_INFORMATION",
        "STORAGE_INFORMATION",
        "CAMERA_CAPTURE_STATUS",
    ]


@both
def test_an_information_that_is_lost_is_had_in_the_old_way(autopilot: str) -> None:
    flight = Flight("straight", autopilot)
    flight.qgc.deaf_to = {"CAMERA_INFORMATION": 1}
    flight.fly(3.0, [])
    assert flight.qgc.has_tracking_button
    assert [number for number, _ in flight.qgc.commands()][:2] == [REQUEST, 521]
    assert not flight.qgc.camera.flags & 256  # no stream was configured
    assert not flight.qgc.of("VIDEO_STREAM_INFORMATION")


@both
def test_what_is_lost_is_had_in_the_old_way(autopilot: str) -> None:
    flight = Flight("straight", autopilot, STREAM)
    flight.qgc.deaf_to = dict.fromkeys(MESSAGES, 1)
    qgc = flight.fly(8.0, [(5.5, lambda qgc, _: qgc.ask_stream_status())]).qgc
    assert qgc.commands() == [
        *((REQUEST, INFORMATION), (REQUEST, SETTINGS), (REQUEST, STREAM_INFORMATION), (522, 0), (2504, 0)),
        *((REQUEST, STORAGE), (REQUEST, CAPTURE), (525, 0), (527, 0)),
        *((REQUEST, STREAM_STATUS), (2505, 0)),
    ]
    assert qgc.results == [(number, 0) for number, _ in qgc.commands()]
    kinds = [message.get_type() for _, message in qgc.heard if message.get_type() in MESSAGES]
    assert kinds == [
        *("CAMERA_SETTINGS", "VIDEO_STREAM_INFORMATION", "STORAGE_INFORMATION", "CAMERA_CAPTURE_STATUS"),
        "VIDEO_STREAM_STATUS",
    ]


@both
def test_a_track_command_is_answered_for_good_within_200_ms(autopilot: str) -> None:
    qgc = Flight("straight", autopilot).fly(7.0, [(3.0, click), (4.0, drag), (5.51, click), (6.02, drag)]).qgc
    for command in (TRACK_POINT, TRACK_RECTANGLE):
        delays_s = qgc.answer_delays_s(command)
        assert len(delays_s) == 2
        assert 0 < max(delays_s) <= ANSWER_S + 1e-9
    assert {result for number, result in qgc.results if number in {TRACK_POINT, TRACK_RECTANGLE}} == {0}


@both
def test_a_station_that_does_not_ask_for_the_status_is_told_its_changes_and_nothing_else(autopilot: str) -> None:
    flight = Flight("straight", autopilot)
    flight.qgc.asks_for_status = False
    qgc = flight.fly(10.0, [(3.0, drag), (5.0, click), (8.0, stop)]).qgc
    said = qgc.of("CAMERA_TRACKING_IMAGE_STATUS")
    assert [message.tracking_status for _, message in said] == [1, 0, 1, 0]
    # begun on what was dragged, taken from it and begun on what was clicked, stopped
    assert [time_s for time_s, _ in said] == pytest.approx([3.1, 5.05, 5.1, 8.05], abs=0.101)
    assert qgc.commands().count((SET_INTERVAL, IMAGE_STATUS)) == 1  # of stopping


@both
def test_the_status_comes_twice_a_second_while_it_is_drawn_and_not_at_all_before_and_after(autopilot: str) -> None:
    qgc = Flight("straight", autopilot).fly(12.0, [(3.0, drag), (8.0, stop)]).qgc
    times_s = [time_s for time_s, _ in qgc.of("CAMERA_TRACKING_IMAGE_STATUS")]
    assert 3.0 < times_s[0] < 3.3
    assert len([t for t in times_s if t < 8.0]) == pytest.approx(10, abs=2)
    assert [t for t in times_s if t >= 8.0] == pytest.approx([8.05], abs=0.051)  # that it has ended


@both
def test_a_lost_answer_is_given_again_and_the_target_is_not_selected_anew(autopilot: str) -> None:
    flight = Flight("straight", autopilot)

    def drag_unheard(qgc: QGroundControl, box: Box) -> None:
        qgc.deaf_to = {"COMMAND_ACK": 2}  # of the rectangle and of the interval
        qgc.drag(box)

    flight.fly(9.0, [(3.0, drag_unheard)])
    qgc = flight.qgc
    sent = [(round(time_s, 1), m.command, m.confirmation) for time_s, m in qgc.sent if m.command != REQUEST]
    assert sent == [
        (3.0, TRACK_RECTANGLE, 0),
        (3.0, SET_INTERVAL, 0),
        (6.0, TRACK_RECTANGLE, 1),
        (6.0, SET_INTERVAL, 1),
    ]
    assert qgc.results[-2:] == [(TRACK_RECTANGLE, 0), (SET_INTERVAL, 0)]
    assert {step.control.selection.number for step in flight.steps} == {0, 1}
    assert min(flight.overlaps(3.2, 9.0)) > 0.7


@both
def test_a_station_that_may_not_select_sees_the_camera_and_changes_nothing(autopilot: str) -> None:
    flight = Flight("straight", autopilot, system_id=250).fly(6.0, [(3.0, drag), (4.0, click)])
    assert flight.qgc.has_tracking_button
    assert [(n, r) for n, r in flight.qgc.results if n != REQUEST] == [
        *((TRACK_RECTANGLE, 2), (SET_INTERVAL, 0), (TRACK_POINT, 2), (SET_INTERVAL, 0))
    ]
    assert not any(flight.drawn(0, 6.0))
    assert {step.control.selection.number for step in flight.steps} == {0}


@both
def test_a_target_that_is_hidden_is_not_drawn_and_one_that_is_followed_is(autopilot: str) -> None:
    """The screen of an operator who follows a car under a viaduct."""
    flight = Flight("occlusion", autopilot).fly(27.0, [(1.0, drag)], wait_s=6.0, engages=True)
    modes = {step.control.mode.value for step in flight.steps}
    assert "following" in modes
    later = [screen for screen in flight.screens if screen[0] > 1.5]
    hidden = [box for _, box, _, share in later if share < 0.5]
    seen = [box for _, box, _, share in later if share >= 0.5]
    assert len(hidden) > 20
    assert not any(hidden)
    assert all(seen)
    # between two messages, half a second apart, the camera moves on under the drawn box
    fresh_s = {time_s for time_s, _ in flight.qgc.of("CAMERA_TRACKING_IMAGE_STATUS")}
    overlaps = [box.iou(truth) for time_s, box, truth, _ in later if time_s in fresh_s and box and truth]
    assert len(overlaps) > 40
    assert min(overlaps) > 0.75
    said = flight.qgc.of("CAMERA_TRACKING_IMAGE_STATUS")
    assert {message.tracking_status for time_s, message in said if time_s > 1.5} == {1, 2}
