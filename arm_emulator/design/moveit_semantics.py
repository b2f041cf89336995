"""A scene as MoveIt takes it: groups of its robot (SRDF), limits, kinematics, controllers."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from typing import Any

import numpy as np

from arm_emulator.design.ros2_control import TRAJECTORY_CONTROLLER
from arm_emulator.machine.scene import Scene
from arm_emulator.machine.urdf_tree import names_of, read_joints, root_of
from arm_emulator.motion.kinematics import Kinematics
from arm_emulator.motion.kinematics_model import rate_limits
from arm_emulator.motion.link_pairs import DRAWN, link_pairs
from arm_emulator.motion.motion_config import MotionConfig

GROUP = "arm"
WORLD = "world"
ACTION = "follow_joint_trajectory"
FREE = 6  # joints that can reach any pose


def base_link(scene: Scene) -> str:
    """Return the link that no joint moves."""
    robot = ET.fromstring(scene.urdf)
    links = names_of(robot, "link", scene.where)
    return root_of(links, read_joints(robot, links, scene.where), scene.where)


def named_states(scene: Scene) -> dict[str, list[float]]:
    """Return poses by name: where the scene starts, and all joints at 0 where limits allow it."""
    arm = Kinematics(scene.urdf, scene.joint_names, scene.tool)
    states = {"start": [float(one) for one in scene.start]}
    within = (arm.lower <= 0.0) & (arm.upper >= 0.0)
    if np.all(within) and any(states["start"]):
        states["zero"] = [0.0] * len(scene.joints)
    return states


def srdf(scene: Scene, drawn: int = DRAWN) -> str:
    """Return the SRDF of a scene's robot.

    Args:
        scene: the machine.
        drawn: configurations in which links are tested for contact (`link_pairs`).

    Raises:
        Refusal: a mesh of the robot that cannot be read.
    """
    base = base_link(scene)
    robot = ET.Element("robot", name=ET.fromstring(scene.urdf).get("name") or scene.name)
    group = ET.SubElement(robot, "group", name=GROUP)
    ET.SubElement(group, "chain", base_link=base, tip_link=scene.tool)
    for name, positions in named_states(scene).items():
        state = ET.SubElement(robot, "group_state", name=name, group=GROUP)
        for joint, value in zip(scene.joint_names, positions, strict=True):
            ET.SubElement(state, "joint", name=joint, value=f"{value!r}")
    if base != WORLD:
        ET.SubElement(robot, "virtual_joint", name=f"{WORLD}_to_{base}", type="fixed",
                      parent_frame=WORLD, child_link=base)  # fmt: skip
    for pair in link_pairs(scene.urdf, scene.joint_names, drawn):
        ET.SubElement(robot, "disable_collisions", link1=pair.first, link2=pair.second,
                      reason=pair.reason.value)  # fmt: skip
    ET.indent(robot)
    return ET.tostring(robot, encoding="unicode", xml_declaration=True) + "\n"


def joint_limits(scene: Scene, motion: MotionConfig) -> dict[str, Any]:
    """Return the content of joint_limits.yaml: what our motion control would keep, too."""
    limits = rate_limits(scene.urdf)
    of_joints = {}
    for name in scene.joint_names:
        values = {
            "velocity": min(limits[name].velocity, motion.velocity_limit),
            "acceleration": min(limits[name].acceleration, motion.acceleration_limit),
        }
        of_joints[name] = {
            key: given
            for what, value in values.items()
            for key, given in ((f"has_{what}_limits", True), (f"max_{what}", value))
        }
    return {
        "default_velocity_scaling_factor": 1.0,
        "default_acceleration_scaling_factor": 1.0,
        "joint_limits": of_joints,
    }


def cartesian_limits(motion: MotionConfig) -> dict[str, Any]:
    """Return the content of pilz_cartesian_limits.yaml: of the tool on our paths."""
    limits = {
        "max_trans_vel": motion.tool_speed,
        "max_trans_acc": motion.tool_acceleration,
        "max_trans_dec": -motion.tool_acceleration,
        "max_rot_vel": motion.tool_turn_speed,
    }
    return {"cartesian_limits": limits}


def kinematics(scene: Scene) -> dict[str, Any]:
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


def trajectory_execution(scene: Scene, network: bool) -> dict[str, Any]:
    """Return the content of a file *_controllers.yaml of MoveIt.

    Args:
        scene: the machine.
        network: whether the action is that of our motion controller, in the root namespace.
    """
    # MoveIt joins the controller's name and its action_ns.
    name, inner = (ACTION, "") if network else (TRAJECTORY_CONTROLLER, ACTION)
    one = {
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
        simple: {"controller_names": [name], name: one},
    }
