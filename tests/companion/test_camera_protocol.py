"""The camera component against a ground station of its own pymavlink, with the real controller between them."""

import math
from collections.abc import Iterable
from dataclasses import replace
from functools import cache
from io import BytesIO
from typing import Any

import numpy as np
import pytest
from cockpit import AHEAD, FOLLOW, SIZE_HW
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from companion.camera_model import CameraModel, product, quaternion, rotation, rotation_of
from companion.camera_protocol import POINT_RADIUS, CameraProtocol, firmware_number, stream_address
from companion.config import parse
from companion.controller import Controller, ControlOutput
from companion.geo_place import METRES_PER_DEG, VEHICLE_SIGMA_M
from companion.target import RangeFix, RangeReference, measure, range_fix, range_from_above
from companion.types import (
    Attitude,
    Autopilot,
    ControlInput,
    Deselect,
    FlightMode,
    GlobalPosition,
    Heartbeat,
    HeightReading,
    LinkEvent,
    LocalState,
    Select,
    TrackSample,
)
from companion.wire import Wire
from mscf import Box, TrackStatus

VEHICLE = 7  # its system id; neither 1 nor 255, which might be defaults
CAMERA = 100
STEP_S = 0.05
HEIGHT, WIDTH = SIZE_HW
ACCEPTED, REJECTED, DENIED, UNSUPPORTED, FAILED = 0, 1, 2, 3, 4
IDLE, ACTIVE, ERROR, COASTING = 0, 1, 2, 9
POINT, RECTANGLE, STOP = 2004, 2005, 2010
INFORMATION, IMAGE_STATUS, GEO_STATUS = 259, 275, 276
STREAM = FOLLOW + '[ground]\nstream_uri="rtsp://10.0.0.2:8554/video"\n'
NAN, INF = math.nan, math.inf
INT32_MAX = 0x7FFFFFFF
OTHER = Box(100, 100, 50, 60)
A_POINT = (0.5, 0.25, 0.05)
A_RECTANGLE = (0.25, 0.5, 0.375, 0.75)
DRAWN = Box(160, 240, 80, 120)  # the pixels of A_RECTANGLE


configured = cache(parse)


def long(number: int, *params: float, confirmation: int = 0, system: int = VEHICLE, component: int = CAMERA) -> Any:
    padded = (*params, *[0.0] * 7)[:7]
    return mavlink.MAVLink_command_long_message(system, component, number, confirmation, *padded)


def integer(number: int, *params: float) -> Any:
    p = (*params, *[0.0] * 7)[:7]
    return mavlink.MAVLink_command_int_message(VEHICLE, CAMERA, 0, number, 0, 0, *p[:4], int(p[4]), int(p[5]), p[6])


class Stand:
    """A camera component, a controller, and a vehicle that hovers at 14 m over its start, its nose to the north.

    status, is_measured, box, fault : what the tracker says of the selection in force, from the frame after it on.
    is_blind : no new frame comes. is_deaf : the tracker does not come to the new selection.
    """

    def __init__(self, config: str = FOLLOW, *, has_frame: bool = True, muted: Iterable[type] = ()) -> None:
        self.wire = Wire(VEHICLE)
        self.camera = CameraProtocol(self.wire.sender(CAMERA), configured(config), "1.2.3")
        self.controller = Controller(configured(config))
        self.now_s = 100.0
        self.has_frame = has_frame
        self.is_blind = self.is_deaf = False
        self.status = TrackStatus.TRACKING
        self.is_measured = True
        self.box = AHEAD
        self.fault = ""
        self.is_frozen = False  # a fault beside which the tracker goes on
        self.velocity_ned_mps = (0.0, 0.0, 0.0)
        self.moved_m = [0.0, 0.0, 0.0]
        self.place_age_s = 0.0  # of the place on the globe when it arrives
        self.muted = set(muted)  # events of the vehicle that do not come
        self.place = GlobalPosition(0.0, 47.0, 8.0, 514.0)
        self.pos_ned_m = (0.0, 0.0, -14.0)
        self.heard: list[tuple[float, Any]] = []
        self.output: ControlOutput | None = None
        self._grounds: dict[int, Any] = {}
        self._in = mavlink.MAVLink(BytesIO())
        self._track: TrackSample | None = None
        self._seq = 0
        self.run(0.2)

    @property
    def selection(self) -> Any:
        assert self.output is not None
        return self.output.selection

    def step(self, *messages: Any, commands: tuple[Any, ...] = (), sender: int = 255) -> list[Any]:
        """What the camera says in a step in which these messages arrive."""
        self.now_s += STEP_S
        step_m = [STEP_S * speed_mps for speed_mps in self.velocity_ned_mps]
        self.moved_m = [moved + step for moved, step in zip(self.moved_m, step_m, strict=True)]
        north_m, east_m, down_m = (place + step for place, step in zip(self.pos_ned_m, step_m, strict=True))
        self.pos_ned_m = (north_m, east_m, down_m)
        self._expose()
        ground = self._grounds.setdefault(sender, mavlink.MAVLink(BytesIO(), srcSystem=sender, srcComponent=190))
        data = b"".join(bytes(message.pack(ground)) for message in messages)
        orders = self.camera.receive(self.wire.receive(data), self._track, self.now_s)
        inputs = ControlInput(self.now_s, self._track, self._said(), (*orders, *commands))
        self.output = self.controller.step(inputs)
        self.camera.after(self.output, self.controller.vehicle, self._track, self.now_s)
        said = self._in.parse_buffer(b"".join(self.wire.drain())) or []
        self.heard += [(self.now_s, message) for message in said]
        return said

    def run(self, duration_s: float) -> list[Any]:
        return [message for _ in range(round(duration_s / STEP_S)) for message in self.step()]

    def tracked(self) -> "Stand":
        """With OTHER selected by somebody else, and tracked for a while."""
        self.step(commands=(Select(OTHER),))
        self.run(0.3)
        self.heard.clear()
        return self

    def acks(self) -> list[tuple[int, int]]:
        return [(m.command, m.result) for m in self.of("COMMAND_ACK")]

    def of(self, kind: str) -> list[Any]:
        return [message for _, message in self.heard if message.get_type() == kind]

    def statuses(self) -> list[int]:
        return [m.tracking_status for m in self.of("CAMERA_TRACKING_IMAGE_STATUS")]

    def _expose(self) -> None:
        if not self.has_frame or self.is_blind:
            return
        self._seq += 1
        captured_s = self.now_s - 0.02
        selection = self.output.selection if self.output is not None else None
        number = selection.number if selection is not None else 0
        nothing = TrackSample(self._seq, captured_s, self.now_s, SIZE_HW, number)
        if self.is_deaf and self._track is not None:
            nothing = replace(nothing, selection=self._track.selection)
        if selection is None or selection.box is None or self.is_deaf:
            self._track = nothing
        elif self.fault:
            self._track = replace(nothing, fault=self.fault)
        else:
            self._track = replace(
                nothing, status=self.status, is_measured=self.is_measured, box=self.box, confidence=0.9
            )
        if self.is_frozen:
            self._track = replace(self._track, fault="the camera repeats one picture")

    def _said(self) -> tuple[LinkEvent, ...]:
        now_s = self.now_s
        beat = Heartbeat(
            now_s,
            Autopilot.ARDUPILOT,
            is_multicopter=True,
            mode=FlightMode.EXTERNAL,
            mode_name="",
            is_armed=True,
            has_failsafe=False,
        )
        events: tuple[LinkEvent, ...] = (
            beat,
            Attitude(now_s, 0.0, 0.0, 0.0, 0.0),
            LocalState(now_s, self.pos_ned_m, self.velocity_ned_mps),
            HeightReading(now_s, -self.pos_ned_m[2]),
            self._place(),
        )
        return tuple(event for event in events if type(event) not in self.muted)

    def _place(self) -> GlobalPosition:
        """Where the vehicle was on the globe; `place` is where it began to move."""
        age_s = self.place_age_s
        north_m, east_m, down_m = (self.moved_m[k] - age_s * self.velocity_ned_mps[k] for k in range(3))
        return GlobalPosition(
            self.now_s - age_s,
            self.place.lat_deg + north_m / METRES_PER_DEG,
            self.place.lon_deg + east_m / METRES_PER_DEG / math.cos(math.radians(self.place.lat_deg)),
            self.place.amsl_m - down_m,
        )


