"""The camera component of `mscf-companion run`, as a ground station sees it that is none of ours: MAVSDK, over UDP."""

import json
import math
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from companion.control_socket import ask
from mscf import Box
from sim.camera import observe
from sim.realtime import fake_autopilot
from sim.scenarios import SCENARIOS
from sim.server import CameraServer, RealTime, UdpEnd
from sim.stages import stage

mavsdk = pytest.importorskip("mavsdk", minversion="4.1", reason="mavsdk 4.1 or newer is not installed")
camera_plugin = pytest.importorskip("mavsdk.plugins.camera")
direct_plugin = pytest.importorskip("mavsdk.plugins.mavlink_direct")

COMPANION = str(Path(sys.executable).with_name("mscf-companion"))
DEADLINE_S = 20.0  # of every wait: far beyond what a busy machine needs
END_S = 10.0  # in which systemd wants a service to have ended
WIDTH_PX, HEIGHT_PX, FOCAL_PX = 320, 240, 277.0
CAMERA, GROUND_STATION, STRANGER = 100, 255, 77  # a component; system ids, of which the last may not select
STREAM = "rtsp://192.0.2.1:8554/camera"
STATUS = "CAMERA_TRACKING_IMAGE_STATUS"
RADIUS = 20 / WIDTH_PX  # of a click

CONFIG = f"""
[camera]
source = "{{source}}"
width_px = {WIDTH_PX}
height_px = {HEIGHT_PX}
focal_px = {FOCAL_PX}
mount_pitch_deg = -30
[link]
device = "{{device}}"
[control]
socket = "{{socket}}"
[ground]
stream_uri = "{STREAM}"
[record]
enabled = false
"""


def until(what: str, is_there: Callable[[], Any]) -> Any:
    """Poll until something is there, and return it."""
    end_s = time.monotonic() + DEADLINE_S
    while not (found := is_there()):
        assert time.monotonic() < end_s, f"waited {DEADLINE_S:g} s for {what}"
        time.sleep(0.01)
    return found


def in_pixels(status: dict[str, Any]) -> Box:
    """The box of a CAMERA_TRACKING_IMAGE_STATUS."""
    x, y = status["rec_top_x"] * WIDTH_PX, status["rec_top_y"] * HEIGHT_PX
    return Box(x, y, status["rec_bottom_x"] * WIDTH_PX - x, status["rec_bottom_y"] * HEIGHT_PX - y)


class Vehicle(threading.Thread):
    """The application on an autopilot that hovers 14 m above a standing car, which its camera sees."""

    def __init__(self, folder: Path) -> None:
        super().__init__(name="vehicle")
        place = stage("straight", 7)
        place = replace(place, camera=replace(place.camera, size_hw=(HEIGHT_PX, WIDTH_PX), focal_px=FOCAL_PX))
        autopilot = fake_autopilot(SCENARIOS["straight"], place, "ardupilot")
        frames, end = CameraServer(folder / "frames.sock"), UdpEnd()
        self.port = int(end.device.rpartition(":")[2])
        box = observe(place.world, place.camera, place.start, 0.0).box
        assert box is not None
        self.target = box
        self._socket = folder / "control.sock"
        self._log = folder / "stderr"
        config = folder / "config.toml"
        config.write_text(CONFIG.format(source=frames.source, device=end.device, socket=self._socket))
        self._realtime = RealTime(place, autopilot, end, frames, world_s_of=lambda _: 0.0)
        self._stop_asked = threading.Event()
        with self._log.open("w") as log:
            self._process = subprocess.Popen([COMPANION, "run", "-c", str(config)], stderr=log)

    @property
    def target_xyxy(self) -> tuple[float, float, float, float]:
        """The car's corners, as the camera protocol counts: 0..1 over the picture."""
        box = self.target
        return box.x / WIDTH_PX, box.y / HEIGHT_PX, (box.x + box.w) / WIDTH_PX, (box.y + box.h) / HEIGHT_PX

    @property
    def status(self) -> dict[str, Any]:
        """What the application itself says."""
        return ask(self._socket, {"do": "status"})

    def run(self) -> None:
        self._realtime.start()
        while not self._stop_asked.is_set():
            self._realtime.shoot()

    def wait(self) -> None:
        until("the control socket", lambda: self._process.poll() is not None or self._socket.exists())
        assert self._process.poll() is None, self._log.read_text()
        until("pictures and telemetry", lambda: self.status["height_m"] is not None)

    def end(self) -> tuple[int, str]:
        """End the application; its exit status and its log."""
        self._process.terminate()
        return self._process.wait(END_S), self._log.read_text()

    def close(self) -> None:
        self._process.kill()
        self._process.wait()
        self._stop_asked.set()
        self.join()
        self._realtime.stop()


