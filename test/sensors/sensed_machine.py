"""A machine with sensors of all kinds, in motion: readings, and the truth that they read."""

import math
from pathlib import Path

import numpy as np
from machines import GRAVITY, LINK, MOTOR, write_scene

from arm_emulator import Measured, Plant, PlantState, Scene
from arm_emulator.machine.plant.outputs import KNOWN

TURN = 2.0 * math.pi

FIELDS = tuple(KNOWN)

DRAWS = 4000  # ticks of a statistic

SIGMAS = 5.0  # that a statistic of so many draws may be off; by chance 1 in 2 million is

ERRORS = {  # of an encoder, all of which can be set while the machine runs
    "offset": 0.0,
    "eccentricity": 0.0,
    "eccentricity_phase": 0.0,
    "ripple": 0.0,
    "ripple_order": 5,
    "ripple_phase": 0.0,
    "noise": 0.0,
    "missed": 0.0,
    "held": 0.0,
}

ANALOG = {
    "held": 0.0,
    "drift": 0.0,
    "gain_error": 0.0,
    "offset": 0.0,
    "noise": 0.0,
    "range": 1e9,
    "resolution": 1e-12,
}

AXES = {
    "held": 0.0,
    "gain_error": 0.0,
    "noise": 0.0,
    "range": 1e9,
    "resolution": 1e-12,
    **{f"bias_{axis}": 0.0 for axis in "xyz"},
}

POSE = {"xyz": [0.1, -0.2, 0.05], "rpy": [0.4, -1.1, 2.2]}

FRICTION = {"viscous": 0.3, "coulomb": 0.5, "breakaway": 60.0}


def urdf() -> str:
    """A turn, a slide and a turn about slanted axes; the last link has another fixed to it."""
    joints = [
        ("turn", "continuous"),
        ("slide", "prismatic"),
        ("hand", "revolute"),
        ("tip", "fixed"),
    ]
    text, parent = '<robot name="sensed"><link name="base"/>', "base"
    rng = np.random.default_rng(12)
    for name, kind in joints:
        text += LINK.format(
            name=name, kind=kind, parent=parent, xyz="0.1 0.2 0.3", rpy="0.3 -0.5 1.2",
            axis=" ".join(map(repr, rng.normal(size=3).tolist())), com="0.05 0.1 0.02",
            com_rpy="0 0 0", mass=1.5, ixx=0.03, iyy=0.04, izz=0.05, ixy=0.0, ixz=0.0, iyz=0.01,
        )  # fmt: skip
        parent = f"{name}_link"
    return text + "</robot>"


def write(folder: Path) -> Path:
    gear = {"ratio": 0.02, "stiffness": 3e3, "damping": 5.0}
    joints = {
        "turn": {
            "gear": gear,
            "encoder": {"counts_per_turn": 1000, "index": "latch", **ERRORS},
            "link_encoder": {"kind": "absolute", "counts_per_turn": 4096, "bits": 14, **ERRORS},
            "current_sensor": ANALOG,
        },
        "slide": {
            "gear": {"ratio": 0.03},
            "encoder": {"counts_per_turn": 1024, "index": "correct", **ERRORS},
            "link_encoder": {"counts_per_turn": 100_000, "index": "latch", "delay": 4},
            "torque_sensor": {**ANALOG, "delay": 3},
        },
        "hand": {
            "gear": gear,
            "encoder": {
                "kind": "absolute", "counts_per_turn": 1000, "bits": 10, "delay": 1, **ERRORS
            },
            "current_sensor": {"delay": 2},
            "torque_sensor": {},
        },
    }  # fmt: skip
    for joint in joints.values():
        joint |= {"motor": MOTOR, "friction": FRICTION}
    imus = {
        "at_hand": {"link": "tip_link", **POSE, "accelerometer": AXES, "gyroscope": AXES},
        "late": {"link": "turn_link", "delay": 1},
    }
    names = "joints.*.*encoder.*", "joints.*_sensor.*", "imus.*", "seed"
    return write_scene(
        folder, urdf(), joints, imus=imus, seed=1, varied=list(names), gravity=GRAVITY,
        integrator={"scheme": "rosenbrock", "dt": 2e-4},
    )  # fmt: skip


def set_all(plant: Plant, numbers: dict[str, float]) -> None:
    for name, value in numbers.items():
        plant.set_parameter(name, value)


def motion(plant: Plant, rng: np.random.Generator, ticks: int) -> list[tuple[Measured, PlantState]]:
    """Return measured and true values at each tick, from the present one on."""
    reported = [(plant.measured, plant.state)]
    for tick in range(ticks):
        if tick % 50 == 0:
            voltage = (rng.choice([-1.0, 1.0], 3) * rng.uniform(35.0, 48.0, 3))[
                : len(plant.scene.joints)
            ]
        plant.exchange(voltage)
        reported.append((plant.measured, plant.state))
    return reported


def rows(reported: list[tuple[Measured, PlantState]], name: str) -> np.ndarray:
    """A quantity measured, a row per tick."""
    return np.array([getattr(measured, name) for measured, _ in reported])


def truth(reported: list[tuple[Measured, PlantState]], name: str) -> np.ndarray:
    return np.array([getattr(state, name) for _, state in reported])


def late(values: np.ndarray, ticks: int) -> np.ndarray:
    """Return the readings of a delayed sensor: at first the initial value."""
    return np.concatenate([np.repeat(values[:1], ticks, axis=0), values[: len(values) - ticks]])


def same(first: Measured, second: Measured) -> bool:
    return all(getattr(first, f).tobytes() == getattr(second, f).tobytes() for f in FIELDS)


def draw_state(rng: np.random.Generator, plant: Plant) -> None:
    q, v = rng.normal(0.0, 1.0, 3), rng.normal(0.0, 2.0, 3)
    ratio = plant.scene.gear_ratios
    theta_m, omega_m = (q + 1e-3 * rng.normal(size=3)) / ratio, (v + rng.normal(size=3)) / ratio
    theta_m[1], omega_m[1] = q[1] / ratio[1], v[1] / ratio[1]  # behind a rigid gear
    values = {"q": q, "v": v, "theta_m": theta_m, "omega_m": omega_m, "current": rng.normal(size=3)}
    plant.put("drawn", values)


def noisy(scene: Scene, seed: float) -> Plant:
    plant = Plant(scene)
    numbers = {
        number.name: 0.02 for number in scene.varied if number.name.endswith(("noise", "missed"))
    }
    set_all(plant, numbers | {"seed": seed})
    plant.reset()
    return plant