# ------------------------------------------------------------------------------------ track commands: the tables
def with_one(params: tuple[float, ...], index: int, value: float) -> tuple[float, ...]:
    return (*params[:index], value, *params[index + 1 :])


BAD_SHARES = (NAN, INF, -INF, -0.001, 1.001, 2.0)
BAD: list[tuple[int, tuple[float, ...]]] = [
    *((POINT, with_one(A_POINT, index, bad)) for index in (0, 1) for bad in BAD_SHARES),
    *((POINT, with_one(A_POINT, 2, bad)) for bad in (INF, -INF, -0.1, 1.001)),
    *((POINT, (*A_POINT, camera)) for camera in (1.0, 101.0, -1.0, 0.5)),
    *((RECTANGLE, with_one(A_RECTANGLE, index, bad)) for index in range(4) for bad in BAD_SHARES),
    *((RECTANGLE, (*A_RECTANGLE, camera)) for camera in (1.0, 101.0, -1.0)),
]
# what only a frame tells
SMALL: list[tuple[int, tuple[float, ...]]] = [
    (RECTANGLE, (0.5, 0.5, 0.5, 0.6)),
    (RECTANGLE, (0.5, 0.5, 0.6, 0.5)),
    (RECTANGLE, (0.6, 0.5, 0.5, 0.6)),
    (RECTANGLE, (0.5, 0.6, 0.6, 0.5)),
    (RECTANGLE, (0.5, 0.5, 0.5 + 3.9 / WIDTH, 0.6)),
    (RECTANGLE, (0.5, 0.5, 0.6, 0.5 + 3.9 / HEIGHT)),
]
GOOD: list[tuple[int, tuple[float, ...]]] = [
    *((POINT, (*A_POINT, camera)) for camera in (0.0, NAN, 100.0)),
    *((POINT, with_one(A_POINT, 2, radius)) for radius in (NAN, 0.0, 0.001, 1.0)),
    *((POINT, (u, v, 0.05)) for u in (0.0, 1.0) for v in (0.0, 1.0)),
    *((RECTANGLE, (*A_RECTANGLE, camera)) for camera in (0.0, 100.0)),
    (RECTANGLE, (0.0, 0.0, 1.0, 1.0)),
    (RECTANGLE, (0.5, 0.5, 0.5 + 4.1 / WIDTH, 0.5 + 4.1 / HEIGHT)),
]
KINDS = {"long": long, "int": integer}


def answers(stand: Stand, cases: list[tuple[int, tuple[float, ...]]], kind: str, sender: int = 255) -> list[Any]:
    """Each command with what is said in its step."""
    return [(case, stand.step(KINDS[kind](*(case[0], *case[1])), sender=sender)) for case in cases]


@pytest.mark.parametrize("has_frame", [True, False])
@pytest.mark.parametrize("sender", [255, 254])
@pytest.mark.parametrize("kind", KINDS)
def test_a_bad_track_command_is_denied_at_once_and_changes_nothing(kind: str, sender: int, *, has_frame: bool) -> None:
    stand = Stand(has_frame=has_frame)
    if has_frame:
        stand.tracked()
    before = stand.selection
    for case, said in answers(stand, BAD, kind, sender):
        assert [(m.command, m.result, m.target_system, m.target_component) for m in said] == [
            (case[0], DENIED, sender, 190)
        ], case
        assert stand.selection == before
    stand.run(1.5)
    assert stand.selection == before
    assert len(stand.acks()) == len(BAD)


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_too_small_or_turned_round_is_denied_once_there_is_a_frame(kind: str) -> None:
    stand = Stand().tracked()
    before = stand.selection
    for case, said in answers(stand, SMALL, kind):
        assert [(m.command, m.result) for m in said] == [(case[0], DENIED)], case
    stand.run(1.5)
    assert (len(stand.acks()), stand.selection) == (len(SMALL), before)


@pytest.mark.parametrize("has_frame", [True, False])
@pytest.mark.parametrize("kind", KINDS)
def test_a_sender_that_may_not_select_is_denied(kind: str, *, has_frame: bool) -> None:
    stand = Stand(has_frame=has_frame)
    before = stand.selection
    for case, said in answers(stand, [*GOOD, *SMALL], kind, sender=254):
        assert [(m.command, m.result) for m in said] == [(case[0], DENIED)], case
    stand.run(1.5)
    assert stand.selection == before


