"""Dry friction of rotors: they stick exactly, and slide as the closed form states."""

import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from draws import some, with_slow
from machines import make_link_urdf, write_scene

from arm_emulator import Diverged, Plant, Scene, load_scene
from arm_emulator.base.arrays import Array
from oracles.random_chain import write_slides

PERIOD = 1e-2  # s
RATIO = 0.05


def swinging(rng: np.random.Generator) -> tuple[dict[str, Any], float]:
    """A rotor on its gear's spring, the link locked by friction of its own; where it is let go."""
    stiffness, rotor = (10 ** rng.uniform((2.0, -4.0), (3.0, -3.0))).tolist()
    spring = RATIO**2 * stiffness  # N m/rad at the rotor
    dry = float(np.float32(spring * rng.uniform(0.05, 0.2)))
    breakaway = dry * float(rng.choice([1.0, 1.25]))  # exactly: a library is of the multiple
    joint = {
        "motor": {
            "resistance": 1.0,
            "torque_constant": 0.05,
            "back_emf_constant": 0.0,
            "rotor_inertia": rotor,
            "friction": {"coulomb": dry, "breakaway": breakaway},
        },
        "gear": {"ratio": RATIO, "stiffness": stiffness},
        "friction": {"coulomb": 1e6},
    }
    return joint, float(rng.uniform(0.8, 1.2))


def swing_truth(joint: dict[str, Any], begin: float, t: Array) -> tuple[Array, float]:
    """Angle of the rotor at times t, and where it rests.

    Each half swing is a harmonic one about the angle at which spring and friction balance, and
    ends at rest. There the rotor stays if the spring pulls by no more than the breakaway torque.
    """
    motor, gear = joint["motor"], joint["gear"]
    k, J = gear["ratio"] ** 2 * gear["stiffness"], motor["rotor_inertia"]
    dry, breakaway = motor["friction"]["coulomb"], motor["friction"]["breakaway"]
    half = np.pi * np.sqrt(J / k)
    out, at, start = np.full_like(t, np.nan), begin, 0.0
    while abs(k * at) > breakaway:
        middle = np.sign(at) * dry / k
        here = (t >= start) & (t <= start + half)
        out[here] = middle + (at - middle) * np.cos(np.pi * (t[here] - start) / half)
        at, start = 2.0 * middle - at, start + half
    out[t >= start] = at
    return out, at


def scene_of(folder: Path, joint: dict[str, Any], steps: int, **integrator: Any) -> Scene:
    file = write_scene(
        folder,
        make_link_urdf(),
        {"joint": joint},
        servo_period=PERIOD,
        integrator={"scheme": "rosenbrock", "dt": PERIOD / steps, **integrator},
        energy_flow=True,
        # one library for all that are drawn
        varied=["joints.*.motor.rotor_inertia", "joints.*.motor.friction.*", "joints.*.gear.*"],
    )
    return load_scene(file)


def angles(plant: Plant, begin: float, rows: int, steps: int) -> Array:
    """Of a rotor that is let go, after each of the rows."""
    let_go(plant, begin)
    positions = []
    for _ in range(rows):
        plant.advance(np.zeros(1), steps)
        positions.append(float(plant.state.theta_m[0]))
    return np.array(positions)


def let_go(plant: Plant, angle: float) -> None:
    plant.put("test", {"theta_m": [angle], "omega_m": [0.0]})


# Seed 3 is of another library: its breakaway torque is another multiple.
@pytest.mark.parametrize(
    ("seed", "scheme"),
    with_slow(some(
        [(0, "rosenbrock"), (1, "rosenbrock"), (2, "rosenbrock"), (3, "extrapolated"),
         (0, "extrapolated"), (1, "extrapolated"), (2, "extrapolated"), (3, "rosenbrock")], 3,
    ), 1),
)  # fmt: skip
def test_a_rotor_swings_and_sticks_as_the_closed_form_states_with_order_two(
    tmp_path: Path, seed: int, scheme: str
) -> None:
    joint, begin = swinging(np.random.default_rng([seed, 11]))
    rows = 40
    truth, rest = swing_truth(joint, begin, PERIOD * np.arange(1, rows + 1))
    errors = []
    for steps in (10, 20, 40):
        plant = Plant(scene_of(tmp_path, joint, steps, scheme=scheme, events="located"))
        errors.append(float(np.abs(angles(plant, begin, rows, steps) - truth).max()))
        if abs(truth[-1] - rest) < 1e-12:
            assert plant.state.omega_m[0] == 0.0, "the rotor sticks exactly"
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    # The next term of the error's expansion is a few per cent of it, more with few steps per
    # oscillation.
    assert orders[-1] == pytest.approx(2.0, abs=0.2), errors


