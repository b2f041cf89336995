"""Write a layout of Foxglove and Lichtblick for a scene."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from pathlib import Path

from arm_emulator.base.refusal import Refusal
from arm_emulator.cli.command import command
from arm_emulator.cli.options import SceneName
from arm_emulator.cli.output import output
from arm_emulator.machine.measured_fields import MeasuredFields
from arm_emulator.machine.scene import load_scene
from arm_emulator.machine.urdf_tree import names_of, read_joints, root_of
from arm_emulator.view.foxglove_layout import foxglove_layout


@command(of_ros=True, keys="`file`, `panels`")
def foxglove(scene: SceneName, file: Path, /, *, namespace: str = "") -> int:
    """Write a layout of Foxglove and Lichtblick for a network of a scene, or for its bag.

    Args:
        file: new .json, for *Import from file* among the layouts.
        namespace: of all topics, such as /cell1.
    """
    from arm_emulator_msgs.msg import MotorState

    machine = load_scene(scene)
    known = MeasuredFields(machine, MotorState.get_fields_and_field_types())
    further = {one.name: one.unit for one in known.own if not one.per_unit}
    robot = ET.fromstring(machine.urdf)
    links = names_of(robot, "link", scene)
    root = root_of(links, read_joints(robot, links, scene), scene)
    layout = foxglove_layout(root, machine.joint_names, further, namespace)
    try:
        with file.open("x", encoding="utf-8") as stream:
            json.dump(layout, stream, indent=2)
    except FileExistsError:
        raise Refusal("foxglove", f"file {file}", "be new", "one that exists") from None
    except OSError as error:
        raise Refusal("foxglove", f"file {file}", "be writable", error.strerror) from None
    panels = layout["configById"]
    output.line(f"{file}: {len(panels)} panels")
    output.facts({"file": file, "panels": list(panels)})
    return 0
