"""Data of a scene for showing its machine in Rerun."""

from __future__ import annotations

from typing import Any

import numpy as np

from arm_emulator.base.shafts import shaft_limits
from arm_emulator.machine.outputs import reported_by_parts
from arm_emulator.machine.scene import Scene
from arm_emulator.machine.urdf_file import example_robot_data


def view_of(scene: Scene) -> dict[str, Any]:
    """Return what `RerunStream` gets of a scene."""
    robots = example_robot_data()
    shown = [one for one in reported_by_parts(scene) if not one.per_unit]
    of_joints = shaft_limits(scene.urdf, scene.joint_names)
    none = -np.inf, np.inf
    most = np.array(scene.largest_commands)
    return {
        "limits": {
            "q": np.array([of_joints.get(name) or none for name in scene.joint_names]).T,
            "applied": np.array([-most, most]),
        },
        "urdf_xml": scene.urdf,
        "joint_names": scene.joint_names,
        "q_start": scene.start,
        "tool": scene.tool,
        "package_dirs": [robots.parents[1]] if robots else [],
        "further": {one.name: one.unit for one in shown},
    }
