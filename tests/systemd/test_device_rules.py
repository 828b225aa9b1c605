"""Which device gets which name, by reading the rules as udev does."""

import fnmatch
import re
import shutil
import subprocess
from collections.abc import Mapping
from pathlib import Path

import pytest

RULES = Path(__file__).resolve().parents[2] / "systemd" / "70-mscf-companion.rules"
LINE = re.compile(r'(?P<key>[A-Z]+(?:\{[^}]+\})?)(?P<operator>==|!=|\+=|=)"(?P<value>[^"]*)"(?:, |$)')
FIRST_PORT = {"ENV{ID_USB_INTERFACE_NUM}": "00"}


def parsed(line: str) -> list[tuple[str, str, str]]:
    """(key, operator, value) of every part of a line, which must consist of nothing else."""
    parts = [(found["key"], found["operator"], found["value"]) for found in LINE.finditer(line)]
    assert "".join(found[0] for found in LINE.finditer(line)) == line, line
    return parts


def applied(device: Mapping[str, str]) -> dict[str, str]:
    """What the rules assign to a device of these keys (udev(7): matches, assignments, GOTO and LABEL)."""
    known = {"ACTION": "add", **device}
    given: dict[str, str] = {}
    awaited = ""
    for line in RULES.read_text().splitlines():
        if not line or line.startswith("#"):
            continue
        parts = parsed(line)
        if awaited:
            awaited = "" if ("LABEL", "=", awaited) in parts else awaited
            continue
        matches = [(key, operator, value) for key, operator, value in parts if operator in {"==", "!="}]
        if all(
            any(fnmatch.fnmatchcase(known.get(key, ""), one) for one in value.split("|")) == (operator == "==")
            for key, operator, value in matches
        ):
            for key, operator, value in parts:
                if key == "GOTO":
                    awaited = value
                elif operator in {"=", "+="}:
                    known[key] = given[key] = value
    assert not awaited, f"no label {awaited}"
    return given


def camera(**changes: str) -> dict[str, str]:
    keys = {"SUBSYSTEM": "video4linux", "ATTR{index}": "0", "ENV{ID_V4L_CAPABILITIES}": ":capture:"}
    return keys | {f"ATTR{{{key}}}" if key == "index" else f"ENV{{{key}}}": value for key, value in changes.items()}


def port(vendor_product: str, interface: str = "00") -> dict[str, str]:
    vendor, product = vendor_product.split(":")
    ids = {"ATTRS{idVendor}": vendor, "ATTRS{idProduct}": product}
    return {"SUBSYSTEM": "tty", "ENV{ID_USB_INTERFACE_NUM}": interface, **ids}


def test_a_camera_gets_its_name_and_group() -> None:
    assert applied(camera()) == {"GROUP": "video", "MODE": "0660", "SYMLINK": "follow-cam"}


@pytest.mark.parametrize(
    "device",
    [
        camera(index="1"),  # the metadata node beside it
        camera(ID_V4L_CAPABILITIES=":"),  # metadata or statistics
        camera(ID_V4L_CAPABILITIES=":video_output:"),  # a codec or a loopback's input
        camera() | {"ACTION": "remove"},
    ],
)
def test_what_gives_no_picture_gets_no_name(device: Mapping[str, str]) -> None:
    assert applied(device).get("SYMLINK") is None


@pytest.mark.parametrize(
    "vendor_product",
    [
        "26ac:0011",  # Pixhawk 1
        "26ac:0032",  # FMU v5
        "3185:0035",  # FMU v6X
        "3185:0039",  # ARK v6X
        "2dae:1016",  # Cube Orange
        "2dae:1058",  # Cube Orange+
        "3162:004b",  # Durandal
        "3162:0053",  # Pixhawk 6C
        "3163:004c",  # CUAV
        "1209:5740",  # ArduPilot, one port
        "1209:5741",  # ArduPilot, two ports
        "0483:5740",  # ArduPilot, older
        "0483:a32f",  # ModalAI FC v1
        "0483:a330",  # ModalAI FC v2
    ],
)
def test_a_flight_controller_gets_its_name_on_the_first_port_only(vendor_product: str) -> None:
    first = applied(port(vendor_product))
    assert first["SYMLINK"] == "follow-fc"
    second = applied(port(vendor_product, interface="02"))
    assert "SYMLINK" not in second
    for given in (first, second):
        assert (given["GROUP"], given["MODE"]) == ("dialout", "0660")
        assert given["ENV{ID_MM_PORT_IGNORE}"] == "1"


@pytest.mark.parametrize(
    "device",
    [
        port("26ac:0015"),  # PX4Flow, a sensor of the same vendor
        port("1209:0001"),  # any of the many other things of pid.codes
        port("0483:374b"),  # ST-Link
        port("10c4:ea60"),  # telemetry radio: the other end may be any vehicle
        {"SUBSYSTEM": "tty"},  # UART of the board
        port("2dae:1016") | {"SUBSYSTEM": "usb"},
        port("2dae:1016") | {"ACTION": "remove"},
    ],
)
def test_other_devices_are_left_as_they_are(device: Mapping[str, str]) -> None:
    assert applied(device) == {}


def test_udev_reads_the_rules() -> None:
    udevadm = shutil.which("udevadm")
    if udevadm is None:
        pytest.skip("no udevadm")
    said = subprocess.run([udevadm, "--version"], capture_output=True, text=True, check=True).stdout
    if int(re.match(r"\d+", said)[0]) < 254:  # type: ignore[index]
        pytest.skip("udevadm verify came with systemd 254")
    done = subprocess.run([udevadm, "verify", str(RULES)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
