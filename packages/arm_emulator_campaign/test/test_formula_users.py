"""One language of formulas: all that evaluate a text at a moment give it the same answer.

The truth is written beside each text, or computed by Python and NumPy for random ones.
"""

import math
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
import yaml
from draws import FULL, with_slow

from arm_emulator import Breakpoint, Condition, Plant, Refusal, Session, load_scene
from arm_emulator.base.expression.formula import bind_signals, parse_formula
from arm_emulator.machine.session.tool_chain import TOOL
from arm_emulator_campaign.definition.campaign import Campaign
from arm_emulator_campaign.definition.campaign_file import load_campaign
from arm_emulator_campaign.results.parts import find_formula_unit
from arm_emulator_campaign.simulation.batch_simulator import BatchSimulator
from arm_emulator_campaign.simulation.case import draw_case
from arm_emulator_campaign.simulation.forking import ForkingRun
from arm_emulator_campaign.simulation.simulator import Simulator

SCENE = load_scene("three_axis")
Q = dict(zip(SCENE.joint_names, SCENE.start.tolist(), strict=True))
UNDEFINED = math.nan
FAILS_BY_0 = -sys.float_info.min
MANY = 1900  # terms: a text may have 4000 characters

# At rest at tick 0, where speeds and currents are 0, with the margin; NaN: undefined.
TABLE = {
    "q.elbow / 2 < 100": 100.0 - Q["elbow"] / 2,
    "v.elbow <= 0": 0.0,
    "v.elbow < 0": FAILS_BY_0,
    "not v.elbow < 0": 0.0,
    "not v.elbow <= 0": FAILS_BY_0,
    "0 <= v.elbow <= 0": 0.0,
    "0 <= v.elbow < 0": FAILS_BY_0,
    "v.elbow > 0 implies v.elbow > 5": 0.0,
    # A quotient by 0 is not a number, whatever the signs of dividend and 0.
    "1 / v.elbow > 5": UNDEFINED,
    "not (1 / v.elbow > 5)": UNDEFINED,
    "1 / v.elbow <= 5": UNDEFINED,
    "0 / v.elbow > 5": UNDEFINED,
    "not (0 / v.elbow > 5)": UNDEFINED,
    "1 / (0 * (0 - 1)) < 5": UNDEFINED,
    "abs(current.elbow / v.elbow) <= 1": UNDEFINED,
    "sqrt(0 - 1) >= 0": UNDEFINED,
    "not (sqrt(0 - 1) >= 0)": UNDEFINED,
    "sqrt(0 - 0) >= 0": 0.0,
    # So are a minimum and a maximum with it, in either order.
    "min(0 / v.elbow, 1) <= 1": UNDEFINED,
    "min(1, 0 / v.elbow) <= 1": UNDEFINED,
    "max(1, 0 / v.elbow) >= 1": UNDEFINED,
    "max(0 / v.elbow, 1) >= 1": UNDEFINED,
    "max(1, 2, 0 / v.elbow, 3) >= 1": UNDEFINED,
    "min(3, 1, 2) >= 1": 0.0,
    # Results that are too large are infinite.
    "1e308 * 100 <= 1e308 * 1000": 0.0,
    "1e308 * 100 < 1e308 * 1000": FAILS_BY_0,
    "1e308 * 100 > 1": math.inf,
    "0 - 1e308 * 100 > 1": -math.inf,
    "1e308 * 100 - 1e308 * 100 >= 0": UNDEFINED,
    "0 * (1e308 * 100) >= 0": UNDEFINED,
    "1e308 + 1e308 >= 1e308": math.inf,
    "1e-300 * 1e-300 >= 0": 0.0,
    # An undefined part is neither true nor false: the others decide where they can.
    "q.elbow < 100 or 1 / v.elbow > 5": 100.0 - Q["elbow"],
    "1 / v.elbow > 5 or q.elbow < 100": 100.0 - Q["elbow"],
    "q.elbow > 100 or 1 / v.elbow > 5": UNDEFINED,
    "1 / v.elbow > 5 or q.elbow > 100": UNDEFINED,
    "q.elbow > 100 and 1 / v.elbow > 5": Q["elbow"] - 100.0,
    "1 / v.elbow > 5 and q.elbow > 100": Q["elbow"] - 100.0,
    "q.elbow < 100 and 1 / v.elbow > 5": UNDEFINED,
    "abs(v.elbow) > 0.1 implies current.elbow / v.elbow < 5": 0.1,
    "1 / v.elbow > 5 implies 1 / v.elbow > 5": UNDEFINED,
    # Sums that are longer than Python recurses.
    "+".join(["1"] * MANY) + " >= 1": MANY - 1.0,
    "-".join(["1"] * MANY) + " <= 1": MANY - 1.0,
    "min(" + ",".join(["1"] * MANY) + ") >= 1": 0.0,
    " and ".join(["1>0"] * 480): 1.0,
    "<".join(map(str, range(700))): 1.0,
    "t >= 0": 0.0,
    "tick < 1": 1.0,
}  # fmt: skip

