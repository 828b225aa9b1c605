"""The MSCF tracker: `init` once, `update` for every further frame."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from mscf.arrays import Image, Probe, Spectrum, no_probe
from mscf.confidence import confidence
from mscf.config import TrackerConfig
from mscf.errors import TrackerNotInitialisedError
from mscf.features.fhog import CELL_PX
from mscf.filter import Model, learn
from mscf.frame import check_box, check_frame, check_same_shape, is_gray, single_channel
from mscf.geometry import Box, nearest_pixel, round_half_away
from mscf.kernels import Kernels
from mscf.kernels.choice import chosen_kernels
from mscf.labels import ideal_label
from mscf.mutation import measure_threat
from mscf.plan import Plan
from mscf.sampling import sample
from mscf.scale import ScaleFilter, estimate_scale, scale_features, train_scale

PEAK_MEAN_RATE = 0.1  # of the running mean of peaks, per frame that shows the target


@dataclass(frozen=True, slots=True)
class TrackResult:
    """What the tracker says of one frame."""

    box: Box  # the target, 0-based px; may reach outside the frame
    peak: float  # maximum of the response map
    threat: float  # mutation threat factor: 0 where there is no sub-peak, 1 where there is no positive peak
    scale: float  # size of the target over its size in the first frame
    confidence: float  # 0..1: how likely the box holds the target; see mscf.confidence for what that is worth
    is_held: bool = False  # the target seems hidden: the box is where it was seen last
    is_smallest: bool = False  # the box is as small as it can become: the target may be smaller still


@dataclass(frozen=True, slots=True)
class State:
    """What the tracker carries from frame to frame; replaced whole."""

    frame_index: int  # 0 for the frame of `init`
    pos_rc: tuple[float, float]  # centre of the target, px
    scale: float  # frame pixels per pixel of the resized search patch
    model_f: Spectrum  # (C, M, N') running mean of samples
    filter_f: Spectrum  # (C, M, N') g
    label_f: Spectrum  # (M, N') r
    scale_filter: ScaleFilter
    peak_mean: float  # running mean of the response's peak; NaN before the first response
    held: int  # frames for which the target has been held hidden


def always(_result: TrackResult, /) -> bool:
    """Learn every frame: what the tracker does where it is not told otherwise."""
    return True


@dataclass(frozen=True, slots=True)
class Snapshot:
    """All that a tracker knows at one moment; to be given back to `Tracker.restore`, not to be looked into."""

    plan: Plan
    state: State


class Tracker:
    """Mutation sensitive correlation filter (ICRA 2021).

    Parameters
    ----------
    kernels : what it computes with; None: `chosen_kernels`.

    Examples
    --------
    >>> import numpy as np
    >>> from mscf import Box, Tracker
    >>> frame = np.random.default_rng(0).integers(0, 255, (240, 320, 3), dtype=np.uint8)
    >>> tracker = Tracker()
    >>> tracker.init(frame, Box(x=100, y=80, w=41, h=31))
    >>> moved = np.roll(frame, (3, 5), axis=(0, 1))
    >>> box = tracker.update(moved).box
    >>> abs(box.x - 105) < 1, abs(box.y - 83) < 1
    (True, True)
    """

    def __init__(self, config: TrackerConfig | None = None, kernels: Kernels | None = None) -> None:
        self._config = TrackerConfig() if config is None else config
        self._kernels = chosen_kernels() if kernels is None else kernels
        self._started: Snapshot | None = None

    @property
    def config(self) -> TrackerConfig:
        """What the tracker was made with."""
        return self._config

    @property
    def kernels(self) -> Kernels:
        """What it computes with."""
        return self._kernels

    def init(self, frame: Image, box: Box, *, probe: Probe = no_probe) -> None:
        """Learn the target in `box` of `frame`; may be called again for another target.

        Parameters
        ----------
        frame : (H, W, 3) BGR or (H, W) uint8.
        box : 0-based pixels; may reach over the border of the frame.
        probe : is shown every intermediate array by name.

        Raises
        ------
        FrameError
            If the frame is not such an array.
        BoxError
            If the box is not finite, under 4 px wide or high, or wholly outside the frame.

        After an exception the tracker is as it was before.
        """
        check_frame(frame)
        check_box(box, frame)
        plan = Plan.make(self._config, frame.shape, box, is_gray=is_gray(frame), kernels=self._kernels)
        frame = single_channel(frame) if plan.is_gray else frame
        pos_rc, scale = box.to_pos_size()[0], plan.first_scale

        model_f = sample_features(frame, pos_rc, scale, plan, probe=probe, stage="train")
        probe("model_f", model_f)
        height = self._config.pedestal_height if self._config.pedestal_at_start else 0.0
        ideal_f = ideal_label(plan.gaussian_f, plan.pedestal_f, height=height, threat=0.0)
        probe("ideal_label_f", ideal_f)
        learned = learn(
            Model.of(model_f, self._kernels),
            ideal_f,
            plan.gaussian_f,
            threat=0.0,
            support=plan.support,
            cfg=self._config,
            kernels=self._kernels,
            probe=probe,
        )
        probe("label_f", learned.label_f)
        probe("filter_f", learned.g_f)
        features = scale_features(frame, pos_rc, scale, plan.scale, self._kernels)
        probe("scale_features_train", features)
        state = State(
            frame_index=0,
            pos_rc=pos_rc,
            scale=scale,
            model_f=model_f,
            filter_f=learned.g_f,
            label_f=learned.label_f,
            scale_filter=train_scale(self._kernels.scale_dft(features), None, plan.scale, self._kernels),
            peak_mean=math.nan,
            held=0,
        )
        self._started = Snapshot(plan, state)

    def update(
        self, frame: Image, *, learn: Callable[[TrackResult], bool] = always, probe: Probe = no_probe
    ) -> TrackResult:
        """Locate the target in `frame`, then learn from it.

        Parameters
        ----------
        frame : of the shape and dtype given to `init`.
        learn : is asked, of what is going to be returned, whether the frame is to be learned. A target that is
            held hidden is never learned.
        probe : is shown every intermediate array by name.

        Raises
        ------
        TrackerNotInitialisedError
            Before `init`.
        FrameError
            If the frame has another shape or dtype.

        After an exception the tracker is as it was before.
        """
        plan, state = self._current("update")
        frame, kernels = accepted(frame, plan), plan.kernels

        # LOCALISATION (paper Eq. 14)
        sample_f = sample_features(frame, state.pos_rc, state.scale, plan, probe=probe, stage="detect")
        probe("sample_f", sample_f)
        response_f = kernels.correlate(state.filter_f, sample_f)  # (M, N')
        response = kernels.inverse_dft(response_f, plan.grid_mn)  # (M, N)
        probe("response", response)
        peak = float(response.max())
        # SELECTION (paper Eq. 1, 2)
        threat = measure_threat(response, self._config, kernels, probe=probe)
        probe("threat", np.array(threat))
        sure = confidence(peak, kernels.peak_to_sidelobe(response))
        probe("confidence", np.array(sure))

        if is_hidden(peak, state, self._config):
            after = replace(state, frame_index=state.frame_index + 1, held=state.held + 1)
            result = result_of(after, peak, threat, sure, plan)
        else:
            offset_rc = kernels.locate_peak(response, response_f)  # cells
            pos_rc = displaced(state, offset_rc, self._config)
            probe("pos_rc", np.array(pos_rc))
            # SCALE (spec B8)
            scale_sample = scale_features(frame, pos_rc, state.scale, plan.scale, kernels)
            probe("scale_features_detect", scale_sample)
            scale_f = kernels.scale_dft(scale_sample)
            scale = estimate_scale(scale_f, state.scale, state.scale_filter, plan.scale, kernels, probe)
            after = seen(state, peak, pos_rc, scale, self._config)
            result = result_of(after, peak, threat, sure, plan)
            # TRAINING (paper Eq. 3-13)
            is_learned = learn(result)
            if is_learned and after.frame_index % self._config.train_interval == 0:
                train_f, train_offset_rc = training_sample(frame, sample_f, offset_rc, state, after, plan, probe)
                after = train(after, train_f, train_offset_rc, threat, plan, probe)
            if is_learned and after.frame_index % self._config.scale_train_interval == 0:
                growth = scale / state.scale
                if is_grown_little(growth, self._config):
                    probe("scale_features_train", scale_sample)
                else:
                    scale_sample, growth = scale_features(frame, pos_rc, scale, plan.scale, kernels), 1.0
                    probe("scale_features_train", scale_sample)
                    scale_f = kernels.scale_dft(scale_sample)
                scale_filter = train_scale(scale_f, state.scale_filter, plan.scale, kernels, growth)
                after = replace(after, scale_filter=scale_filter)
                probe("scale_numerator_f", after.scale_filter.num_f)
                probe("scale_denominator", after.scale_filter.den)

        self._started = Snapshot(plan, after)
        return result

    def snapshot(self) -> Snapshot:
        """What the tracker knows now. Nothing is copied, as nothing that a snapshot refers to is ever changed.

        Raises
        ------
        TrackerNotInitialisedError
            Before `init`.
        """
        plan, state = self._current("snapshot")
        return Snapshot(plan, state)

    def restore(self, snapshot: Snapshot) -> None:
        """Be as the tracker was when `snapshot` was taken, of this tracker or of one with the same configuration."""
        self._started = snapshot

    def look(self, frame: Image, center_xy: tuple[float, float], scale: float | None = None) -> TrackResult:
        """What the filter finds around another place; nothing is learned and the tracker stays where it is.

        The size is not measured: the box has the given one. It takes about half the time of an `update`.

        Parameters
        ----------
        frame : of the shape and dtype given to `init`.
        center_xy : `Box.center_xy` of a target in the middle of the search patch, px.
        scale : size to look for, over the size in the first frame; None: that of the last box.

        Raises
        ------
        TrackerNotInitialisedError, FrameError
            As `update`.
        """
        plan, state = self._current("look")
        frame, kernels = accepted(frame, plan), plan.kernels
        pos_rc = center_xy[1] - 0.5, center_xy[0] - 0.5
        there = replace(state, pos_rc=pos_rc, scale=state.scale if scale is None else scale * plan.first_scale)
        sample_f = sample_features(frame, there.pos_rc, there.scale, plan, probe=no_probe, stage="detect")
        response_f = kernels.correlate(there.filter_f, sample_f)  # (M, N')
        response = kernels.inverse_dft(response_f, plan.grid_mn)  # (M, N)
        peak, threat = float(response.max()), measure_threat(response, self._config, kernels)
        offset_rc = kernels.locate_peak(response, response_f)
        found = replace(there, pos_rc=displaced(there, offset_rc, self._config), held=0)
        return result_of(found, peak, threat, confidence(peak, kernels.peak_to_sidelobe(response)), plan)

    def resume(self, result: TrackResult) -> None:
        """Go on from the place and size of `result`, of `look`, with what is known now.

        Raises
        ------
        TrackerNotInitialisedError
            Before `init`.
        """
        plan, state = self._current("resume")
        pos_rc, _ = result.box.to_pos_size()
        scale = result.scale * plan.first_scale
        self._started = Snapshot(plan, replace(state, pos_rc=pos_rc, scale=scale, held=0))

    def _current(self, verb: str) -> tuple[Plan, State]:
        if self._started is None:
            raise TrackerNotInitialisedError(f"{verb} was called before init: call init(frame, box) first")
        return self._started.plan, self._started.state


def accepted(frame: Image, plan: Plan) -> Image:
    """The frame as the features take it: (H, W, 3), or (H, W) where one channel is looked at.

    Raises
    ------
    FrameError
        If the frame is not of the planned shape, uint8.
    """
    check_frame(frame)
    check_same_shape(frame, plan.frame_shape)
    return single_channel(frame) if plan.is_gray else frame


def sample_features(
    frame: Image, pos_rc: tuple[float, float], scale: float, plan: Plan, *, probe: Probe, stage: str
) -> Spectrum:
    """Windowed features of the square search patch around `pos_rc`: (C, M, N') complex64 (spec B2, B3)."""
    out_px = plan.config.sample_side_px
    side_px = out_px * scale
    if plan.config.sampling == "exact":
        patch = plan.kernels.sample_exact(frame, pos_rc, np.array([[side_px, side_px]]), (out_px, out_px))[0]
    else:
        whole_px = max(1, round_half_away(side_px))
        patch = sample(frame, nearest_pixel(pos_rc), (whole_px, whole_px), (out_px, out_px))
    probe(f"patch_{stage}", patch)
    features = plan.kernels.feature_stack(patch, plan.color_table)  # (C, M, N)
    probe(f"features_{stage}", features)
    return plan.kernels.windowed_dft(features, plan.window)


def displaced(state: State, offset_rc: tuple[float, float], cfg: TrackerConfig) -> tuple[float, float]:
    """New centre of the target in px: that of the patch plus the peak's offset in cells (spec B6).

    Sampling by pixels forgets the rest of a pixel, as published: a box of even size comes out half a pixel off.
    """
    row, col = state.pos_rc if cfg.sampling == "exact" else nearest_pixel(state.pos_rc)
    cell_px = CELL_PX * state.scale
    return row + offset_rc[0] * cell_px, col + offset_rc[1] * cell_px


def result_of(state: State, peak: float, threat: float, sure: float, plan: Plan) -> TrackResult:
    """What is said of a frame that led to `state`."""
    box, scale = plan.box_at(state.pos_rc, state.scale), state.scale / plan.first_scale
    is_smallest = state.scale <= plan.scale.limits[0] < plan.first_scale
    return TrackResult(box, peak, threat, scale, sure, is_held=state.held > 0, is_smallest=is_smallest)


def is_hidden(peak: float, state: State, cfg: TrackerConfig) -> bool:
    """Whether the response is so weak that the target must be behind something.

    Not in the paper. A filter follows the occluder where it takes the highest of weak peaks; a target that is
    held where it was seen last, with nothing learned, is mostly still in the search area when it comes out.
    """
    return state.held < cfg.hold_frames and peak < cfg.hold_floor * state.peak_mean  # False while that is NaN


def seen(state: State, peak: float, pos_rc: tuple[float, float], scale: float, cfg: TrackerConfig) -> State:
    """State after a frame that shows the target, or in which waiting for it was given up."""
    starts_anew = math.isnan(state.peak_mean) or state.held >= cfg.hold_frames
    mean = peak if starts_anew else state.peak_mean + PEAK_MEAN_RATE * (peak - state.peak_mean)
    return replace(
        state,
        frame_index=state.frame_index + 1,
        pos_rc=pos_rc,
        scale=scale,
        peak_mean=mean,
        held=0,
    )


def training_sample(
    frame: Image,
    sample_f: Spectrum,
    offset_rc: tuple[float, float],
    before: State,
    after: State,
    plan: Plan,
    probe: Probe,
) -> tuple[Spectrum, tuple[float, float]]:
    """Sample around the target's new place, (C, M, N'), and by how many cells the target is off its middle.

    Where neither the patch nor its scale has changed it is the sample of the detection. Not in the paper, for
    speed: after a small change it is that sample, to be shifted by a linear phase. The Hann window is then off the
    target by the displacement, and the patch of another scale by less than half a cell at its border.
    """
    cfg = plan.config
    is_near = cfg.shift_limit_cells > 0 and max(map(abs, offset_rc)) <= cfg.shift_limit_cells
    if is_near and is_grown_little(after.scale / before.scale, cfg):
        return sample_f, offset_rc
    is_same_patch = cfg.sampling == "pixels" and nearest_pixel(after.pos_rc) == nearest_pixel(before.pos_rc)
    if is_same_patch and after.scale == before.scale:
        return sample_f, (0.0, 0.0)
    return sample_features(frame, after.pos_rc, after.scale, plan, probe=probe, stage="train"), (0.0, 0.0)


def is_grown_little(growth: float, cfg: TrackerConfig) -> bool:
    """Whether a sample that was cut for another size will do: `growth` is the ratio of the sizes."""
    return 1 / cfg.shift_limit_ratio <= growth <= cfg.shift_limit_ratio


def train(
    state: State, sample_f: Spectrum, offset_rc: tuple[float, float], threat: float, plan: Plan, probe: Probe
) -> State:
    """Learn a sample (C, M, N') that has the target `offset_rc` cells off its middle."""
    cfg, kernels = plan.config, plan.kernels
    model = Model(*kernels.blend(state.model_f, sample_f, cfg.learning_rate, offset_rc, plan.grid_mn))
    probe("model_f", model.m_f)
    ideal_f = ideal_label(plan.gaussian_f, plan.pedestal_f, height=cfg.pedestal_height, threat=threat)
    probe("ideal_label_f", ideal_f)
    learned = learn(
        model, ideal_f, state.label_f, threat=threat, support=plan.support, cfg=cfg, kernels=kernels, probe=probe
    )
    probe("label_f", learned.label_f)
    probe("filter_f", learned.g_f)
    return replace(state, model_f=model.m_f, filter_f=learned.g_f, label_f=learned.label_f)
