"""The state machine, exhaustively: every mode with every event."""

from itertools import product

import pytest

from companion.errors import IllegalTransitionError
from companion.modes import TRANSITIONS, Event, Mode, after

PAIRS = [*product(Mode, Event)]
STREAMING = [mode for mode in Mode if mode.is_streaming]


def reachable(start: Mode, events: frozenset[Event]) -> set[Mode]:
    """Modes that these events can lead to from `start`, and `start` itself."""
    found, todo = {start}, [start]
    while todo:
        row = TRANSITIONS[todo.pop()]
        new = {row[event] for event in events & row.keys()} - found
        found |= new
        todo += new
    return found


def test_every_mode_has_a_row() -> None:
    assert set(TRANSITIONS) == set(Mode)


@pytest.mark.parametrize(("mode", "event"), [pair for pair in PAIRS if pair[1] in TRANSITIONS[pair[0]]])
def test_a_pair_of_the_table_leads_where_it_says(mode: Mode, event: Event) -> None:
    assert after(mode, event) is TRANSITIONS[mode][event]


@pytest.mark.parametrize(("mode", "event"), [pair for pair in PAIRS if pair[1] not in TRANSITIONS[pair[0]]])
def test_any_other_pair_raises_and_names_both(mode: Mode, event: Event) -> None:
    with pytest.raises(IllegalTransitionError, match=f"{mode.name} .*{event.name}"):
        after(mode, event)


def test_the_modes_that_stream_are_the_engaged_ones_and_two_that_stand() -> None:
    assert {mode for mode in Mode if not mode.is_streaming} == {Mode.IDLE, Mode.TRACKING, Mode.LOST}
    assert {mode for mode in STREAMING if not mode.is_engaged} == {Mode.READY, Mode.LEAVING}


@pytest.mark.parametrize("mode", STREAMING)
def test_an_override_ends_the_stream_at_once(mode: Mode) -> None:
    assert not after(mode, Event.OVERRIDE).is_streaming


@pytest.mark.parametrize("mode", [mode for mode in STREAMING if mode is not Mode.LEAVING])
def test_the_operator_leaves_any_stream_in_two_events(mode: Mode) -> None:
    leaving = after(mode, Event.DISENGAGE)
    assert leaving is Mode.LEAVING
    assert not after(leaving, Event.LEFT).is_streaming


@pytest.mark.parametrize("mode", STREAMING)
def test_an_engagement_never_follows_from_a_target_that_is_gone(mode: Mode) -> None:
    if Event.DESELECTED in TRANSITIONS[mode]:
        assert after(mode, Event.DESELECTED) is Mode.LEAVING
    else:
        assert mode is Mode.LEAVING


@pytest.mark.parametrize("mode", Mode)
def test_every_mode_has_a_way_to_idle(mode: Mode) -> None:
    assert Mode.IDLE in reachable(mode, frozenset(Event))


@pytest.mark.parametrize("mode", [mode for mode in Mode if not mode.is_streaming])
def test_without_the_operators_word_nothing_begins_to_stream(mode: Mode) -> None:
    others = frozenset(Event) - {Event.ENGAGE, Event.PREPARE}
    assert not any(found.is_streaming for found in reachable(mode, others))


@pytest.mark.parametrize("mode", [Mode.READY, Mode.LEAVING, Mode.AWAITING])
def test_a_mode_that_stands_moves_only_after_an_engage_or_a_sight_in_between(mode: Mode) -> None:
    """From AWAITING the target may be missed and seen again; whether it then has to be confirmed is not the table's."""
    others = frozenset(Event) - {Event.ENGAGE, Event.SEEN}
    moving = {Mode.FOLLOWING, Mode.COASTING}
    assert not reachable(mode, others) & moving


@pytest.mark.parametrize("mode", [Mode.COASTING, Mode.HOLDING, Mode.SEARCHING, Mode.AWAITING])
def test_a_target_that_never_comes_back_ends_in_leaving(mode: Mode) -> None:
    ladder = frozenset({Event.HOLD_DUE, Event.SEARCH_DUE, Event.GIVE_UP_DUE, Event.MISSED})
    assert Mode.LEAVING in reachable(mode, ladder)