@pytest.mark.slow
@pytest.mark.parametrize("scheme", some(["rosenbrock", "implicit", "extrapolated", "paper"], 1))
@pytest.mark.parametrize("seed", range(2))
def test_the_error_is_of_first_order_without_located_events(
    tmp_path: Path, seed: int, scheme: str
) -> None:
    joint, begin = swinging(np.random.default_rng([seed, 11]))
    rows = 40
    truth, _ = swing_truth(joint, begin, PERIOD * np.arange(1, rows + 1))
    gear, rotor = joint["gear"], joint["motor"]["rotor_inertia"]
    rate = gear["ratio"] * np.sqrt(gear["stiffness"] / rotor)
    for steps in (97, 1601):
        plant = Plant(scene_of(tmp_path, joint, steps, scheme=scheme))
        off = np.abs(angles(plant, begin, rows, steps) - truth).max()
        # Each turn takes up to a step too long, at a speed of at most rate * begin. Schemes of
        # first order are a step beside the truth in each radian of the swing, too.
        turned = rate * rows * PERIOD * (1.0 / np.pi + (scheme in ("implicit", "paper")))
        bound = (1.0 + turned) * rate * begin * PERIOD / steps
        assert off < bound, f"{steps} steps"


@pytest.mark.parametrize(
    ("seed", "events"),
    with_slow([(0, "located"), (1, "located"), (0, "step"), (1, "step")], 2),
)
def test_a_stuck_rotor_holds_up_to_its_breakaway_torque(
    tmp_path: Path, seed: int, events: str
) -> None:
    joint, _ = swinging(np.random.default_rng([seed, 12]))
    volts_per_torque = joint["motor"]["resistance"] / joint["motor"]["torque_constant"]
    volts = joint["motor"]["friction"]["breakaway"] * volts_per_torque
    plant = Plant(scene_of(tmp_path, joint, 10, events=events))
    plant.advance(np.array([0.999999 * volts]), 200)
    assert plant.state.theta_m[0] == 0.0, "a stuck rotor has moved"
    plant.advance(np.array([1.000001 * volts]), 20)
    assert plant.state.theta_m[0] > 0.0, "an overloaded rotor is still stuck"


@pytest.mark.slow
def test_friction_of_a_rotor_that_moves_with_its_link_is_that_of_the_link(tmp_path: Path) -> None:
    """Behind a rigid gear the same motion as with that friction at the link, to rounding."""
    motor = {"resistance": 1.0, "torque_constant": 0.05, "back_emf_constant": 0.05}
    motor["rotor_inertia"] = 1e-4
    ratio, rows = 0.05, np.array([[12.0], [-12.0], [0.0], [6.0]])
    dry, viscous = 0.05, 1e-4
    friction = {
        "coulomb": dry / ratio,
        "breakaway": 1.5 * dry / ratio,
        "viscous": viscous / ratio**2,
    }
    at_link = {"motor": motor, "gear": {"ratio": ratio}, "friction": friction}
    own = {"coulomb": dry, "breakaway": 1.5 * dry, "viscous": viscous}
    at_rotor = {"motor": {**motor, "friction": own}, "gear": {"ratio": ratio}}
    joints = {"at_link": at_link, "at_rotor": at_rotor}
    file = write_scene(tmp_path, write_slides(joints), joints, servo_period=0.1)
    q = Plant(load_scene(file, {"integrator.dt": 1e-3})).run(rows.repeat(2, axis=1), 100)
    assert np.ptp(q) > 0.01, "the link shall move"
    assert q[:, 1] == pytest.approx(q[:, 0], rel=1e-9), "friction of rotor and of link differ"


@pytest.mark.slow
@pytest.mark.parametrize("events", some(["located", "step"], 2))
def test_a_rotor_far_faster_than_the_step_costs_a_bounded_time(events: str, tmp_path: Path) -> None:
    """No modes may hold in any part of its steps; it moves on, or is refused as diverged."""
    motor = {
        "resistance": 1.2,
        "inductance": 2e-3,
        "torque_constant": 0.05,
        "back_emf_constant": 0.05,
        "rotor_inertia": 1e-4,
        "current_loop": {"bandwidth": 400.0},
        "friction": {"coulomb": 4e-3, "breakaway": 5e-3, "load": 0.2},
    }
    gear = {"ratio": 0.02, "stiffness": 5e3, "damping": 1.0, "backlash": 1e-3}
    link = {"coulomb": 0.4, "breakaway": 0.6, "load": 0.2}
    scene = scene_of(tmp_path, {"motor": motor, "gear": gear, "friction": link}, 20, events=events)

    def measure_period(rotor_inertia: float, periods: int) -> float:
        plant = Plant(scene)
        plant.set_parameter("joints.joint.motor.rotor_inertia", rotor_inertia)
        began = time.process_time()
        for count in range(periods):
            try:
                plant.exchange([4.0 if count % 2 else -4.0])
            except Diverged:
                break
        return (time.process_time() - began) / (count + 1)

    for rotor_inertia in (1e-15, 1e-14, 1e-13):
        # With 8191 parts in a step some 1900 to 3700 times as long, with 129 some 45 to 490 times.
        # Other processes may lengthen one of the two times: the best of three pairs counts.
        assert any(
            measure_period(rotor_inertia, 40) < 1000.0 * measure_period(1e-4, 400) for _ in range(3)
        ), rotor_inertia