@pytest.mark.parametrize("kind", KINDS)
def test_before_the_first_frame_a_track_command_is_rejected_for_now(kind: str) -> None:
    stand = Stand(has_frame=False)
    for case, said in answers(stand, [*GOOD, *SMALL], kind):
        assert [(m.command, m.result) for m in said] == [(case[0], REJECTED)], case
    stand.run(1.5)
    assert stand.selection.number == 0


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("number", "params"), GOOD)
def test_a_good_track_command_is_accepted_when_the_tracker_has_begun(
    number: int, params: tuple[float, ...], kind: str
) -> None:
    stand = Stand().tracked()
    before = stand.selection
    said = stand.step(KINDS[kind](number, *params))
    assert not [m for m in said if m.get_type() == "COMMAND_ACK"]
    assert stand.selection.number == before.number + 1
    (ack, *_) = stand.step()
    assert (ack.get_type(), ack.command, ack.result, ack.target_system) == ("COMMAND_ACK", number, ACCEPTED, 255)
    stand.run(2.0)
    assert stand.acks() == [(number, ACCEPTED)]
    assert stand.selection.number == before.number + 1


def test_the_camera_id_of_a_command_int_may_be_left_out() -> None:
    stand = Stand()
    stand.step(integer(RECTANGLE, *A_RECTANGLE, INT32_MAX))
    stand.step()
    assert stand.acks() == [(RECTANGLE, ACCEPTED)]


def test_the_shares_of_a_rectangle_are_the_edges_of_its_pixels() -> None:
    stand = Stand()
    stand.step(long(RECTANGLE, *A_RECTANGLE))
    assert (stand.selection.box, stand.selection.is_point) == (DRAWN, False)
    stand.step(long(RECTANGLE, 0.0, 0.0, 1.0, 1.0))
    assert stand.selection.box == Box(0, 0, WIDTH, HEIGHT)


@pytest.mark.parametrize(
    ("radius", "side"), [(0.05, 64), (0.0, 2 * POINT_RADIUS * WIDTH), (NAN, 2 * POINT_RADIUS * WIDTH), (0.0001, 4)]
)
def test_a_point_becomes_a_square_around_it_whose_half_side_is_a_share_of_the_width(radius: float, side: float) -> None:
    stand = Stand()
    stand.step(long(POINT, 0.5, 0.25, radius))
    box = stand.selection.box
    assert stand.selection.is_point
    assert box.center_xy == pytest.approx((320, 120))
    assert (box.w, box.h) == pytest.approx((side, side), rel=1e-6)


@pytest.mark.parametrize("sender", [255, 254])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("camera", "result"), [(0, ACCEPTED), (100, ACCEPTED), (NAN, ACCEPTED), (101, DENIED), (INF, DENIED)]
)
def test_stop_is_obeyed_whoever_sends_it(camera: float, result: int, kind: str, sender: int) -> None:
    stand = Stand().tracked()
    (ack, *_) = stand.step(KINDS[kind](STOP, camera), sender=sender)
    assert (ack.command, ack.result, ack.target_system) == (STOP, result, sender)
    assert (stand.selection.box is None) is (result == ACCEPTED)


def test_stop_with_nothing_selected_is_accepted() -> None:
    stand = Stand(has_frame=False)
    stand.step(long(STOP))
    assert stand.acks() == [(STOP, ACCEPTED)]


# ------------------------------------------------------------------------------------ what comes of a track command
def test_a_track_command_that_the_tracker_refuses_has_failed_and_leaves_nothing_selected() -> None:
    stand = Stand().tracked()
    stand.fault = "too small"
    stand.step(long(RECTANGLE, *A_RECTANGLE))
    stand.step()
    assert stand.acks() == [(RECTANGLE, FAILED)]
    assert stand.selection.box is None


def test_a_track_command_on_a_picture_that_stands_still_has_failed() -> None:
    stand = Stand().tracked()
    stand.is_frozen = True
    stand.step(long(RECTANGLE, *A_RECTANGLE))
    stand.step()
    assert stand.acks() == [(RECTANGLE, FAILED)]
    assert stand.selection.box is None


def test_a_selection_by_somebody_else_in_the_step_of_a_track_command_counts_more() -> None:
    stand = Stand()
    stand.step(long(RECTANGLE, *A_RECTANGLE), commands=(Select(OTHER),))
    stand.run(1.5)
    assert stand.acks() == [(RECTANGLE, FAILED)]
    assert stand.selection.box == OTHER


def test_a_tracker_that_does_not_come_to_it_within_a_second_has_failed_and_nothing_stays_selected() -> None:
    stand = Stand().tracked()
    stand.is_deaf = True
    stand.step(long(RECTANGLE, *A_RECTANGLE))
    stand.run(1.0)
    assert stand.acks() == []
    assert stand.selection.box == DRAWN
    stand.step()
    assert stand.acks() == [(RECTANGLE, FAILED)]
    assert stand.selection.box is None


def test_what_somebody_else_selects_meanwhile_is_not_taken_back() -> None:
    stand = Stand().tracked()
    stand.is_deaf = True
    stand.step(long(RECTANGLE, *A_RECTANGLE))
    stand.run(0.5)
    stand.step(commands=(Select(OTHER),))
    assert stand.acks() == [(RECTANGLE, FAILED)]
    stand.run(2.0)
    assert stand.selection.box == OTHER
    assert stand.acks() == [(RECTANGLE, FAILED)]


def test_a_selection_by_somebody_else_in_the_very_step_of_the_time_out_stays() -> None:
    stand = Stand().tracked()
    stand.is_deaf = True
    stand.step(long(RECTANGLE, *A_RECTANGLE))
    stand.run(1.0)
    stand.step(commands=(Select(OTHER),))
    stand.run(1.0)
    assert stand.selection.box == OTHER
    assert stand.acks() == [(RECTANGLE, FAILED)]


@pytest.mark.parametrize("gap", [0, 1, 4])
def test_a_newer_track_command_supersedes_one_that_waits(gap: int) -> None:
    stand = Stand().tracked()
    stand.is_deaf = True
    first, second = long(RECTANGLE, *A_RECTANGLE), long(POINT, *A_POINT)
    if gap:
        stand.step(first)
        stand.run(gap * STEP_S - STEP_S)
        stand.step(second)
    else:
        stand.step(first, second)
    assert stand.acks() == [(RECTANGLE, FAILED)]
    stand.is_deaf = False
    stand.run(2.0)
    assert stand.acks() == [(RECTANGLE, FAILED), (POINT, ACCEPTED)]
    assert stand.selection.is_point