CAMPAIGN = {"scene": "three_axis", "scenario": {"seconds": 0.001}}
SAMPLED = {**CAMPAIGN, "count": 1}
NOISY = {
    **CAMPAIGN,
    "set": {"faults": ["elbow.encoder_misses_edges"]},
    "vary": {"faults.edges.magnitude": "uniform(0.1, 0.2)"},
    "faults": {
        "edges": {
            "kind": "machine",
            "at": 0.0,
            "fault": "elbow.encoder_misses_edges",
            "magnitude": 0.1,
        }
    },
}

Verdicts = Sequence[float]


def campaign_of(texts: Sequence[str], folder: Path, data: dict[str, object]) -> Campaign:
    requirements = {f"r{k}": f"always[0, 0] ({text})" for k, text in enumerate(texts)}
    file = folder / "c.yaml"
    file.write_text(yaml.safe_dump({**data, "requirements": requirements}, sort_keys=False))
    return load_campaign(file)


def by_condition(texts: Sequence[str], folder: Path) -> list[bool]:
    session = Session(SCENE, "lockstep", "first_answer")
    return [Condition(text, SCENE).holds(session) for text in texts]


def by_breakpoint(texts: Sequence[str], folder: Path) -> list[bool]:
    plant, hits = Plant(SCENE), []
    for text in texts:
        condition = Breakpoint(plant, text)
        hits.append(bool(condition.struct.held))
        condition.close()
    return hits


def by_lanes(texts: Sequence[str], folder: Path) -> Verdicts:
    campaign = campaign_of(texts, folder, SAMPLED)
    case = draw_case(campaign.variation, 0)
    return list(BatchSimulator(campaign).simulate_run(case).robustness.values())


def by_simulator(texts: Sequence[str], folder: Path) -> Verdicts:
    return list(Simulator(campaign_of(texts, folder, SAMPLED)).simulate_run(0).robustness.values())


def by_splitting(texts: Sequence[str], folder: Path) -> Verdicts:
    margins = []
    for text in texts:
        search = {"method": "splitting", "of": "r0", "per_level": 20, "repetitions": 4}
        run = ForkingRun(campaign_of([text], folder, {**NOISY, "search": search}))
        run.begin_run(0, 1)
        margins.append(run.reach_level(-math.inf)[1])
    return margins


VERDICTS = (by_condition, by_breakpoint)
MARGINS = (by_lanes, by_simulator)


@pytest.mark.parametrize("user", with_slow(VERDICTS, 1))
def test_verdicts(user: Callable[[Sequence[str], Path], list[bool]], tmp_path: Path) -> None:
    verdicts = dict(zip(TABLE, user(list(TABLE), tmp_path), strict=True))
    assert verdicts == {text: margin >= 0.0 for text, margin in TABLE.items()}


@pytest.mark.parametrize("user", with_slow(MARGINS, 1))
def test_margins(user: Callable[[Sequence[str], Path], Verdicts], tmp_path: Path) -> None:
    margins = dict(zip(TABLE, user(list(TABLE), tmp_path), strict=True))
    assert margins == {text: reported(margin) for text, margin in TABLE.items()}


@pytest.mark.slow
def test_margins_of_splitting(tmp_path: Path) -> None:
    texts = [text for text in TABLE if "elbow" in text]
    margins = dict(zip(texts, by_splitting(texts, tmp_path), strict=True))
    for text, margin in margins.items():
        expected = reported(TABLE[text])
        # 0 is the level of failure: the sampled run goes on to its end by no other margin.
        assert margin == expected or abs(margin - expected) <= sys.float_info.min, text


def reported(margin: float) -> float:
    """A campaign reports what is undefined as what fails."""
    return -math.inf if math.isnan(margin) else margin


def arithmetic(rng: np.random.Generator, depth: int) -> tuple[str, np.float64]:
    """A random text, and its value by NumPy."""
    if depth == 0 or rng.random() < 0.15:
        values = {"0": 0.0, "1": 1.0, "2.5": 2.5, "1e308": 1e308, "v.elbow": 0.0}
        values |= {f"q.{joint}": q for joint, q in Q.items()}
        text = str(rng.choice(list(values)))
        return text, np.float64(values[text])
    left, of_left = arithmetic(rng, depth - 1)
    right, of_right = arithmetic(rng, depth - 1)
    match str(rng.choice(["+", "-", "*", "/", "abs", "sqrt", "min", "max"])):
        case "+":
            return f"({left} + {right})", of_left + of_right
        case "-":
            return f"({left} - {right})", of_left - of_right
        case "*":
            return f"({left} * {right})", of_left * of_right
        case "/":
            quotient = of_left / of_right if of_right != 0.0 else np.float64(math.nan)
            return f"({left} / {right})", quotient
        case "abs" | "sqrt" as name:
            return f"{name}({left})", getattr(np, name)(of_left)
        case name:
            return f"{name}({left}, {right})", getattr(np, f"{name}imum")(of_left, of_right)


