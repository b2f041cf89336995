"""Gears with hysteresis: springs that bend with the twist and slip one after the other."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from draws import some, with_slow
from machines import LINK_INERTIA, make_link_urdf, write_scene
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from arm_emulator import ExternalWrench, Plant, Scene, linearise, load_scene
from arm_emulator.base.arrays import Array
from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.parts.gears.hysteresis import Hysteresis
from arm_emulator.machine.schemes.known import KNOWN, SCHEMES
from oracles.random_chain import write_slides

PERIOD = 1e-2  # s, over which a voltage is held
STEPS = (80, 160, 320, 640)  # in a period
RATIO, ROTOR, KT = 0.02, 1e-4, 0.1  # 1 ohm, no back EMF: the torque is KT times the voltage
DAMPING = 0.3  # N m s/rad


def sample_hysteresis(rng: np.random.Generator, elements: int) -> dict[str, float]:
    """A loop that takes up to all of some 10 N m, with twists of 1e-4 to 1e-3 rad."""
    return {
        "torque": float(rng.uniform(2.0, 10.0)),
        "twist": float(10 ** rng.uniform(-3.5, -2.5)),
        "elements": elements,
    }


def scene_of(
    folder: Path,
    hysteresis: dict[str, float],
    steps: int,
    scheme: str = "rosenbrock",
    events: str = "step",
    gear: dict[str, Any] | None = None,
) -> Scene:
    """A link without gravity and friction behind an elastic gear with hysteresis."""
    joint: dict[str, Any] = {
        "motor": {"resistance": 1.0, "torque_constant": KT, "back_emf_constant": 0.0,
                  "rotor_inertia": ROTOR},
        "gear": {"ratio": RATIO, "stiffness": 5000.0, "damping": DAMPING, **(gear or {}),
                 "hysteresis": hysteresis},
    }  # fmt: skip
    file = write_scene(
        folder, make_link_urdf(), {"joint": joint}, servo_period=PERIOD, supply_voltage=1e3,
        integrator={"scheme": scheme, "dt": PERIOD / steps, "events": events}, energy_flow=True,
        varied=["joints.joint.gear.hysteresis.*"],
    )  # fmt: skip
    return load_scene(file)


class Truth:
    """The same machine as elements that stick or slip, cut where one of them changes."""

    def __init__(self, hysteresis: dict[str, float], cubic: float = 0.0) -> None:
        n, self.cubic = int(hysteresis["elements"]), cubic
        self.d = hysteresis["twist"] * np.array([(2 * i - 1) / (2 * n) for i in range(1, n + 1)])
        self.k = hysteresis["torque"] / self.d.sum()

    def gear_torque(self, x: Array) -> float:
        twist = RATIO * x[0] - x[2]
        bent = self.k * np.clip(x[4:], -self.d, self.d).sum()
        rate = RATIO * x[1] - x[3]
        return float(5000.0 * twist + self.cubic * twist**3 + DAMPING * rate + bent)

    def follow(self, voltages: Array) -> Array:
        """States (tm, wm, q, v, bends) after each row."""
        x, out = np.zeros(4 + len(self.d)), []
        for (V,) in voltages:
            x = self._over_period(x, float(V))
            out.append(x)
        return np.array(out)

    def _rates(self, x: Array, V: float, slipping: Array) -> Array:
        T, rate = self.gear_torque(x), RATIO * x[1] - x[3]
        bends = np.where(slipping, 0.0, rate)
        return np.array([x[1], (KT * V - RATIO * T) / ROTOR, x[3], T / LINK_INERTIA, *bends])

    def _over_period(self, x: Array, V: float) -> Array:
        t = 0.0
        sign = np.sign(RATIO * x[1] - x[3])
        if sign == 0.0:  # at rest: of the way that the twist is about to take
            f = self._rates(x, V, np.zeros(len(self.d), bool))
            sign = np.sign(RATIO * f[1] - f[3])
        slipping = sign * x[4:] >= self.d * (1.0 - 1e-12)
        while True:
            events: list[Any] = [lambda _, x, sign=sign: sign * (RATIO * x[1] - x[3])]
            sticking = np.flatnonzero(~slipping)
            for i in sticking:
                events.append(lambda _, x, i=i, sign=sign: self.d[i] - sign * x[4 + i])
            for event in events:
                event.terminal, event.direction = True, -1.0
            solved = solve_ivp(
                lambda _, x, slipping=slipping: self._rates(x, V, slipping),
                (t, PERIOD), x, "DOP853", rtol=1e-11, atol=1e-13, events=events,
            )  # fmt: skip
            x, t = solved.y[:, -1].copy(), float(solved.t[-1])
            if solved.status == 0:
                return x
            if len(solved.t_events[0]):
                sign, slipping = -sign, np.zeros_like(slipping)
            else:
                slipping = slipping.copy()
                slipping[[i for k, i in enumerate(sticking) if len(solved.t_events[k + 1])]] = True


def pushes(rng: np.random.Generator, hysteresis: dict[str, float], rows: int = 12) -> Array:
    """Voltages to and fro, under which a few elements slip, or all."""
    return float(hysteresis["torque"]) * RATIO / KT * rng.uniform(-3.0, 3.0, (rows, 1))


@pytest.mark.parametrize(
    ("scheme", "events", "cubic"),
    # At first a linear spring without located events, then a cubic one with them.
    with_slow(
        some(
            [
                (scheme, events, cubic)
                for scheme in SCHEMES
                for swapped in (False, True)
                for events, cubic in zip(
                    ("step", "located")[: 1 + KNOWN[scheme].locates],
                    (2e9, 0.0) if swapped else (0.0, 2e9),
                    strict=False,
                )
            ],
            4,
        ),
        1,
    ),
)
def test_every_scheme_keeps_its_order(
    tmp_path: Path, scheme: str, events: str, cubic: float
) -> None:
    rng = np.random.default_rng([SCHEMES.index(scheme), cubic > 0.0, 43])
    hysteresis = sample_hysteresis(rng, int(rng.integers(1, 6)))
    voltages = pushes(rng, hysteresis)
    expected = Truth(hysteresis, cubic).follow(voltages)[:, 2]
    gear = {"cubic_stiffness": cubic} if cubic else {}

    def error(steps: int) -> float:
        plant = Plant(scene_of(tmp_path, hysteresis, steps, scheme, events, gear))
        return float(np.abs(plant.run(voltages, steps)[:, 0] - expected).max())

    errors = [error(steps) for steps in STEPS]
    # A kink falls anywhere into a step: errors fall unevenly, by the order over a factor of 8.
    order = np.log2(errors[0] / errors[-1]) / 3.0
    assert order > KNOWN[scheme].order - 0.35 or errors[-1] < 1e-11, errors
    assert errors[-1] < 0.01 * np.abs(expected).max(), errors


def replayed(hysteresis: dict[str, float], twist: Array) -> Array:
    """Torque (K,) of the elements along a twist, by Prandtl's stop operator and from no bend."""
    n = int(hysteresis["elements"])
    d = hysteresis["twist"] * np.array([(2 * i - 1) / (2 * n) for i in range(1, n + 1)])
    bent, out = np.zeros(n), []
    for step in np.diff(twist, prepend=0.0):
        bent = np.clip(bent + step, -d, d)
        out.append(hysteresis["torque"] / d.sum() * bent.sum())
    return np.array(out)