class Ground:
    """A ground station by MAVSDK: the camera is what its camera plugin makes of it.

    It shares the application's port with the autopilot and does not hear that: parameters that it does not use are
    NaN then, as for PX4; for an ArduPilot they would be 0.
    """

    def __init__(self, port: int, system_id: int) -> None:
        self._sdk = mavsdk.Mavsdk(mavsdk.Configuration.create_manual(system_id, mavlink.MAV_COMP_ID_MISSIONPLANNER, 1))
        self._sdk.add_any_connection(f"udpout://127.0.0.1:{port}")
        until("a camera's heartbeat", lambda: any(system.has_camera() for system in self._sdk.get_systems()))
        (self.system,) = self._sdk.get_systems()
        self.camera = camera_plugin.Camera(self.system)
        self._direct = direct_plugin.MavlinkDirect(self.system)
        self.heard: list[tuple[str, dict[str, Any]]] = []  # what the camera has said
        self._direct.subscribe_message("", self._hear)

    def _hear(self, message: Any, _: Any) -> None:
        if message.component_id == CAMERA:
            self.heard.append((message.message_name, json.loads(message.fields_json)))

    @property
    def mark(self) -> int:
        """How much was heard so far."""
        return len(self.heard)

    def since(self, mark: int, name: str) -> list[dict[str, Any]]:
        return [fields for kind, fields in self.heard[mark:] if kind == name]

    def command(self, number: int, *params: float) -> int:
        """Send a COMMAND_LONG to the camera; the result that it answers with."""
        fields = {f"param{index}": value for index, value in enumerate((*params, *[0.0] * 7)[:7], 1)}
        to = {"target_system": self.system.get_system_id(), "target_component": CAMERA}
        text = json.dumps({"command": number} | to | fields)
        message = direct_plugin.MavlinkMessage("COMMAND_LONG", fields_json=text)
        return int(json.loads(self._direct.send_command(message).fields_json)["result"])

    def request(self, name: str, number: int) -> dict[str, Any]:
        """Ask for a message once, by REQUEST_MESSAGE."""
        mark = self.mark
        assert self.command(mavlink.MAV_CMD_REQUEST_MESSAGE, number) == mavlink.MAV_RESULT_ACCEPTED
        messages: list[dict[str, Any]] = until(name, lambda: self.since(mark, name))
        return messages[0]

    def refusal(self, order: Callable[..., Any], *params: float) -> str:
        """What MAVSDK calls the answer to an order that must not be followed."""
        with pytest.raises(camera_plugin.CameraError) as refused:
            order(CAMERA, *params)
        return str(refused.value.result.name)

    def until_status(self, mark: int, flags: int) -> dict[str, Any]:
        """The first tracking status since `mark` that has just these flags."""
        found: dict[str, Any] = until(
            f"a tracking status {flags}",
            lambda: next((s for s in self.since(mark, STATUS) if s["tracking_status"] == flags), None),
        )
        return found

    def close(self) -> None:
        self._sdk.destroy()


@pytest.fixture(scope="module")
def vehicle() -> Iterator[Vehicle]:
    """One for all tests, which leave it without a target; its folder's path is short, as those of sockets must be."""
    with tempfile.TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patch:
        for name in ("HOME", "TMPDIR"):  # MAVSDK leaves folders in both
            patch.setenv(name, folder)
        flying = Vehicle(Path(folder))
        flying.start()
        try:
            flying.wait()
            yield flying
            exit_status, log = flying.end()
        finally:
            flying.close()
        assert exit_status == 0, log
        assert "Traceback" not in log


@pytest.fixture(scope="module")
def station(vehicle: Vehicle) -> Iterator[Ground]:
    connected = Ground(vehicle.port, GROUND_STATION)
    yield connected
    connected.close()


@pytest.fixture
def ground(station: Ground, vehicle: Vehicle) -> Iterator[Ground]:
    """A ground station whose camera tracks nothing, and tells nothing unasked."""
    assert vehicle.status["mode"] == "idle"
    yield station
    station.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAVLINK_MSG_ID_CAMERA_TRACKING_IMAGE_STATUS, -1)
    station.camera.track_stop(CAMERA)
    until("no target", lambda: vehicle.status["mode"] == "idle")


