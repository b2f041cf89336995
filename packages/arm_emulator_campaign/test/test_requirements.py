"""Requirements: robustness that runs along, against brute force over whole traces."""

import math
import sys

import numpy as np
import pytest
from draws import FULL, some

from arm_emulator.base.expression.formula import (
    Constant,
    Operation,
    Signal,
    bind_signals,
    list_signals,
    parse_formula,
)
from arm_emulator.base.refusal import Refusal
from arm_emulator_campaign.judging.program import Program, Rows, Targets, judges
from arm_emulator_campaign.judging.requirement import Robustness
from arm_emulator_campaign.results.parts import find_formula_unit

PERIOD = 0.01
NAMES = ("a", "b.c", "d")
ALL, NONE = (1, math.inf), (-1, -math.inf)


def draw_formula(rng, depth, horizon):
    """A random text, and the brute force over rows of signals that means the same.

    A truth value is (1, margin) where it holds, (-1, margin) where it fails, and (0, 0) where it is
    undefined, which is between them.
    """
    kind = rng.choice(["atom", "not", "and", "or", "implies", "until", "always", "eventually"])
    if depth == 0 or kind == "atom":
        name, limit = str(rng.choice(NAMES)), float(rng.integers(-8, 9)) / 4.0
        sign = str(rng.choice(["<", "<=", ">", ">="]))
        return f"{name} {sign} {limit!r}", atom(name, sign, limit)
    left, of_left = draw_formula(rng, depth - 1, horizon)
    if kind == "not":
        return f"not ({left})", lambda rows, t: negated(of_left(rows, t))
    if kind in ("always", "eventually"):
        text, begin, end = draw_interval(rng, horizon)
        best, none = (min, ALL) if kind == "always" else (max, NONE)
        return f"{kind}{text} ({left})", window(of_left, begin, end, best, none)
    right, of_right = draw_formula(rng, depth - 1, horizon)
    if kind == "until":
        text, begin, end = draw_interval(rng, horizon)
        return f"({left}) until{text} ({right})", until(of_left, of_right, begin, end)
    if kind == "implies":
        return f"({left}) -> ({right})", lambda r, t: max(negated(of_left(r, t)), of_right(r, t))
    best = min if kind == "and" else max
    return f"({left}) {kind} ({right})", lambda r, t: best(of_left(r, t), of_right(r, t))


def atom(name, sign, limit):
    def value(rows, t):
        margin = (rows[name][t] - limit) * (1.0 if sign[0] == ">" else -1.0)
        if math.isnan(margin):
            return 0, 0.0
        return (1 if margin > 0.0 or (margin == 0.0 and "=" in sign) else -1), margin

    return value


def negated(truth):
    return -truth[0], -truth[1]


def margin_of(truth):
    """The margin that stands for a truth value: a strict comparison fails by the least number."""
    holds, margin = truth
    if not holds:
        return math.nan
    return margin or (0.0 if holds > 0 else -sys.float_info.min)


def window(of, begin, end, best, none):
    def value(rows, t):
        last = min(t + end, len(rows["a"]) - 1)
        return best([of(rows, s) for s in range(t + begin, int(last) + 1)], default=none)

    return value


def until(left, right, begin, end):
    def value(rows, t):
        last = min(t + end, len(rows["a"]) - 1)
        best = NONE
        for s in range(t + begin, int(last) + 1):
            left_margin = min((left(rows, r) for r in range(t, s)), default=ALL)
            best = max(best, min(left_margin, right(rows, s)))
        return best

    return value


def draw_interval(rng, horizon):
    if rng.random() < 0.25:
        return "", 0, math.inf
    begin = int(rng.integers(0, horizon))
    if rng.random() < 0.2:
        return f"[{begin * PERIOD:.2f}, end]", begin, math.inf
    end = begin + int(rng.integers(0, horizon))
    return f"[{begin * PERIOD:.2f}, {end * PERIOD:.2f}]", begin, end


def fed(text, rows, cuts, longest=None):
    count = len(rows["a"])
    judged = Judged(parse_formula(text, "test", "formula"), longest or count, room=count)
    for _ in range(2):  # the second trace begins anew
        for first, last in zip([0, *cuts], [*cuts, count], strict=True):
            judged.feed({name: row[first:last] for name, row in rows.items()})
        value = judged.end()
    return value


class Judged:
    """A formula alone in its program."""

    def __init__(self, formula, longest, quantity="formula", room=None):
        self.rows = Rows([], PERIOD)
        row_of = self.rows.add_formula
        robustness = Robustness(judges(), formula, row_of, PERIOD, longest, "c.yaml", quantity)
        self.program = Program(self.rows, [[robustness]], [], [], room or longest)
        self.program.begin_runs()

    def feed(self, signals):
        samples = [signals[name] for name in self.rows.samples] or [*signals.values()]
        self.program.take_samples(np.array([samples]), np.array([len(samples[0])]))

    def end(self):
        value = float(self.program.end_runs()[0][0, 0])
        self.program.begin_runs()
        return value


