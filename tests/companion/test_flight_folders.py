import errno
import json
import os
import shutil
from datetime import UTC, datetime
from pathlib import Path

import pytest

from companion.config import RecordConfig
from companion.errors import UsageError
from companion.flight_folders import (
    NoRoomError,
    about_of,
    check_free,
    flights_folder,
    make_room,
    new_folder,
    remove_old,
    try_folder,
)
from companion.flight_record import ABOUT, CONTROL, KIND

NOW = datetime(2026, 3, 1, 12, 30, 5, tzinfo=UTC)


def flight(flights: Path, number: int, *, size: int = 1000, age_days: float = 0.0) -> Path:
    """A record of a size and an age."""
    folder = flights / f"20260101T000000Z-{number:04d}"
    folder.mkdir(parents=True)
    (folder / ABOUT).write_text(json.dumps({"record": KIND}))
    (folder / CONTROL).write_bytes(bytes(size))
    written_s = NOW.timestamp() - age_days * 86400
    for path in folder.iterdir():
        os.utime(path, (written_s, written_s))
    return folder


def limits(total_mb: float = 1.0, days: float = 30.0) -> RecordConfig:
    return RecordConfig(max_total_mb=total_mb, max_age_days=days, min_free_mb=1.0)


def left(flights: Path) -> list[int]:
    return sorted(int(path.name[-4:]) for path in flights.iterdir())


def test_the_oldest_flights_go_until_the_rest_fits(tmp_path: Path) -> None:
    for number in (1, 2, 3, 10):
        flight(tmp_path, number, size=400_000)
    used = remove_old(tmp_path, None, limits(1.0), NOW.timestamp())
    assert left(tmp_path) == [3, 10]
    assert 800_000 < used < 1_000_000


def test_the_running_flight_is_never_removed(tmp_path: Path) -> None:
    running = flight(tmp_path, 1, size=2_000_000, age_days=90)
    flight(tmp_path, 2)
    assert remove_old(tmp_path, running, limits(1.0), NOW.timestamp()) > 1e6
    assert left(tmp_path) == [1]


def test_flights_go_when_they_are_too_old(tmp_path: Path) -> None:
    for number, age_days in ((1, 31.0), (2, 29.0), (3, 40.0)):
        flight(tmp_path, number, age_days=age_days)
    remove_old(tmp_path, None, limits(), NOW.timestamp())
    assert left(tmp_path) == [2]


def test_a_clock_that_was_not_set_makes_no_flight_old(tmp_path: Path) -> None:
    flight(tmp_path, 1, age_days=NOW.timestamp() / 86400)  # written in 1970
    flight(tmp_path, 2)
    remove_old(tmp_path, None, limits(), NOW.timestamp())
    assert left(tmp_path) == [1, 2]
    remove_old(tmp_path, None, limits(), 0.0)
    assert left(tmp_path) == [1, 2]


def test_what_is_no_record_of_ours_stays(tmp_path: Path) -> None:
    flights, elsewhere = tmp_path / "flights", flight(tmp_path / "elsewhere", 7, age_days=99)
    flights.mkdir()
    (flights / "link-0001").symlink_to(elsewhere)
    (flights / "notes.txt").write_text("mine")
    for name, about in (("holidays", None), ("other-0002", '{"record": "other"}'), ("bad-0003", "{")):
        (flights / name).mkdir()
        if about is not None:
            (flights / name / ABOUT).write_text(about)
    before = sorted(flights.iterdir())
    for path in before:
        os.utime(path, (1e9, 1e9))
    remove_old(flights, None, limits(0.0), NOW.timestamp())
    assert sorted(flights.iterdir()) == before
    assert (elsewhere / CONTROL).exists()


def test_a_record_with_a_report_and_folders_in_it_goes_whole(tmp_path: Path) -> None:
    folder = flight(tmp_path / "flights", 1)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("mine")
    (folder / "more").mkdir()
    (folder / "more" / "page.html").write_text("a page")
    (folder / "link").symlink_to(tmp_path / "mine")
    remove_old(tmp_path / "flights", None, limits(0.0), NOW.timestamp())
    assert left(tmp_path / "flights") == []
    assert (tmp_path / "mine" / "notes.txt").exists()


def test_a_new_flight_is_after_all_others_whatever_the_clock_says(tmp_path: Path) -> None:
    flight(tmp_path, 41)
    (tmp_path / "notes-99").mkdir()
    early = new_folder(tmp_path, datetime(1970, 1, 1, tzinfo=UTC))
    (early / ABOUT).write_text(json.dumps({"record": KIND}))
    late = new_folder(tmp_path, NOW)
    assert (early.name, late.name) == ("19700101T000000Z-0042", "20260301T123005Z-0043")
    assert new_folder(tmp_path, NOW).name == "20260301T123005Z-0044"  # the last one says not yet what it is


