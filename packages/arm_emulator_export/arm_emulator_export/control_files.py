"""A scene as ros2_control takes it: a robot description with our hardware, and controllers."""

import xml.etree.ElementTree as ET

import yaml

from arm_emulator.extension.base import Refusal
from arm_emulator.extension.machine import Scene

PLUGIN = "arm_emulator_hardware/ArmSystem"
STATE_BROADCASTER = "joint_state_broadcaster"
TRAJECTORY_CONTROLLER = "joint_trajectory_controller"
COMMANDS = ("position", "velocity", "effort")
STATES = (
    "position", "velocity", "effort", "current", "temperature", "motor_counts",
    "true_position", "true_velocity", "true_effort",
)  # fmt: skip
FASTEST = 500  # Hz: of the controllers


def describe_control(scene: Scene, compiled: str) -> str:
    """Return the scene's URDF with a ``<ros2_control>`` element.

    Args:
        scene: the machine.
        compiled: FOLDER/NAME of its libraries.

    Raises:
        Refusal: a scene with couplings, whose drives are not those of its joints.
    """
    if not scene.chain.coupling.is_mimic:
        rule = "have no couplings but joints that follow one other joint each"
        valid = "`locked` joints, or a drive for each (without `couplings`)"
        raise Refusal("ros2-control", "scene", rule, scene.where, valid)
    robot = ET.fromstring(scene.urdf)
    for element in robot.iter("joint"):
        for follows in element.findall("coupling"):  # others know `mimic` alone
            follows.tag = "mimic"
            if follows.get("joint") == element.get("name"):
                element.remove(follows)
    for old in robot.findall("ros2_control"):
        robot.remove(old)
    control = ET.SubElement(robot, "ros2_control", name=scene.name, type="system")
    hardware = ET.SubElement(control, "hardware")
    ET.SubElement(hardware, "plugin").text = PLUGIN
    ET.SubElement(hardware, "param", name="scene").text = compiled
    for joint in scene.joints:
        joint_element = ET.SubElement(control, "joint", name=joint.name)
        for name in COMMANDS:
            ET.SubElement(joint_element, "command_interface", name=name)
        for name in STATES:
            state = ET.SubElement(joint_element, "state_interface", name=name)
            if name == "position":
                ET.SubElement(state, "param", name="initial_value").text = f"{joint.start!r}"
    power = ET.SubElement(control, "gpio", name=f"{scene.name}_power")
    ET.SubElement(power, "command_interface", name="power")
    ET.SubElement(power, "state_interface", name="powered")
    if scene.varied:
        numbers = ET.SubElement(control, "gpio", name=f"{scene.name}_varied")
        for number in scene.varied:
            joint_element = ET.SubElement(numbers, "command_interface", name=number.name)
            ET.SubElement(joint_element, "param", name="initial_value").text = f"{number.value!r}"
    ET.indent(robot)
    return ET.tostring(robot, encoding="unicode") + "\n"


def update_rate(scene: Scene) -> int:
    """Return the largest rate of controllers, a whole number of servo periods apart [Hz].

    Raises:
        Refusal: no whole rate has such a period.
    """
    period = round(1e9 * scene.servo_period)
    for rate in range(FASTEST, 0, -1):
        if 10**9 % rate == 0 and 10**9 // rate % period == 0:
            return rate
    rule = "divide the period of a whole rate"
    raise Refusal("ros2-control", "servo_period", rule, f"{scene.servo_period:g} s")


def describe_controllers(scene: Scene) -> str:
    """Return parameters of a controller manager with the usual controllers, as YAML.

    Raises:
        Refusal: as `update_rate`.
    """
    joints = list(scene.joint_names)
    types = {
        STATE_BROADCASTER: "joint_state_broadcaster/JointStateBroadcaster",
        TRAJECTORY_CONTROLLER: "joint_trajectory_controller/JointTrajectoryController",
    }
    manager = {"update_rate": update_rate(scene), **{n: {"type": t} for n, t in types.items()}}
    trajectory: dict[str, object] = {
        "joints": joints,
        "command_interfaces": ["position"],
        "state_interfaces": ["position", "velocity"],
    }
    if scene.chain.is_branched:  # a planner of one arm names its joints alone
        trajectory["allow_partial_joints_goal"] = True
    nodes = {"controller_manager": manager, TRAJECTORY_CONTROLLER: trajectory}
    parameters = {name: {"ros__parameters": node} for name, node in nodes.items()}
    return yaml.safe_dump(parameters, sort_keys=False)
