"""A machine that has every fault, for tests without a network."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from machines import GRAVITY, MOTOR, PMSM, write_scene

from arm_emulator import Scene, load_scene
from arm_emulator.machine.parts.measuring.sensors import ANALOG
from arm_emulator.machine.parts.measuring.thermometer import Thermometer
from arm_emulator.machine.scene.known_parts import DECORATORS, EXTRAS
from oracles.part_truths import draw_part
from oracles.random_chain import LINK

NAMES = ("shoulder", "elbow", "wrist")


def chain_urdf(beside: Iterable[str] = ()) -> str:
    """Return a chain of three links, and links beside it, each on the base."""
    text, parent = '<robot name="all"><link name="base"/>', "base"
    axes = dict(zip(NAMES, ("0 0 1", "0 1 0", "0 1 0"), strict=True))
    for name in (*NAMES, *beside):
        axis, parent = axes.get(name, "0 0 1"), parent if name in NAMES else "base"
        text += LINK.format(
            name=name, kind="continuous", parent=parent, xyz="0.1 0.2 0.3", rpy="0.3 -0.5 1.2",
            axis=axis, com="0.05 0.1 0.02", com_rpy="0 0 0", mass=1.5,
            ixx=0.03, iyy=0.04, izz=0.05, ixy=0.0, ixz=0.0, iyz=0.01,
        )  # fmt: skip
        parent = f"{name}_link"
    return text + "</robot>"


def everything(folder: Path, **more: Any) -> Scene:
    """A machine that has every fault, at one of its joints at least."""
    sensors = {kind.section: {"noise": 0.01, "range": 4.0, "resolution": 1e-3} for kind in ANALOG}
    heat = Thermometer.section
    sensors[heat] |= {"range": 40.0}
    analog = {name: section for name, section in sensors.items() if name != heat}
    encoders = {
        "encoder": {"counts_per_turn": 1000, "index": "latch"},
        "link_encoder": {"kind": "absolute", "counts_per_turn": 65536, "bits": 20},
    }
    heated = {"winding": {"heat_capacity": 50.0, "thermal_resistance": 2.0, "limit": 120.0}}
    rng = np.random.default_rng(0)
    around = {
        kind.section.partition(".")[2]: draw_part(kind, rng)
        for kind in DECORATORS
        if kind.list_faults()
    }
    friction = {"viscous": 0.1, "coulomb": 0.3, "load": 0.02}
    shoulder = {
        "motor": {
            **MOTOR, **around, **heated, "current_limit": 8.0,
            "friction": {"viscous": 1e-4, "coulomb": 0.01, "load": 0.01},
        },
        "gear": {
            "ratio": 0.02, "stiffness": 3e3, "damping": 5.0, "backlash": 1e-3,
            "thermal": {"heat_capacity": 20.0, "thermal_resistance": 2.0, "viscous_decay": 20.0},
        },
        "friction": friction,
        "brake": {"torque": 1.0},
        "end_stops": {"lower": -0.5, "upper": 6e-3, "stiffness": 1e4, "damping": 10.0},
        "counterbalance": {
            "base_distance": 0.3, "link_distance": 0.1, "force": 50.0, "length": 0.2,
            "stiffness": 100.0,
        },
        **encoders, **analog,
    }  # fmt: skip
    elbow = {
        "start": 0.7,
        "motor": {**PMSM, **heated},
        "gear": {"ratio": 0.05, "stiffness": 2e3, "damping": 2.0, "cubic_stiffness": 1e5},
        "lugre": {"coulomb": 0.2, "bristle_stiffness": 1e3, "bristle_damping": 10.0},
        "brake": {"torque": 0.5},
        **encoders, **sensors,
    }  # fmt: skip
    wrist = {
        "start": -0.7,
        "motor": {"kind": "torque", "rotor_inertia": 1e-4, "bandwidth": 200.0, "torque_limit": 2.0},
        "drag": {"coefficient": 1.5},
        "gear": {"ratio": 0.1},
        "brake": {"torque": 0.2},
        **encoders, **analog,
    }  # fmt: skip
    # Others, each alone, so that the chain moves as without them.
    beside = {
        kind.section: {"start": 0.1, kind.section: draw_part(kind, rng)}
        for kind in EXTRAS
        if kind.list_faults()
        and kind.shaft == "link"
        and "." not in kind.section
        and kind.section not in {**shoulder, **elbow, **wrist}
    }
    imu = {"noise": 0.01, "range": 1.0}
    return load_scene(
        write_scene(
            folder, chain_urdf(beside),
            {**dict(zip(NAMES, (shoulder, elbow, wrist), strict=True)), **beside},
            tool="wrist_link", gravity=GRAVITY, seed=3,
            payload={"mass": 1.0, "com": [0.1, 0.0, 0.1]},
            imus={"hand": {"link": "elbow_link", "accelerometer": imu, "gyroscope": imu}},
            integrator={"scheme": "rosenbrock", "dt": 2e-4},
            **{"faults": ["*"], **more},
        )
    )  # fmt: skip
