"""ros2_control for a scene: description, controllers, and names that its plugin knows."""

import re
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
import yaml
from draws import some
from test_couplings import machine

from arm_emulator import Refusal, load_scene
from arm_emulator_export.control_files import (
    COMMANDS,
    PLUGIN,
    STATES,
    describe_control,
    describe_controllers,
    update_rate,
)
from oracles.coupled_arms import ARMS, list_shafts

ROOT = Path(__file__).resolve().parents[3]
PACKAGE = ROOT / "packages/arm_emulator_hardware"


@pytest.mark.parametrize("name", some(["three_axis", "kuka_kr300", "ur5", "panda"], 2))
def test_a_description_has_every_drive_once(name: str, tmp_path: Path) -> None:
    scene = load_scene(name)
    robot = ET.fromstring(describe_control(scene, f"{tmp_path / name}"))
    was = ET.fromstring(scene.urdf)
    (control,) = robot.findall("ros2_control")
    assert control.findtext("hardware/plugin") == PLUGIN
    assert control.findtext("hardware/param") == str(tmp_path / name)
    of_robot = {joint.get("name") for joint in was.findall("joint")}
    joints = control.findall("joint")
    assert tuple(joint.get("name") for joint in joints) == scene.joint_names
    assert of_robot.issuperset(scene.joint_names)
    for element, joint in zip(joints, scene.joints, strict=True):
        commands = tuple(
            interface.get("name") for interface in element.findall("command_interface")
        )
        states = tuple(interface.get("name") for interface in element.findall("state_interface"))
        assert (commands, states) == (COMMANDS, STATES)
        (start,) = element.findall("state_interface[@name='position']/param")
        assert float(start.text or "") == joint.start
    robot.remove(control)
    assert [joint.attrib for joint in robot] == [joint.attrib for joint in was]


def test_varied_numbers_are_commands_with_the_scene_s_values(tmp_path: Path) -> None:
    changed = {"varied": ["joints.elbow.gear.*"], "faults": ["elbow.gear_breaks"]}
    scene = load_scene("three_axis", changed)
    robot = ET.fromstring(describe_control(scene, f"{tmp_path}/three_axis"))
    commands = robot.findall("ros2_control/gpio[@name='three_axis_varied']/command_interface")
    values = {
        command.get("name"): float(command.findtext("param") or "nan") for command in commands
    }
    assert values == {number.name: number.value for number in scene.varied}
    assert values["faults.elbow.gear_breaks"] == 0.0 and len(values) == 3


def test_joints_that_follow_a_single_joint_are_mimics_and_further_couplings_are_refused(
    tmp_path: Path,
) -> None:
    parts, shares = ARMS["telescope"]
    robot = ET.fromstring(describe_control(machine(tmp_path, parts, shares), "anywhere"))
    (control,) = robot.findall("ros2_control")
    assert [mimic.get("name") for mimic in control.findall("joint")] == list_shafts(parts, shares)
    mimics = {
        joint.get("name", ""): {mimic.get("joint", ""): float(mimic.get("multiplier", ""))}
        for joint in robot.findall("joint")
        for mimic in joint.findall("mimic")
    }
    assert mimics == shares and not list(robot.iter("coupling"))
    for name in ("palletizer", "bevel wrist", "differential"):
        with pytest.raises(Refusal, match="follow one other joint each"):
            describe_control(machine(tmp_path, *ARMS[name]), "anywhere")


def test_interfaces_are_those_of_the_plugin() -> None:
    text = (PACKAGE / "src" / "arm_system.cpp").read_text()
    commands = re.findall(r'\{"(\w+)", Loop::(\w+)\}', text)
    readings = re.findall(r'\{"(\w+)", &JointReading::(\w+)\}', text)
    assert tuple(name for name, _ in commands) == COMMANDS
    assert tuple(name for name, _ in readings) == STATES
    assert all(name == member for name, member in commands + readings)


def test_the_package_exports_the_plugin_of_descriptions() -> None:
    (library,) = ET.parse(PACKAGE / "plugins.xml").iter("library")
    (plugin,) = library
    assert plugin.get("name") == PLUGIN
    package = ET.parse(PACKAGE / "package.xml").getroot()
    ours = ET.parse(ROOT / "package.xml").getroot()
    assert package.findtext("name") == library.get("path") == PLUGIN.split("/")[0]
    assert package.findtext("version") == ours.findtext("version")
    built = (PACKAGE / "CMakeLists.txt").read_text()
    for depend, start in (("depend", "^"), ("test_depend", "^  ")):
        depends = {dependency.text for dependency in package.findall(depend)}
        packages = set(re.findall(rf"{start}find_package\((\w+)", built, re.M)) - {"ament_cmake"}
        controllers = {
            dependency for dependency in depends if str(dependency).endswith("_controller")
        }
        assert depends - controllers == packages


@pytest.mark.parametrize(("period", "rate"), [(1e-3, 500), (2e-3, 500), (4e-3, 250), (5e-4, 500)])
def test_controllers_wait_for_complete_servo_periods(period: float, rate: int) -> None:
    scene = load_scene("three_axis", {"servo_period": period, "integrator.dt": 5e-4})
    assert update_rate(scene) == rate
    parameters = yaml.safe_load(describe_controllers(scene))
    assert parameters["controller_manager"]["ros__parameters"]["update_rate"] == rate
    trajectory = parameters["joint_trajectory_controller"]["ros__parameters"]
    assert tuple(trajectory["joints"]) == scene.joint_names


def test_a_servo_period_without_an_integer_rate_is_refused() -> None:
    scene = load_scene("three_axis", {"servo_period": 3e-3, "integrator.dt": 1e-3})
    with pytest.raises(Refusal, match="servo_period must divide the period of a whole rate"):
        update_rate(scene)
