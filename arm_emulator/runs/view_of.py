"""Data of a scene for showing its machine in Rerun."""

from typing import Any

from arm_emulator.machine.plant.outputs import list_reported_by_parts
from arm_emulator.machine.scene.scene import Scene
from arm_emulator.machine.scene.urdf_file import find_example_robot_data


def get_view(scene: Scene) -> dict[str, Any]:
    """Return what `RerunStream` gets of a scene."""
    robots = find_example_robot_data()
    quantities = [part for part in list_reported_by_parts(scene) if not part.per_unit]
    return {
        "urdf_xml": scene.true_urdf,
        "joint_names": scene.joint_names,
        "q_start": scene.start,
        "tool": scene.tool,
        "package_dirs": [robots.parents[1]] if robots else [],
        "further": {quantity.name: quantity.unit for quantity in quantities},
    }