def draw_case(seed, horizon=None):
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 14))
    text, brute = draw_formula(rng, int(rng.integers(0, 4)), horizon or 1 + count // 2)
    rows = {name: rng.integers(-12, 13, count) / 4.0 + rng.normal(0, 1e-3) for name in NAMES}
    cuts = sorted(rng.integers(0, count + 1, int(rng.integers(0, 4))).tolist())
    return text, brute, rows, cuts


@pytest.mark.parametrize("part", range(10))
def test_random_formulas_equal_brute_force(part):
    # Minima and maxima of differences: not a bit may differ.
    finite = 0
    for k in range(1000 if FULL else 40):
        text, brute, rows, cuts = draw_case([part, k])
        expected = margin_of(brute(rows, 0))
        assert fed(text, rows, cuts) == expected, (part, k, text)
        finite += math.isfinite(expected)
    assert finite > 15


@pytest.mark.parametrize("horizon", [None, 20, 10**11])
def test_traces_of_unknown_length_end_within_or_before_any_window(horizon):
    # Where the length of runs is drawn, no window can be cut to it beforehand.
    for k in range(1000 if FULL else 60):
        text, brute, rows, cuts = draw_case([7, k], horizon)
        expected = margin_of(brute(rows, 0))
        assert fed(text, rows, cuts, longest=2**40) == expected, (k, text)


def test_samples_that_are_no_numbers_decide_nothing():
    """A verdict that is reached beside them would be the same with any values in their place."""
    undefined, decided = 0, 0
    for k in range(300):
        text, brute, rows, cuts = draw_case([8, k])
        count = len(rows["a"])
        rng = np.random.default_rng(k)
        for name in NAMES:
            rows[name][rng.integers(0, count, 2)] = math.nan
        margin, expected = fed(text, rows, cuts), margin_of(brute(rows, 0))
        assert margin == expected or (math.isnan(margin) and math.isnan(expected)), (k, text)
        if math.isnan(margin):
            undefined += 1
            continue
        for _ in range(5):
            replaced = {
                name: np.where(np.isnan(row), rng.uniform(-3.0, 3.0, count), row)
                for name, row in rows.items()
            }
            assert (margin_of(brute(replaced, 0)) >= 0.0) == (margin >= 0.0), (k, text)
        decided += math.isfinite(margin) and any(np.isnan(row).any() for row in rows.values())
    assert undefined > 30 and decided > 100


def test_long_windows_over_a_long_trace():
    rng = np.random.default_rng(1)
    a = rng.normal(size=6_000)
    text = "always[0, 45] eventually[0.5, 3] (a >= 0.2 until[0.1, 1] a <= 1)"
    judged = Judged(parse_formula(text, "test", "formula"), len(a))
    values = []
    for piece in (1, 7, 501, 6_000):
        for first in range(0, len(a), piece):
            some = a[first : first + piece]
            judged.feed({"a": some})
        values.append(judged.end())
    last = 4_500 + 300 + 100
    inner = [
        max(min(a[t:s].min(initial=math.inf) - 0.2, 1.0 - a[s]) for s in range(t + 10, t + 101))
        for t in range(last - 99)
    ]
    inner = np.lib.stride_tricks.sliding_window_view(inner, 251)[50:].max(axis=1)
    assert values == [inner[:4_501].min()] * 4


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("a <", "got its end"),
        ("always a", "must be a comparison"),
        ("a < 1 < ", "got its end"),
        ("always[2, 1] a < 1", "a <= b"),
        ("always[0.001, 0.002] a < 1", "a sample in them"),
        ("sin(a) < 1", "abs, sqrt, min, max"),
        ("abs(a, d) < 1", "1 argument"),
        ("a < 1 and", "got its end"),
        ("a < 1 )", "')' at character 7"),
        ("(a < 1) + 2 < 3", "must be a number"),
        ("q < 1", "name signals"),
        ("x.* < 1", "name signals"),
        ("a = 1", "'= 1' at character 3"),
        ("(" * 200 + "a < 1", "levels"),
        ("not " * 500 + "a < 1", "levels"),
        ("", "got its end"),
    ],
)
def test_bad_formulas_are_refused_in_a_line(text, reason):
    with pytest.raises(Refusal) as refusal:
        formula = parse_formula(text, "c.yaml", "requirements.x")
        Judged(bind_signals(formula, NAMES, "c.yaml", "requirements.x"), 100, "requirements.x")
    assert reason in str(refusal.value) and "\n" not in str(refusal.value)
    assert str(refusal.value).startswith("c.yaml: requirements.x must ")


def test_stars_stand_for_all_joints():
    signal_names = ["q.elbow", "q.waist", "target.elbow", "target.waist", "v.waist"]
    formula = parse_formula("always abs(q.* - target.*) < 1", "c", "r")
    assert list_signals(bind_signals(formula, signal_names, "c", "r")) == set(signal_names[:4])
    rows = Rows(["elbow", "waist"], PERIOD)
    formula = bind_signals(formula, signal_names, "c", "r")
    requirement = Robustness(judges(), formula, rows.add_formula, PERIOD, 3)
    program = Program(rows, [[requirement]], [], [], 3)
    program.begin_runs()
    positions = {"q.elbow": 0.0, "q.waist": 0.5}
    targets = Targets.stack_runs([([0], np.array([[0.25, -0.25]]))])
    program.take_samples(
        np.array([[[positions[name]] * 3 for name in rows.samples]]), np.array([3]), targets
    )
    robustness, measures = program.end_runs()
    assert robustness.tolist() == [[0.25]] and measures.shape == (1, 0)