def test_one_camera_is_found_which_can_track_and_claims_nothing_else(ground: Ground) -> None:
    (camera,) = until("the camera", lambda: ground.camera.camera_list().cameras)
    assert camera.component_id == CAMERA
    assert camera.vendor_name
    assert camera.model_name
    assert (camera.horizontal_resolution_px, camera.vertical_resolution_px) == (WIDTH_PX, HEIGHT_PX)
    flags = ground.request("CAMERA_INFORMATION", mavlink.MAVLINK_MSG_ID_CAMERA_INFORMATION)["flags"]
    can = (
        mavlink.CAMERA_CAP_FLAGS_HAS_TRACKING_POINT
        | mavlink.CAMERA_CAP_FLAGS_HAS_TRACKING_RECTANGLE
        | mavlink.CAMERA_CAP_FLAGS_HAS_VIDEO_STREAM
    )
    cannot = (
        mavlink.CAMERA_CAP_FLAGS_CAPTURE_IMAGE
        | mavlink.CAMERA_CAP_FLAGS_HAS_MODES
        | mavlink.CAMERA_CAP_FLAGS_HAS_BASIC_ZOOM
        | mavlink.CAMERA_CAP_FLAGS_HAS_BASIC_FOCUS
    )
    assert flags & (can | cannot) == can


def test_what_the_camera_cannot_do_is_refused_as_unsupported(ground: Ground) -> None:
    orders = (ground.camera.take_photo, ground.camera.zoom_stop, ground.camera.focus_stop, ground.camera.reset_settings)
    assert [ground.refusal(order) for order in orders] == ["ACTION_UNSUPPORTED"] * len(orders)
    assert ground.command(mavlink.MAV_CMD_NAV_TAKEOFF) == mavlink.MAV_RESULT_UNSUPPORTED


@pytest.mark.parametrize(
    ("name", "number", "old_request"),
    [
        ("CAMERA_INFORMATION", 259, (521, 1)),
        ("CAMERA_SETTINGS", 260, (522, 1)),
        ("STORAGE_INFORMATION", 261, (525, 0, 1)),
        ("CAMERA_CAPTURE_STATUS", 262, (527, 1)),
        ("VIDEO_STREAM_INFORMATION", 269, (2504, 0)),
        ("VIDEO_STREAM_STATUS", 270, (2505, 0)),
    ],
)
def test_what_the_camera_is_and_does_is_told_on_either_request(
    ground: Ground, name: str, number: int, old_request: tuple[int, ...]
) -> None:
    asked = ground.request(name, number)
    mark = ground.mark
    assert ground.command(*old_request) == mavlink.MAV_RESULT_ACCEPTED
    (asked_as_of_old, *_) = until(name, lambda: ground.since(mark, name))
    asked.pop("time_boot_ms", None)
    assert asked == {key: asked_as_of_old[key] for key in asked}


def test_storage_capture_and_mode_say_that_nothing_is_recorded(ground: Ground) -> None:
    ground.request("STORAGE_INFORMATION", mavlink.MAVLINK_MSG_ID_STORAGE_INFORMATION)
    captured = ground.request("CAMERA_CAPTURE_STATUS", mavlink.MAVLINK_MSG_ID_CAMERA_CAPTURE_STATUS)
    ground.request("CAMERA_SETTINGS", mavlink.MAVLINK_MSG_ID_CAMERA_SETTINGS)
    assert (captured["image_status"], captured["video_status"]) == (0, 0)
    storage = until("both of the storage's messages", lambda: _storage(ground))
    assert (storage.video_on, storage.photo_interval_on) == (False, False)
    assert 0 <= storage.used_storage_mib + storage.available_storage_mib <= storage.total_storage_mib
    until("video mode", lambda: ground.camera.get_mode(CAMERA) == camera_plugin.Mode.VIDEO)


def _storage(ground: Ground) -> Any:
    try:
        return ground.camera.get_storage(CAMERA)
    except camera_plugin.CameraError:  # not known yet
        return None


def test_the_video_stream_is_the_configured_one_and_shows_what_is_tracked(ground: Ground) -> None:
    ground.request("VIDEO_STREAM_INFORMATION", mavlink.MAVLINK_MSG_ID_VIDEO_STREAM_INFORMATION)
    stream = until(
        "the stream", lambda: (info := ground.camera.get_video_stream_info(CAMERA)).settings.uri and info.settings
    )
    assert stream.uri == STREAM
    # a click is told relative to the picture that the operator sees: it must have the tracked one's shape
    assert (stream.horizontal_resolution_pix, stream.vertical_resolution_pix) == (WIDTH_PX, HEIGHT_PX)
    assert stream.horizontal_fov_deg == pytest.approx(math.degrees(2 * math.atan(WIDTH_PX / 2 / FOCAL_PX)), abs=0.6)


