"""The application: builds the objects, starts the threads, runs the command loop.

Three threads: capture, vision, and the main one with the command loop. They meet in `Latest` only. One that dies
ends the process, which systemd restarts, disengaged. Two more record, steps and video; nobody waits for them, and the
flight goes on without them.
"""

import logging
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from types import FrameType
from typing import Any

from companion.capture import Capture
from companion.config import Config
from companion.control_socket import ControlSocket
from companion.flight_folders import flights_folder
from companion.follower import Follower, Step, StepError
from companion.latest import Latest
from companion.link import Link
from companion.notify import Notifier
from companion.recorder import Recorder
from companion.signing_keeper import keeper_from
from companion.timing import Timing
from companion.types import Frame, Selection, Severity, TrackSample
from companion.vision import Vision
from mscf import Expected

logger = logging.getLogger(__name__)
WATCHDOG_EVERY_S = 1.0
STATUS_EVERY_S = 5.0
MAX_HEALTHY_AGE_S = 0.5  # of the newest frame; an older one is a camera in trouble
MAX_BEAT_AGE_S = 3.0  # a thread that has not got round for longer is stuck
FAREWELL_S = 0.2  # for a slow port to take the last words
JOIN_S = 4.0  # for a thread to end; the whole end stays below the ten seconds that systemd waits
RECORD_END_S = 1.5  # for the recorder to write what waits; what is not finished then is readable all the same
_SWITCH_S = 0.0005  # how soon the command loop gets Python's lock from the tracker
_TAKE_S = 0.2
_START_MORE_S = 15.0  # by which systemd's patience is prolonged while the port is not there
_LEVELS = {
    Severity.CRITICAL: logging.CRITICAL,
    Severity.ERROR: logging.ERROR,
    Severity.WARNING: logging.WARNING,
    Severity.NOTICE: logging.INFO,
    Severity.INFO: logging.INFO,
}

Order = tuple[Selection, Expected | None]  # what to track, and where it should be


class _VisionThread(threading.Thread):
    """Takes the newest frame, puts the newest sample."""

    def __init__(
        self,
        preset: str,
        frames: Latest[Frame],
        orders: Latest[Order],
        samples: Latest[TrackSample],
        show: Callable[[Frame, TrackSample], None] | None,
    ) -> None:
        # joined like any other, but one that is stuck in a library must not keep the process from ending
        super().__init__(name="vision", daemon=True)
        self.failure: BaseException | None = None
        self.beat: Latest[float] = Latest()
        self.stop_asked = threading.Event()
        self._vision = Vision(preset)
        self._frames, self._orders, self._samples, self._show = frames, orders, samples, show

    def run(self) -> None:
        """Body of the thread; what kills it is kept for the main thread."""
        try:
            while not self.stop_asked.is_set():
                self.beat.put(time.monotonic())
                frame = self._frames.take(_TAKE_S)
                if frame is None:
                    continue
                selection, expected = self._orders.value or (Selection(0, None), None)
                sample = self._vision.see(frame, selection, expected)
                self._samples.put(replace(sample, finished_s=time.monotonic()))
                if self._show is not None:
                    self._show(frame, sample)
        except BaseException as error:  # the thread's top: the main thread raises it again
            self.failure = error
            raise


