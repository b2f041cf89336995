"""Arms of any number of joints, for measuring how costs grow."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from arm_emulator.machine.scene.scene import Scene, load_scene

LENGTH, RADIUS = 0.2, 0.03  # m
BASE_MASS = 4.0  # kg; every link is a tenth lighter than the one before
AXES = ("0 0 1", "0 1 0", "1 0 0")

JOINT = {
    "start": 0.2,
    "motor": {
        "resistance": 1.0,
        "inductance": 1e-3,
        "torque_constant": 0.05,
        "back_emf_constant": 0.05,
        "rotor_inertia": 1e-4,
    },
    "gear": {"ratio": 0.01, "stiffness": 1e4, "damping": 10.0},
    "friction": {"viscous": 0.5},
}


def write_chain(folder: Path, joints: int, **keys: Any) -> Scene:
    """Return a scene of solid cylinders on top of each other, written into `folder`.

    The joints turn about z, y and x in turn. Motors and gears are those of three_axis.
    """
    names = [f"joint_{k}" for k in range(joints)]
    (folder / f"chain_{joints}.urdf").write_text(_write_urdf(names), encoding="utf-8")
    data = {
        "name": f"chain_{joints}",
        "urdf": f"chain_{joints}.urdf",
        "tool": f"{names[-1]}_link",
        "gravity": [0.0, 0.0, -9.81],
        "supply_voltage": 48.0,
        "joints": dict.fromkeys(names, JOINT),
        "integrator": {"scheme": "rosenbrock", "dt": 1e-5},
        "servo_period": 1e-3,
    }
    file = folder / f"chain_{joints}.yaml"
    file.write_text(yaml.safe_dump(data), encoding="utf-8")
    return load_scene(file, keys)


def _write_urdf(names: list[str]) -> str:
    text, parent, mass = '<robot name="chain"><link name="base"/>', "base", BASE_MASS
    for k, name in enumerate(names):
        # Solid cylinder along z: ixx = iyy = m (3 r^2 + l^2) / 12, izz = m r^2 / 2.
        across, along = mass * (3 * RADIUS**2 + LENGTH**2) / 12, mass * RADIUS**2 / 2
        text += f"""
<joint name="{name}" type="continuous"><parent link="{parent}"/><child link="{name}_link"/>
<origin xyz="0 0 {LENGTH if k else 0}"/><axis xyz="{AXES[k % 3]}"/></joint>
<link name="{name}_link"><inertial><origin xyz="0 0 {LENGTH / 2}"/><mass value="{mass}"/>
<inertia ixx="{across}" iyy="{across}" izz="{along}" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
        parent, mass = f"{name}_link", 0.9 * mass
    return text + "</robot>"
