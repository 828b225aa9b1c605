import dataclasses
import json
import math
import re
import tomllib
from pathlib import Path
from typing import Any, get_args, get_type_hints

import pytest

import companion
from companion.config import Config, _cross_checks, _section, parse, read, warnings, without_passwords
from companion.errors import ConfigError

EXAMPLES = sorted((Path(companion.__file__).parent / "examples").glob("*.toml"))
SECTIONS: dict[str, type] = get_type_hints(Config)
FIELDS: list[tuple[str, Any]] = [
    (table, field) for table, kind in SECTIONS.items() for field in dataclasses.fields(kind)
]
NUMBERS = [(table, field) for table, field in FIELDS if type(field.default) in {int, float}]
WORDS = [(table, field) for table, field in FIELDS if field.metadata["choices"]]
LISTS = [(table, field) for table, field in FIELDS if field.metadata["count"]]
VALID = "[camera]\nhorizontal_fov_deg = 70\n"


def named(rows: list[tuple[str, Any]]) -> list[Any]:
    return [pytest.param(table, field, id=f"{table}.{field.name}") for table, field in rows]


def written(values: dict[str, dict[str, object]]) -> str:
    """The values as a TOML text, on top of a configuration that is valid."""
    tables = {"camera": {"horizontal_fov_deg": 70, **values.get("camera", {})}} | {
        table: keys for table, keys in values.items() if table != "camera"
    }
    lines = []
    for table, keys in tables.items():
        lines.append(f"[{table}]")
        for key, value in keys.items():
            is_number = type(value) in {int, float}
            lines.append(f"{key} = {value!r}" if is_number else f"{key} = {json.dumps(value)}")
    return "\n".join(lines)


def refusal(text: str) -> str:
    with pytest.raises(ConfigError) as caught:
        parse(text)
    said = str(caught.value)
    assert len(said.splitlines()) == 1
    return said


# ------------------------------------------------------------------------------------------- single values
def test_every_field_has_one_rule_and_a_default_that_obeys_it() -> None:
    for table, field in FIELDS:
        rule = field.metadata
        if (table, field) in NUMBERS:
            assert rule["low"] <= field.default <= rule["high"], field.name
        elif field.metadata["choices"]:
            assert field.default in rule["choices"], field.name
        elif field.metadata["count"]:
            assert len(field.default) in rule["count"], field.name
        else:
            assert type(field.default) in {bool, str}, field.name


@pytest.mark.parametrize(("table", "field"), named(NUMBERS))
def test_a_number_at_its_limits_is_taken_as_it_is(table: str, field: Any) -> None:
    for value in (field.metadata["low"], field.metadata["high"]):
        taken = getattr(_section(table, SECTIONS[table], {field.name: value}), field.name)
        assert taken == value
        assert type(taken) is type(field.default)


@pytest.mark.parametrize(("table", "field"), named(NUMBERS))
def test_a_number_beyond_its_limits_is_refused_with_value_and_range(table: str, field: Any) -> None:
    low, high = field.metadata["low"], field.metadata["high"]
    if isinstance(field.default, int):
        beyond: tuple[float, ...] = (low - 1, high + 1)
    else:
        beyond = (math.nextafter(low, -math.inf), math.nextafter(high, math.inf))
    for value in (*beyond, math.inf, -math.inf, math.nan, -(10**400), 10**400):
        said = refusal(written({table: {field.name: value}}))
        assert said.startswith(f"{table}.{field.name} = {value!r} must be")
        assert said.endswith(f"in {low}..{high}")


@pytest.mark.parametrize(("table", "field"), named(FIELDS))
def test_a_value_of_another_type_is_refused_by_its_name(table: str, field: Any) -> None:
    wrong: list[object] = [{}, [[]], ["1", 2, 3, 4]]
    wrong += [] if isinstance(field.default, str) else ["text"]
    wrong += [] if isinstance(field.default, bool) else [True]
    wrong += [] if type(field.default) in {int, float} else [1]
    wrong += [1.5] if isinstance(field.default, int) else []
    for value in wrong:
        text = f"[{table}]\n{field.name} = {'{}' if value == {} else json.dumps(value)}"
        assert refusal(text).startswith(f"{table}.{field.name} = {value!r} must be"), value


def test_a_date_is_no_value_of_any_key() -> None:
    assert refusal("[loop]\nrate_hz = 2026-04-01").startswith("loop.rate_hz = datetime.date(2026, 4, 1) must be")


@pytest.mark.parametrize(("table", "field"), named(WORDS))
def test_a_word_is_one_of_the_choices(table: str, field: Any) -> None:
    for word in field.metadata["choices"]:
        assert getattr(_section(table, SECTIONS[table], {field.name: word}), field.name) == word
        said = refusal(written({table: {field.name: word + "x"}}))
        assert said.startswith(f"{table}.{field.name} = {word + 'x'!r} is unknown: choose ")
        assert repr(word) in said


