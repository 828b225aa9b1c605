"""The built-in flight keeps what it promises to a tracker's demo."""

import itertools
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from sim.camera import observe
from sim.flight import SyntheticFlight, exposure_gain
from sim.scenery import village


@pytest.fixture(scope="module")
def flight() -> SyntheticFlight:
    return SyntheticFlight()


def small(frame_count: int = 3, seed: int = 7) -> SyntheticFlight:
    return SyntheticFlight(frame_count, (90, 160), seed=seed)


def test_same_seed_gives_the_same_frames_on_every_iteration() -> None:
    first, second = small(), small()
    for frame, again, other in zip(first, first, second, strict=True):
        np.testing.assert_array_equal(frame, again)
        np.testing.assert_array_equal(frame, other)


def test_other_seed_gives_other_frames_and_another_truth() -> None:
    assert not np.array_equal(small().frame(0), small(seed=8).frame(0))
    assert small().truth != small(seed=8).truth


def test_no_global_random_numbers_are_drawn() -> None:
    np.random.seed(1)  # noqa: NPY002  the global generator is what is looked at
    expected = np.random.random()  # noqa: NPY002
    np.random.seed(1)  # noqa: NPY002
    small(1).frame(0)
    assert np.random.random() == expected  # noqa: NPY002


def test_frames_come_lazily_in_the_asked_number_and_form() -> None:
    frames = list(small())
    assert len(frames) == 3
    assert {(frame.shape, frame.dtype) for frame in frames} == {((90, 160, 3), np.dtype(np.uint8))}
    assert next(iter(SyntheticFlight(10**6, (90, 160)))).shape == (90, 160, 3)


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="reads the peak from Linux's /proc")
def test_rendering_fits_beside_a_tracker_on_a_small_computer() -> None:
    """Below 140 MB: `mscf demo` shall peak below 300 MB, with the tracker, the encoder and the plots.

    Numpy, OpenCV and this project's modules take about 50 MB of them, which the demo has anyway; the ground
    takes 35, and the noise and the frame on its way to the caller 25. The rest is reserve for other versions.
    """
    program = """
from pathlib import Path
from sim.flight import SyntheticFlight

assert len(list(SyntheticFlight(3))) == 3
print(Path("/proc/self/status").read_text())
"""
    # VmHWM, not getrusage's ru_maxrss: that one starts from the peak of the process that forked it, this one.
    status = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True).stdout
    (peak_kb,) = (int(line.split()[1]) for line in status.splitlines() if line.startswith("VmHWM"))
    assert peak_kb / 1024 < 140


def test_short_flight_is_the_start_of_the_long_one(flight: SyntheticFlight) -> None:
    short = SyntheticFlight(20)
    assert short.truth == flight.truth[:20]
    assert short.visible_share == flight.visible_share[:20]


def test_truth_comes_one_per_frame_and_fits_any_frame_size(flight: SyntheticFlight) -> None:
    assert len(flight.truth) == len(flight.visible_share) == len(flight) == flight.frame_count
    half, whole = SyntheticFlight(1, (360, 640)).truth[0], flight.truth[0]
    assert half is not None
    assert whole is not None
    assert (2 * half.x, 2 * half.w) == pytest.approx((whole.x, whole.w))


def test_truth_of_a_frame_is_what_its_geometry_says(flight: SyntheticFlight) -> None:
    time_s = 100 / 30
    truth = observe(flight.world, flight.camera, flight.pose(time_s), time_s)
    assert (truth.box, truth.visible_share) == (flight.truth[100], flight.visible_share[100])


def test_target_stays_wholly_in_the_frame(flight: SyntheticFlight) -> None:
    for box in flight.truth:
        assert box is not None
        assert min(box.x, box.y) > 100
        assert box.x + box.w < 1180
        assert box.y + box.h < 620


def test_target_is_30_to_100_pixels_wide_and_doubles(flight: SyntheticFlight) -> None:
    widths = np.array([box.w for box in flight.truth if box])
    assert widths.min() > 30
    assert widths.max() < 100
    sizes = np.array([(box.w * box.h) ** 0.5 for box in flight.truth if box])
    assert sizes.max() / sizes.min() == pytest.approx(2.0, abs=0.3)


def test_image_motion_stays_below_40_percent_of_the_target(flight: SyntheticFlight) -> None:
    for box, after in itertools.pairwise(flight.truth):
        assert box is not None
        assert after is not None
        (x, y), (x_after, y_after) = box.center_xy, after.center_xy
        assert abs(x_after - x) < 0.4 * box.w
        assert abs(y_after - y) < 0.4 * box.h


def test_target_is_half_hidden_first_and_then_briefly_gone(flight: SyntheticFlight) -> None:
    share = np.array(flight.visible_share)
    gone = np.flatnonzero(share < 0.02)
    assert 14 <= len(gone) <= 24  # about 0.6 s at 30 frames/s
    assert gone[-1] - gone[0] + 1 == len(gone)  # once, in one piece
    assert 0.1 < share[: gone[0] - 15].min() < 0.6  # the tree crowns before
    assert share[:25].min() == share[gone[-1] + 15 :].min() == 1.0  # a clean start, nothing hides it later


def test_rival_comes_close(flight: SyntheticFlight) -> None:
    rival = flight.world.traffic[0]
    target = flight.world.target
    assert target is not None
    times_s = np.arange(450) / 30
    gaps_m = [
        np.linalg.norm(np.subtract(target.motion.pose(t).pos_ned_m, rival.motion.pose(t).pos_ned_m)) for t in times_s
    ]
    assert 3.0 < min(gaps_m) < 5.0


def test_exposure_dips_once() -> None:
    gains = np.array([exposure_gain(index / 30) for index in range(450)])
    dark = gains < 0.8
    assert np.count_nonzero(np.diff(dark.astype(int)) == 1) == 1


def test_village_scatters_by_seed_and_is_painted_once() -> None:
    assert village(7) is village(7)
    assert village(7).trees != village(8).trees


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: SyntheticFlight(frame_count=0), "frame_count is 0, must be at least 1"),
        (lambda: SyntheticFlight(size_hw=(8, 1280)), r"size_hw is \(8, 1280\)"),
        (lambda: SyntheticFlight(frames_per_s=0.0), r"frames_per_s is 0\.0"),
        (lambda: SyntheticFlight(frames_per_s=float("nan")), "frames_per_s is nan"),
        (lambda: SyntheticFlight(seed=-1), "seed is -1"),
    ],
)
def test_argument_out_of_range_is_refused_with_its_value(make: Callable[[], SyntheticFlight], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()
