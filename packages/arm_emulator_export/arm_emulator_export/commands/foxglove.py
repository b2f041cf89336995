"""Write a layout of Foxglove and Lichtblick for a scene."""

import json
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from arm_emulator.extension.base import Refusal
from arm_emulator.extension.commands import SceneName, command, output
from arm_emulator.extension.machine import (
    MeasuredFields,
    find_root_link,
    list_element_names,
    load_scene,
    read_urdf_joints,
)


@command(keys="`file`, `panels`")
def write_foxglove_layout(scene: SceneName, file: Path, /, *, namespace: str = "") -> int:
    """Write a layout of Foxglove and Lichtblick for a network of a scene, or for its bag.

    Args:
        file: new .json, for *Import from file* among the layouts.
        namespace: of all topics, such as /cell1.
    """
    from arm_emulator_msgs.msg import MotorState

    machine = load_scene(scene)
    measured_fields = MeasuredFields(machine, MotorState.get_fields_and_field_types())
    further = {output.name: output.unit for output in measured_fields.own if not output.per_unit}
    robot = ET.fromstring(machine.urdf)
    links = list_element_names(robot, "link", scene)
    root = find_root_link(links, read_urdf_joints(robot, links, scene), scene)
    layout = make_foxglove_layout(root, machine.joint_names, further, namespace)
    try:
        with file.open("x", encoding="utf-8") as stream:
            json.dump(layout, stream, indent=2)
    except FileExistsError:
        raise Refusal("foxglove", f"file {file}", "be new", "one that exists") from None
    except OSError as error:
        raise Refusal("foxglove", f"file {file}", "be writable", error.strerror) from None
    panels = layout["configById"]
    output.print_line(f"{file}: {len(panels)} panels")
    output.add_facts({"file": file, "panels": list(panels)})
    return 0


# Layout of Foxglove and Lichtblick for the topics of a network, or of its bag.
#
# The JSON that both read has panels by their names with their settings, and a tree of the panels.

ROOM = 62.0  # per cent of the width for the arm
COLOURS = (
    "#569cd6", "#f08c32", "#6ebe64", "#d65a5a", "#aa82d2", "#50c3c3", "#dcbe50", "#dc82b4",
)  # fmt: skip
# Each plot of a joint has a title, a topic and a field.
PLOTS = (
    ("Position, true [rad or m]", "emulator/joint_states", "position"),
    ("Position, measured", "joint_states", "position"),
    ("Speed, true [rad/s or m/s]", "emulator/joint_states", "velocity"),
    ("Torque of the gear [N m or N]", "emulator/joint_states", "effort"),
    ("Motor current [A]", "motor_states", "current"),
    ("Motor command", "motor_states", "applied"),
)
STATES = (
    ("Motion", "motion/status", "state"),
    ("Change by hand", "emulator/events", "kind"),
    ("Phase", "emulator/status", "phase"),
)


def make_foxglove_layout(
    root: str, joints: Sequence[str], further: Mapping[str, str], namespace: str = ""
) -> dict[str, Any]:
    """Return a layout: the arm, signals of its joints, states, events and health.

    Args:
        root: root link of the robot description.
        joints: names in the order of the scene.
        further: more fields of motor_states with a value per joint, and their units.
        namespace: of all topics, such as "/cell1".
    """
    base = f"/{namespace.strip('/')}/" if namespace.strip("/") else "/"

    def make_plot(title: str, topic: str, field: str) -> dict[str, Any]:
        paths = [
            _make_path(f"{base}{topic}.{field}[{k}]", name, COLOURS[k % len(COLOURS)])
            for k, name in enumerate(joints)
        ]
        return {"title": title, "paths": paths, "xAxisVal": "timestamp", "showLegend": True}

    more = [
        (f"{name} [{unit}]" if unit else name, "motor_states", name)
        for name, unit in further.items()
    ]
    plots = {
        f"Plot!{topic.replace('/', '_')}_{field}": make_plot(title, topic, field)
        for title, topic, field in (*PLOTS, *more)
    }
    speed = "Plot!speed"
    paths = [_make_path(f"{base}emulator/status.real_time_factor", "times real time", COLOURS[0])]
    plots[speed] = {"title": "Speed of logical time", "paths": paths, "xAxisVal": "timestamp"}
    states = [
        {"value": f"{base}{topic}.{field}", "label": title, "timestampMethod": "headerStamp"}
        for title, topic, field in STATES
    ]
    tabs = [
        {"title": plot_config["title"].partition(" [")[0], "layout": panel}
        for panel, plot_config in plots.items()
    ]
    panels = {
        "3D!arm": _make_arm_settings(root, base),
        "Tab!signals": {"activeTabIdx": 0, "tabs": tabs},
        **plots,
        "StateTransitions!states": {"paths": states, "isSynced": True},
        "RawMessages!events": {"topicPath": f"{base}emulator/events"},
        "DiagnosticSummary!health": {"minLevel": 0, "topicToRender": f"{base}diagnostics"},
    }
    right = _make_split(
        "column",
        "Tab!signals",
        _make_split("column", "StateTransitions!states", "RawMessages!events"),
    )
    left = _make_split("column", "3D!arm", "DiagnosticSummary!health", 75.0)
    return {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1.0},
        "layout": _make_split("row", left, right, ROOM),
    }


def _make_path(value: str, label: str, colour: str) -> dict[str, Any]:
    how = {"enabled": True, "timestampMethod": "headerStamp"}
    return {"value": value, "label": label, "color": colour, **how}


def _make_split(direction: str, first: Any, second: Any, share: float = 50.0) -> dict[str, Any]:
    return {"direction": direction, "first": first, "second": second, "splitPercentage": share}


def _make_arm_settings(root: str, base: str) -> dict[str, Any]:
    """Return the settings of the picture: the robot description, moved by true joint angles."""
    arm = {
        "layerId": "foxglove.Urdf", "instanceId": "arm", "label": "Arm", "visible": True,
        "sourceType": "topic", "topic": f"{base}robot_description", "framePrefix": "",
        "controlMode": "jointStates", "jointStatesTopic": f"{base}emulator/joint_states",
        "displayMode": "visual",
    }  # fmt: skip
    grid = {
        "layerId": "foxglove.Grid", "instanceId": "grid", "label": "Floor", "visible": True,
        "frameId": root, "size": 4, "divisions": 16,
    }  # fmt: skip
    return {
        "followMode": "follow-none",
        "followTf": root,
        "scene": {"meshUpAxis": "z_up"},
        "cameraState": {
            "distance": 2.5, "phi": 65.0, "thetaOffset": 45.0, "perspective": True,
            "target": [0.0, 0.0, 0.4], "fovy": 45.0,
        },
        "layers": {"arm": arm, "grid": grid},
        "topics": {f"{base}tool_target": {"visible": True}},
    }  # fmt: skip
