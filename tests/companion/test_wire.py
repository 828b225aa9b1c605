"""The bytes of a link with several components of ours on it."""

from io import BytesIO
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from companion.wire import Wire

VEHICLE = 7


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
    assert [m.get_srcSystem() for packet in wire.drain() for m in parsed(packet)] == [1, VEHICLE, VEHICLE]


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