@pytest.mark.parametrize("elements", some([5, 1, 3, 8], 1))
def test_loops_are_those_of_stops_that_bend_and_slip(tmp_path: Path, elements: int) -> None:
    """After every reversal, in loops within loops, to the rounding of the twist."""
    rng = np.random.default_rng([elements, 44])
    hysteresis = sample_hysteresis(rng, elements)
    plant = Plant(scene_of(tmp_path, hysteresis, STEPS[0]))
    twist, torque = [], []
    for row in pushes(rng, hysteresis, 40):
        for _ in range(STEPS[0]):
            plant.advance(row, 1)
            x = plant.state
            w, rate = RATIO * x.theta_m[0] - x.q[0], RATIO * x.omega_m[0] - x.v[0]
            twist.append(w)
            torque.append(x.gear_torque[0] - 5000.0 * w - DAMPING * rate)
    expected = replayed(hysteresis, np.array(twist))
    assert np.ptp(expected) > 1.5 * hysteresis["torque"], "the loops are wide"
    assert (np.diff(np.sign(np.diff(twist))) != 0).sum() > 20, "and there are many"
    # Angles have some rad of rounding 1e-16, times the stiffness, over all steps.
    np.testing.assert_allclose(torque, expected, atol=1e-9 * hysteresis["torque"])


def test_a_first_loading_and_its_loop_have_the_shape_of_many_elements(tmp_path: Path) -> None:
    """F (2 u - u^2), and at a reversal the same curve at twice the size."""
    u = np.concatenate([np.linspace(0.0, 0.8, 400), np.linspace(0.8, -0.8, 400)])
    for n in (4, 16):
        torque = replayed({"torque": 1.0, "twist": 1.0, "elements": n}, u)
        first = 2.0 * u[:400] - u[:400] ** 2
        half = (0.8 - u[400:]) / 2.0
        back = first[-1] - 2.0 * (2.0 * half - half**2)
        assert np.abs(torque - np.append(first, back)).max() < 0.6 / n**2


