"""Breakaway of joints behind rigid gears, against the balance of torques.

Let T be the motor's torque at the link, and G the torque that the joint needs to hold its links.
Friction of link and of rotor may grow with |T|. A joint at rest stays at rest while

    |T - G| <= c + mu |T|          c = Ds + Ds_m / |Ng|,  mu = mu_link + mu_rotor

which with mu < 1 is an interval of T around G.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from draws import some, with_slow
from machines import Oracle, list_moving_joints, write_random_chain, write_scene

from arm_emulator import Plant, Scene, load_scene

PERIOD, STEPS = 1e-3, 4  # s, and steps in it
POSES, ROWS = 12, 8
NEAR = 0.02  # of the way from the middle of the interval to its end
LARGEST = 1e4  # V, A, N m: nothing is at its limit


def sample_friction(rng: np.random.Generator, dry: float, alone: bool) -> dict[str, float]:
    """A law, or two at once; `alone`: it may be the load, whose torque is 0 without a command."""
    law: dict[str, float] = {"load": float(rng.uniform(0.05, 0.4))} if rng.random() < 0.7 else {}
    if not alone or rng.random() < 0.7:
        law |= {"coulomb": dry, "breakaway": dry * float(rng.uniform(1.0, 1.5))}
        if rng.random() < 0.3:
            law["stribeck"] = 0.1
    return law


def sample_motor(rng: np.random.Generator) -> dict[str, Any]:
    """Motors that follow at once, and others that take far less, or more, than a step for it.

    (One that takes a tenth of a step swings beyond, by a fifth of the way: schemes of order 2 do.)
    """
    lag = float(rng.choice([0.0, 0.0, 1e-8, rng.uniform(1e-3, 3e-3)]))  # s
    kind = str(rng.choice(["dc", "torque", "current"]))
    motor: dict[str, Any] = {"kind": kind, "rotor_inertia": float(10 ** rng.uniform(-5.0, -3.5))}
    if kind == "dc":
        motor |= {"resistance": 0.7, "torque_constant": 0.05, "back_emf_constant": 0.05,
                  "inductance": 0.7 * lag}  # fmt: skip
    else:
        motor |= {"bandwidth": 1.0 / (2.0 * np.pi * lag)} if lag > 0.0 else {}
        motor |= (
            {"torque_limit": LARGEST}
            if kind == "torque"
            else {"torque_constant": 0.08, "current_limit": LARGEST}
        )
    return motor


class Balance:
    """Torque that holds each joint of a scene at rest."""

    def __init__(self, scene: Scene) -> None:
        self.oracle = Oracle(scene)
        ratio = np.array([joint.gear.ratio for joint in scene.joints])
        frictions = [(joint.friction, joint.rotor_friction) for joint in scene.joints]

        def number(law: object, key: str) -> float:
            return float(getattr(law, key, 0.0))

        self.c = np.array(
            [
                number(link, "breakaway") + number(rotor, "breakaway") / abs(Ng)
                for (link, rotor), Ng in zip(frictions, ratio, strict=True)
            ]
        )
        self.mu = np.array(
            [number(link, "load") + number(rotor, "load") for link, rotor in frictions]
        )
        self.torque_per_command = np.array([joint.torque_per_command for joint in scene.joints])
        self.at_once = np.array(
            [not (vars(joint.motor).get("inductance") or vars(joint.motor).get("bandwidth"))
             for joint in scene.joints]
        )  # fmt: skip

    def interval(self, q: np.ndarray) -> np.ndarray:
        """The least and the most motor torques that hold the joints at q (2, N) [N m]."""
        at, still = self.oracle.configuration(q), np.zeros(len(q))
        G = pin.rnea(self.oracle.model, self.oracle.data, at, still, still)

        def upper_end(G: np.ndarray) -> np.ndarray:
            return np.where(G + self.c >= 0.0, 1.0 / (1.0 - self.mu), 1.0 / (1.0 + self.mu)) * (
                G + self.c
            )

        return np.array([-upper_end(-G), upper_end(G)])


def sample_scene(folder: Path, seed: int, scheme: str, events: str) -> Scene:
    rng = np.random.default_rng([seed, 77])
    urdf = write_random_chain(rng, int(rng.integers(1, 4)))
    joints = {}
    for name in list_moving_joints(urdf):
        motor = sample_motor(rng)
        at_once = not (motor.get("inductance") or motor.get("bandwidth"))
        link = sample_friction(rng, float(10 ** rng.uniform(-1.0, 0.5)), at_once)
        ratio = float(rng.choice([-1.0, 1.0]) * 10 ** rng.uniform(-2.0, 0.0))
        rotor = sample_friction(rng, abs(ratio) * float(10 ** rng.uniform(-1.0, 0.5)), True)
        joints[name] = {"motor": {**motor, "friction": rotor}, "gear": {"ratio": ratio},
                        "friction": link}  # fmt: skip
    integrator = {"scheme": scheme, "events": events, "dt": PERIOD / STEPS}
    file = write_scene(
        folder, urdf, joints, servo_period=PERIOD, supply_voltage=LARGEST,
        gravity=[0.0, 0.0, -float(10 ** rng.uniform(-1.5, 1.0))], integrator=integrator,
    )  # fmt: skip
    return load_scene(file)


def sample_pose(rng: np.random.Generator, balance: Balance) -> np.ndarray:
    """One in which nothing breaks away before its motor has a torque."""
    for _ in range(200):
        q: np.ndarray = rng.uniform(-2.0, 2.0, len(balance.c))
        low, high = balance.interval(q)
        if (balance.at_once | ((low < 0.0) & (high > 0.0))).all():
            return q
    pytest.skip("no pose holds itself")


METHODS = [
    ("extrapolated", "step"), ("rosenbrock", "located"), ("rosenbrock", "step"),
    ("extrapolated", "located"), ("implicit", "step"), ("paper", "step"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("seed", "scheme", "events"),
    with_slow(
        some([(seed, *METHODS[(seed + k) % 6]) for k in range(6) for seed in range(12)], 2), 1
    ),
)
def test_a_joint_breaks_away_where_the_balance_states(
    tmp_path: Path, seed: int, scheme: str, events: str
) -> None:
    """Commands jump and creep within what holds, up to its ends, and then beyond one of them."""
    scene = sample_scene(tmp_path, seed, scheme, events)
    plant, balance = Plant(scene), Balance(scene)
    rng = np.random.default_rng([seed, 78])
    for _ in range(POSES):
        q = sample_pose(rng, balance)
        plant.reset(q)
        low, high = balance.interval(q)
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        for _ in range(ROWS):
            part = rng.choice([-1.0, -0.5, 0.0, 0.5, 1.0], len(q)) * (1.0 - NEAR)
            torque = middle + part * half
            plant.advance(torque / balance.torque_per_command, int(rng.integers(1, 3 * STEPS)))
            assert (plant.state.q == q).all() and (plant.state.v == 0.0).all(), (
                f"at {q}: {torque} N m is within {low} to {high}, and it moved: {plant.state}"
            )
        j, direction = int(rng.integers(len(q))), float(rng.choice([-1.0, 1.0]))
        torque[j] = middle[j] + direction * (1.0 + NEAR) * half[j]
        # The slowest motor takes some 13 ms; joints that break away pull at the others.
        for _ in range(60):
            plant.advance(torque / balance.torque_per_command, STEPS)
            if abs(moved := plant.state.q[j] - q[j]) > 1e-7:
                break
        assert moved * direction > 0.0, (
            f"at {q}: {torque[j]} N m is beyond {low[j]} to {high[j]}: joint {j} went {moved}"
        )