def test_stop_supersedes_a_track_command_that_waits() -> None:
    stand = Stand().tracked()
    stand.is_deaf = True
    stand.step(long(RECTANGLE, *A_RECTANGLE))
    stand.step(long(STOP))
    stand.run(2.0)
    assert stand.acks() == [(RECTANGLE, FAILED), (STOP, ACCEPTED)]
    assert stand.selection.box is None


def test_a_command_that_is_denied_supersedes_nothing() -> None:
    stand = Stand().tracked()
    stand.step(long(RECTANGLE, *A_RECTANGLE), long(POINT, NAN, 0.5))
    stand.run(1.5)
    assert stand.acks() == [(POINT, DENIED), (RECTANGLE, ACCEPTED)]
    assert stand.selection.box == DRAWN


# ------------------------------------------------------------------------------------ retries and addresses
@pytest.mark.parametrize("confirmation", [0, 1])
def test_a_retry_while_the_answer_is_awaited_is_answered_once_at_the_end(confirmation: int) -> None:
    stand = Stand().tracked()
    stand.is_deaf = True
    stand.step(long(RECTANGLE, *A_RECTANGLE))
    number = stand.selection.number
    for _ in range(4):
        stand.step(long(RECTANGLE, *A_RECTANGLE, confirmation=confirmation))
    stand.is_deaf = False
    stand.run(1.5)
    assert stand.acks() == [(RECTANGLE, ACCEPTED)]
    assert stand.selection.number == number


def test_a_retry_after_a_lost_answer_is_acknowledged_again_and_selects_nothing() -> None:
    stand = Stand().tracked()
    stand.step(long(RECTANGLE, *A_RECTANGLE))
    stand.run(3.0)
    number = stand.selection.number
    (ack,) = stand.step(long(RECTANGLE, *A_RECTANGLE, confirmation=1))
    assert (ack.command, ack.result) == (RECTANGLE, ACCEPTED)
    assert stand.selection.number == number


def test_the_same_rectangle_drawn_again_later_is_selected_again() -> None:
    stand = Stand().tracked()
    for _ in range(2):
        stand.step(long(RECTANGLE, *A_RECTANGLE))
        stand.run(5.0)
    assert stand.acks() == [(RECTANGLE, ACCEPTED)] * 2
    assert stand.selection.number == 3


def test_the_same_rectangle_again_is_a_new_one_where_somebody_else_has_chosen_another() -> None:
    stand = Stand().tracked()
    stand.step(long(RECTANGLE, *A_RECTANGLE))
    stand.run(0.5)
    stand.step(commands=(Select(Box(10, 10, 40, 40)),))
    stand.run(0.5)
    stand.step(long(RECTANGLE, *A_RECTANGLE))
    stand.run(0.5)
    assert stand.acks() == [(RECTANGLE, ACCEPTED)] * 2
    assert stand.selection.number == 4


def test_the_same_rectangle_again_at_once_is_a_retry_even_where_it_does_not_say_so() -> None:
    stand = Stand().tracked()
    for _ in range(2):
        stand.step(long(RECTANGLE, *A_RECTANGLE))
        stand.run(0.5)
    assert stand.acks() == [(RECTANGLE, ACCEPTED)] * 2
    assert stand.selection.number == 2


@pytest.mark.parametrize(
    "message",
    [
        long(RECTANGLE, *A_RECTANGLE, system=VEHICLE + 1),
        long(RECTANGLE, *A_RECTANGLE, component=191),
        long(RECTANGLE, *A_RECTANGLE, component=1),
        long(512, INFORMATION, system=1),
    ],
)
def test_what_is_for_somebody_else_is_neither_answered_nor_obeyed(message: Any) -> None:
    stand = Stand()
    assert stand.step(message) == []
    assert stand.run(1.5) == []
    assert stand.selection.number == 0


def test_a_broadcast_is_answered_where_it_is_known_and_passed_over_where_it_is_not() -> None:
    stand = Stand()
    kinds = [m.get_type() for m in stand.step(long(512, INFORMATION, component=0))]
    assert kinds == ["COMMAND_ACK", "CAMERA_INFORMATION"]
    assert stand.step(long(511, 30, 1e5, component=0)) == []
    assert stand.step(long(512, 148, component=0)) == []
    assert stand.step(long(400, 1, component=0)) == []
    assert [m.get_type() for m in stand.step(long(512, INFORMATION, system=0, component=0))] == kinds


# zoom, focus, mode, format, photo, video, streaming, reset, and what no camera knows
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    "number",
    [0, 176, 400, 526, 528, 529, 530, 531, 532, 533, 534, 2000, 2001, 2002, 2003, 2500, 2501, 2502, 2503, 31010],
)
def test_what_we_do_not_claim_is_unsupported_at_once(number: int, kind: str) -> None:
    stand = Stand(STREAM)
    (ack,) = stand.step(KINDS[kind](number, 1, 1, 1))
    assert (ack.command, ack.result) == (number, UNSUPPORTED)


# ------------------------------------------------------------------------------------ requests
REQUESTS = [
    (259, "CAMERA_INFORMATION", 521),
    (260, "CAMERA_SETTINGS", 522),
    (261, "STORAGE_INFORMATION", 525),
    (262, "CAMERA_CAPTURE_STATUS", 527),
    (269, "VIDEO_STREAM_INFORMATION", 2504),
    (270, "VIDEO_STREAM_STATUS", 2505),
    (271, "CAMERA_FOV_STATUS", None),
    (275, "CAMERA_TRACKING_IMAGE_STATUS", None),
]


@pytest.mark.parametrize("has_frame", [True, False])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("message", "name", "old"), REQUESTS)
def test_a_request_is_acknowledged_first_and_then_fulfilled(
    message: int, name: str, old: int | None, kind: str, *, has_frame: bool
) -> None:
    stand = Stand(STREAM, has_frame=has_frame)
    asked = [(512, KINDS[kind](512, message))]
    if old is not None:
        asked.append((old, KINDS[kind](old, 1)))
    for number, request in asked:
        ack, answer = stand.step(request)
        assert (ack.get_type(), ack.command, ack.result) == ("COMMAND_ACK", number, ACCEPTED)
        assert answer.get_type() == name
        assert (answer.get_srcSystem(), answer.get_srcComponent()) == (VEHICLE, CAMERA)


@pytest.mark.parametrize("message", [0, 1, 30, 148, 263, 264, 272, NAN, INF, 259.5, -1])
def test_a_message_that_we_do_not_have_is_unsupported(message: float) -> None:
    (ack,) = Stand(STREAM).step(long(512, message))
    assert (ack.command, ack.result) == (512, UNSUPPORTED)