@pytest.mark.parametrize(("table", "field"), named(LISTS))
def test_a_list_has_as_many_finite_numbers_as_its_rule_says(table: str, field: Any) -> None:
    counts = field.metadata["count"]
    for count in range(max(counts) + 2):
        if count in counts:
            taken = getattr(_section(table, SECTIONS[table], {field.name: [1] * count}), field.name)
            (kind, _) = get_args(get_type_hints(SECTIONS[table])[field.name])
            assert taken == (kind(1),) * count
            assert all(type(item) is kind for item in taken)
        else:
            assert "must be a list of" in refusal(written({table: {field.name: [1] * count}}))
    for item in (math.nan, math.inf, 10**400, "1", True):
        with pytest.raises(ConfigError, match="must be a list of"):
            _section(table, SECTIONS[table], {field.name: [1, 1, 1, item]})


def test_the_items_of_a_list_are_in_its_range() -> None:
    assert parse(written({"ground": {"system_ids": [1, 255]}})).ground.system_ids == (1, 255)
    for item in (0, 256, 1.0):
        said = refusal(written({"ground": {"system_ids": [255, item]}}))
        assert said == f"ground.system_ids[1] = {item!r} must be a whole number in 1..255"


# ------------------------------------------------------------------------------------------- names
@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[folow]", "unknown table, 'folow': did you mean [follow]?"),
        (
            "[follow]\nyaw_gian_per_s = 1",
            "unknown key in [follow], 'yaw_gian_per_s': did you mean follow.yaw_gain_per_s?",
        ),
        ("[loop]\nzzz = 1", "unknown key in [loop], 'zzz': valid are rate_hz"),
        ("camera = 3", "camera = 3 stands outside a table: write it as a key of one, below [camera]"),
        ('[follow]\n"a\\nb" = 1', r"unknown key in [follow], 'a\nb': valid are mode, "),
        ('["a\\nb"]', r"unknown table, 'a\nb': valid are camera, tracker, "),
        ("[camera\n", "not valid TOML: "),
        ("[loop]\nrate_hz = 20\nrate_hz = 30", "not valid TOML: "),
    ],
)
def test_a_name_that_does_not_exist_is_refused_with_the_nearest_one(text: str, said: str) -> None:
    assert refusal(text).startswith(said)


# ------------------------------------------------------------------------------------------- several values
# one row for each row of _cross_checks, in its order
CONTRADICTIONS: list[tuple[dict[str, dict[str, object]], str]] = [
    ({"camera": {"focal_px": 900}}, "camera: give one of horizontal_fov_deg and focal_px"),
    ({"select": {"at_start": "box"}}, 'select.at_start = "box" needs select.box'),
    ({"select": {"box": [5, 5, 10, 0]}}, "width and height must be above 0"),
    ({"limits": {"floor_m": 60, "ceiling_m": 60}}, "limits.floor_m = 60 must be below limits.ceiling_m = 60"),
    ({"follow": {"yaw_gain_per_s": 1.58, "delay_ms": 1000}}, "= 1.58 s/s is unstable from 1.57: lower the gain"),
    ({"follow": {"approach_gain_per_s": 0.61}}, "follow.retreat_gain_per_s = 0.6 must not be below"),
    ({"follow": {"range_m": 2.9}}, "follow.range_m = 2.9 must be 0 or in 3..200"),
    ({"follow": {"mode": "follow"}, "camera": {"mount_roll_deg": 90}}, "must be within 45 of 0 or 180"),
    ({"follow": {"mode": "overhead"}, "camera": {"mount_pitch_deg": -69.9}}, "= -69.9 must be in -90..-70"),
    ({"camera": {"mount_pitch_deg": -75.1}}, '-75.1 must be in -75..45, or follow.mode "overhead"'),
    (
        {"loss": {"give_up_after_s": 3, "hold_after_s": 3}},
        "loss.give_up_after_s = 3 must be above loss.hold_after_s = 3",
    ),
    ({"loss": {"search_after_s": 0.6}}, "loss.search_after_s = 0.6 must be 0 or above loss.hold_after_s = 0.6"),
    ({"limits": {"yaw_rate_dps": 14}}, "must not be above limits.yaw_rate_dps = 14"),
    ({"select": {"centre_share": 0.01}, "camera": {"height_px": 360}}, "nothing so small is tracked"),
    (
        {"link": {"device": "/dev/serial0", "baud": 9600}},
        "link.baud = 9600 is too slow for 20 setpoints a second: give 52000 or more, or lower loop.rate_hz",
    ),
    ({"ground": {"camera_component": 99}}, "must be 0 for none, or a camera's id in 100..105"),
    ({"ground": {"engage_command": 31000}}, "must be 0 for none, or one of 31010..31014"),
    ({"link": {"component_id": 101}, "ground": {"camera_component": 101}}, "are both 101: give two different ids"),
    ({"ground": {"stream_uri": "http://10.0.0.1/"}}, "must begin with rtsp://, udp://, tcp://, mpegts://"),
    ({"ground": {"stream_uri": "rtsp://" + "x" * 154}}, "is 161 bytes long: MAVLink carries 160"),
    (
        {"landing": {"send_target": True}, "camera": {"mount_pitch_deg": -60}},
        "landing.send_target needs a camera that looks down: camera.mount_pitch_deg = -60 must be in -90..-70",
    ),
    ({"rc": {"switch_channel": 4}}, "must be four different channels"),
]


