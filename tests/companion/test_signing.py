"""Signed links against an independent instance of pymavlink, which has its own key, link number and clock."""

import hashlib
import struct
from io import BytesIO
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from companion.codec import MavlinkCodec
from companion.config import GroundConfig, SigningConfig
from companion.errors import ConfigError
from companion.ground_command import GroundCommands
from companion.modes import Mode
from companion.safety import stop
from companion.signing import STAMPS_PER_S, Signing, parse_key, read_key, stamp_at
from companion.types import Disengage, Engage
from companion.wire import Wire

KEY, OTHER_KEY = bytes(range(32)), bytes(range(1, 33))
NOW_S = 1_790_000_000.0  # Unix time: September of 2026
NOW = stamp_at(NOW_S)
ENGAGE = 31010  # MAV_CMD_USER_1
LATER = 10 * STAMPS_PER_S


class Peer:
    """Another component with pymavlink's own signing: what it sends, and what it hears."""

    def __init__(self, key: bytes | None = KEY, stamp: int = NOW + 100, link: int = 3, system: int = 255) -> None:
        self.mav = mavlink.MAVLink(BytesIO(), srcSystem=system, srcComponent=190 if system == 255 else 1)
        self.mav.robust_parsing = True
        if key is not None:
            self.mav.signing.secret_key = key
            self.mav.signing.sign_outgoing = True
            self.mav.signing.timestamp = stamp
            self.mav.signing.link_id = link

    def say(self, message: Any, *, as_version_1: bool = False) -> bytes:
        return bytes(message.pack(self.mav, force_mavlink1=as_version_1))

    def hear(self, data: bytes) -> list[str]:
        messages = self.mav.parse_buffer(data) or []
        return [m.get_type() for m in messages if m.get_type() != "BAD_DATA"]


class Ours:
    """The onboard computer's side: a wire with a key, orders from the ground."""

    def __init__(self, key: bytes = KEY, stamp: int = NOW) -> None:
        self.signing = Signing(key, 7, stamp)
        self.wire = Wire(1, self.signing)
        self.codec = MavlinkCodec(self.wire)
        self._commands = GroundCommands(self.wire.sender(191), GroundConfig(engage_command=ENGAGE))

    def orders(self, data: bytes) -> list[Any]:
        messages = self.wire.receive(data)
        self.codec.receive(messages, 50.0)
        orders = self._commands.receive(messages, 50.0)
        self._commands.after(Mode.IDLE)
        return [*orders]

    def sent(self) -> bytes:
        return b"".join(self.wire.drain())

    def heartbeat(self) -> bytes:
        self.sent()
        self.codec.send_heartbeat(is_active=False, is_healthy=True)
        return self.sent()


def order(what: int = 1) -> Any:
    return mavlink.MAVLink_command_long_message(1, 191, ENGAGE, 0, what, 0, 0, 0, 0, 0, 0)


def autopilot() -> Any:
    return mavlink.MAVLink_heartbeat_message(2, 3, 0x81, 4, 4, 3)


def resigned(packet: bytes, key: bytes, **changed: int) -> bytes:
    """A signed packet with another stamp or link number, signed again with a key."""
    stamp = changed.get("stamp", int.from_bytes(packet[-12:-6], "little"))
    body = packet[:-13] + bytes([changed.get("link", packet[-13])]) + struct.pack("<Q", stamp)[:6]
    return body + hashlib.sha256(key + body).digest()[:6]


# --------------------------------------------------------------------------------------------- who is heard
def test_an_order_that_is_signed_with_the_key_is_obeyed_and_the_answer_is_signed() -> None:
    ours, peer = Ours(), Peer()
    assert ours.orders(peer.say(order(0))) == [Disengage()]
    assert peer.hear(ours.sent()) == ["COMMAND_ACK"]
    assert ours.orders(peer.say(order(1))) == [Engage()]


def forged_stamp(peer: Peer) -> bytes:
    genuine = peer.say(order())
    return genuine[:-12] + struct.pack("<Q", NOW + LATER)[:6] + genuine[-6:]


