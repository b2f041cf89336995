"""A ROS package with all that MoveIt wants of a scene, as MoveIt's own assistant lays it out."""

import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from arm_emulator.extension.base import escape_xml
from arm_emulator.extension.compiler import name_stem
from arm_emulator.extension.machine import (
    Scene,
    find_root_link,
    list_element_names,
    read_urdf_joints,
)
from arm_emulator.extension.motion import (
    DRAWN_CONFIGURATIONS,
    Kinematics,
    find_link_pairs,
    read_rate_limits,
)
from arm_emulator.extension.page import list_package_folders
from arm_emulator.extension.runs import MotionConfig
from arm_emulator_export import control_files
from arm_emulator_export.control_files import TRAJECTORY_CONTROLLER

MACHINE = "machine"  # folder of the compiled scene
RUNS = (
    "arm_emulator", "arm_emulator_hardware", "controller_manager", "joint_state_broadcaster",
    "joint_trajectory_controller", "moveit_configs_utils", "moveit_kinematics", "moveit_planners",
    "moveit_ros_move_group", "moveit_ros_visualization", "moveit_simple_controller_manager",
    "robot_state_publisher", "rviz2", "tf2_ros", "xacro",
)  # fmt: skip
# Launch files of MoveIt's own functions.
LAUNCHES = {
    "demo": "generate_demo_launch",
    "move_group": "generate_move_group_launch",
    "moveit_rviz": "generate_moveit_rviz_launch",
    "rsp": "generate_rsp_launch",
    "spawn_controllers": "generate_spawn_controllers_launch",
    "static_virtual_joint_tfs": "generate_static_virtual_joint_tfs_launch",
}

_CMAKE = """cmake_minimum_required(VERSION 3.16)
project({package} LANGUAGES NONE)
find_package(ament_cmake REQUIRED)
install(DIRECTORY config launch {machine} DESTINATION share/${{PROJECT_NAME}})
install(FILES .setup_assistant DESTINATION share/${{PROJECT_NAME}})
ament_package()
"""

_LAUNCH = '''"""MoveIt for {name}: `{function}`."""

from moveit_configs_utils import MoveItConfigsBuilder
from moveit_configs_utils.launches import {function}


def generate_launch_description():
    return {function}(
        MoveItConfigsBuilder("{name}", package_name="{package}").to_moveit_configs()
    )
'''

_NETWORK = '''"""MoveIt moves the arm of our three nodes, on its time.

ros2 launch {package} network.launch.py clock:=realtime
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, GroupAction, IncludeLaunchDescription
from launch.conditions import IfCondition
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import SetParameter
from launch_ros.substitutions import FindPackageShare
from moveit_configs_utils import MoveItConfigsBuilder
from moveit_configs_utils.launches import (
    generate_move_group_launch,
    generate_moveit_rviz_launch,
    generate_static_virtual_joint_tfs_launch,
)


def generate_launch_description():
    config = (
        MoveItConfigsBuilder("{name}", package_name="{package}")
        .trajectory_execution("config/network_controllers.yaml", moveit_manage_controllers=False)
        .to_moveit_configs()
    )
    bringup = PathJoinSubstitution([FindPackageShare("arm_emulator"), "launch/bringup.launch.py"])
    arguments = {{
        "scene": LaunchConfiguration("scene"),
        "clock": LaunchConfiguration("clock"),
        "use_sim_time": "true",
    }}
    rviz = generate_moveit_rviz_launch(config)
    return LaunchDescription(
        [
            DeclareLaunchArgument("scene", default_value={scene!r}),
            DeclareLaunchArgument("clock", default_value="realtime"),
            DeclareLaunchArgument("use_rviz", default_value="true"),
            IncludeLaunchDescription(
                PythonLaunchDescriptionSource(bringup), launch_arguments=arguments.items()
            ),
            GroupAction(
                [
                    SetParameter("use_sim_time", True),
                    *generate_static_virtual_joint_tfs_launch(config).entities,
                    *generate_move_group_launch(config).entities,
                    GroupAction(
                        rviz.entities, condition=IfCondition(LaunchConfiguration("use_rviz"))
                    ),
                ]
            ),
        ]
    )
'''


def make_package_name(scene: Scene) -> str:
    """Return the name of a scene's package, as ROS allows names."""
    return f"{_make_ros_name(scene.name)}_moveit_config"