def test_every_cross_check_has_a_row_here() -> None:
    assert len(_cross_checks(parse(VALID))) == len(CONTRADICTIONS)


@pytest.mark.parametrize(("row", "values", "said"), [(k, *case) for k, case in enumerate(CONTRADICTIONS)])
def test_two_values_that_contradict_each_other_are_refused_by_the_check_for_them(
    row: int, values: dict[str, dict[str, object]], said: str
) -> None:
    assert said in refusal(written(values))
    sections = {"camera": {"horizontal_fov_deg": 70}} | values
    sections["camera"] = {"horizontal_fov_deg": 70, **values.get("camera", {})}
    config = Config(**{table: _section(table, SECTIONS[table], keys) for table, keys in sections.items()})
    assert [k for k, (is_bad, _) in enumerate(_cross_checks(config)) if is_bad] == [row]


@pytest.mark.parametrize(
    "values",
    [
        {"camera": {"horizontal_fov_deg": 0, "focal_px": 900}},
        {"select": {"at_start": "box", "box": [0, 0, 1, 1]}},
        {"limits": {"floor_m": 59.9, "ceiling_m": 60}},
        {"follow": {"yaw_gain_per_s": 1.57, "delay_ms": 1000}},
        {"follow": {"approach_gain_per_s": 0.6}},
        {"follow": {"range_m": 3}},
        {"follow": {"mode": "follow"}, "camera": {"mount_roll_deg": 180}},
        {"follow": {"mode": "follow"}, "camera": {"mount_roll_deg": -45}},
        {"follow": {"mode": "overhead"}, "camera": {"mount_pitch_deg": -70, "mount_roll_deg": 90}},
        {"camera": {"mount_pitch_deg": -75}},
        {"loss": {"give_up_after_s": 3.1, "hold_after_s": 3}},
        {"loss": {"search_after_s": 0.7}},
        {"limits": {"yaw_rate_dps": 15}},
        {"rc": {"switch_channel": 5}},
        {"ground": {"camera_component": 0, "engage_command": 31014}},
        {"ground": {"camera_component": 105, "stream_uri": "rtsp://" + "x" * 153}},
        {"follow": {"mode": "overhead"}, "landing": {"send_target": True}, "camera": {"mount_pitch_deg": -70}},
        {"landing": {"send_target": True}, "gimbal": {"axes": "pitch"}},
    ],
)
def test_values_that_just_agree_are_taken(values: dict[str, dict[str, object]]) -> None:
    parse(written(values))


def test_neither_angle_nor_focal_length_is_refused_as_both_are() -> None:
    assert "give one of" in refusal("")


def test_the_focal_length_follows_from_the_angle_of_view() -> None:
    assert parse("[camera]\nhorizontal_fov_deg = 90\nwidth_px = 1000").focal_px == pytest.approx(500)
    assert parse("[camera]\nfocal_px = 812.5").focal_px == 812.5


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({}, []),
        ({"follow": {"yaw_gain_per_s": 2.6, "delay_ms": 200}}, []),
        ({"follow": {"yaw_gain_per_s": 2.61, "delay_ms": 200}}, ["use a gain of at most 2.6"]),
        ({"follow": {"mode": "follow"}}, ["follow.target_height_m is not given"]),
        ({"follow": {"mode": "follow", "target_height_m": 1.7}}, []),
        ({"follow": {"mode": "follow"}, "camera": {"mount_pitch_deg": -10}}, []),
        ({"camera": {"latency_ms": 300}}, []),
        ({"camera": {"latency_ms": 301}}, ["camera.latency_ms = 301"]),
        ({"loop": {"rate_hz": 19}}, ["loop.rate_hz = 19"]),
        ({"link": {"device": "udpin:0.0.0.0:14540"}}, ["whoever reaches this port can play the autopilot"]),
        ({"link": {"device": "udpin:127.0.0.1:14540"}}, []),
        ({"link": {"device": "tcp:127.0.0.1:5760", "baud": 9600}}, []),
    ],
)
def test_what_is_likely_not_meant_is_warned_of_in_a_line(values: dict[str, dict[str, object]], said: list[str]) -> None:
    found = warnings(parse(written(values)))
    assert len(found) == len(said)
    assert all(part in line and len(line.splitlines()) == 1 for part, line in zip(said, found, strict=True))


