"""Conditions on a machine, against Python's own evaluation of the same text."""

import math
import re
from typing import Any

import numpy as np
import pytest

from arm_emulator import Condition, Kinematics, Refusal, Session, Timeline, load_scene
from arm_emulator.machine.session.record_row import list_columns
from arm_emulator.runs.condition import TOOL
from arm_emulator.runs.offline import load_offline_run

SCENE = load_scene("three_axis")
NAMES = [*(column.name for column in list_columns(SCENE)), *TOOL]


def some_session(seed: int) -> Session:
    session, rng = Session(SCENE, "lockstep", "free_run"), np.random.default_rng(seed)
    for _ in range(20):
        session.offer(session.tick, SCENE.joint_names, rng.uniform(-10.0, 10.0, 3).tolist())
        session.advance()
    return session


def values_of(session: Session) -> dict[str, float]:
    state, measured = session.state, session.measured
    values: dict[str, float] = {
        "t": state.t, "tick": float(session.tick), "energy": session.energy,
    }  # fmt: skip
    for name in NAMES:
        path = name.split(".")
        if path[0] == "measured":
            row = getattr(measured, path[1])
            values[name] = float(np.atleast_1d(row)[SCENE.joint_names.index(path[2])])
        elif len(path) == 2 and path[0] != "tool":
            values[name] = float(getattr(state, path[0])[SCENE.joint_names.index(path[1])])
    kinematics = Kinematics(SCENE.urdf, SCENE.joint_names, SCENE.tool)
    return values | dict(zip(TOOL, kinematics.forward(state.q)[1].tolist(), strict=True))


def arithmetic(rng: np.random.Generator, depth: int) -> str:
    match int(rng.integers(6 if depth else 2)):
        case 0:
            return f"{rng.uniform(-5.0, 5.0):.3f}".replace("-", "0 - ")
        case 1:
            return str(rng.choice(NAMES))
        case 2:
            return f"abs({arithmetic(rng, depth - 1)})"
        case 3:
            return f"min({arithmetic(rng, depth - 1)}, {arithmetic(rng, depth - 1)})"
        case 4:
            return f"max({arithmetic(rng, depth - 1)}, {arithmetic(rng, depth - 1)})"
        case _:
            sign = rng.choice(["+", "-", "*", "/"])
            return f"({arithmetic(rng, depth - 1)} {sign} {arithmetic(rng, depth - 1)})"


def comparison(rng: np.random.Generator, depth: int) -> str:
    match int(rng.integers(5 if depth else 2)):
        case 0 | 1:
            sign = rng.choice(["<", "<=", ">", ">="])
            return f"{arithmetic(rng, 2)} {sign} {arithmetic(rng, 2)}"
        case 2:
            return f"not ({comparison(rng, depth - 1)})"
        case 3:
            return f"({comparison(rng, depth - 1)}) and ({comparison(rng, depth - 1)})"
        case _:
            return f"({comparison(rng, depth - 1)}) or ({comparison(rng, depth - 1)})"


def by_python(text: str, values: dict[str, float]) -> bool | None:
    """The condition by Python; None: it divides by 0."""
    names = sorted(values, key=len, reverse=True)
    pattern = re.compile("|".join(rf"\b{re.escape(name)}\b" for name in names))
    replaced = pattern.sub(lambda result: f"v[{result[0]!r}]", text)
    try:
        return bool(eval(replaced, {"v": values, "abs": abs, "min": min, "max": max}))
    except ZeroDivisionError:
        return None


@pytest.mark.slow
def test_random_conditions_hold_where_python_finds_them_true() -> None:
    rng, outcomes = np.random.default_rng(1), list[bool]()
    sessions = [some_session(seed) for seed in range(4)]
    expected_values = [values_of(session) for session in sessions]
    for _ in range(300):
        text = comparison(rng, 3)
        condition = Condition(text, SCENE)
        for session, values in zip(sessions, expected_values, strict=True):
            expected = by_python(text, values)
            if expected is not None:
                assert condition.holds(session) == expected, text
                outcomes.append(expected)
    assert 0.2 < np.mean(outcomes) < 0.8, "both come"


def test_comparisons_are_strict_as_they_are_written() -> None:
    session = Session(SCENE, "lockstep", "free_run")  # at rest
    for text, holds in (
        ("v.waist > 0", False), ("v.waist >= 0", True), ("v.waist < 0", False),
        ("v.waist <= 0", True), ("0 <= v.waist <= 0", True), ("0 <= v.waist < 0", False),
        ("not v.waist > 0", True), ("v.waist > 0 implies v.waist > 5", True),
    ):  # fmt: skip
        assert Condition(text, SCENE).holds(session) is holds, text


def test_a_star_means_every_joint() -> None:
    session = Session(SCENE, "lockstep", "free_run")
    session.set_state(SCENE.joint_names, {"v": [1.0, 2.0, 3.0]})
    for smallest, all_of, some_of in ((0.5, True, True), (1.5, False, True), (3.5, False, False)):
        assert Condition(f"v.* > {smallest}", SCENE).holds(session) is all_of
        assert Condition(f"not v.* <= {smallest}", SCENE).holds(session) is some_of


@pytest.mark.parametrize(
    ("text", "rule"),
    [
        ("v.elbw > 1", "valid: v.elbow"), ("v.elbow", "be a comparison"), ("", "whole formula"),
        ("always(v.elbow > 1)", "without always"), ("v.elbow > 1 until v.waist > 1", "until"),
        ("t > 1 or eventually[0, 1](t > 1)", "eventually"), ("__import__ > 1", "name signals"),
        ("v.elbow > 1; t > 1", "be a formula"), (5, "be text"), (None, "be text"),
        ("(" * 100 + "t > 1" + ")" * 100, "nest at most"),
    ],
)  # fmt: skip
def test_malformed_conditions_are_refused(text: Any, rule: str) -> None:
    with pytest.raises(Refusal, match=re.escape(rule)):
        Condition(text, SCENE)


def test_a_condition_with_a_division_by_zero_never_holds() -> None:
    session = Session(SCENE, "lockstep", "free_run")
    for text in ("1 / v.waist > 0", "1 / v.waist <= 0", "sqrt(0 - 1) >= 0"):
        assert not Condition(text, SCENE).holds(session)
    assert not math.isnan(session.energy)


def test_a_run_is_followed_to_the_tick_at_which_a_condition_begins_to_hold() -> None:
    run, straight = load_offline_run("three_axis"), load_offline_run("three_axis")
    for offline in (run, straight):
        first = offline.session.scene.joint_names[0]
        offline.session.set_state([first], {"v": [0.5]})
    condition = Condition("abs(v.waist) < 0.02", run.session.scene)
    line = Timeline(run, every=50)
    result = line.find(lambda offline: condition.holds(offline.session), 400)
    assert result is not None and result == line.tick > 1
    speeds = []
    for _ in range(result):
        straight.advance(1)
        speeds.append(abs(straight.session.state.v[0]))
    assert speeds[-1] < 0.02 <= min(speeds[:-1])
    line.go_to(0)
    assert line.find(lambda offline: condition.holds(offline.session), 400) == result, (
        "from the past"
    )
    line.go_to(0)
    assert line.find(lambda offline: False, 37) is None and line.tick == 37
    with pytest.raises(Refusal, match="last must be"):
        line.find(lambda offline: True, 36)