REFUSED = {
    "unsigned": lambda _: Peer(None).say(order()),
    "version 1": lambda _: Peer(None).say(order(), as_version_1=True),
    "version 1 with the key": lambda peer: peer.say(order(), as_version_1=True),
    "another key": lambda _: Peer(OTHER_KEY).say(order()),
    "no signature but zeros": lambda peer: peer.say(order())[:-6] + bytes(6),
    "half a signature": lambda peer: peer.say(order())[:-3] + bytes(3),
    "another stamp": forged_stamp,
    "more than a minute old": lambda peer: resigned(peer.say(order()), KEY, stamp=NOW - 61 * STAMPS_PER_S),
    "before we began": lambda peer: resigned(peer.say(order()), KEY, stamp=NOW - 1),
}


@pytest.mark.parametrize("forge", REFUSED.values(), ids=REFUSED.keys())
def test_what_is_not_signed_with_the_key_changes_nothing(forge: Any) -> None:
    ours, peer = Ours(), Peer()
    assert ours.orders(forge(peer)) == []
    assert ours.sent() == b""
    assert ours.signing.stamp == NOW
    assert ours.orders(peer.say(order())) == [Engage()]  # and it keeps nobody else from being heard


def test_an_autopilot_that_does_not_sign_is_none() -> None:
    ours = Ours()
    for peer in (Peer(None, system=1), Peer(OTHER_KEY, system=1)):
        assert ours.orders(peer.say(autopilot())) == []
    assert ours.codec.autopilot is None
    ours.orders(Peer(system=1).say(autopilot()))
    assert ours.codec.autopilot is not None


@pytest.mark.parametrize("at", range(-12, 0))
def test_a_flipped_bit_in_stamp_or_signature_is_noticed(at: int) -> None:
    ours, packet = Ours(), bytearray(Peer().say(order()))
    packet[at] ^= 1
    assert ours.orders(bytes(packet)) == []


def test_a_payload_that_was_changed_with_its_checksum_is_noticed() -> None:
    ours, packet = Ours(), bytearray(Peer().say(order(0)))
    assert packet[10:14] == bytes(4)
    packet[10:14] = struct.pack("<f", 1.0)
    checksum = mavlink.x25crc(packet[1:-15])
    checksum.accumulate(bytes([mavlink.MAVLink_command_long_message.crc_extra]))
    packet[-15:-13] = struct.pack("<H", checksum.crc)
    unsigned = packet[:-13]
    assert ours.orders(bytes(packet)) == []
    # the checksum is right: without a key it would have been an order
    unsigned[2] = 0
    checksum = mavlink.x25crc(unsigned[1:-2])
    checksum.accumulate(bytes([mavlink.MAVLink_command_long_message.crc_extra]))
    unsigned[-2:] = struct.pack("<H", checksum.crc)
    assert len(Wire().receive(bytes(unsigned))) == 1


def test_what_was_heard_is_not_heard_again_nor_is_anything_older() -> None:
    ours, peer = Ours(), Peer()
    first, second, third = (peer.say(order()) for _ in range(3))
    assert [len(ours.wire.receive(packet)) for packet in (second, second, first, third)] == [1, 0, 0, 1]


def test_senders_and_links_have_their_own_order() -> None:
    ours, one = Ours(), Peer(stamp=NOW + 500)
    packet = one.say(order())
    other = resigned(packet, KEY, link=9, stamp=NOW + 400)
    assert [len(ours.wire.receive(said)) for said in (packet, other, other)] == [1, 1, 0]


@pytest.mark.parametrize(("behind_s", "is_heard"), [(59, True), (61, False)])
def test_a_sender_that_was_not_heard_before_may_be_a_minute_behind(behind_s: int, is_heard: bool) -> None:  # noqa: FBT001
    ours = Ours()
    ours.signing.follow(NOW_S + 3600)
    packet = Peer(stamp=NOW + (3600 - behind_s) * STAMPS_PER_S).say(order())
    assert ours.orders(packet) == [Engage()] * is_heard


