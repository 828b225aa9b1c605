"""The bytes of a link with several components of ours on it."""

from io import BytesIO
from typing import Any

import pytest
from cockpit import AHEAD, FOLLOW, SIZE_HW
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from companion.config import parse
from companion.follower import Follower, Step
from companion.modes import Mode
from companion.signing import Signing
from companion.types import Engage, Select, TrackSample
from companion.wire import Wire
from mscf import TrackStatus

VEHICLE = 7
KEY = bytes(range(32))
NOW = 40_000_000_000_000  # in 10 us since 2015


def parsed(data: bytes) -> list[Any]:
    return mavlink.MAVLink(BytesIO()).parse_buffer(data) or []


def beat(system: int = VEHICLE, component: int = 1) -> bytes:
    sender = mavlink.MAVLink(BytesIO(), srcSystem=system, srcComponent=component)
    return bytes(mavlink.MAVLink_heartbeat_message(2, 3, 0x81, 4, 4, 3).pack(sender))


def say(wire: Wire, component: int, text: str = "said") -> None:
    wire.sender(component).statustext_send(6, text.encode())


def test_what_is_sent_leaves_in_order_and_once() -> None:
    wire = Wire(VEHICLE)
    for component, text in ((191, "a"), (100, "b"), (191, "c")):
        say(wire, component, text)
    sent = [message for packet in wire.drain() for message in parsed(packet)]
    assert [(m.get_srcSystem(), m.get_srcComponent(), m.text) for m in sent] == [
        *((VEHICLE, 191, "a"), (VEHICLE, 100, "b"), (VEHICLE, 191, "c"))
    ]
    assert wire.drain() == ()


def test_every_component_counts_its_own_messages() -> None:
    wire = Wire(VEHICLE)
    for component in (191, 100, 100, 191, 191):
        say(wire, component)
    sent = [message for packet in wire.drain() for message in parsed(packet)]
    assert [m.get_seq() for m in sent if m.get_srcComponent() == 191] == [0, 1, 2]
    assert [m.get_seq() for m in sent if m.get_srcComponent() == 100] == [0, 1]


def setpoint(wire: Wire, north_mps: float) -> None:
    velocity = (north_mps, 0.0, 0.0)
    rest = (*velocity, *[0.0] * 4, 0.0)
    wire.sender(191).set_position_target_local_ned_send(0, VEHICLE, 1, 1, 1479, 0.0, 0.0, 0.0, *rest)


def command(wire: Wire, number: int) -> None:
    wire.sender(191).command_long_send(VEHICLE, 1, number, 0, *[0.0] * 7)


def answers(wire: Wire) -> None:
    for component in (191, 100) * 16:
        wire.sender(component).command_ack_send(512, 0)
    say(wire, 100, "x" * 50)
    wire.sender(191).timesync_send(7, 7)


SET_MODE, SET_INTERVAL = 176, 511


def test_what_moves_the_vehicle_leaves_before_all_answers_and_in_the_order_in_which_it_was_written() -> None:
    wire = Wire(VEHICLE)
    wire.sender(191).timesync_send(0, 7)
    answers(wire)
    command(wire, SET_INTERVAL)
    command(wire, SET_MODE)
    setpoint(wire, 1.0)
    setpoint(wire, 2.0)
    say(wire, 191)
    sent = [message for packet in wire.drain() for message in parsed(packet)]
    assert [m.get_type() for m in sent[:4]] == ["TIMESYNC", "COMMAND_LONG", *["SET_POSITION_TARGET_LOCAL_NED"] * 2]
    assert (sent[0].tc1, sent[1].command) == (0, SET_MODE)
    assert [m.vx for m in sent[2:4]] == [1.0, 2.0]
    # and the others as they were
    assert [m.get_type() for m in sent[4:]] == [
        *["COMMAND_ACK"] * 32,
        *("STATUSTEXT", "TIMESYNC", "COMMAND_LONG", "STATUSTEXT"),
    ]
    assert sent[-2].command == SET_INTERVAL


@pytest.mark.parametrize("signing", [None, Signing(KEY, 0, NOW)], ids=["unsigned", "signed"])
def test_what_has_overtaken_is_in_sequence_and_no_replay(signing: Signing | None) -> None:
    wire = Wire(VEHICLE, signing)
    for north_mps in (1.0, 2.0):
        answers(wire)
        setpoint(wire, north_mps)
    packets = wire.drain()
    other = mavlink.MAVLink(None)
    if signing is not None:
        Signing(KEY, 0, NOW).equip(other)  # refuses what is not newer than the last of its sender
    heard = other.parse_buffer(b"".join(packets)) or []
    assert [m.get_type() for m in heard[:2]] == ["SET_POSITION_TARGET_LOCAL_NED"] * 2
    assert len(heard) == len(packets) == 70
    for component in (191, 100):
        numbers = [m.get_seq() for m in heard if m.get_srcComponent() == component]
        assert numbers == [*range(len(numbers))]


@pytest.mark.parametrize("signing", [None, Signing(KEY, 0, NOW)], ids=["unsigned", "signed"])
def test_a_message_that_cannot_be_packed_costs_no_other_one_and_is_logged_once_a_kind(
    signing: Signing | None, caplog: pytest.LogCaptureFixture
) -> None:
    wire = Wire(VEHICLE, signing)
    for _ in range(2):
        say(wire, 191)
        wire.sender(191).command_ack_send(-1, 0)
        setpoint(wire, 1.0)
        command(wire, 70_000)
        wire.sender(191).command_ack_send(70_000, 0)
        setpoint(wire, 2.0)
        sent = [message for packet in wire.drain() for message in parsed(packet)]
        assert [m.get_type() for m in sent] == [*["SET_POSITION_TARGET_LOCAL_NED"] * 2, "STATUSTEXT"]
        assert [m.vx for m in sent[:2]] == [1.0, 2.0]
        assert [m.get_seq() - sent[0].get_seq() for m in sent] == [0, 1, 2]
    assert caplog.messages == [f"{kind} cannot be packed, and is not sent" for kind in ("COMMAND_ACK", "COMMAND_LONG")]


