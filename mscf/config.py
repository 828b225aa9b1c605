"""What a run of the tracker is configured with: one frozen value, and the presets.

Every field names its unit; sources are the paper (arXiv:2106.08073, section IV-A), the published code
(spec part B), or a measurement in docs/results.md. Numbers that follow from these belong to `Plan`.
"""

from ast import literal_eval
from dataclasses import dataclass, fields, replace
from difflib import get_close_matches
from numbers import Integral
from pathlib import Path
from typing import Any, Literal, Self, SupportsFloat, get_args

from mscf.errors import ConfigError

LabelRule = Literal["fixed", "joint", "split"]
ThreatRule = Literal["window", "peaks"]
SamplingRule = Literal["pixels", "exact"]
PresetName = Literal["mscf", "reference", "paper", "bacf", "bacf+al", "bacf+ahl"]
PRESETS: tuple[str, ...] = get_args(PresetName)

# lowest and highest value allowed, both included
_RANGES: dict[str, tuple[float, float]] = {
    "search_area_ratio": (4, 100),
    "sample_side_px": (64, 512),
    "color_weight": (0, 10),
    "label_sigma": (0.01, 1),
    "pedestal_height": (0, 1),
    "pedestal_ratio": (0.25, 10),
    "pedestal_min_cells": (1, 25),
    "threat_nu": (0, 100),
    "threat_delta": (0, 1),
    "learning_rate": (0, 1),
    "train_interval": (1, 100),
    "shift_limit_cells": (0, 25),
    "shift_limit_ratio": (1, 1.2),
    "hold_floor": (0, 1),
    "hold_frames": (0, 1000),
    "iterations": (1, 20),
    "penalty": (1e-6, 1e6),
    "penalty_growth": (1, 1000),
    "penalty_max": (1e-6, 1e9),
    "filter_weight": (0, 1e6),
    "ideal_weight": (0, 1e9),
    "previous_weight": (0, 1e9),
    "label_penalty": (1e-6, 1e6),
    "scale_count": (3, 99),
    "scale_step": (1.001, 1.5),
    "scale_sigma": (0.01, 10),
    "scale_model_area_px": (64, 4096),
    "scale_learning_rate": (0, 1),
    "scale_floor": (1e-12, 1),
    "scale_train_interval": (1, 100),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackerConfig:
    """Configuration of a `Tracker`; the defaults are preset `mscf`.

    Raises
    ------
    ConfigError
        If a value is outside its range: the text names the field, the value and the range.
    """

    # sampling (spec B1, B2)
    search_area_ratio: float = 25.0  # area of the search patch over that of the box
    sample_side_px: int = 200  # side of the resized search patch; a multiple of the 4 px cell
    sampling: SamplingRule = "exact"  # pixels: as published, whole ones; takes longer the larger the target is

    # features (spec B3, D)
    color_table: Path | None = None  # .npz with `table` (32768, 10); None: the package's own
    color_weight: float = 2.0  # of the colour names; at 1 they vary by a twentieth of what the gradients do

    # label (paper Eq. 3; spec B4, B5)
    label_sigma: float = 0.066  # of the Gaussian, over the geometric mean of the target's sides
    pedestal_height: float = 0.044  # eta; 0: none
    pedestal_ratio: float = 0.625  # side of the target over side of the pedestal
    pedestal_min_cells: float = 5.0  # the pedestal's least side
    pedestal_centred: bool = False  # symmetric about the centre; the published code's is a cell or two off
    pedestal_at_start: bool = False  # also in the first frame
    label_rule: LabelRule = "split"  # fixed: Omega itself; joint: paper Eq. 12; split: spec B10

    # mutation threat factor (paper Eq. 1, 2; spec B7)
    threat_rule: ThreatRule = "window"  # window: spec B7; peaks: as the paper states it
    threat_nu: float = 1.0  # nu
    threat_delta: float = 0.01  # delta, per exp(cell)

    # occlusion: not in the paper (docs/results.md)
    hold_floor: float = 0.4  # where the peak is below this share of its running mean, the target is held hidden
    hold_frames: int = 25  # for no longer than this

    # training (paper IV-A; spec B10)
    learning_rate: float = 0.022  # of the model, per training; published: 0.0158
    train_interval: int = 1  # frames from one training to the next
    # up to this displacement the sample of the detection is shifted for training; 0: cut anew wherever it moved
    shift_limit_cells: float = 8.0
    shift_limit_ratio: float = 1.015  # and up to this ratio of the scales; 1: only where it is the same
    iterations: int = 2  # ADMM iterations; of rule "split" in each of its three loops
    penalty: float = 0.1  # mu of the first iteration
    penalty_growth: float = 10.0  # beta, of mu and gamma
    penalty_max: float = 1e4  # mu_max and gamma_max
    filter_weight: float = 20.0  # lambda1
    ideal_weight: float = 840.0  # lambda2
    previous_weight: float = 1.0  # phi
    label_penalty: float = 27.0  # gamma of the first iteration; rule "split" only

    # scale filter (spec B8)
    scale_count: int = 33  # odd
    scale_step: float = 1.03  # ratio of neighbouring scales
    scale_sigma: float = 0.5  # of the label, over sqrt(scale_count)
    scale_interpolation: bool = True  # the best scale is between the steps; published: it is one of them
    scale_model_area_px: float = 512.0  # largest area of a resized scale sample
    scale_learning_rate: float = 0.024
    scale_floor: float = 1e-4  # added to the denominator
    scale_train_interval: int = 2  # frames from one training to the next; 1 as published

    def __post_init__(self) -> None:
        for name, (low, high) in _RANGES.items():
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, SupportsFloat):
                raise ConfigError(f"{name} must be a number from {low:g} to {high:g}, got {value!r}")
            if not low <= float(value) <= high:
                raise ConfigError(f"{name} must be from {low:g} to {high:g}, got {value!r}")
        self._check_kinds()
        if self.sample_side_px % 8:
            raise ConfigError(f"sample_side_px must be a multiple of 8, got {self.sample_side_px}")
        if self.scale_count % 2 == 0:
            raise ConfigError(f"scale_count must be odd, got {self.scale_count}")
        if self.penalty_max < self.penalty:
            raise ConfigError(f"penalty_max must be at least penalty = {self.penalty:g}, got {self.penalty_max:g}")

    def _check_kinds(self) -> None:
        for name in (
            "sample_side_px",
            "hold_frames",
            "train_interval",
            "iterations",
            "scale_count",
            "scale_train_interval",
        ):
            if not isinstance(getattr(self, name), Integral):
                raise ConfigError(f"{name} must be a whole number, got {getattr(self, name)!r}")
        for name, rules in (
            ("label_rule", get_args(LabelRule)),
            ("threat_rule", get_args(ThreatRule)),
            ("sampling", get_args(SamplingRule)),
        ):
            if getattr(self, name) not in rules:
                raise ConfigError(f"{name} must be one of {', '.join(rules)}, got {getattr(self, name)!r}")
        for name in ("pedestal_centred", "pedestal_at_start", "scale_interpolation"):
            if not isinstance(getattr(self, name), bool):
                raise ConfigError(f"{name} must be True or False, got {getattr(self, name)!r}")
        if isinstance(self.color_table, str):
            object.__setattr__(self, "color_table", Path(self.color_table))
        if not (self.color_table is None or isinstance(self.color_table, Path)):
            raise ConfigError(f"color_table must be a path or None, got {self.color_table!r}")

    @classmethod
    def preset(cls, name: str, **overrides: Any) -> Self:
        """Configuration by name, with any field overridden by its name.

        Parameters
        ----------
        name : `mscf` (the default), `reference` (the published code, step by step), `paper` (the paper as
            stated), `bacf`, `bacf+al`, `bacf+ahl` (the paper's ablation rows).

        Raises
        ------
        ConfigError
            If the preset or a field is unknown (the text names the nearest one) or a value out of range.
        """
        if name not in PRESETS:
            raise ConfigError(f"unknown preset {name!r}{_nearest(name, PRESETS)}: choose from {', '.join(PRESETS)}")
        known = [field.name for field in fields(cls)]
        for key in overrides:
            if key not in known:
                raise ConfigError(f"unknown field {key!r} of TrackerConfig{_nearest(key, known)}")
        return replace(cls(**_VALUES[name]), **overrides)

    @classmethod
    def named(cls, text: str) -> Self:
        """Configuration of a preset's name, or of `PRESET,FIELD=VALUE,...`: a variant for a study.

        Examples
        --------
        >>> TrackerConfig.named("reference,threat_rule=peaks,train_interval=2").train_interval
        2

        Raises
        ------
        ConfigError
            As `preset`; also where a part after the name is not FIELD=VALUE.
        """
        name, *parts = text.split(",")
        overrides: dict[str, Any] = {}
        for part in parts:
            field, is_set, value = part.partition("=")
            if not is_set:
                raise ConfigError(f"{text!r}: {part!r} is not FIELD=VALUE, as in {name},train_interval=2")
            try:
                overrides[field] = literal_eval(value)
            except (ValueError, SyntaxError):  # a word: the name of a rule, or a path
                overrides[field] = value
        return cls.preset(name, **overrides)


