"""Torques declared by parts for a motion, against those of the core."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from draws import with_slow
from machines import MOVED, gantry_urdf, write_scene

from arm_emulator import Plant, Refusal, Scene, load_scene
from arm_emulator.machine.parts.part import Part
from arm_emulator.machine.parts.shaft_motion import ShaftMotion
from arm_emulator.machine.scene.joint import Joint
from arm_emulator.machine.scene.known_parts import PARTS
from arm_emulator_identification.torque_model import TorqueModel

DT, EVERY, STEPS = 2e-5, 25, 4000  # s, steps per sample, samples
WEIGHT = 1.0  # m/s2 along each axis
RIGID, ELASTIC = {"ratio": 0.02}, {"ratio": -0.02, "stiffness": 1e7, "damping": 3e3}
TABLE = {"angles": [-2.0, -1.0, 0.0, 1.0, 2.0], "torques": [3.0, -2.0, 1.0, 4.0, -1.0]}


def torque(**more: Any) -> dict[str, Any]:
    return {"kind": "torque", "rotor_inertia": 1e-3, **more}


# Every part that has a torque in motion, in joints that do not feel each other.
MACHINES: list[list[dict[str, Any]]] = [
    [
        {"motor": torque(friction={"viscous": 1e-3, "coulomb": 0.02, "breakaway": 0.05,
                                   "stribeck": 10.0},
                         cogging={"waves": [[3.0, 0.03, 0.4], [0.5, 0.02]]}), "gear": RIGID},
        {"motor": torque(), "gear": RIGID, "torque_table": TABLE,
         "friction": {"viscous": 3.0, "coulomb": 2.0, "load": 0.1, "stribeck": 0.2}},
        {"motor": torque(lugre={"coulomb": 0.03, "breakaway": 0.05, "stribeck": 10.0,
                                "bristle_stiffness": 0.1, "bristle_damping": 1e-3},
                         ripple={"waves": [[0.7, 0.2, 1.0]]}),
         "gear": RIGID, "lugre": {"coulomb": 1.0, "bristle_stiffness": 200.0,
                                  "bristle_damping": 1.0},
         "end_stops": {"lower": -0.1, "upper": 0.15, "stiffness": 30.0, "damping": 3.0}},
    ],
    [
        {"motor": torque(friction={"viscous": 1e-3, "coulomb": 0.02}),
         "gear": ELASTIC | {"kinematic_error": {"motor": [[0.4, 2e-3, 0.3]],
                                                "link": [[9.0, 1e-3]]}}},
        {"motor": torque(friction={"viscous": 2e-3, "load": 0.2}), "gear": ELASTIC,
         "friction": {"coulomb": 2.0, "load": 0.15},
         "counterbalance": {"base_distance": 0.5, "link_distance": 0.2, "angle": 0.4,
                            "force": 60.0, "length": 0.5, "stiffness": 40.0}},
        {"motor": torque(friction={"load": 0.1}), "gear": RIGID,
         "counterbalance": {"base_distance": 0.8, "link_distance": 0.2, "force": -90.0,
                            "length": 0.6, "gas_column": 0.6}},
    ],
]  # fmt: skip


def machine(folder: Path, drives: list[dict[str, Any]]) -> Scene:
    joints = dict(zip("xyz", drives, strict=True))
    return load_scene(write_scene(
        folder, gantry_urdf(), joints, gravity=[-WEIGHT] * 3, servo_period=EVERY * DT,
        integrator={"scheme": "rosenbrock", "dt": DT},
    ))  # fmt: skip


def taken(joint: Joint, moved: float, t: np.ndarray, of_link: list[np.ndarray],
          of_rotor: list[np.ndarray], command: np.ndarray) -> np.ndarray:  # fmt: skip
    """The motor's torque that angle, speed and acceleration take, by what the parts state."""
    Ng, a, none = joint.gear.ratio, of_link[2], np.zeros_like(t)
    link = moved * (a + WEIGHT)
    T = command / Ng if joint.gear.stiffness is None else link.copy()
    for _ in range(8):  # friction under load is part of what loads it
        at = ShaftMotion(t, of_link[0], of_link[1], a, T, command / Ng, Ng)
        efforts = [part.compute_effort(at) for part in joint.parts if part.shaft == "link"]
        on_link = link + sum(effort for effort in efforts if effort is not None)
        T = T if joint.gear.stiffness is None else on_link
    at = ShaftMotion(t, of_rotor[0], of_rotor[1], of_rotor[2], Ng * T, command, Ng)
    efforts = [part.compute_effort(at) for part in joint.parts if part.shaft == "rotor"]
    return Ng * on_link + sum((effort for effort in efforts if effort is not None), none)