def following() -> tuple[Follower, Step]:
    """A follower whose vehicle follows, with ten questions of a ground station in every step, and its last step."""
    follower, out, selection = Follower(parse(FOLLOW)), mavlink.MAVLink(None, VEHICLE, 1), 0
    station = mavlink.MAVLink(None, 255, 190)
    for k in range(1, 31):
        now_s, boot_ms = 50.0 + k / 20, 1000 + 50 * k
        vehicle = (
            mavlink.MAVLink_heartbeat_message(2, 3, 0x81, 4, 4, 3),
            mavlink.MAVLink_extended_sys_state_message(0, 2),
            mavlink.MAVLink_attitude_message(boot_ms, 0, 0, 0, 0, 0, 0),
            mavlink.MAVLink_local_position_ned_message(boot_ms, 0, 0, -14, 0, 0, 0),
            mavlink.MAVLink_global_position_int_message(boot_ms, 0, 0, 0, 14000, 0, 0, 0, 0),
        )
        questions = [
            mavlink.MAVLink_command_long_message(VEHICLE, component, 512, 0, what, *[0.0] * 6)
            for component in (191, 100)
            for what in (259, 260, 261, 262, 269)
        ]
        data = b"".join(bytes(message.pack(out)) for message in vehicle)
        data += b"".join(bytes(message.pack(station)) for message in questions)
        status = TrackStatus.TRACKING if selection else None
        track = TrackSample(k, now_s - 0.02, now_s, SIZE_HW, selection, status, bool(selection), AHEAD, 0.9)
        orders = {2: (Select(AHEAD),), 15: (Engage(),)}.get(k, ())
        step = follower.step(now_s, data, track, orders)
        selection = step.control.selection.number
    assert step.control.mode is Mode.FOLLOWING
    return follower, step


def test_the_setpoint_leaves_before_what_a_ground_station_is_told_in_the_same_step() -> None:
    _, step = following()
    sent = [message.get_type() for message in parsed(step.data)]
    assert sent[0] == "SET_POSITION_TARGET_LOCAL_NED"
    assert {"COMMAND_ACK", "CAMERA_INFORMATION"} <= {*sent}


def test_an_answer_that_cannot_be_packed_costs_no_last_words() -> None:
    follower, _ = following()
    follower._wire.sender(191).command_ack_send(70_000, 0)  # of the step that is not finished
    kinds = [message.get_type() for packet in follower.farewell(60.0) for message in parsed(packet)]
    assert kinds == [*["SET_POSITION_TARGET_LOCAL_NED"] * 3, "COMMAND_LONG", "STATUSTEXT"]


def test_a_component_has_one_sender() -> None:
    wire = Wire(VEHICLE)
    assert wire.sender(100) is wire.sender(100)
    assert wire.sender(100) is not wire.sender(191)


def test_everything_is_sent_as_mavlink_2() -> None:
    wire = Wire(VEHICLE)
    say(wire, 191)
    (packet,) = wire.drain()
    assert packet[0] == 0xFD


def test_all_components_change_their_system_together() -> None:
    wire = Wire(1)
    say(wire, 191)
    wire.system_id = VEHICLE
    for component in (191, 100):
        say(wire, component)
    assert wire.system_id == VEHICLE
    assert [m.get_srcSystem() for packet in wire.drain() for m in parsed(packet)] == [VEHICLE] * 3


def test_our_own_messages_that_come_back_are_not_heard_and_those_of_others_are() -> None:
    wire = Wire(VEHICLE)
    say(wire, 191)
    echo = b"".join(wire.drain())
    others = beat() + beat(component=100) + beat(system=8, component=191)
    heard = wire.receive(echo + others)
    assert [(m.get_srcSystem(), m.get_srcComponent()) for m in heard] == [(VEHICLE, 1), (VEHICLE, 100), (8, 191)]
    say(wire, 100)  # from now on that is ours
    assert [m.get_srcComponent() for m in wire.receive(others)] == [1, 191]


@given(st.lists(st.integers(1, 60), max_size=20))
@settings(deadline=None)
def test_messages_arrive_whatever_the_chunks(sizes: list[int]) -> None:
    wire, data, heard = Wire(VEHICLE), beat() * 5, 0
    for size in sizes:
        heard += len(wire.receive(data[:size]))
        data = data[size:]
    assert heard + len(wire.receive(data)) == 5


@given(st.binary(max_size=300))
@settings(deadline=None)
def test_garbage_raises_nothing_and_what_follows_it_is_heard(noise: bytes) -> None:
    wire = Wire(VEHICLE)
    wire.receive(noise)
    # the noise may pretend to be a long message, which swallows what comes until it would be complete
    assert wire.receive(beat() * 30)


def test_the_buffer_does_not_grow() -> None:
    wire = Wire(VEHICLE)
    for _ in range(300):
        wire.receive(beat() + beat()[:5])
        wire.receive(beat()[5:])
    assert len(wire._parser.buf) < 300


def test_of_a_read_that_is_too_long_the_newest_is_heard() -> None:
    wire = Wire(VEHICLE)
    heard = wire.receive(beat(component=1) * 4000 + beat(component=2))
    assert len(heard) < 4000
    assert heard[-1].get_srcComponent() == 2
