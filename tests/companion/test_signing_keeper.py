"""The stamp of signing over restarts; whether we are heard is judged by an independent instance of pymavlink."""

import logging
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from companion.config import SigningConfig
from companion.signing import STAMPS_PER_S, Signing, stamp_at
from companion.signing_keeper import MARGIN, STAMP_NAME, SigningKeeper, keeper_from
from companion.wire import Wire

KEY = bytes(range(32))
NOW_S = 1_790_000_000.0  # Unix time: September of 2026
NOW = stamp_at(NOW_S)


class Peer:
    """Another component with the key: what it sends, and what it hears."""

    def __init__(self, stamp: int = NOW) -> None:
        self._mav = mavlink.MAVLink(BytesIO(), srcSystem=255, srcComponent=190)
        self._mav.robust_parsing = True
        self._mav.signing.secret_key = KEY
        self._mav.signing.sign_outgoing = True
        self._mav.signing.timestamp = stamp

    def order(self) -> bytes:
        message = mavlink.MAVLink_command_long_message(1, 191, 31010, 0, 1, 0, 0, 0, 0, 0, 0)
        return bytes(message.pack(self._mav))

    def hear(self, data: bytes) -> list[str]:
        messages: list[Any] = self._mav.parse_buffer(data) or []
        return [m.get_type() for m in messages if m.get_type() != "BAD_DATA"]


@pytest.fixture
def state(tmp_path: Path) -> Iterator[dict[str, str]]:
    (tmp_path / "key").write_text(KEY.hex())
    (tmp_path / "key").chmod(0o600)
    (tmp_path / "state").mkdir()
    yield {"STATE_DIRECTORY": str(tmp_path / "state")}
    assert not list(tmp_path.rglob("*.new"))


def started(state: dict[str, str], wall_s: float) -> SigningKeeper:
    keeper = keeper_from(SigningConfig(key_file=str(Path(state["STATE_DIRECTORY"]).parent / "key")), state, wall_s)
    assert keeper is not None
    return keeper


def settle(keeper: SigningKeeper) -> None:
    assert keeper._writer is not None
    keeper._writer.join()


def packet_of(signing: Signing) -> bytes:
    wire = Wire(1, signing)
    wire.sender(191).heartbeat_send(18, 8, 0, 0, 3)
    return b"".join(wire.drain())


@pytest.mark.parametrize("is_orderly", [True, False], ids=["stopped", "power cut"])
@pytest.mark.parametrize("wall_s", [0.0, NOW_S - 86_400, NOW_S + 95.0])
def test_after_a_restart_with_a_clock_that_went_back_the_others_still_hear_us(
    state: dict[str, str],
    wall_s: float,
    is_orderly: bool,  # noqa: FBT001
) -> None:
    peer, keeper = Peer(), started(state, NOW_S)
    for second in range(95):
        keeper.keep(NOW_S + second)
        settle(keeper)
        assert peer.hear(packet_of(keeper.signing)) == ["HEARTBEAT"]
    if is_orderly:
        keeper.close()
    again = started(state, wall_s)
    again.keep(wall_s)
    settle(again)
    assert peer.hear(packet_of(again.signing)) == ["HEARTBEAT"]
    assert again.signing.stamp <= NOW + 95 * STAMPS_PER_S + (10 if is_orderly else MARGIN)


def test_what_was_recorded_before_a_restart_is_not_heard_after_it(state: dict[str, str]) -> None:
    keeper, peer = started(state, NOW_S), Peer(NOW + STAMPS_PER_S)
    keeper.keep(NOW_S + 1)
    recorded = peer.order()
    assert len(Wire(1, keeper.signing).receive(recorded)) == 1
    settle(keeper)
    for wall_s in (0.0, NOW_S + 5):  # an attacker who is quick
        again = Wire(1, started(state, wall_s).signing)
        assert again.receive(recorded) == []


def test_the_stamp_on_the_disk_is_always_ahead_of_all_that_was_sent(state: dict[str, str]) -> None:
    keeper, path = started(state, NOW_S), Path(state["STATE_DIRECTORY"]) / STAMP_NAME
    kept = set()
    for second in range(0, 300, 3):
        keeper.keep(NOW_S + second)
        settle(keeper)
        kept.add(int(path.read_text()))
        assert keeper.signing.stamp < int(path.read_text()) <= keeper.signing.stamp + MARGIN
    assert len(kept) == 10  # every half minute
    keeper.close()
    assert int(path.read_text()) == keeper.signing.stamp


@pytest.mark.parametrize("content", ["", "x", "-5", "1e9", "99999999999999999999999", "\0" * 20])
def test_a_stamp_file_that_holds_none_is_said_and_the_clock_counts(
    state: dict[str, str], content: str, caplog: pytest.LogCaptureFixture
) -> None:
    (Path(state["STATE_DIRECTORY"]) / STAMP_NAME).write_text(content)
    assert started(state, NOW_S).signing.stamp == NOW
    assert "holds no time stamp" in caplog.text


def test_a_state_folder_that_cannot_be_written_is_said_once_and_signing_goes_on(
    state: dict[str, str], caplog: pytest.LogCaptureFixture
) -> None:
    gone = SigningKeeper(Signing(KEY, 0, NOW), Path(state["STATE_DIRECTORY"]) / "gone" / STAMP_NAME)
    for second in range(0, 120, 10):
        gone.keep(NOW_S + second)
        settle(gone)
    gone.close()
    assert [record.levelno for record in caplog.records] == [logging.WARNING]
    assert "cannot be written" in caplog.text
    assert Peer().hear(packet_of(gone.signing)) == ["HEARTBEAT"]


def test_without_a_state_folder_the_stamp_lies_beside_the_key_and_of_several_folders_in_the_first(
    state: dict[str, str],
) -> None:
    folder = Path(state["STATE_DIRECTORY"])
    config = SigningConfig(key_file=str(folder.parent / "key"))
    for environ, path in (
        ({}, folder.parent / STAMP_NAME),
        ({"STATE_DIRECTORY": f"{folder}:/elsewhere"}, folder / STAMP_NAME),
    ):
        keeper = keeper_from(config, environ, NOW_S)
        assert keeper is not None
        keeper.keep(NOW_S)
        settle(keeper)
        assert path.exists()


def test_a_key_of_systemds_without_a_state_folder_is_used_and_the_lack_is_said(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "signing-key").write_text(KEY.hex())
    (tmp_path / "signing-key").chmod(0o400)
    keeper = keeper_from(SigningConfig(link_id=4), {"CREDENTIALS_DIRECTORY": str(tmp_path)}, NOW_S)
    assert keeper is not None
    keeper.keep(NOW_S + 1)
    keeper.close()
    assert packet_of(keeper.signing)[-13] == 4
    assert "is not kept" in caplog.text


def test_without_a_key_nothing_is_signed() -> None:
    assert keeper_from(SigningConfig(), {}, NOW_S) is None