def draw_arithmetic(rng, depth, signals):
    """A random expression, and its values by NumPy."""
    if depth == 0 or rng.random() < 0.15:
        if rng.random() < 0.2:
            value = float(rng.integers(-3, 4)) / 2.0
            return Constant(value), np.full(len(signals["t"]), value)
        name = str(rng.choice(sorted(signals)))
        return Signal(name), signals[name]
    sign = str(rng.choice(["+", "-", "*", "/", "abs", "sqrt", "min", "max"]))
    left, of_left = draw_arithmetic(rng, depth - 1, signals)
    if sign in ("abs", "sqrt"):
        return Operation(sign, (left,)), getattr(np, sign)(of_left)
    right, of_right = draw_arithmetic(rng, depth - 1, signals)
    name = {"+": "add", "-": "subtract", "*": "multiply", "/": "divide"}.get(sign, f"{sign}imum")
    if sign == "/":  # which numpy gives a sign of infinity
        divisor = np.where(of_right == 0.0, math.nan, of_right)
        return Operation(sign, (left, right)), of_left / divisor
    return Operation(sign, (left, right)), getattr(np, name)(of_left, of_right)


REDUCED = {"max": np.max, "min": np.min, "last": lambda row: row[-1],
           "mean": np.mean, "rms": lambda row: np.sqrt(np.mean(row * row))}  # fmt: skip


@pytest.mark.parametrize("seed", some(range(200), 20))
def test_arithmetic_of_signals_equals_numpy(seed):
    rng = np.random.default_rng([7, seed])
    count = int(rng.choice([1, 3, 255, 256, 257, 700]))
    ticks = np.arange(count)
    joints = ["x", "y.z"]
    since = np.unique([0, *rng.integers(0, count, 5)])
    targets = Targets.stack_runs([(since, rng.normal(size=(len(since), 2)))])
    signals = {name: rng.normal(size=count) for name in ("a", "q.x", "q.y.z")}
    signals |= {"t": ticks * PERIOD, "tick": ticks.astype(float)}
    for place, joint in enumerate(joints):
        target = targets.q[np.searchsorted(since, ticks, "right") - 1, place]
        signals |= {f"target.{joint}": target, f"error.{joint}": signals[f"q.{joint}"] - target}
    rows = Rows(joints, PERIOD)
    with np.errstate(all="ignore"):
        expressions = [draw_arithmetic(rng, 4, signals) for _ in range(8)]
    traced = [rows.add_expression(expression) for expression, _ in expressions]
    measures = [(kind, row) for kind in REDUCED for row in traced]
    program = Program(rows, [()], measures, traced, count)
    samples = np.array([signals[name] for name in rows.samples]).reshape(-1, count)
    for _ in range(2):  # the second run begins anew
        program.begin_runs()
        pieces, first = [], 0
        for last in [*np.sort(rng.integers(0, count + 1, 2)), count]:
            piece = np.ascontiguousarray(samples[:, first:last])[np.newaxis]
            program.take_samples(piece, np.array([last - first]), targets)
            pieces.append(program.kept[0, :, : last - first].copy())
            first = last
        _, reduced = program.end_runs()
        assert np.array_equal(
            np.hstack(pieces), [values for _, values in expressions], equal_nan=True
        )
    with np.errstate(all="ignore"):
        by_numpy = [REDUCED[kind](values) for kind in REDUCED for _, values in expressions]
    scale = [np.abs(values).max() for _, values in expressions] * len(REDUCED)
    for value, expected, magnitude in zip(reduced[0], by_numpy, scale, strict=True):
        # Sums in another order: rounding of `count` terms.
        same = value == expected or (math.isnan(value) and math.isnan(expected))
        assert same or abs(value - expected) <= 1e-15 * count * magnitude


@pytest.mark.parametrize(
    ("text", "unit"),
    [
        ("always abs(q.a - 0.5) < 0.1", "rad"),
        ("always (q.a < 0.1 and abs(current.a) < 3)", ""),
        ("eventually[0, 1] always[0, 1] max(current.a, 2 * current.a) < 3", "A"),
        ("always current.a / 2 + 1 < 3", "A"),
        ("always q.a * current.a < 3", ""),
        ("always 2 / current.a < 3", ""),
        ("always sqrt(current.a) < 3", ""),
        ("always 1 < 2", None),
    ],
)
def test_robustness_has_the_unit_of_the_compared_quantity(text, unit):
    units = {"q.a": "rad", "current.a": "A"}
    assert find_formula_unit(parse_formula(text, "c", "r"), units) == unit