def test_a_forged_stamp_of_the_future_does_not_lock_its_victim_out() -> None:
    """With pymavlink's own check it does: it stores the stamp first."""
    peer, theirs, ours = Peer(), Peer(), Ours()
    first = peer.say(order())
    forged = first[:-12] + struct.pack("<Q", NOW + LATER)[:6] + first[-6:]
    genuine = peer.say(order())
    assert theirs.hear(forged + genuine) == []
    assert ours.orders(forged + genuine) == [Engage()]


def test_a_message_that_nobody_knows_is_not_handed_on_unchecked() -> None:
    header = bytes([4, 0, 0, 0, 255, 190]) + (50_000).to_bytes(3, "little")
    unknown = b"\xfd" + header + bytes(4) + b"\0\0"
    assert [m.get_type() for m in Wire().receive(unknown)] == ["UNKNOWN_50000"]
    assert Wire(1, Signing(KEY, 0, NOW)).receive(unknown) == []


@pytest.mark.parametrize("signing", [None, Signing(KEY, 0, NOW)], ids=["unsigned", "signed"])
def test_a_key_that_somebody_sends_is_handed_to_nobody(signing: Signing | None) -> None:
    peer = Peer(KEY if signing else None)
    wire = Wire(1, signing)
    assert wire.receive(peer.say(mavlink.MAVLink_setup_signing_message(1, 1, KEY, NOW))) == []
    assert len(wire.receive(peer.say(order()))) == 1


# ------------------------------------------------------------------------------------------- what is sent
def test_all_our_components_sign_and_no_stamp_is_used_twice() -> None:
    ours, peer = Ours(), Peer(system=1)
    ours.orders(peer.say(autopilot()))
    camera = ours.wire.sender(100)
    for _ in range(20):
        ours.codec.send_setpoint(stop(), 50.0)
        camera.heartbeat_send(30, 8, 0, 0, 4)
        ours.codec.send_time_request(50.0)
    packets = ours.wire.drain()
    assert len(packets) == 60
    stamps = [int.from_bytes(packet[-12:-6], "little") for packet in packets]
    assert stamps == sorted(set(stamps))
    assert {packet[-13] for packet in packets} == {7}
    assert len(Peer(system=2).hear(b"".join(packets))) == 60
    assert Peer(OTHER_KEY, system=2).hear(b"".join(packets)) == []


def test_our_stamps_follow_the_wall_clock_forward_and_never_back() -> None:
    signing = Signing(KEY, 0, NOW)
    for wall_s, stamp in ((NOW_S + 5, NOW + 500_000), (0.0, NOW + 500_000), (NOW_S + 4, NOW + 500_000)):
        signing.follow(wall_s)
        assert signing.stamp == stamp


@pytest.mark.parametrize(
    ("wall_s", "stamp"), [(0.0, 0), (1_420_070_400.0, 0), (1_420_070_401.0, 100_000), (1_420_070_400.00001, 1)]
)
def test_a_stamp_counts_ten_microseconds_since_2015(wall_s: float, stamp: int) -> None:
    assert stamp_at(wall_s) == pytest.approx(stamp, abs=1 if wall_s % 1 else 0)


def test_a_computer_with_a_wrong_clock_catches_up_with_whom_it_hears() -> None:
    ours, peer = Ours(stamp=0), Peer()
    assert peer.hear(ours.heartbeat()) == []
    ours.orders(peer.say(autopilot()))
    assert peer.hear(ours.heartbeat()) == ["HEARTBEAT"]


def test_a_peer_with_a_wrong_clock_is_heard_once_it_has_heard_us() -> None:
    ours, peer = Ours(), Peer(stamp=1000)
    assert ours.orders(peer.say(order())) == []
    assert peer.hear(ours.heartbeat()) == ["HEARTBEAT"]
    assert ours.orders(peer.say(order())) == [Engage()]