def test_without_a_stream_its_messages_are_unsupported() -> None:
    stand = Stand()
    stand.step(long(512, 269), long(512, 270), long(2504, 1), long(2505, 1))
    assert stand.acks() == [(512, UNSUPPORTED), (512, UNSUPPORTED), (2504, UNSUPPORTED), (2505, UNSUPPORTED)]


@pytest.mark.parametrize(("stream", "result"), [(0, ACCEPTED), (1, ACCEPTED), (NAN, ACCEPTED), (2, DENIED)])
def test_there_is_one_stream_whose_number_is_1(stream: float, result: int) -> None:
    stand = Stand(STREAM)
    stand.step(long(512, 269, stream), long(2504, stream))
    assert stand.acks() == [(512, result), (2504, result)]


def test_the_information_says_only_what_is_true() -> None:
    stand = Stand()
    _, said = stand.step(long(512, INFORMATION))
    assert bytes(said.vendor_name).rstrip(b"\0") == b"mscf-companion"
    assert bytes(said.model_name).rstrip(b"\0") == b"MSCF tracker"
    assert said.firmware_version == 1 | 2 << 8 | 3 << 16
    assert math.isnan(said.focal_length)
    assert math.isnan(said.sensor_size_h)
    assert math.isnan(said.sensor_size_v)
    assert (said.resolution_h, said.resolution_v) == (WIDTH, HEIGHT)
    assert (said.cam_definition_version, said.cam_definition_uri) == (0, "")
    assert (said.gimbal_device_id, said.lens_id) == (0, 0)


@pytest.mark.parametrize(
    ("config", "muted", "flags"),
    [
        (FOLLOW, {GlobalPosition}, 512 | 1024),
        (FOLLOW, {LocalState}, 512 | 1024),
        (FOLLOW, set(), 512 | 1024 | 2048),
        (STREAM, {GlobalPosition}, 512 | 1024 | 256),
        (STREAM, set(), 512 | 1024 | 256 | 2048),
    ],
)
def test_the_flags_are_those_that_are_true(config: str, muted: set[type], flags: int) -> None:
    _, said = Stand(config, has_frame=False, muted=muted).step(long(512, INFORMATION))
    assert said.flags == flags
    assert (said.resolution_h, said.resolution_v) == (0, 0)


def test_there_is_no_storage_and_nothing_is_captured() -> None:
    stand = Stand()
    _, settings_, _, storage, _, capture = stand.step(long(512, 260), long(512, 261), long(512, 262))
    assert settings_.mode_id == 1  # video
    assert math.isnan(settings_.zoomLevel)
    assert math.isnan(settings_.focusLevel)
    assert (storage.storage_count, storage.status, storage.total_capacity) == (0, 3, 0.0)
    assert (capture.image_status, capture.video_status, capture.image_count) == (0, 0, 0)


@pytest.mark.parametrize(
    ("uri", "encoding", "kind", "address"),
    [
        ("rtsp://10.0.0.2:8554/video", "h264", 0, "rtsp://10.0.0.2:8554/video"),
        ("udp://0.0.0.0:5600", "h264", 1, "5600"),
        ("udp://0.0.0.0:5600", "h265", 1, "5600"),
        ("tcp://10.0.0.2:5000", "h264", 2, "tcp://10.0.0.2:5000"),
        ("mpegts://0.0.0.0:5600", "h264", 3, "5600"),
        ("udp://somewhere", "h264", 1, "udp://somewhere"),
    ],
)
def test_the_stream_is_told_in_the_words_that_a_ground_station_expects(
    uri: str, encoding: str, kind: int, address: str
) -> None:
    stand = Stand(FOLLOW + f'[ground]\nstream_uri="{uri}"\nstream_encoding="{encoding}"\n')
    _, said, _, status = stand.step(long(512, 269), long(512, 270))
    assert (said.type, said.uri, said.encoding) == (kind, address, 1 if encoding == "h264" else 2)
    assert (said.stream_id, said.count) == (1, 1)
    for message in (said, status):
        assert (message.resolution_h, message.resolution_v, message.framerate) == (WIDTH, HEIGHT, 30.0)
        assert message.hfov == round(math.degrees(2 * math.atan(320 / 554)))
        assert message.flags == 1


def test_a_port_that_is_no_number_is_left_in_its_address() -> None:
    assert stream_address("udp://[::1]") == "udp://[::1]"
    assert stream_address("mpegts://@:1234") == "1234"


@pytest.mark.parametrize(
    ("version", "number"), [("1.2.3", 0x030201), ("0.1.0", 0x0100), ("2.0.0rc1", 2), ("0.1.dev7", 0x070100), ("", 0)]
)
def test_the_version_is_a_number_with_the_major_one_lowest(version: str, number: int) -> None:
    assert firmware_number(version) == number


def test_the_field_of_view_is_that_of_the_frame_and_looks_where_the_mount_does() -> None:
    stand = Stand()
    _, said = stand.step(long(512, 271))
    assert said.hfov == pytest.approx(math.degrees(2 * math.atan(320 / 554)))
    assert said.vfov == pytest.approx(math.degrees(2 * math.atan(240 / 554)))
    assert said.q == pytest.approx((math.cos(math.radians(-15)), 0, math.sin(math.radians(-15)), 0))
    assert (said.lat_camera, said.lon_camera, said.alt_camera) == (470_000_000, 80_000_000, 514_000)
    assert (said.lat_image, said.lon_image, said.alt_image) == (INT32_MAX,) * 3


def test_a_camera_on_a_gimbal_names_it_and_does_not_say_where_it_looks_by_its_mount() -> None:
    stand = Stand(FOLLOW + '[gimbal]\naxes="pitch_yaw"\ndevice_id=154\n')
    _, information, _, fov = stand.step(long(512, INFORMATION), long(512, 271))
    assert information.gimbal_device_id == 154
    assert all(map(math.isnan, fov.q))


def test_the_field_of_view_is_not_known_where_nothing_is() -> None:
    stand = Stand(has_frame=False)
    stand.muted = {GlobalPosition, Attitude}
    stand.run(1.5)
    _, said = stand.step(long(512, 271))
    assert all(map(math.isnan, (said.hfov, said.vfov, *said.q)))
    assert (said.lat_camera, said.lon_camera, said.alt_camera) == (INT32_MAX,) * 3