def test_by_default_nothing_moves_by_itself() -> None:
    config = parse(VALID)
    assert (config.select.at_start, config.engage.auto, config.follow.mode) == ("nothing", False, "spotlight")
    assert config.follow.vertical_gain_per_s == 0
    assert config.loss.on_give_up == "hold"


# ------------------------------------------------------------------------------------------- files
def test_a_file_that_cannot_be_read_is_refused_with_its_path(tmp_path: Path) -> None:
    latin = tmp_path / "latin.toml"
    latin.write_bytes(b"# caf\xe9\n")
    wrong = tmp_path / "wrong.toml"
    wrong.write_text("[loop]\nrate_hz = 5\n", encoding="utf-8")
    for path, said in (
        (tmp_path / "none.toml", "cannot be read: No such file or directory; give another file with -c"),
        (tmp_path, "cannot be read: Is a directory"),
        (latin, "is not UTF-8 text: save it as such"),
        (wrong, "loop.rate_hz = 5 must be a number in 10..50"),
    ):
        with pytest.raises(ConfigError) as caught:
            read(path)
        assert str(caught.value).startswith(str(path))
        assert said in str(caught.value)
        assert len(str(caught.value).splitlines()) == 1


# ------------------------------------------------------------------------------------------- examples
def explained(path: Path) -> dict[str, str]:
    """Comment above each `table.key` of an example; keys without a comment between them share one."""
    table, comment, is_open, found = "", "", False, {}
    for line in path.read_text(encoding="utf-8").splitlines():
        if line.startswith("#"):
            comment, is_open = (comment + " " if is_open else "") + line.removeprefix("#").strip(), True
        elif line.startswith("["):
            table, comment = line.strip("[]"), ""
        elif line:
            found[f"{table}.{line.split(' = ')[0]}"] = comment
            is_open = False
    return found


def test_there_is_an_example_for_each_kind_of_autopilot() -> None:
    assert [path.name for path in EXAMPLES] == ["copter.toml", "px4.toml"]


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.name)
def test_an_example_has_every_key_in_order_with_its_range_and_default(path: Path) -> None:
    comments = explained(path)
    assert list(comments) == [f"{table}.{field.name}" for table, field in FIELDS]
    for table, field in FIELDS:
        comment, rule = comments[f"{table}.{field.name}"], field.metadata
        assert comment.endswith((".", ":")), field.name
        if (table, field) in NUMBERS:
            assert f"{rule['low']}..{rule['high']}" in comment, field.name
        for word in rule["choices"]:
            assert f'"{word}"' in comment, field.name
        default = {True: "true", False: "false"}.get(field.default) if isinstance(field.default, bool) else None
        default = default or (str(list(field.default)) if rule["count"] else None)
        default = default or (f"{field.default:g}" if type(field.default) is float else str(field.default))
        assert re.search(rf"Left out: ([^:.]*\W)?{re.escape(default)}(?!\.?\d)", comment), field.name


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.name)
def test_an_example_is_valid_safe_and_without_warning(path: Path) -> None:
    config = read(path)
    assert warnings(config) == ()
    changed = {
        f"{table}.{key}"
        for table, keys in tomllib.loads(path.read_text(encoding="utf-8")).items()
        for key in keys
        if getattr(getattr(config, table), key) != getattr(SECTIONS[table](), key)
    }
    # what every user has to set is set; all else is as it would be without the line
    assert changed == {"camera.source", "camera.horizontal_fov_deg", "camera.mount_pitch_deg", "link.device"}


@pytest.mark.parametrize(
    ("uri", "kept"),
    [
        ("rtsp://user:secret@10.0.0.2/video", "rtsp://10.0.0.2/video"),
        ("rtsp://user:sec@ret@10.0.0.2/video", "rtsp://10.0.0.2/video"),
        ("rtsp://10.0.0.2/video", "rtsp://10.0.0.2/video"),
        ("rtsp://10.0.0.2/video?password=secret", "rtsp://10.0.0.2/video"),
        ("tcp://user:secret@10.0.0.2:5000", "tcp://10.0.0.2:5000"),
        ("rtsp://10.0.0.2/a@b", "rtsp://10.0.0.2/a@b"),
        ("udp://@:5600", "udp://@:5600"),
        ("", ""),
    ],
)
def test_what_is_kept_of_a_configuration_has_no_password_in_it(uri: str, kept: str) -> None:
    config = parse(written({"ground": {"stream_uri": uri}}))
    assert without_passwords(config).ground.stream_uri == kept