@pytest.mark.parametrize("drives", with_slow(MACHINES, 1), ids=["rigid", "elastic"])
def test_parts_state_the_torque_that_the_core_gives(
    tmp_path: Path, drives: list[dict[str, Any]]
) -> None:
    scene = machine(tmp_path, drives)
    plant = Plant(scene)
    t = DT * EVERY * np.arange(STEPS)
    waves = np.column_stack([np.sin(w * t + k) for k, w in enumerate((4.0, 5.0, 6.0))])
    size = np.array([1.0, 1.0, 0.8]) * np.abs(scene.gear_ratios) * (MOVED * WEIGHT + 25.0)
    weight = scene.gear_ratios * MOVED * WEIGHT
    rows = []
    for k in range(STEPS):
        state = plant.state
        rows.append((state.q, state.v, state.theta_m, state.omega_m))
        plant.advance(weight + size * waves[k], EVERY)
    q, v, theta_m, omega_m = (np.array(column) for column in zip(*rows, strict=True))
    a, a_m = (np.gradient(speed, t, axis=0) for speed in (v, omega_m))
    command = weight + size * waves
    acting = 0.5 * (command + np.vstack([command[:1], command[:-1]]))
    for j, (joint, moved) in enumerate(zip(scene.joints, MOVED, strict=True)):
        of_link = [signal[:, j] for signal in (q, v, a)]
        of_rotor = [signal[:, j] for signal in (theta_m, omega_m, a_m)]
        actual = taken(joint, moved, t, of_link, of_rotor, acting[:, j])
        # Bristles begin straight; at reversals a is that of before and after.
        inner = np.minimum.reduce([np.roll(np.abs(v[:, j]), s) for s in range(-4, 5)])
        good = (inner > 0.05 * np.abs(v[:, j]).max()) & (t > 0.2) & (t < t[-1] - 0.01)
        assert good.mean() > 0.4, f"{joint.name} hardly moves"
        error = np.abs(actual - acting[:, j])[good]
        deviation = acting[:, j].std()
        # The bound is what waves of the teeth shift their own phase by.
        assert np.quantile(error, 0.98) < 0.005 * deviation, (
            f"{joint.name}: {np.quantile(error, 0.98) / deviation:.3g} of its torque"
        )


def test_every_part_states_its_torque_or_is_refused(tmp_path: Path) -> None:
    """No part counts as one of zero effort because its effort was forgotten."""
    inherited = [
        part.__name__ for part in PARTS if part.compute_effort is Part.compute_effort
    ]  # fmt: skip
    assert inherited == [], "these are refused by `identify`: state an effort, or decline in words"
    motor = {
        "resistance": 1.0, "inductance": 1e-3, "torque_constant": 0.05, "back_emf_constant": 0.05,
        "rotor_inertia": 1e-4,
    }  # fmt: skip
    hot = {"heat_capacity": 10.0, "thermal_resistance": 1.0, "magnet_coefficient": -1e-3}
    drives = [{"motor": motor | {"winding": hot}}, {"motor": motor}, {"motor": motor}]
    ones = np.ones(3), np.ones(3)
    with pytest.raises(Refusal, match=r"joints\.x\.motor\.winding must be without parts"):
        TorqueModel(machine(tmp_path, drives), ones, 0.5)
    drives[0] = {"motor": motor, "bearing": {"tilt_y": {"stiffness": 1e4}}}
    with pytest.raises(Refusal, match=r"joints\.x\.bearing\.tilt_y must be without parts"):
        TorqueModel(machine(tmp_path, drives), ones, 0.5)
