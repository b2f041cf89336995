"""Machines that break integrators: held, or detected and reported, no numbers past divergence."""

import re
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from draws import FULL, some, with_slow
from hard_cases import (
    CASES,
    DETECTED,
    DRIFTS,
    EARTH,
    EVERYTHING,
    FAILED,
    LINKS_ALONE,
    RIGID,
    SHARED,
    spin,
    undamped_stiff_gear,
)

from arm_emulator import Diverged, Plant, Scene, load_scene
from arm_emulator.analysis.stability import SmallMotions, describe_divergence
from arm_emulator.machine.schemes.known import KNOWN, SCHEMES

# The corners below meet the class of the first, with gears without damping.
SPARED = ("undamped stiff gear", "50 links")
TRIED = sorted(CASES, key=lambda name: name in SPARED)


def growing() -> set[str]:
    """Schemes with which an oscillation that nothing damps grows, at some step."""
    J, steps = np.array([[0.0, 1.0], [-1.0, 0.0]]), np.logspace(-1, 3, 100)
    return {
        name
        for name, scheme in KNOWN.items()
        if any(
            np.abs(np.linalg.eigvals(scheme.build_step_matrix(J, J, 0, h))).max() > 1.001
            for h in steps
        )
    }


@pytest.mark.parametrize("name", with_slow(some(TRIED, len(CASES) - len(SPARED)), 1))
def test_hard_case(name: str) -> None:
    """The bounds stand in hard_cases.py, each beside its truth and reason."""
    case = CASES[name]
    outcomes = list(case(not FULL))
    tried = {outcome.scheme for outcome in outcomes}
    assert tried & {"rosenbrock", "extrapolated"}, f"tried: {tried}"
    verdicts = {(outcome.scheme, outcome.dt): outcome.verdict for outcome in outcomes}
    assert FAILED not in verdicts.values(), verdicts
    if case is spin:  # nothing is stiff there and nothing damps: no case for `implicit`
        fine = [1e-4, 1e-5] if FULL else [1e-4]
        second = tried & {"rosenbrock", "extrapolated"}
        assert {verdicts[scheme, dt] for scheme in second for dt in fine} == {"held"}, verdicts
        return
    assert DRIFTS not in verdicts.values(), verdicts
    for scheme in set(SCHEMES) - (growing() if case is undamped_stiff_gear else {"paper"}):
        assert DETECTED not in {v for (s, _), v in verdicts.items() if s == scheme}, verdicts


# Bounded everywhere

COMMON = {"servo_period": 1e-2, **SHARED}
FASTEST: dict[tuple[str, float, str], float] = {}  # what was found, for tests with the same truth


def corners(everything: bool) -> Iterator[Any]:
    """The stability map's corners, and some that combine the worst. Its middle is three_axis."""
    gear, motor = "joints.*.gear.", "joints.*.motor."
    for stiffness in (1e2, 1e8):
        yield pytest.param({f"{gear}stiffness": stiffness}, id=f"Kg {stiffness:g}")
    for inductance in (1e-7, 1e-2):  # R = 1 ohm
        yield pytest.param({f"{motor}inductance": inductance}, id=f"L/R {inductance:g}")
    # Links of 0.1 to 1 kg m2; the rotor's 1e-4 kg m2 are 1 kg m2 behind the gear.
    for rotor in (1e-8, 1e0):
        yield pytest.param({f"{motor}rotor_inertia": rotor}, id=f"rotor {rotor:g}")
    worst = {f"{gear}stiffness": 1e8, f"{gear}damping": 0.0, f"{motor}inductance": 1e-7}
    yield pytest.param({**worst, f"{motor}rotor_inertia": 1e-8}, id="all fast, undamped")
    slow = {f"{gear}stiffness": 1e2, f"{gear}damping": 0.0, f"{motor}inductance": 1e-2}
    yield pytest.param({**slow, f"{motor}rotor_inertia": 1e-8}, id="all slow, undamped")
    if everything:
        yield pytest.param({**EVERYTHING, **worst}, id="all fast, everything on")


