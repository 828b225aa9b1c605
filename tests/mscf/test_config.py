from dataclasses import FrozenInstanceError, fields
from pathlib import Path

import pytest

from mscf import PRESETS, ConfigError, TrackerConfig
from mscf.config import _RANGES, _VALUES


@pytest.mark.parametrize("name", PRESETS)
def test_every_preset_can_be_made_and_overridden(name: str) -> None:
    assert TrackerConfig.preset(name, learning_rate=0.5).learning_rate == 0.5


def test_the_default_is_preset_mscf() -> None:
    assert TrackerConfig.preset("mscf") == TrackerConfig()


@pytest.mark.parametrize("name", [name for name in PRESETS if name != "mscf"])
def test_a_published_preset_names_every_field_so_that_new_defaults_do_not_change_it(name: str) -> None:
    assert set(_VALUES[name]) == {field.name for field in fields(TrackerConfig)}


def test_the_published_values_are_those_of_the_paper_and_its_code() -> None:
    reference = TrackerConfig.preset("reference")
    assert (reference.penalty, reference.penalty_max, reference.penalty_growth) == (0.1, 1e4, 10)
    assert (reference.label_penalty, reference.learning_rate) == (27, 0.0158)
    assert (reference.filter_weight, reference.ideal_weight, reference.previous_weight) == (20, 840, 1)
    assert (reference.threat_delta, reference.threat_nu, reference.pedestal_height) == (0.01, 1, 0.044)
    assert (reference.scale_count, reference.scale_step, reference.scale_learning_rate) == (33, 1.03, 0.024)
    assert (reference.search_area_ratio, reference.sample_side_px, reference.label_sigma) == (25, 200, 0.066)


def test_the_ablation_takes_the_terms_away_one_by_one() -> None:
    al, ahl, paper = (TrackerConfig.preset(name) for name in ("bacf+al", "bacf+ahl", "paper"))
    assert (al.ideal_weight, al.previous_weight, al.pedestal_height) == (0, 0, 0)
    assert (ahl.ideal_weight, ahl.previous_weight) == (paper.ideal_weight, 0)
    assert (paper.iterations, paper.train_interval, paper.pedestal_ratio) == (3, 2, 2.5)


def test_an_unknown_preset_is_refused_with_the_nearest() -> None:
    with pytest.raises(ConfigError, match=r"'refernce' \(did you mean 'reference'\?\).*choose from mscf"):
        TrackerConfig.preset("refernce")


def test_a_variant_is_a_preset_with_fields_of_its_own() -> None:
    variant = TrackerConfig.named("reference,threat_rule=peaks,pedestal_centred=True,learning_rate=0.02,iterations=3")
    assert variant == TrackerConfig.preset(
        "reference", threat_rule="peaks", pedestal_centred=True, learning_rate=0.02, iterations=3
    )
    assert TrackerConfig.named("paper") == TrackerConfig.preset("paper")


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("mscf,iterations", "'mscf,iterations': 'iterations' is not FIELD=VALUE, as in mscf,train_interval=2"),
        ("mscf,", "'' is not FIELD=VALUE"),
        ("mcsf,iterations=2", "unknown preset 'mcsf'.*did you mean 'mscf'"),
        ("mscf,iteration=2", "unknown field 'iteration'.*did you mean 'iterations'"),
        ("mscf,iterations=many", "iterations must be a number from 1 to 20, got 'many'"),
        ("mscf,iterations=2.5", "iterations must be a whole number, got 2.5"),
    ],
)
def test_a_variant_that_cannot_be_is_refused_with_what_is_wrong(text: str, why: str) -> None:
    with pytest.raises(ConfigError, match=why):
        TrackerConfig.named(text)


def test_an_unknown_field_is_refused_with_the_nearest() -> None:
    with pytest.raises(ConfigError, match=r"'learning_rat'.*did you mean 'learning_rate'"):
        TrackerConfig.preset("mscf", learning_rat=0.1)


@pytest.mark.parametrize("name", sorted(_RANGES))
def test_a_value_at_its_limits_passes_and_beyond_them_is_refused(name: str) -> None:
    low, high = _RANGES[name]
    whole = isinstance(getattr(TrackerConfig(), name), int)
    step = 1 if whole else max(abs(low), 1e-12) * 1e-3 + 1e-15
    # cross-field rules of their own
    extra = {"penalty_max": 1e9} if name == "penalty" else {}
    extra |= {"penalty": 1e-6} if name == "penalty_max" else {}
    for value in (low, high):
        assert getattr(TrackerConfig(**{name: value}, **extra), name) == value
    for value in (low - step, high * 2, float("nan"), "1", True):
        with pytest.raises(ConfigError, match=rf"{name} must be"):
            TrackerConfig(**{name: value}, **extra)


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"sample_side_px": 201}, "multiple of 8"),
        ({"sample_side_px": 200.0}, "whole number"),
        ({"iterations": 2.5}, "whole number"),
        ({"scale_count": 32}, "odd"),
        ({"label_rule": "best"}, "fixed, joint, split"),
        ({"threat_rule": 3}, "window, peaks"),
        ({"penalty": 10.0, "penalty_max": 1.0}, "at least penalty = 10"),
    ],
)
def test_values_that_do_not_fit_are_refused(values: dict[str, object], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        TrackerConfig(**values)  # type: ignore[arg-type]


def test_every_number_has_a_range() -> None:
    numbers = {f.name for f in fields(TrackerConfig) if isinstance(getattr(TrackerConfig(), f.name), int | float)}
    booleans = {f.name for f in fields(TrackerConfig) if isinstance(getattr(TrackerConfig(), f.name), bool)}
    assert numbers - booleans == set(_RANGES)


def test_a_path_may_be_given_as_text() -> None:
    assert TrackerConfig(color_table="table.npz").color_table == Path("table.npz")  # type: ignore[arg-type]


def test_a_configuration_cannot_be_changed() -> None:
    with pytest.raises(FrozenInstanceError):
        TrackerConfig().iterations = 3  # type: ignore[misc]