def test_a_rectangle_is_tracked_and_told_until_it_is_stopped(ground: Ground, vehicle: Vehicle) -> None:
    mark = ground.mark
    assert ground.camera.track_rectangle(CAMERA, *vehicle.target_xyxy) == camera_plugin.CameraResult.SUCCESS
    status = ground.until_status(mark, mavlink.CAMERA_TRACKING_STATUS_FLAGS_ACTIVE)  # unasked: a change of state
    assert status["tracking_mode"] == mavlink.CAMERA_TRACKING_MODE_RECTANGLE
    assert status["target_data"] & mavlink.CAMERA_TRACKING_TARGET_DATA_IN_STATUS
    assert in_pixels(status).iou(vehicle.target) > 0.5
    assert vehicle.status["mode"] == "tracking"
    assert Box(*vehicle.status["box"]).iou(vehicle.target) > 0.5

    mark = ground.mark
    ground.camera.track_stop(CAMERA)
    ground.until_status(mark, mavlink.CAMERA_TRACKING_STATUS_FLAGS_IDLE)
    assert vehicle.status["mode"] == "idle"


def test_a_point_is_tracked_with_a_box_around_it(ground: Ground, vehicle: Vehicle) -> None:
    x, y = vehicle.target.center_xy
    mark = ground.mark
    ground.camera.track_point(CAMERA, x / WIDTH_PX, y / HEIGHT_PX, RADIUS)
    ground.until_status(mark, mavlink.CAMERA_TRACKING_STATUS_FLAGS_ACTIVE)
    assert vehicle.status["mode"] == "tracking"
    assert Box(*vehicle.status["box"]).iou(vehicle.target) > 0.5  # a square of the click's radius has 0.37


def test_the_status_is_streamed_at_the_asked_interval_and_no_longer(ground: Ground, vehicle: Vehicle) -> None:
    interval, number = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAVLINK_MSG_ID_CAMERA_TRACKING_IMAGE_STATUS
    ground.camera.track_rectangle(CAMERA, *vehicle.target_xyxy)
    assert ground.command(interval, number, 200_000) == mavlink.MAV_RESULT_ACCEPTED
    mark = ground.mark
    until("three heartbeats", lambda: len(ground.since(mark, "HEARTBEAT")) >= 3)
    heard = [name for name, _ in ground.heard[mark:]]
    first, _, third, *_ = (index for index, name in enumerate(heard) if name == "HEARTBEAT")
    assert 7 <= heard[first:third].count(STATUS) <= 12  # in two seconds of the vehicle's, whatever those of the test

    assert ground.command(interval, number, -1) == mavlink.MAV_RESULT_ACCEPTED
    mark = ground.mark
    until("two heartbeats", lambda: len(ground.since(mark, "HEARTBEAT")) >= 2)
    assert len(ground.since(mark, STATUS)) <= 1  # which was on its way


def test_a_wrong_selection_is_denied_and_leaves_the_target_alone(ground: Ground, vehicle: Vehicle) -> None:
    x0, y0, x1, y1 = vehicle.target_xyxy
    rectangles = {
        "reversed": (x1, y1, x0, y0),
        "empty": (x0, y0, x0, y1),
        "beyond the picture": (0.5, 0.5, 1.2, 0.7),
        "before the picture": (-0.2, 0.5, 0.5, 0.7),
        "no number": (math.nan, y0, x1, y1),
        "endless": (x0, y0, math.inf, y1),
        "smaller than can be tracked": (x0, y0, x0 + 1 / WIDTH_PX, y0 + 1 / HEIGHT_PX),
    }
    answers = {what: ground.refusal(ground.camera.track_rectangle, *corners) for what, corners in rectangles.items()}
    answers["point"] = ground.refusal(ground.camera.track_point, 0.5, 1.5, RADIUS)
    assert answers == dict.fromkeys([*rectangles, "point"], "DENIED")
    assert vehicle.status["mode"] == "idle"

    ground.camera.track_rectangle(CAMERA, *vehicle.target_xyxy)
    until("the target", lambda: vehicle.status["mode"] == "tracking")
    assert ground.refusal(ground.camera.track_rectangle, *rectangles["reversed"]) == "DENIED"
    assert vehicle.status["mode"] == "tracking"
    assert Box(*vehicle.status["box"]).iou(vehicle.target) > 0.5


def test_a_ground_station_that_is_not_named_sees_the_camera_and_selects_nothing(vehicle: Vehicle) -> None:
    stranger = Ground(vehicle.port, STRANGER)
    try:
        (camera,) = until("the camera", lambda: stranger.camera.camera_list().cameras)
        assert camera.component_id == CAMERA
        assert stranger.refusal(stranger.camera.track_rectangle, *vehicle.target_xyxy) == "DENIED"
        assert stranger.refusal(stranger.camera.track_point, 0.5, 0.5, RADIUS) == "DENIED"
    finally:
        stranger.close()
    assert vehicle.status["mode"] == "idle"