def write_moveit_files(scene: Scene, motion: MotionConfig, bringup: str) -> dict[str, str]:
    """Return the texts of a scene's package by their paths in it.

    The compiled scene belongs into its folder `MACHINE`.

    Args:
        scene: the machine.
        motion: parameters of its motion controller, for limits.
        bringup: the scene, as `bringup.launch.py` takes it.

    Raises:
        Refusal: as `control_files.describe_control`; a scene without a rate for controllers, or
            with unreadable meshes.
    """
    name, package = _make_ros_name(scene.name), make_package_name(scene)
    words = {"name": name, "package": package, "scene": bringup, "machine": MACHINE}
    texts = {
        "package.xml": _write_package_xml(package, scene.name),
        "CMakeLists.txt": _CMAKE.format(**words),
        ".setup_assistant": _dump_yaml(_configure_assistant(name, package)),
        f"config/{name}.urdf.xacro": _describe_robot(scene, package),
        f"config/{name}.srdf": write_srdf(scene),
        "config/ros2_controllers.yaml": control_files.describe_controllers(scene),
        "config/moveit.rviz": _dump_yaml(_configure_rviz()),
        "launch/network.launch.py": _NETWORK.format(**words),
    }
    contents = {
        "kinematics": describe_kinematics(scene),
        "joint_limits": describe_joint_limits(scene, motion),
        "pilz_cartesian_limits": describe_cartesian_limits(motion),
        "moveit_controllers": describe_execution(scene, network=False),
        "network_controllers": describe_execution(scene, network=True),
    }
    texts |= {f"config/{file}.yaml": _dump_yaml(content) for file, content in contents.items()}
    for file, function in LAUNCHES.items():
        texts[f"launch/{file}.launch.py"] = _LAUNCH.format(function=function, **words)
    return texts


def _make_ros_name(name: str) -> str:
    """Return a name of lower-case letters, digits and underscores that begins with a letter."""
    words = re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")
    return words if words[:1].isalpha() else f"arm_{words}".rstrip("_")


def _dump_yaml(content: Mapping[str, Any]) -> str:
    return yaml.safe_dump(dict(content), sort_keys=False)


def _describe_robot(scene: Scene, package: str) -> str:
    """Return the robot description as a xacro source that finds the machine in its package."""
    robot = ET.fromstring(control_files.describe_control(scene, f"MACHINE/{name_stem(scene.name)}"))
    folders = [Path(folder) for folder in list_package_folders()]
    for mesh in robot.iter("mesh"):
        # A wheel's packages are not in the index of ROS packages.
        rest = mesh.get("filename", "").removeprefix("package://")
        path = next((file for at in folders if (file := at / rest).is_file()), None)
        if path is not None:
            mesh.set("filename", path.as_uri())
    text = re.sub(r"\$(?=[({])", "$$", ET.tostring(robot, encoding="unicode"))
    return text.replace(">MACHINE/", f">$(find {package})/{MACHINE}/") + "\n"


def _configure_assistant(name: str, package: str) -> dict[str, Any]:
    files = {
        "urdf": {"package": package, "relative_path": f"config/{name}.urdf.xacro"},
        "srdf": {"relative_path": f"config/{name}.srdf"},
    }
    return {"moveit_setup_assistant_config": files}


def _write_package_xml(package: str, scene: str) -> str:
    root = ET.Element("package", format="3")
    for tag, text in (
        ("name", package),
        ("version", "0.1.0"),
        ("description", f"MoveIt for the emulated arm {scene}"),
    ):
        ET.SubElement(root, tag).text = escape_xml(text)
    ET.SubElement(root, "maintainer", email="arm_emulator@example.org").text = "its user"
    ET.SubElement(root, "license").text = "Apache-2.0"
    ET.SubElement(root, "buildtool_depend").text = "ament_cmake"
    for run in RUNS:
        ET.SubElement(root, "exec_depend").text = run
    ET.SubElement(ET.SubElement(root, "export"), "build_type").text = "ament_cmake"
    ET.indent(root)
    return '<?xml version="1.0"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def _configure_rviz() -> dict[str, Any]:
    planning = {
        "Class": "moveit_rviz_plugin/MotionPlanning",
        "Name": "MotionPlanning",
        "Planning Request": {"Planning Group": GROUP},
        "Planning Scene Topic": "monitored_planning_scene",
        "Robot Description": "robot_description",
        "Value": True,
    }
    grid = {"Class": "rviz_default_plugins/Grid", "Name": "Grid", "Value": True}
    view = {"Class": "rviz_default_plugins/Orbit", "Name": "Current View", "Distance": 3.0,
            "Pitch": 0.5, "Yaw": 0.8, "Target Frame": WORLD}  # fmt: skip
    tools = ["Interact", "MoveCamera", "Select"]
    return {
        "Panels": [
            {"Class": f"rviz_common/{panel_kind}", "Name": panel_kind}
            for panel_kind in ("Displays", "Views")
        ],
        "Visualization Manager": {
            "Displays": [grid, planning],
            "Global Options": {"Fixed Frame": WORLD},
            "Tools": [{"Class": f"rviz_default_plugins/{tool}"} for tool in tools],
            "Value": True,
            "Views": {"Current": view},
        },
        "Window Geometry": {"Height": 900, "Width": 1400},
    }


GROUP = "arm"
WORLD = "world"
ACTION = "follow_joint_trajectory"
FREE = 6  # joints that can reach any pose


