import math
import sys
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest

from companion.modes import Mode
from mscf.arrays import Image
from mscf.errors import OutputError
from sim.figure import check_plottable, mode_hex, mode_spans, plot_png, rates
from sim.film import mode_color
from sim.scenarios import Act
from sim.trace import Moment, Trace
from sim.world import Pose

NAN = math.nan
MOMENT = Moment(
    time_s=0.0,
    mode="following",
    flight_mode="GUIDED",
    is_armed=True,
    pose=Pose((0.0, 0.0, -14.0)),
    velocity_ned_mps=(4.0, 0.0, 0.0),
    target_ned_m=(20.0, 0.0, 0.0),
    box=None,
    truth=None,
    visible_share=1.0,
    status="tracking",
    confidence=0.9,
    threat=0.2,
    frame_age_s=0.04,
    setpoint_ned_mps=(4.0, 0.0, 0.0),
    yaw_rate_radps=0.0,
    range_m=20.0,
)


def trace_of(modes: Sequence[str], step_s: float = 0.5) -> Trace:
    return Trace(tuple(replace(MOMENT, time_s=step_s * k, mode=mode) for k, mode in enumerate(modes)))


def plotted(trace: Trace, acts: Sequence[Act] = (), *, has_truth: bool = True) -> Image:
    data = np.frombuffer(plot_png("a run", trace, acts, has_truth=has_truth), np.uint8)
    picture = cv2.imdecode(data, cv2.IMREAD_COLOR)
    assert picture is not None
    return np.asarray(picture, np.uint8)


@pytest.mark.parametrize(
    ("modes", "spans"),
    [
        ((), ()),
        (("idle",), (("idle", 0.0, 0.0),)),
        (("idle", "idle", "following"), (("idle", 0.0, 1.0), ("following", 1.0, 1.0))),
        (
            ("idle", "following", "following", "idle", "idle"),
            (("idle", 0.0, 0.5), ("following", 0.5, 1.5), ("idle", 1.5, 2.0)),
        ),
    ],
)
def test_a_stay_in_a_mode_ends_where_the_next_begins(
    modes: tuple[str, ...], spans: tuple[tuple[str, float, float], ...]
) -> None:
    assert mode_spans(trace_of(modes)) == spans


def test_the_bands_behind_the_panels_match_the_modes_in_colour_and_time() -> None:
    picture = plotted(trace_of(["idle"] * 20 + ["following"] * 60 + ["holding"] * 21)).astype(int)
    widths = {}
    for mode in ("idle", "following", "holding"):
        band_bgr = 255 + 0.22 * (np.array(mode_color(mode)) - 255)
        columns = (np.abs(picture - band_bgr).max(axis=2) <= 1.0).sum(axis=0) > 200
        assert columns.any()
        widths[mode] = np.flatnonzero(columns)
    assert widths["idle"].max() < widths["following"].min()
    assert widths["following"].max() < widths["holding"].min()
    whole = np.ptp(np.concatenate(list(widths.values())))
    for mode, share in (("idle", 0.2), ("following", 0.6), ("holding", 0.2)):
        assert np.ptp(widths[mode]) / whole == pytest.approx(share, abs=0.01)


def test_the_colours_of_the_modes_are_those_of_the_film() -> None:
    for mode in Mode:
        text = mode_hex(mode.value)
        assert (int(text[5:], 16), int(text[3:5], 16), int(text[1:3], 16)) == mode_color(mode.value)


def test_an_act_is_a_line_through_all_panels() -> None:
    trace = trace_of(["following"] * 101)
    without, with_act = plotted(trace), plotted(trace, (Act(25.0, "unplugged", lambda _: None),))
    changed = (without != with_act).any(axis=2)
    dashes = changed.sum(axis=0)
    column = int(dashes.argmax())
    following = (np.abs(without.astype(int) - (255 + 0.22 * (np.array(mode_color("following")) - 255))) <= 1).all(
        axis=2
    )
    band = np.flatnonzero(following.sum(axis=0) > 200)
    assert column == pytest.approx((band.min() + band.max()) / 2, abs=2.0)
    assert np.ptp(np.flatnonzero(changed[:, column])) > 0.8 * len(changed)