@pytest.mark.parametrize(
    ("gear", "rule"),
    [
        ({"stiffness": None, "damping": None}, "elastic gear without play"),
        ({"backlash": 1e-3}, "elastic gear without play"),
        ({"hysteresis": {"torque": 0.0, "twist": 1e-3}}, "> 0"),
        ({"hysteresis": {"torque": 1.0}}, "twist"),
        ({"hysteresis": {"torque": 1.0, "twist": 1e-3, "elements": 2.5}}, "elements"),
        ({"hysteresis": {"torque": 1.0, "twist": 1e-3, "elements": 17}}, "elements"),
        ({"hysteresis": 3.0}, "hysteresis"),
    ],
)
def test_refusals(tmp_path: Path, gear: dict[str, Any], rule: str) -> None:
    base = {"torque": 1.0, "twist": 1e-3}
    scene_of(tmp_path, base, 10)
    overrides = {f"joints.joint.gear.{key}": value for key, value in gear.items()}
    with pytest.raises(Refusal, match=rule):
        load_scene(tmp_path / "scene.yaml", overrides | {"varied": None})


def test_the_loop_in_python_is_that_of_elements_along_random_paths() -> None:
    """Identification fits it to measured twists."""
    rng = np.random.default_rng(45)
    for elements in (1, 4, 7):
        law = sample_hysteresis(rng, elements)
        truth = Truth(law)
        path = law["twist"] * np.cumsum(rng.uniform(-0.5, 0.5, 2000))
        path[500:520] = path[500]  # it stands
        bend, expected = np.zeros(elements), []
        for step in np.diff(path, prepend=0.0):
            bend = np.clip(bend + step, -truth.d, truth.d)
            expected.append(truth.k * bend.sum())
        part = Hysteresis(torque=law["torque"], twist=law["twist"], elements=elements)
        assert part.compute_loop_torque(path) == pytest.approx(
            np.array(expected), abs=1e-9 * law["torque"]
        )


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_weights_rest_on_wound_up_gears_as_loops_have_it(tmp_path: Path, seed: int) -> None:
    """Three weights wind their gears up from unloaded; about there slipping elements count half.

    The first twist at which spring and elements bear the weight is that of the closed form. Beyond
    `twist` all slip, far below it none: weights are drawn for both and for what is between.
    """
    rng = np.random.default_rng([seed, 611])
    mass, joints = 2.0, dict[str, Any]()
    counts = {"a": 1, "b": 5, "c": 16}  # of elements; a library has one of each joint
    numbers = []
    for (name, elements), share in zip(
        counts.items(), rng.permutation([1e-3, 0.5, 3.0]), strict=True
    ):
        F, twist, K = 10 ** rng.uniform([0.0, -3.7, 3.0], [1.3, -2.7, 4.3])
        weight = share * (F + K * twist)
        numbers.append((elements, F, twist, K, weight))
        joints[name] = {
            "motor": {"kind": "torque", "rotor_inertia": 1e-4},
            "gear": {"ratio": 0.02, "stiffness": float(K), "damping": 1.0,
                     "hysteresis": {"torque": float(F), "twist": float(twist),
                                    "elements": elements}},
        }  # fmt: skip
    file = write_scene(
        tmp_path, write_slides(joints), joints, external_wrench=True, varied=["joints.*"]
    )
    plant = Plant(load_scene(file))
    for name, (*_, weight) in zip(joints, numbers, strict=True):
        plant.set_external_wrench(f"{name}_link", ExternalWrench([-weight, 0.0, 0.0]))
    linear = linearise(plant, [0.3, -0.2, 0.1])
    # Newton ends where the residual is rounding of the largest term, 1e4 N m/rad times 50 rad.
    assert np.abs(linear.rate[linear.v]).max() < 1e-8 * max(row[-1] for row in numbers) / mass
    for j, (elements, F, twist, K, weight) in enumerate(numbers):
        limits = (2 * np.arange(elements) + 1) * twist / (2 * elements)
        k = 2.0 * F / (elements * twist)

        def torque(w: float, k: float = k, K: float = K, limits: Any = limits) -> float:
            return float(K * w + k * np.minimum(w, limits).sum())

        w = brentq(lambda w, load=weight: torque(w) - load, 0.0, weight / K, xtol=1e-18)
        assert linear.u0[j] == pytest.approx(0.02 * weight, rel=1e-9)
        slope = K + k * np.where(w < limits, 1.0, 0.5).sum()
        at = linear.q.start + j
        # A difference of 2e-7 rad, to which the position is rounded by 1e-16.
        assert linear.A[linear.v.start + j, at] == pytest.approx(-slope / mass, rel=1e-6)
