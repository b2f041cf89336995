"""The matrix by which a scheme's small motions are judged is that of its steps."""

from functools import cache
from typing import Any

import numpy as np
import pytest
from draws import some, with_slow

from arm_emulator import Plant, load_scene
from arm_emulator.analysis.stability import SmallMotions
from arm_emulator.machine.schemes.known import SCHEMES

STEPS = 20
SIZE = 1e-6  # rad and rad/s


def random_overrides(seed: int) -> dict[str, Any]:
    """In gravity: a joint with a rigid gear, one without inductance, one that has all."""
    rng = np.random.default_rng([seed, 31])
    elastic, plain, rigid = rng.permutation(["waist", "shoulder", "elbow"])
    return {
        f"joints.{elastic}.gear.stiffness": float(10.0 ** rng.uniform(2.5, 3.5)),
        f"joints.{plain}.gear.stiffness": float(10.0 ** rng.uniform(2.5, 3.5)),
        f"joints.{plain}.motor.inductance": None,
        f"joints.{rigid}.gear.stiffness": None,
        f"joints.{rigid}.gear.damping": None,
        "joints.*.friction.viscous": float(10.0 ** rng.uniform(-1.0, 1.0)),
        "joints.*.motor.rotor_inertia": float(10.0 ** rng.uniform(-4.5, -3.5)),
        "integrator.dt": 1e-3,
        # Strong, so that what a scheme does with the links' own forces counts; upright or hanging
        # at q = 0, where no torque is needed to rest.
        "gravity": [0.0, 0.0, float(rng.choice([-1.0, 1.0]) * rng.uniform(100.0, 500.0))],
        "joints.*.start": 0.0,
    }


@cache
def small_motions(seed: int) -> SmallMotions:
    """Return those of a machine, whose equations are the same with every scheme."""
    plant = Plant(load_scene("three_axis", overrides=random_overrides(seed)))
    return SmallMotions(plant, np.zeros(3))


PAIRS = [(scheme, seed) for seed in range(2) for scheme in SCHEMES]


@pytest.mark.slow
@pytest.mark.parametrize(("scheme", "seed"), with_slow(some(PAIRS, len(SCHEMES)), 1))
def test_small_motions_move_as_the_matrix_of_the_scheme(scheme: str, seed: int) -> None:
    overrides = {**random_overrides(seed), "integrator.scheme": scheme}
    plant = Plant(load_scene("three_axis", overrides=overrides))
    scene, motions = plant.scene, small_motions(seed)
    rng = np.random.default_rng([seed, 32])
    dq, dv = SIZE * rng.normal(size=(2, len(scene.joints)))
    x = []
    for drive, joint, joint_q, joint_v in zip(
        plant.linear_drives(), scene.joints, dq, dv, strict=True
    ):
        behind = [0.0, joint_q / joint.gear.ratio, joint_v / joint.gear.ratio][: len(drive.D)]
        x += [value for value, D in zip(behind, drive.D, strict=True) if D != 0.0]
    x = np.concatenate([x, dq, dv])
    transition = motions.compute_step_matrix(scheme, scene.integrator.dt)
    if len(transition) == 2 * len(x):  # a scheme that takes the step before: it begins without one
        x = np.concatenate([x, x])
    plant.reset(q=dq, v=dv)
    plant.advance(np.zeros(len(dq)), STEPS)
    x = np.linalg.matrix_power(transition, STEPS) @ x
    q, v = x[motions.links :][: 2 * len(dq)].reshape(2, -1)
    # By symmetry what is not linear is SIZE**2 of the motion. SmallMotions differentiates gravity
    # with a step of 1e-5, which is good to 1e-10; both add up over the steps.
    for quantity, actual, expected in (("q", plant.state.q, q), ("v", plant.state.v, v)):
        error = np.abs(actual - expected).max() / np.abs(expected).max()
        assert error < 1e-8, (
            f"{scheme}: {quantity} is {actual} in the core, {expected} by the matrix"
        )
