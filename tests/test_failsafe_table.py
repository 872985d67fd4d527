"""The failsafe's table, its settings and its law, over every combination of what can be wrong."""

from __future__ import annotations

import itertools
from dataclasses import replace

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from missions.mission import Mission
from vehicle.failsafe_table import DOING, TABLE, Action, Trigger, decide
from vehicle.settings import Settings

SETTINGS = Settings.of(msgspec.convert({"title": "test"}, Mission))
NOTHING, WARN, FINISH_PLAN, HOLD, FINISH_LEG, RETURN, LAND, TERMINATE = Action

AGREED = {
    "energy gone": [(0, LAND)], "battery emergency": [(0, LAND)], "position invalid": [(1, HOLD), (10, LAND)],
    "fence breached": [(0, RETURN)], "energy for the way home": [(0, RETURN)], "battery critical": [(0, RETURN)],
    "fence ahead": [(0, HOLD), (10, RETURN), (60, LAND)], "peer too close": [(0, HOLD), (15, RETURN)],
    "battery low": [(0, FINISH_LEG)], "range sensor blind": [(0, HOLD), (20, RETURN)],
    "plan invalid": [(0, HOLD), (10, RETURN)], "clock jump": [(0, HOLD), (30, RETURN)],
    "memory card trouble": [(0, HOLD), (120, RETURN)],
    "battery unknown": [(2, WARN), (30, RETURN)], "ground lost": [(0, FINISH_PLAN)]}
"""What was agreed on, written down a second time."""
actions = st.sampled_from([NOTHING, WARN, FINISH_PLAN, HOLD, FINISH_LEG, RETURN, LAND])
asked = st.dictionaries(st.sampled_from(list(Trigger)), actions)


def lawful(wanted: dict[str, Action]) -> Action:
    """The law, as it would be told to a person: land if anything says so, or if the vehicle should come home and cannot
    find the way; come home at once if anything says so, or if it should come home soon and something says stop; ..."""
    said = set(wanted.values())
    home = bool(said & {RETURN, FINISH_LEG})
    if LAND in said or (home and wanted.get("position invalid", NOTHING) is not NOTHING):
        return LAND
    if RETURN in said or (FINISH_LEG in said and HOLD in said):
        return RETURN
    return next((a for a in (FINISH_LEG, HOLD, FINISH_PLAN, WARN) if a in said), NOTHING)


def combinations(stage: int) -> list[dict[Trigger, Action]]:
    """Every set of triggers (2^15), each at its first (0) or last (-1) step."""
    steps = {t: SETTINGS.steps(t)[stage].action for t in Trigger}
    return [{t: steps[t] for t, on in zip(Trigger, bits, strict=True) if on}
            for bits in itertools.product((False, True), repeat=len(Trigger))]


def test_the_table_is_what_was_agreed() -> None:
    assert {t.value: [(s.after_s, s.action) for s in SETTINGS.steps(t)] for t in Trigger} == AGREED
    assert list(TABLE) == list(Trigger)


@pytest.mark.parametrize("stage", [0, -1], ids=["first step", "last step"])
def test_every_combination_of_triggers_follows_the_law(stage: int) -> None:
    combos = combinations(stage)
    assert len(combos) == 2 ** 15
    for combo in combos:
        assert decide(combo).action is lawful({t.value: a for t, a in combo.items()}), combo


def test_no_trigger_makes_any_combination_milder_and_each_alone_gets_what_it_asks_for() -> None:
    decided = {frozenset(c): decide(c).action for c in combinations(0)}
    for combo, action in decided.items():
        assert action >= max((decided[frozenset({t})] for t in combo), default=NOTHING)
        for t in Trigger:
            assert decided[combo | {t}] >= action
    for t in Trigger:
        assert decided[frozenset({t})] is SETTINGS.steps(t)[0].action


@given(asked, st.sampled_from(list(Trigger)), actions)
def test_at_any_step_and_for_any_setting_more_is_never_milder(combo: dict[Trigger, Action], trigger: Trigger,
                                                             more: Action) -> None:
    before = decide(combo)
    assert before.action is lawful({t.value: a for t, a in combo.items()})
    assert decide({**combo, trigger: max(more, combo.get(trigger, NOTHING))}).action >= before.action
    assert decide(dict(reversed(combo.items()))) == before


@given(asked)
def test_the_one_that_people_are_told_about_is_active(combo: dict[Trigger, Action]) -> None:
    decision = decide(combo)
    if decision.action is NOTHING:
        assert (decision.trigger, decision.text) == (None, "")
    else:
        assert decision.trigger is not None
        assert combo[decision.trigger] is not NOTHING
        assert decision.text.endswith(DOING[decision.action])


def test_texts_fit_into_one_statustext_and_the_four_old_ones_are_as_they_were() -> None:
    for t, row in TABLE.items():
        assert len(row.remedy.encode()) <= 50
        for step in row.steps:
            text = decide({t: step.action}).text
            assert 10 < len(text.encode()) <= 50, text
    assert decide({Trigger.ENERGY_GONE: LAND}).text == "battery too low to come home: landing here"
    assert decide({Trigger.ENERGY_HOME: RETURN}).text == "battery needed for the way home: returning"
    assert decide({Trigger.BATTERY_LOW: FINISH_LEG}).text == "battery at threshold: returning"
    assert decide({Trigger.GROUND_LOST: FINISH_PLAN}).text == "ground silent: finishing the plan, then returning"


@given(st.sampled_from(list(Trigger)), st.sampled_from(list(Action)), st.sampled_from([0.0, 5.0]))
def test_whatever_is_set_nothing_holds_for_ever_and_steps_only_get_worse(trigger: Trigger, action: Action,
                                                                        hold_first_s: float) -> None:
    try:
        settings = SETTINGS.with_action(trigger, action)
    except ValueError:
        assert action in (NOTHING, TERMINATE) or TABLE[trigger].least is LAND
        return
    steps = replace(settings, hold_first_s=hold_first_s).steps(trigger)
    for a, b in itertools.pairwise(steps):
        assert b.after_s > a.after_s
        assert b.action > a.action
    waits = hold_first_s > 0.0 and action in (FINISH_LEG, RETURN)
    assert steps[0].action is (HOLD if waits else action)
    assert HOLD < steps[-1].action < TERMINATE or action < HOLD
    assert steps[-1].action >= TABLE[trigger].least


@pytest.mark.parametrize(("name", "value"), [("cruise_m_s", 0.0), ("jerk_m_s3", -1.0), ("climb_m_s", float("nan")),
                                             ("battery_low_percent", 101.0), ("ground_lost_s", float("inf")),
                                             ("takeoff_altitude_m", -1.0)])
def test_settings_that_make_no_sense_are_refused_by_name(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=name):
        replace(SETTINGS, **{name: value})  # type: ignore[arg-type]