def find_base_link(scene: Scene) -> str:
    """Return the link that no joint moves."""
    robot = ET.fromstring(scene.urdf)
    links = list_element_names(robot, "link", scene.where)
    return find_root_link(links, read_urdf_joints(robot, links, scene.where), scene.where)


def list_named_states(scene: Scene) -> dict[str, list[float]]:
    """Return poses by name: where the scene starts, and all joints at 0 where limits allow it."""
    arm = Kinematics(scene.urdf, scene.joint_names, scene.tool)
    states = {"start": [float(position) for position in scene.start]}
    within = (arm.lower <= 0.0) & (arm.upper >= 0.0)
    if np.all(within) and any(states["start"]):
        states["zero"] = [0.0] * len(scene.joints)
    return states


def write_srdf(scene: Scene, drawn: int = DRAWN_CONFIGURATIONS) -> str:
    """Return the SRDF of a scene's robot.

    Args:
        scene: the machine.
        drawn: configurations in which links are tested for contact (`find_link_pairs`).

    Raises:
        Refusal: a mesh of the robot that cannot be read.
    """
    base = find_base_link(scene)
    robot = ET.Element("robot", name=ET.fromstring(scene.urdf).get("name") or scene.name)
    group = ET.SubElement(robot, "group", name=GROUP)
    ET.SubElement(group, "chain", base_link=base, tip_link=scene.tool)
    for name, positions in list_named_states(scene).items():
        state = ET.SubElement(robot, "group_state", name=name, group=GROUP)
        for joint, value in zip(scene.joint_names, positions, strict=True):
            ET.SubElement(state, "joint", name=joint, value=f"{value!r}")
    if base != WORLD:
        ET.SubElement(robot, "virtual_joint", name=f"{WORLD}_to_{base}", type="fixed",
                      parent_frame=WORLD, child_link=base)  # fmt: skip
    for pair in find_link_pairs(scene.urdf, scene.joint_names, drawn):
        ET.SubElement(robot, "disable_collisions", link1=pair.first, link2=pair.second,
                      reason=pair.reason.value)  # fmt: skip
    ET.indent(robot)
    return ET.tostring(robot, encoding="unicode", xml_declaration=True) + "\n"


def describe_joint_limits(scene: Scene, motion: MotionConfig) -> dict[str, Any]:
    """Return the content of joint_limits.yaml: what our motion control would keep, too."""
    limits = read_rate_limits(scene.urdf)
    of_joints = {}
    for name in scene.joint_names:
        values = {
            "velocity": min(limits[name].velocity, motion.velocity_limit),
            "acceleration": min(limits[name].acceleration, motion.acceleration_limit),
        }
        of_joints[name] = {
            key: option
            for quantity, value in values.items()
            for key, option in ((f"has_{quantity}_limits", True), (f"max_{quantity}", value))
        }
    return {
        "default_velocity_scaling_factor": 1.0,
        "default_acceleration_scaling_factor": 1.0,
        "joint_limits": of_joints,
    }


def describe_cartesian_limits(motion: MotionConfig) -> dict[str, Any]:
    """Return the content of pilz_cartesian_limits.yaml: of the tool on our paths."""
    limits = {
        "max_trans_vel": motion.tool_speed,
        "max_trans_acc": motion.tool_acceleration,
        "max_trans_dec": -motion.tool_acceleration,
        "max_rot_vel": motion.tool_turn_speed,
    }
    return {"cartesian_limits": limits}


def describe_kinematics(scene: Scene) -> dict[str, Any]:
    """Return the content of kinematics.yaml; fewer than `FREE` joints reach positions alone."""
    solver = {
        "kinematics_solver": "kdl_kinematics_plugin/KDLKinematicsPlugin",
        "kinematics_solver_search_resolution": 0.005,
        "kinematics_solver_timeout": 0.05,
    }
    arm = Kinematics(scene.urdf, scene.joint_names, scene.tool)
    if arm.to_tool.sum() < FREE:
        solver["position_only_ik"] = True
    return {GROUP: solver}


def describe_execution(scene: Scene, network: bool) -> dict[str, Any]:
    """Return the content of a file *_controllers.yaml of MoveIt.

    Args:
        scene: the machine.
        network: whether the action is that of our motion controller, in the root namespace.
    """
    # MoveIt joins the controller's name and its action_ns.
    name, inner = (ACTION, "") if network else (TRAJECTORY_CONTROLLER, ACTION)
    section = {
        "type": "FollowJointTrajectory",
        "action_ns": inner,
        "default": True,
        "joints": list(scene.joint_names),
    }
    simple = "moveit_simple_controller_manager"
    return {
        "trajectory_execution": {
            "allowed_execution_duration_scaling": 1.2,
            "allowed_goal_duration_margin": 0.5,
            "allowed_start_tolerance": 0.01,
        },
        "moveit_controller_manager": f"{simple}/MoveItSimpleControllerManager",
        simple: {"controller_names": [name], name: section},
    }