def test_a_rate_is_the_slope_whatever_the_steps() -> None:
    time_s = np.cumsum([0.0, 0.05, 0.05, 0.2, 0.01, 0.05, 0.5, 0.05, 0.05])
    np.testing.assert_allclose(rates(time_s, 3.0 * time_s - 7.0)[[0, 1, 2, 3, 4, 5, 7, 8]], 3.0)


def test_a_rate_of_turn_does_not_jump_where_the_angle_does() -> None:
    time_s = np.arange(0.0, 10.0, 0.05)
    yaw_rad = np.remainder(1.5 * time_s + math.pi, math.tau) - math.pi
    assert np.ptp(yaw_rad) > 6
    np.testing.assert_allclose(rates(time_s, yaw_rad, turn=math.tau), 1.5)


def test_a_rate_is_not_known_where_a_value_is_not_or_no_other_is_near() -> None:
    time_s = np.array([0.0, 0.1, 0.2, 5.0, 9.0, 9.1])
    known = np.isfinite(rates(time_s, np.array([0.0, 1.0, 2.0, 3.0, NAN, 4.0])))
    assert known.tolist() == [True, True, True, False, False, False]


@pytest.mark.parametrize("count", [0, 1, 3])
def test_what_is_not_known_leaves_gaps_and_any_length_is_plotted(count: int) -> None:
    bare = replace(
        MOMENT,
        mode="",
        pose=Pose((NAN, NAN, NAN), NAN, NAN, NAN),
        velocity_ned_mps=(NAN, NAN, NAN),
        target_ned_m=(NAN, NAN, NAN),
        confidence=NAN,
        threat=NAN,
        frame_age_s=None,
        setpoint_ned_mps=None,
        yaw_rate_radps=None,
        range_m=None,
    )
    moments = tuple(replace(bare, time_s=0.5 * k) for k in range(count))
    assert plotted(Trace(moments)).shape == plotted(trace_of(["following"] * 3)).shape
    assert plotted(Trace(moments), has_truth=False).shape < plotted(trace_of(["following"] * 3), has_truth=False).shape


def test_of_a_recorded_flight_only_what_is_known_has_a_panel() -> None:
    unknown = {"target_ned_m": (NAN, NAN, NAN), "visible_share": NAN}
    whole = tuple(replace(moment, **unknown) for moment in trace_of(["following"] * 3).moments)
    fewer: list[dict[str, Any]] = [
        {"range_m": None},
        {"frame_age_s": None},
        {"setpoint_ned_mps": None, "velocity_ned_mps": (NAN, NAN, NAN)},
        {"yaw_rate_radps": None, "pose": Pose((0.0, 0.0, -14.0), NAN, NAN, NAN)},
        {"confidence": NAN, "threat": NAN},
        {"pose": Pose((NAN, NAN, NAN), NAN, NAN, NAN)},
    ]
    heights_px = [plotted(Trace(whole), has_truth=False).shape[0]]
    for gone in fewer:
        whole = tuple(replace(moment, **gone) for moment in whole)
        heights_px.append(plotted(Trace(whole), has_truth=False).shape[0])
    steps_px = -np.diff(heights_px)
    assert heights_px[0] == plotted(trace_of(["following"])).shape[0]  # the bearing's place is the height's
    assert steps_px[:-1] == pytest.approx(209, abs=1)
    assert steps_px[-1] == 0  # empty axes are left, with the modes


def test_the_same_run_gives_the_same_file() -> None:
    trace = trace_of(["idle", "following", "following"])
    assert plot_png("a run", trace) == plot_png("a run", trace)


def test_without_matplotlib_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(OutputError, match=r"pip install matplotlib"):
        check_plottable()