@given(st.tuples(*[st.floats(-math.pi, math.pi)] * 6))
@settings(max_examples=50, deadline=None)
def test_a_product_of_quaternions_turns_as_one_rotation_after_the_other(angles: tuple[float, ...]) -> None:
    w, x, y, z = product(quaternion(*angles[:3]), quaternion(*angles[3:]))
    turned = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    assert turned == pytest.approx(rotation(*angles[:3]) @ rotation(*angles[3:]), abs=1e-9)
    assert rotation_of((w, x, y, z)) == pytest.approx(turned, abs=1e-9)


# ------------------------------------------------------------------------------------ intervals
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("message", "interval_us", "per_s"),
    [
        *((message, us, 1e6 / us) for message in (275, 276) for us in (5e5, 1e5, 3e5, 7e4, 1e6)),
        (275, 0, 5),
        (276, 0, 2),
        (275, 1, 20),
        (276, 1, 20),
        (275, 1e12, 1 / 60),
    ],
)
def test_a_stream_comes_as_often_as_it_was_asked_for(message: int, interval_us: float, per_s: float, kind: str) -> None:
    stand = Stand().tracked()
    stand.step(KINDS[kind](511, message, interval_us))
    assert stand.acks() == [(511, ACCEPTED)]
    kinds = {275: "CAMERA_TRACKING_IMAGE_STATUS", 276: "CAMERA_TRACKING_GEO_STATUS"}
    stand.heard.clear()
    stand.run(10.0)
    assert len(stand.of(kinds[message])) == pytest.approx(10 * per_s, abs=1.01)
    assert len(stand.heard) == len(stand.of(kinds[message]))


def test_nothing_is_streamed_before_it_is_asked_for_and_after_it_is_stopped() -> None:
    stand = Stand().tracked()
    assert stand.run(5.0) == []
    stand.step(long(511, 275, 1e5), long(511, 276, 1e5))
    assert stand.run(1.0)
    stand.step(long(511, 275, -1), long(511, 276, -1))
    assert stand.acks() == [(511, ACCEPTED)] * 4
    assert stand.run(5.0) == []


@pytest.mark.parametrize("interval_us", [NAN, INF, -INF, -2.0, -0.5, -1e6])
def test_an_interval_that_is_none_is_denied_and_the_stream_goes_on_as_before(interval_us: float) -> None:
    stand = Stand().tracked()
    stand.step(long(511, 275, 1e5), long(511, 275, interval_us))
    assert stand.acks() == [(511, ACCEPTED), (511, DENIED)]
    assert len(stand.run(1.0)) == pytest.approx(10, abs=1)


@pytest.mark.parametrize("message", [0, 30, 259, 269, 271, 274, 277, NAN, INF, 275.5])
def test_other_messages_are_not_streamed(message: float) -> None:
    stand = Stand(STREAM)
    stand.step(long(511, message, 1e5))
    assert stand.acks() == [(511, UNSUPPORTED)]


def test_the_interval_in_force_is_told() -> None:
    stand = Stand()
    stand.step(long(511, 275, 5e5), long(511, 276, 1))
    requests = [long(510, 275), long(510, 276), long(510, 30), long(512, 244, 275), long(510, NAN)]
    answers = [m for m in stand.step(*requests) if m.get_type() == "MESSAGE_INTERVAL"]
    assert [(m.message_id, m.interval_us) for m in answers] == [
        *((275, 500_000), (276, 50_000), (30, 0), (275, 500_000), (0, 0))
    ]
    stand.step(long(511, 275, -1))
    assert stand.step(long(510, 275))[-1].interval_us == -1


# ------------------------------------------------------------------------------------ the image status
def test_every_change_is_told_once_without_being_asked_for() -> None:
    stand = Stand()
    stand.step(commands=(Select(OTHER),))
    stand.run(1.0)
    assert stand.statuses() == [ACTIVE]
    stand.status, stand.is_measured = TrackStatus.UNSURE, False
    stand.run(0.5)
    assert stand.statuses() == [ACTIVE, COASTING]
    stand.status = TrackStatus.LOST
    stand.run(3.0)
    assert stand.statuses() == [ACTIVE, COASTING, ERROR]
    stand.status = TrackStatus.CONFIRMING
    stand.run(0.2)
    assert stand.statuses() == [ACTIVE, COASTING, ERROR]
    stand.status, stand.is_measured = TrackStatus.TRACKING, True
    stand.run(1.0)
    assert stand.statuses() == [ACTIVE, COASTING, ERROR, ACTIVE]
    stand.step(commands=(Deselect(),))
    stand.run(1.0)
    assert stand.statuses() == [ACTIVE, COASTING, ERROR, ACTIVE, IDLE]


def test_another_selection_is_told_even_where_the_status_stays() -> None:
    stand = Stand().tracked()
    stand.step(commands=(Select(DRAWN),))
    stand.run(1.0)
    assert stand.statuses() == [IDLE, ACTIVE]  # nothing is tracked until the tracker has begun


def test_a_change_is_told_at_once_and_not_twice_while_streaming() -> None:
    stand = Stand().tracked()
    stand.step(long(511, 275, 1e6))
    stand.run(0.5)
    stand.heard.clear()
    stand.status, stand.is_measured = TrackStatus.LOST, False
    stand.step()
    assert stand.statuses() == [ERROR]
    stand.run(1.0)
    assert stand.statuses() == [ERROR, ERROR]


def test_a_change_in_the_step_in_which_the_stream_is_due_is_told_once() -> None:
    stand = Stand().tracked()
    stand.step(long(511, 275, 5e4))
    stand.run(0.2)
    stand.heard.clear()
    stand.status, stand.is_measured = TrackStatus.LOST, False
    stand.run(0.2)
    assert stand.statuses() == [ERROR] * 4


def test_a_new_target_does_not_coast_on_what_was_seen_of_the_old_one() -> None:
    stand = Stand().tracked()
    stand.status, stand.is_measured = TrackStatus.UNSURE, False
    stand.step(commands=(Select(DRAWN),))
    stand.run(0.1)
    assert stand.statuses()[-1] == ERROR


def test_a_target_that_is_unsure_for_longer_than_the_vehicle_coasts_is_an_error() -> None:
    stand = Stand().tracked()
    stand.status, stand.is_measured = TrackStatus.UNSURE, False
    stand.run(2.0)
    (coasted_s, _), (ended_s, _) = stand.heard
    assert stand.statuses() == [COASTING, ERROR]
    assert ended_s - coasted_s == pytest.approx(0.6, abs=2 * STEP_S)


def test_a_camera_that_stands_still_is_no_measurement() -> None:
    stand = Stand().tracked()
    stand.is_blind = True
    stand.run(2.0)
    assert stand.statuses() == [COASTING, ERROR]