def _nearest(name: str, known: tuple[str, ...] | list[str]) -> str:
    matches = get_close_matches(name, known, n=1)
    return f" (did you mean {matches[0]!r}?)" if matches else ""


# every field, so that no choice for preset mscf changes what was published
_REFERENCE: dict[str, Any] = {
    "search_area_ratio": 25.0,
    "sample_side_px": 200,
    "sampling": "pixels",
    "color_table": None,
    "color_weight": 1.0,
    "label_sigma": 0.066,
    "pedestal_height": 0.044,
    "pedestal_ratio": 0.625,  # 2.5 in the code, but the side is of sample pixels and used as cells of 4 (spec B5)
    "pedestal_min_cells": 5.0,
    "pedestal_centred": False,
    "pedestal_at_start": False,
    "label_rule": "split",
    "threat_rule": "window",
    "threat_nu": 1.0,
    "threat_delta": 0.01,
    "hold_floor": 0.0,
    "hold_frames": 0,
    "learning_rate": 0.0158,
    "train_interval": 1,
    "shift_limit_cells": 0.0,
    "shift_limit_ratio": 1.0,
    "iterations": 2,
    "penalty": 0.1,
    "penalty_growth": 10.0,
    "penalty_max": 1e4,
    "filter_weight": 20.0,
    "ideal_weight": 840.0,
    "previous_weight": 1.0,
    "label_penalty": 27.0,
    "scale_count": 33,
    "scale_step": 1.03,
    "scale_sigma": 0.5,
    "scale_interpolation": False,
    "scale_model_area_px": 512.0,
    "scale_learning_rate": 0.024,
    "scale_floor": 1e-4,
    "scale_train_interval": 1,
}
_PAPER: dict[str, Any] = _REFERENCE | {
    "pedestal_ratio": 2.5,
    "pedestal_min_cells": 1.0,
    "pedestal_centred": True,
    "pedestal_at_start": True,
    "label_rule": "joint",
    "threat_rule": "peaks",
    "train_interval": 2,
    "iterations": 3,
}
_VALUES: dict[str, dict[str, Any]] = {
    "mscf": {},  # the defaults
    "reference": _REFERENCE,
    "paper": _PAPER,
    # the paper's ablation (section IV-E): the terms of Eq. 4 taken away one by one
    "bacf": _PAPER | {"label_rule": "fixed", "pedestal_height": 0.0},
    "bacf+al": _PAPER | {"pedestal_height": 0.0, "ideal_weight": 0.0, "previous_weight": 0.0},
    "bacf+ahl": _PAPER | {"previous_weight": 0.0},
}