@pytest.mark.parametrize(
    ("folder", "environ", "wanted"),
    [
        ("/a/b", {"STATE_DIRECTORY": "/var/lib/x"}, "/a/b"),
        ("", {"STATE_DIRECTORY": "/var/lib/x", "XDG_STATE_HOME": "/s"}, "/var/lib/x/flights"),
        ("", {"STATE_DIRECTORY": "/var/lib/x:/var/lib/y"}, "/var/lib/x/flights"),
        ("", {"XDG_STATE_HOME": "/s", "HOME": "/h"}, "/s/mscf-companion/flights"),
        ("", {"XDG_STATE_HOME": "", "HOME": "/h"}, "/h/.local/state/mscf-companion/flights"),
    ],
)
def test_flights_are_where_the_configuration_or_the_system_says(
    folder: str, environ: dict[str, str], wanted: str
) -> None:
    assert flights_folder(RecordConfig(folder=folder), environ) == Path(wanted)


def test_room_is_made_before_it_is_looked_for(tmp_path: Path) -> None:
    flight(tmp_path, 1, size=900_000)
    running = flight(tmp_path, 2, size=900_000)
    make_room(tmp_path, running, limits(1.0), NOW.timestamp())
    assert left(tmp_path) == [2]


def test_a_running_flight_that_is_alone_too_large_is_refused_more_room(tmp_path: Path) -> None:
    running = flight(tmp_path, 1, size=1_100_000)
    with pytest.raises(NoRoomError, match=r"holds 1 MB, record\.max_total_mb = 1: fly shorter") as raised:
        make_room(tmp_path, running, limits(1.0), NOW.timestamp())
    assert raised.value.brief == "record.max_total_mb reached"
    assert left(tmp_path) == [1]


def test_the_disk_keeps_what_is_to_stay_free(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    usage = shutil.disk_usage("/")
    config = RecordConfig(min_free_mb=2.0)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage._replace(free=2_000_000))
    check_free(tmp_path, config)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage._replace(free=1_999_999))
    with pytest.raises(NoRoomError, match=r"has 2 MB free, record\.min_free_mb = 2: free some") as raised:
        check_free(tmp_path, config)
    assert str(tmp_path) in str(raised.value)
    assert raised.value.errno == errno.ENOSPC
    assert raised.value.brief == "below record.min_free_mb"


# ------------------------------------------------------------------------------------------------ a trial
def test_a_trial_leaves_nothing_behind_whether_the_folder_is_there_or_not(tmp_path: Path) -> None:
    config = RecordConfig(min_free_mb=1.0)
    assert try_folder(tmp_path / "deep" / "flights", config) > 1
    assert list(tmp_path.iterdir()) == []
    flight(tmp_path / "flights", 1)
    assert try_folder(tmp_path / "flights", config) > 1
    assert left(tmp_path / "flights") == [1]


def test_a_trial_in_a_file_or_with_too_little_room_fails(tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("mine")
    with pytest.raises(NotADirectoryError):
        try_folder(tmp_path / "taken" / "flights", RecordConfig(min_free_mb=1.0))
    with pytest.raises(NoRoomError):
        try_folder(tmp_path / "flights", RecordConfig(min_free_mb=1e6))
    assert [path.name for path in tmp_path.iterdir()] == ["taken"]


# ------------------------------------------------------------------------------------------------ what a record is of
def test_where_no_record_is_those_below_are_named_the_newest_first(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"is no flight record: about.json: No such file or directory$"):
        about_of(tmp_path)
    (tmp_path / "flights" / "other").mkdir(parents=True)
    (tmp_path / "flights" / "other" / ABOUT).write_text("{}")
    one = flight(tmp_path / "flights", 9)
    for folder in (tmp_path, tmp_path / "flights"):
        with pytest.raises(UsageError) as raised:
            about_of(folder)
        assert str(raised.value).endswith(f"; give a record below it: {one}")
    for number in (10, 11, 12):
        flight(tmp_path / "flights", number)
    with pytest.raises(UsageError) as raised:
        about_of(tmp_path)
    said = str(raised.value).partition("below it: ")[2]
    assert [int(path[-4:]) for path in said.partition(", the newest of 4")[0].split(" or ")] == [12, 11, 10]
    assert about_of(one)["record"] == KIND