def test_a_fault_is_an_error_whatever_the_tracker_believes() -> None:
    stand = Stand().tracked()
    stand.is_frozen = True
    stand.run(0.2)
    assert stand.statuses() == [ERROR]


def test_for_older_ground_stations_coasting_is_told_as_active() -> None:
    stand = Stand(FOLLOW + "[ground]\nplain_status=true\n").tracked()
    stand.step(long(511, 275, 1e5))
    stand.status, stand.is_measured = TrackStatus.UNSURE, False
    stand.run(0.5)
    assert set(stand.statuses()) == {ACTIVE}
    stand.run(1.0)
    assert stand.statuses()[-1] == ERROR


def image_status(stand: Stand) -> Any:
    return stand.step(long(512, IMAGE_STATUS))[-1]


def test_a_rectangle_is_told_by_its_edges() -> None:
    said = image_status(Stand().tracked())
    assert (said.tracking_status, said.tracking_mode, said.target_data) == (ACTIVE, 2, 4)
    corners = (said.rec_top_x * 640, said.rec_top_y * 480, said.rec_bottom_x * 640, said.rec_bottom_y * 480)
    assert corners == pytest.approx((AHEAD.x, AHEAD.y, AHEAD.x + AHEAD.w, AHEAD.y + AHEAD.h))
    assert all(map(math.isnan, (said.point_x, said.point_y, said.radius)))


def test_a_point_is_told_by_the_middle_of_what_was_found_there() -> None:
    stand = Stand()
    stand.box = Box(300, 225, 40, 90)
    stand.step(long(POINT, *A_POINT))
    stand.step()
    said = image_status(stand)
    assert (said.tracking_status, said.tracking_mode, said.target_data) == (ACTIVE, 1, 4)
    assert (said.point_x * 640, said.point_y * 480, said.radius * 640) == pytest.approx((320, 270, 30))
    assert all(map(math.isnan, (said.rec_top_x, said.rec_top_y, said.rec_bottom_x, said.rec_bottom_y)))


def test_a_box_that_sticks_out_is_told_as_far_as_it_is_in_the_frame() -> None:
    stand = Stand()
    stand.box = Box(-20, 460, 40, 40)
    said = image_status(stand.tracked())
    edges = (said.rec_top_x, said.rec_bottom_x * 640, said.rec_top_y * 480, said.rec_bottom_y)
    assert edges == pytest.approx((0, 20, 460, 1))


@pytest.mark.parametrize("is_selected", [True, False])
def test_without_a_target_no_place_is_told(*, is_selected: bool) -> None:
    stand = Stand()
    if is_selected:
        stand.tracked()
        stand.status, stand.is_measured = TrackStatus.LOST, False
        stand.step()
    said = image_status(stand)
    assert (said.tracking_status, said.tracking_mode) == ((ERROR, 2) if is_selected else (IDLE, 0))
    assert said.target_data == 0
    places = (said.rec_top_x, said.rec_top_y, said.rec_bottom_x, said.rec_bottom_y)
    assert all(map(math.isnan, (said.point_x, said.point_y, said.radius, *places)))


# ------------------------------------------------------------------------------------ the place on the globe
def geo(stand: Stand) -> Any:
    said = stand.step(long(512, GEO_STATUS))[-1]
    assert said.get_type() == "CAMERA_TRACKING_GEO_STATUS"
    return said


def test_the_target_lies_on_the_globe_where_the_vehicle_sees_it() -> None:
    stand = Stand()
    stand.pos_ned_m = (30.0, -20.0, -14.0)
    stand.place = GlobalPosition(0.0, 47.0003, 8.0001, 514.0)
    stand.tracked()
    stand.run(2.0)
    said = geo(stand)
    target = stand.output.target if stand.output is not None else None
    assert target is not None
    assert target.fix is not None
    north_m, east_m = (said.lat / 1e7 - 47.0003) * METRES_PER_DEG, (said.lon / 1e7 - 8.0001) * METRES_PER_DEG
    east_m *= math.cos(math.radians(47))
    assert math.hypot(north_m, east_m) == pytest.approx(target.fix.range_m, abs=0.1)
    assert north_m == pytest.approx(target.fix.range_m * math.cos(target.seen.bearing_rad), abs=0.1)
    assert east_m == pytest.approx(target.fix.range_m * math.sin(target.seen.bearing_rad), abs=0.1)
    middle_m = target.fix.range_m * math.tan(target.seen.depression_rad)
    assert said.alt == pytest.approx(514 - middle_m, abs=0.01)
    assert said.dist == pytest.approx(math.hypot(target.fix.range_m, middle_m), abs=0.01)
    assert said.hdg == pytest.approx(target.seen.bearing_rad, abs=1e-6)
    assert said.tracking_status == ACTIVE


def test_a_vehicle_that_moves_has_gone_on_since_it_said_where_it_is() -> None:
    """The camera moves with the target beside it, to the north and up, and the place on the globe is late."""
    stand = Stand()
    stand.box = Box(420, 225, 40, 30)
    stand.place_age_s, stand.velocity_ned_mps = 0.3, (4.0, 3.0, -0.5)
    stand.tracked()
    stand.run(8.0)
    said = geo(stand)
    target = stand.output.target if stand.output is not None else None
    assert target is not None
    assert target.fix is not None
    gap_s = target.seen.time_s - stand.now_s
    there_m = [moved + gap_s * speed for moved, speed in zip(stand.moved_m, stand.velocity_ned_mps, strict=True)]
    north_m = there_m[0] + target.fix.range_m * math.cos(target.seen.bearing_rad)
    east_m = there_m[1] + target.fix.range_m * math.sin(target.seen.bearing_rad)
    below_m = target.fix.range_m * math.tan(target.seen.depression_rad)
    assert east_m > 5
    assert (said.lat / 1e7 - 47) * METRES_PER_DEG == pytest.approx(north_m, abs=0.3)
    assert (said.lon / 1e7 - 8) * METRES_PER_DEG * math.cos(math.radians(47)) == pytest.approx(east_m, abs=0.3)
    assert said.alt == pytest.approx(514 - there_m[2] - below_m, abs=0.05)
    # the higher the vehicle, the farther is what it sees at the same place of its picture
    farther_mps = 0.5 * target.fix.range_m / -stand.pos_ned_m[2]
    bearing_rad = target.seen.bearing_rad
    speed_ne_mps = (4 + farther_mps * math.cos(bearing_rad), 3 + farther_mps * math.sin(bearing_rad))
    assert (said.vel_n, said.vel_e) == pytest.approx(speed_ne_mps, abs=0.05)