class App:
    """One run of the application."""

    def __init__(self, config: Config, notifier: Notifier, control: ControlSocket | None) -> None:
        self._config = config
        self._notifier = notifier
        self._frames: Latest[Frame] = Latest()
        self._orders: Latest[Order] = Latest()
        self._samples: Latest[TrackSample] = Latest()
        self._stop = threading.Event()
        self._capture = Capture(config.camera, self._frames, self._stop)
        record = config.record
        self._recorder = Recorder(config, flights_folder(record, os.environ)) if record.enabled else None
        show = self._recorder.put_frame if self._recorder is not None else None
        self._vision = _VisionThread(config.tracker.preset, self._frames, self._orders, self._samples, show)
        self._keeper = keeper_from(config.signing, os.environ, time.time())
        self._follower = Follower(config, self._keeper.signing if self._keeper is not None else None)
        self._link = Link(config.link.device, config.link.baud)
        self._control = control
        self._timing = Timing()
        self._is_ready = False
        self._is_sent = True
        self._watchdog_s = self._status_s = float("-inf")
        self._counted, self._counted_s = 0, time.monotonic()  # samples seen by then
        self._frames_per_s = 0.0
        self._mode = ""
        self._notes: tuple[str, ...] = ()

    def run(self) -> int:
        """Run until SIGTERM, SIGINT or the end of a file; the exit status.

        Raises
        ------
        BaseException
            What killed a thread.
        """
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, self._on_signal)
        sys.setswitchinterval(_SWITCH_S)
        try:
            if self._recorder is not None:
                self._recorder.start()
            self._capture.start()
            self._vision.start()
            self._loop()
        finally:
            self._end()
        for thread in (self._capture, self._vision):
            if thread.failure is not None:
                raise thread.failure
        return 0

    def _on_signal(self, number: int, _: FrameType | None) -> None:
        logger.info("%s: ending", signal.Signals(number).name)
        self._stop.set()

    def _loop(self) -> None:
        """The command loop: at a fixed rate, whatever camera and tracker do."""
        period_s = 1 / self._config.loop.rate_hz
        due_s = time.monotonic()
        while not self._stop.is_set() and self._capture.failure is None and self._vision.failure is None:
            wait_s = due_s - time.monotonic()
            if wait_s > 0:
                time.sleep(wait_s)
            now_s = time.monotonic()
            self._timing.add_step(now_s - due_s)
            self._step(now_s)
            due_s += period_s
            missed = int((time.monotonic() - due_s) / period_s)
            if missed > 0:  # no catching up: setpoints of the past are worth nothing
                self._timing.overruns += missed
                due_s += missed * period_s
            if self._capture.has_ended and not self._capture.is_alive():
                logger.info("%s has ended", self._config.camera.source)
                return

    def _step(self, now_s: float) -> None:
        if self._keeper is not None:
            self._keeper.keep(time.time())
        data = self._link.read(now_s)
        commands = self._control.poll() if self._control is not None else ()
        sample = self._samples.value
        self._timing.see(sample)
        is_fresh = sample is not None and now_s - sample.captured_s <= MAX_HEALTHY_AGE_S and not sample.fault
        is_healthy = not self._capture.fault.value and is_fresh
        notices = self._recorder.notices() if self._recorder is not None else ()
        try:
            step = self._follower.step(
                now_s, data, sample, commands, is_healthy=is_healthy, is_sent=self._is_sent, notices=notices
            )
        except StepError as error:  # ends the run; which step it was is what is asked first afterwards
            if self._recorder is not None:
                self._recorder.put_failed(error.failed)
            raise
        self._is_sent = self._link.write(step.data)
        if step.control.setpoint is not None and sample is not None:
            self._timing.add_setpoint(time.monotonic() - sample.captured_s)
        self._orders.put((step.control.selection, step.control.expected))
        if self._recorder is not None:
            self._recorder.put_step(step)
        self._count(now_s)
        self._log(step)
        if self._control is not None and self._control.is_asked:
            self._control.answer(self._status(step, sample, now_s), self._timing.summary)
        self._notify(step, sample, now_s)

    def _count(self, now_s: float) -> None:
        """Frame rate of the tracker, over the last seconds."""
        if now_s - self._counted_s >= STATUS_EVERY_S:
            seen = self._samples.dropped  # all but the newest: nobody takes samples
            self._frames_per_s = (seen - self._counted) / (now_s - self._counted_s)
            self._counted, self._counted_s = seen, now_s

    def _log(self, step: Step) -> None:
        """Log on change, not per frame."""
        for text in step.texts:
            logger.log(_LEVELS[text.severity], "%s", text.text)
        for said in step.autopilot_texts:
            # what comes over the link must not look like a line of its own, with a priority of its own
            logger.info("autopilot: %s", "".join(c if c.isprintable() else "?" for c in said.text))
        mode = step.control.mode.value
        if mode != self._mode:
            logger.info("mode %s", mode)
        if step.control.notes and step.control.notes != self._notes:
            logger.info("%s: %s", mode, "; ".join(step.control.notes))
        self._mode, self._notes = mode, step.control.notes

    def _faults(self, now_s: float) -> list[str]:
        """Why the application is degraded; the first one is the most important."""
        faults = [f"link: {self._link.fault}"] if self._link.fault else []
        if not self._link.fault and not self._follower.is_connected(now_s):
            faults.append("no autopilot heard")
        if self._capture.fault.value:
            faults.append(f"camera: {self._capture.fault.value}")
        return faults

    def _status(self, step: Step, sample: TrackSample | None, now_s: float) -> dict[str, Any]:
        """What `ctl status` prints."""
        heartbeat, target = step.vehicle.heartbeat, step.control.target
        box = sample.box if sample is not None else None
        return {
            "mode": step.control.mode.value,
            "notes": list(step.control.notes),
            "texts": [text.text for text in step.texts],
            "faults": self._faults(now_s),
            "target": sample.status.name.lower() if sample is not None and sample.status is not None else "none",
            "box": [round(value, 1) for value in (box.x, box.y, box.w, box.h)] if box is not None else None,
            "confidence": round(sample.confidence, 3) if sample is not None else 0.0,
            "threat": round(sample.threat, 3) if sample is not None else 0.0,
            "range_m": round(target.fix.range_m, 1) if target is not None and target.fix is not None else None,
            "frame_seq": sample.seq if sample is not None else None,
            "frame_age_ms": round((now_s - sample.captured_s) * 1000, 1) if sample is not None else None,
            "frame_size": list(reversed(sample.size_hw)) if sample is not None else None,
            "frames_per_s": round(self._frames_per_s, 1),
            "frames_dropped": self._frames.dropped,
            "autopilot": heartbeat.autopilot.value if heartbeat is not None else None,
            "flight_mode": heartbeat.mode_name if heartbeat is not None else None,
            "is_armed": heartbeat.is_armed if heartbeat is not None else None,
            "battery_pct": step.vehicle.battery.remaining_pct if step.vehicle.battery is not None else None,
            "height_m": step.vehicle.height_m(now_s),
            "setpoint_ned_mps": step.control.setpoint.velocity_ned_mps if step.control.setpoint else None,
            "yaw_rate_radps": step.control.setpoint.yaw_rate_radps if step.control.setpoint else None,
            "link_dropped_bytes": self._link.dropped_bytes,
            **self._record_status(),
        }

    def _record_status(self) -> dict[str, Any]:
        recorder = self._recorder
        return {
            "record": str(recorder.folder) if recorder is not None and recorder.is_recording else None,
            "record_steps_dropped": recorder.steps_dropped if recorder is not None else 0,
            "record_frames_dropped": recorder.frames_dropped if recorder is not None else 0,
        }

    def _notify(self, step: Step, sample: TrackSample | None, now_s: float) -> None:
        """READY once the port is open; WATCHDOG while all threads get round; STATUS now and then."""
        if now_s - self._watchdog_s < WATCHDOG_EVERY_S:
            return
        self._watchdog_s = now_s
        if not self._is_ready:
            if self._link.fault:
                more_us = round(_START_MORE_S * 1e6)
                self._notifier.send(EXTEND_TIMEOUT_USEC=str(more_us), STATUS=f"waiting: link: {self._link.fault}")
                return
            self._is_ready = True
            self._notifier.send(READY="1")
        if all(self._is_moving(thread.beat, now_s) for thread in (self._capture, self._vision)):
            self._notifier.send(WATCHDOG="1")
        if now_s - self._status_s >= STATUS_EVERY_S:
            self._status_s = now_s
            age = f"{(now_s - sample.captured_s) * 1000:.0f} ms" if sample is not None else "none"
            faults = "; ".join(self._faults(now_s))
            line = f"{step.control.mode.value}, {self._frames_per_s:.0f} frames/s, frame age {age}"
            self._notifier.send(STATUS=f"{line}; {faults}" if faults else line)

    def _is_moving(self, beat: Latest[float], now_s: float) -> bool:
        return now_s - (beat.value or now_s) <= MAX_BEAT_AGE_S

    def _end(self) -> None:
        """Zero velocity, disengage, and let go of everything."""
        self._notifier.send(STOPPING="1")
        now_s = time.monotonic()
        farewell: tuple[bytes, ...] = ()
        try:
            farewell = self._follower.farewell(now_s)
        except Exception:  # what is said on the way here, and what is to be let go, is not to suffer by it
            logger.exception("no last words")
        self._link.flush(b"".join(farewell), FAREWELL_S)
        if self._keeper is not None:
            self._keeper.close()
        self._stop.set()
        self._vision.stop_asked.set()
        for thread in (self._capture, self._vision):
            if thread.ident is not None:
                thread.join(JOIN_S)
        if self._recorder is not None:
            self._recorder.put_farewell(now_s, farewell)
            self._recorder.end(RECORD_END_S)
        self._link.close()
        if self._control is not None:
            self._control.close()
        self._notifier.close()