def fastest(scene: Scene) -> float:
    """Largest link speed under sines, under saturated voltages to and fro, and after a throw."""
    N, K = len(scene.joints), 150
    t, rng = scene.servo_period * np.arange(K)[:, None], np.random.default_rng(4)
    plant, reached = Plant(scene), 0.0
    for V, v in (
        (12.0 * np.sin(2.0 * np.pi * (0.5 + 0.3 * np.arange(N)) * t + np.arange(N)), 0.0),
        (48.0 * rng.choice([-1.0, 1.0], (K, N)), 0.0),
        (np.zeros((K, N)), 5.0),
    ):
        plant.reset(v=np.full(N, v))
        for row in V:
            plant.advance(row, scene.steps_per_period)
            reached = max(reached, float(np.abs(plant.state.v).max()))
    return reached


def fastest_of(scheme: str, dt: float, **overrides: Any) -> float:
    key = (scheme, dt, repr(overrides))
    if key not in FASTEST:
        own = {"integrator.scheme": scheme, "integrator.dt": dt, **COMMON}
        FASTEST[key] = fastest(load_scene("three_axis", overrides={**own, **overrides}))
    return FASTEST[key]


# With everything on, each scheme needs a library more.
@pytest.mark.parametrize(
    ("scheme", "overrides"),
    [
        pytest.param(scheme, *corner.values, id=f"{scheme}-{corner.id}")
        for scheme in ("rosenbrock", "implicit", "extrapolated")
        for corner in corners(FULL or scheme == "rosenbrock")
    ],
)
def test_bounded_up_to_ten_milliseconds(scheme: str, overrides: dict[str, Any]) -> None:
    """No step up to 10 ms makes the arm faster than it is; the plant's own check stays silent."""

    truth = fastest_of("rosenbrock", 5e-5, **overrides)
    for dt in (1e-2, 2e-3, 1e-3, 1e-4):
        # At alternating 48 V light links turn by 0.2 rad within a step of 10 ms. The explicit part
        # for the turning of the links has an error of that size.
        reached = fastest_of(scheme, dt, **overrides)
        assert reached < 1.5 * truth, f"at {dt} s it reaches {reached:.3g} of {truth:.3g} rad/s"


# Divergence


def paper(dt: float, **overrides: Any) -> Scene:
    own = {"integrator.scheme": "paper", "integrator.dt": dt, **COMMON}
    return load_scene("three_axis", overrides={**own, **overrides})


def drive(plant: Plant, rows: int) -> None:
    t = 1e-2 * np.arange(rows)[:, None]
    for row in 12.0 * np.sin(2.0 * np.pi * (0.5 + 0.3 * np.arange(3)) * t + np.arange(3)):
        plant.advance(row, plant.scene.steps_per_period)


def test_a_divergence_that_stays_finite_is_detected() -> None:
    """At 1.25 ms `paper` rattles at 100 rad/s indefinitely and never leaves the finite world."""
    plant = Plant(paper(1.25e-3))
    with pytest.raises(Diverged) as fault:
        drive(plant, 300)
    holding = plant.state
    assert holding.t == fault.value.t < 1.0, "when it diverged, by the plant and by the fault"
    for _ in range(3):  # and it stays there, whatever is asked for
        with pytest.raises(Diverged):
            plant.advance([0.0, 0.0, 0.0], 1)
        same = plant.t == holding.t and np.array_equal(plant.state.q, holding.q)
        assert same, "a machine that has diverged has moved"
    plant.reset()
    plant.advance([0.0, 0.0, 0.0], 1000)