# ------------------------------------------------------------------------------------------------ keys
@pytest.mark.parametrize(
    ("data", "key"),
    [
        (KEY.hex().encode(), KEY),
        (KEY.hex().upper().encode() + b"\r\n", KEY),
        (b"  " + KEY.hex().encode() + b" \n", KEY),
        (b"correct horse\n", hashlib.sha256(b"correct horse").digest()),
        (b"correct horse \n", hashlib.sha256(b"correct horse ").digest()),
        (b"\xef\xbb\xbfcorrect horse", hashlib.sha256(b"correct horse").digest()),
        ("Flügelschlag".encode(), hashlib.sha256("Flügelschlag".encode()).digest()),
        (b"deadbeef", hashlib.sha256(b"deadbeef").digest()),
    ],
)
def test_a_key_is_64_hexadecimal_digits_or_the_hash_of_a_passphrase(data: bytes, key: bytes) -> None:
    assert parse_key(data) == key


@pytest.mark.parametrize(
    ("data", "text"),
    [
        (b"", "0 characters"),
        (b"\n", "0 characters"),
        (b"short", "5 characters"),
        (b"       x", "1 characters"),
        (b"two lines\nof text", "more than one line"),
        (b"with a \0 in it", "more than one line"),
        (KEY, "more than one line, or no text"),
        (b"\xff\xfe\x00 binary", "neither text nor digits"),
        (KEY.hex().encode()[:-1], "63 hexadecimal digits: a key has 64"),
        (KEY.hex().encode() * 2, "128 hexadecimal digits"),
        (b"0" * 64, "zeros"),
        (b"x" * 2000, "longer than 1024 bytes"),
    ],
)
def test_a_file_without_a_key_is_refused_in_one_line_that_does_not_tell_it(
    data: bytes, text: str, tmp_path: Path
) -> None:
    path = tmp_path / "key"
    path.write_bytes(data)
    path.chmod(0o600)
    with pytest.raises(ConfigError, match=text) as refusal:
        read_key(SigningConfig(key_file=str(path)), {})
    said = str(refusal.value)
    assert said.startswith(f"signing: {path}: ")
    assert "\n" not in said
    assert len(data.strip()) < 8 or data.decode("latin-1").strip() not in said


@pytest.mark.parametrize("name", ["missing", "", "nul\0l"], ids=["missing", "a folder", "no path"])
def test_a_key_file_that_cannot_be_read_is_a_configuration_error(name: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be read"):
        read_key(SigningConfig(key_file=f"{tmp_path}/{name}"), {})


def test_the_unit_starts_without_a_credential(tmp_path: Path) -> None:
    assert read_key(SigningConfig(), {"CREDENTIALS_DIRECTORY": str(tmp_path)}) is None


def test_an_empty_credential_is_no_key_but_a_mistake(tmp_path: Path) -> None:
    (tmp_path / "signing-key").touch(0o400)
    with pytest.raises(ConfigError, match="0 characters"):
        read_key(SigningConfig(), {"CREDENTIALS_DIRECTORY": str(tmp_path)})


def test_the_configured_file_comes_before_the_credential(tmp_path: Path) -> None:
    (tmp_path / "signing-key").write_text("of the service")
    (tmp_path / "mine").write_text(KEY.hex())
    for path in tmp_path.iterdir():
        path.chmod(0o600)
    environ = {"CREDENTIALS_DIRECTORY": str(tmp_path)}
    assert read_key(SigningConfig(key_file=str(tmp_path / "mine")), environ) == KEY
    assert read_key(SigningConfig(), environ) == hashlib.sha256(b"of the service").digest()


@pytest.mark.parametrize(("mode", "is_said"), [(0o600, False), (0o640, False), (0o644, True), (0o602, True)])
def test_a_key_that_everybody_may_read_or_change_is_said(
    mode: int,
    is_said: bool,  # noqa: FBT001
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
) -> None:
    path = tmp_path / "key"
    path.write_text(KEY.hex())
    path.chmod(mode)
    assert read_key(SigningConfig(key_file=str(path)), {}) == KEY
    assert ("open to everybody" in caplog.text) == is_said
    assert KEY.hex() not in caplog.text