def formula(rng: np.random.Generator, depth: int) -> tuple[str, tuple[int, float]]:
    """A random text, and (1, margin) where it holds, (-1, margin) where not, (0, 0) undefined."""
    if depth == 0 or rng.random() < 0.3:
        (left, of_left), (right, of_right) = arithmetic(rng, 2), arithmetic(rng, 2)
        sign = str(rng.choice(["<", "<=", ">", ">="]))
        more, less = (of_right, of_left) if sign[0] == "<" else (of_left, of_right)
        if math.isnan(more) or math.isnan(less):
            return f"{left} {sign} {right}", (0, 0.0)
        margin = 0.0 if more == less else float(more - less)
        holds = more > less or (more == less and "=" in sign)
        return f"{left} {sign} {right}", (1 if holds else -1, margin)
    left_term, value_of_left = formula(rng, depth - 1)
    if rng.random() < 0.25:
        return f"not ({left_term})", (-value_of_left[0], -value_of_left[1])
    right_term, value_of_right = formula(rng, depth - 1)
    sign = str(rng.choice(["and", "or"]))
    joined = (
        min(value_of_left, value_of_right) if sign == "and" else max(value_of_left, value_of_right)
    )
    return f"({left_term}) {sign} ({right_term})", joined


def test_random_formulas_by_all(tmp_path: Path) -> None:
    count = 300 if FULL else 150
    for seed in range(20 if FULL else 1):
        rng = np.random.default_rng(seed)
        with np.errstate(all="ignore"):
            formulas = dict(formula(rng, 3) for _ in range(count))
        texts = list(formulas)
        holds = [rank > 0 for rank, _ in formulas.values()]
        assert sum(rank == 0 for rank, _ in formulas.values()) > count / 15
        assert count / 6 < sum(holds) < count / 1.2
        for user in VERDICTS:
            assert dict(zip(texts, user(texts, tmp_path), strict=True)) == dict(
                zip(texts, holds, strict=True)
            )
        margins = [
            -math.inf
            if rank == 0
            else margin
            if abs(margin) > sys.float_info.min  # the least number that stands for 0
            else 0.0
            if rank > 0
            else FAILS_BY_0
            for rank, margin in formulas.values()
        ]
        for judge in MARGINS:
            assert dict(zip(texts, judge(texts, tmp_path), strict=True)) == dict(
                zip(texts, margins, strict=True)
            )


def test_a_moving_machine_has_the_same_signals_in_conditions_and_campaigns(
    tmp_path: Path,
) -> None:
    """Time, tick and tool to the last bit: from the same machine at the same ticks."""
    file = tmp_path / "c.yaml"
    requirements = {"end": "eventually (tick >= 40)"}
    signals = {name.replace(".", "_"): name for name in ("t", "tick", *TOOL)}
    measures = {name: f"last({signal})" for name, signal in signals.items()}
    file.write_text(yaml.safe_dump({
        "scene": "three_axis", "requirements": requirements, "measures": measures, "count": 1,
        "scenario": {"seconds": 0.04, "targets": [{"at": 0.0, "elbow": 1.5}]},
    }))  # fmt: skip
    simulator = Simulator(load_campaign(file))
    values = simulator.simulate_run(0).measures
    session = simulator.session
    assert session.tick == values["tick"] == 40
    assert session.state.v.any()
    for name, value in values.items():
        text = f"{value!r} <= {signals[name]} <= {value!r}"
        assert Condition(text, SCENE).holds(session), text


def test_walks_of_long_formulas_need_no_recursion() -> None:
    text = "+".join(["v.*"] * 990) + " > 1"
    signal_names = [f"v.{joint}" for joint in SCENE.joint_names]
    bound = bind_signals(parse_formula(text, "c", "r"), signal_names, "c", "r")
    assert find_formula_unit(bound, dict.fromkeys(signal_names, "rad/s")) == "rad/s"
    assert not Breakpoint(Plant(SCENE), text).struct.held


@pytest.mark.parametrize(
    "text", ["(" * 31 + "1" + ")" * 31 + " > 0", "-" * 70 + "1 > 0", "1+" * 2000 + "1 > 0"]
)
def test_texts_that_are_too_deep_or_long_are_refused_in_a_line(text: str) -> None:
    for refused_call in (lambda: Condition(text, SCENE), lambda: Breakpoint(Plant(SCENE), text)):
        with pytest.raises(Refusal, match=r"levels|characters"):
            refused_call()