@pytest.mark.parametrize(
    ("scheme", "overrides"),
    [
        *((scheme, SHARED) for scheme in SCHEMES),
        *((scheme, {**LINKS_ALONE, "gravity": EARTH}) for scheme in some(SCHEMES, 0)),
        # Motors that give more mechanical power than they take from their back-EMF.
        ("rosenbrock", {**SHARED, "joints.*.motor.torque_constant": 0.06}),
    ],
)
def test_no_sound_motion_is_taken_for_a_divergence(scheme: str, overrides: dict[str, Any]) -> None:
    """Motions of all kinds whose energy swings: thrown, braked, dropped, driven to and fro."""
    own = {"integrator.scheme": scheme, "integrator.dt": 1e-4}
    plant = Plant(load_scene("three_axis", overrides={**own, **overrides}))
    plant.reset(v=[5.0, -3.0, 4.0])
    rng = np.random.default_rng(6)
    for _ in range(100):
        plant.advance(rng.uniform(-48.0, 48.0, 3), 300)


def test_the_text_states_which_joint_when_and_why() -> None:
    plant = Plant(paper(1.25e-3))
    words = (
        r"joint (waist|shoulder|elbow) diverged after t = 0\.\d+ s with scheme paper at "
        r"dt = 0\.00125 s; the plant stays at the last state before; each step multiplies a small "
        r"motion about rest in this pose by 1\.\d+, with dt = (0\.00\d+) s none grows"
    )
    with pytest.raises(Diverged) as reported:
        drive(plant, 300)
    reported.value.hint = describe_divergence(reported.value)
    result = re.search(words, str(reported.value))
    assert result, reported.value
    assert 1e-3 < float(result[2]) < 1.25e-3, "the largest step that holds"
    drive(Plant(paper(1e-2 / 9)), 300)  # 1.11 ms does hold


def test_a_motion_too_fast_for_its_step_is_reported_as_such() -> None:
    plant = Plant(paper(1e-3))
    plant.reset(v=[5000.0, 0.0, 0.0])
    with pytest.raises(Diverged) as reported:
        plant.advance([0.0, 0.0, 0.0], 10)
    hint = describe_divergence(reported.value)
    assert "the motion is too fast for the step, 5 rad or m per step" in hint, hint


@pytest.mark.parametrize(
    "overrides",
    some(
        [
            pytest.param({}, id="three_axis"),
            pytest.param({"joints.*.motor.inductance": None}, id="no inductance"),
            pytest.param({"joints.*.gear.stiffness": 1e5}, id="stiff"),
            pytest.param({"joints.*.motor.rotor_inertia": 1e-6}, id="light rotor"),
            pytest.param({**RIGID, "joints.*.friction.viscous": 300.0}, id="rigid"),
        ],
        4,
    ),
)
def test_small_motions_hold_up_to_the_step_that_is_reported(overrides: dict[str, Any]) -> None:
    """A push of 1e-6 rad/s on a resting arm: it fades below the largest step and grows above."""
    plant = Plant(paper(1e-2, **overrides))
    motions = SmallMotions(plant, plant.scene.start)
    # The step need not divide the servo period here.
    low, high = 1e-7, 1e-2
    while high / low > 1.001:
        middle = (low * high) ** 0.5
        low, high = (middle, high) if motions.is_stable("paper", middle) else (low, middle)
    assert low > 1e-6 and high < 1e-2, f"the largest step is looked for up to {low:.2g} s"
    largest = motions.find_largest_step("paper")
    assert largest is not None and largest <= low, "the step that is reported, and the largest"
    steps = round(1e-2 / largest)  # a divisor of the period, sought to 2 %
    assert 1e-2 / (0.98 * steps - 1.0) > low, "the next step, and the largest"
    speeds = []
    for factor in (0.97, 1.1):
        period = 1e-9 * round(1e9 * factor * low)  # whole nanoseconds
        pushed = Plant(paper(period, **{**overrides, "servo_period": period}))
        pushed.reset(v=[1e-6, -1e-6, 1e-6])
        try:
            pushed.advance(np.zeros(3), 20_000)
            speeds.append(float(np.abs(pushed.state.v).max()))
        except Diverged:
            speeds.append(np.inf)
    assert speeds[0] <= 1e-6, "speed after a push, below the largest step"
    assert speeds[1] > 1e-3, "speed after a push, above it"