def test_the_velocity_is_told_once_the_filter_has_settled_and_the_vertical_one_never() -> None:
    stand = Stand().tracked()
    said = geo(stand)
    assert all(map(math.isnan, (said.vel_n, said.vel_e, said.vel_d, said.vel_acc)))
    stand.run(2.0)
    said = geo(stand)
    assert (said.vel_n, said.vel_e) == pytest.approx((0, 0), abs=0.05)
    assert math.isnan(said.vel_d)
    assert said.vel_acc > 0


def test_the_accuracy_gets_worse_with_the_range_and_is_never_better_than_the_receiver() -> None:
    accuracies = []
    for top in (300.0, 225.0, 120.0):
        stand = Stand()
        stand.box = Box(300, top, 40, 30)
        said = geo(stand.tracked())
        accuracies.append((said.h_acc, said.v_acc))
        assert said.h_acc > VEHICLE_SIGMA_M
        assert said.hdg_acc == pytest.approx(math.radians(3))
    assert accuracies == sorted(accuracies)


@pytest.mark.parametrize("muted", [GlobalPosition, LocalState, Attitude])
def test_without_the_vehicles_pose_nothing_is_told_of_the_globe(muted: type) -> None:
    stand = Stand().tracked()
    stand.step(long(511, 276, 1e5))
    stand.run(0.5)
    stand.muted = {muted}
    stand.run(1.2)
    stand.heard.clear()
    stand.run(1.0)
    assert not stand.of("CAMERA_TRACKING_GEO_STATUS")
    stand.step(long(512, GEO_STATUS))
    assert stand.acks() == [(512, REJECTED)]


def test_a_target_that_is_not_measured_is_not_on_the_globe() -> None:
    stand = Stand().tracked()
    stand.step(long(511, 276, 1e5))
    stand.run(0.5)
    stand.status, stand.is_measured = TrackStatus.UNSURE, False
    stand.step()
    stand.heard.clear()
    stand.run(2.0)
    assert not stand.of("CAMERA_TRACKING_GEO_STATUS")


def test_a_target_right_underneath_is_as_far_as_the_ground() -> None:
    nadir = FOLLOW.replace("mount_pitch_deg=-30", "mount_pitch_deg=-90").replace('mode="follow"', 'mode="overhead"')
    stand = Stand(nadir)
    stand.box = Box(300, 220, 40, 40)
    said = geo(stand.tracked())
    assert said.dist == pytest.approx(14, abs=0.1)
    assert said.alt == pytest.approx(500, abs=0.1)
    assert (said.lat, said.lon) == pytest.approx((470_000_000, 80_000_000), abs=50)
    assert math.isfinite(said.h_acc)
    assert math.isfinite(said.v_acc)


def seen_at(range_m: float, height_m: float, attitude_error_rad: float = 0.0) -> Any:
    """A box, 20 px wide and 40 high, whose foot is seen at a range from a height."""
    camera = CameraModel.of(configured(FOLLOW), SIZE_HW)
    ray = np.array([range_m, 0.0, height_m])
    uv = camera.pixel(ray / np.linalg.norm(ray))
    assert uv is not None
    box = Box(uv[0] - 9.5, uv[1] - 39.5, 20, 40)
    return measure(camera, box, Attitude(0.0, 0.0, attitude_error_rad, 0.0, 0.0), 0.0)


@pytest.mark.parametrize("range_m", [10.0, 20.0, 35.0])
def test_errors_of_attitude_and_height_scatter_the_range_by_its_sigma(range_m: float) -> None:
    rng = np.random.default_rng(3)
    errors, sigmas = [], []
    for attitude_rad, height in zip(rng.normal(0, math.radians(1), 60), rng.normal(0, 0.05, 60), strict=True):
        fix = range_fix(seen_at(range_m, 14.0, float(attitude_rad)), 14.0 * math.exp(height), None, None)
        assert fix is not None
        errors.append(fix.range_m - range_m)
        sigmas.append(fix.sigma_m)
    assert float(np.std(errors)) == pytest.approx(float(np.mean(sigmas)), rel=0.35)


def test_two_sources_that_agree_are_better_than_one_and_two_that_do_not_are_worse() -> None:
    seen = seen_at(20.0, 14.0)
    slant_m = 20.0 / math.cos(seen.depression_rad)
    alone, agreed, apart = (
        range_fix(seen, 14.0, reference, None)
        for reference in (None, RangeReference(slant_m, 40.0), RangeReference(2 * slant_m, 40.0))
    )
    assert alone is not None
    assert agreed is not None
    assert apart is not None
    assert agreed.sigma_m < alone.sigma_m < apart.sigma_m
    assert apart.sigma_m > 0.3 * apart.range_m
    assert math.isinf(RangeFix(10.0, is_conflicting=False).sigma_m)


def test_from_above_the_sigma_is_that_of_an_angle_over_the_height() -> None:
    seen = seen_at(1.0, 30.0)
    fix = range_from_above(replace(seen, ray_ned=np.array([0.0, 0.0, 1.0])), 30.0)
    assert fix is not None
    assert (fix.range_m, fix.sigma_m) == pytest.approx((0, 30 * math.radians(1)))


# ------------------------------------------------------------------------------------ whatever comes
NUMBERS = st.floats(width=32) | st.sampled_from([0.0, 1.0, 0.5, 0.6, 100.0, 259.0, 275.0])


@given(
    st.lists(
        st.tuples(
            st.sampled_from([POINT, RECTANGLE, STOP, 510, 511, 512, 521, 2504]) | st.integers(0, 65535),
            st.lists(NUMBERS, min_size=7, max_size=7),
            st.integers(0, 255),
            st.sampled_from([254, 255]),
        ),
        max_size=6,
    )
)
@settings(max_examples=60, deadline=None)
def test_whatever_is_commanded_is_answered_once_and_selects_only_what_is_a_box(commands: list[Any]) -> None:
    stand = Stand(STREAM)
    for number, params, confirmation, sender in commands:
        stand.step(long(number, *params, confirmation=confirmation), sender=sender)
        box = stand.selection.box
        assert box is None or (box.is_finite and min(box.w, box.h) >= 4)
    stand.run(1.5)
    assert len(stand.acks()) <= len(commands)
    assert {number for number, _ in stand.acks()} == {number for number, *_ in commands}
