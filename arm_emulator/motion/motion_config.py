"""Parameters of the motion controller."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from arm_emulator.base.parameters import load_parameters, parameter
from arm_emulator.motion.drive_numbers import SECTION, Drives, drives_of
from arm_emulator.motion.obstacles import OBSTACLES, Obstacle, obstacles_of

NODE = "motion_controller"
SECTIONS = SECTION, OBSTACLES


@dataclass(frozen=True)
class MotionConfig:
    """Parameters of the motion controller."""

    tool: str = parameter("tool", "link of the robot description that is the tool")
    period: float = parameter(
        0.05, "logical time between joint targets", unit="s", at_least=1e-4, at_most=10.0
    )
    method: str = parameter(
        "auto",
        "control law: way, along ways that are known before they begin, within all limits; paper, "
        "eq. (6); auto: way",
        choices=("auto", "way", "paper"),
    )
    weight: float = parameter(0.5, "w of eq. (6)", at_least=1e-6, at_most=1.0, settable=True)
    task: str = parameter(
        "auto",
        "what the target rules; auto: position below 6 joints, else pose",
        choices=("auto", "position", "pose"),
    )
    step_limit: float = parameter(
        0.2,
        "largest joint step per instruction",
        unit="rad",
        at_least=1e-6,
        at_most=100.0,
        settable=True,
    )
    singular_below: float = parameter(
        0.02,
        "singular values of the Jacobian below this are damped",
        at_least=1e-9,
        at_most=1.0,
        settable=True,
    )
    velocity_limit: float = parameter(
        3.0,
        "largest joint speed, beside the robot description's",
        unit="rad/s",
        at_least=1e-6,
        at_most=1e3,
        settable=True,
    )
    acceleration_limit: float = parameter(
        10.0,
        "largest joint acceleration, beside the robot description's",
        unit="rad/s2",
        at_least=1e-6,
        at_most=1e5,
        settable=True,
    )
    jerk_limit: float = parameter(
        0.0,
        "largest joint jerk; 0: the acceleration comes to its limit in 50 ms",
        unit="rad/s3",
        at_least=0.0,
        at_most=1e8,
        settable=True,
    )
    feedforward: str = parameter(
        "auto",
        "given to the servo beside joint angles: none; speed; torque, of the links' gravity and "
        "motion, and speed; full: the same for elastic gears and friction, by the numbers of the "
        "section `joints`; auto: speed with the method paper, else full where there are such "
        "numbers, else torque",
        choices=("auto", "none", "speed", "torque", "full"),
    )
    gravity_x: float = parameter(
        0.0, "gravity in the world, for torques", unit="m/s2", at_least=-1e3, at_most=1e3
    )
    gravity_y: float = parameter(
        0.0, "gravity in the world, for torques", unit="m/s2", at_least=-1e3, at_most=1e3
    )
    gravity_z: float = parameter(
        -9.81, "gravity in the world, for torques", unit="m/s2", at_least=-1e3, at_most=1e3
    )
    reached_within: float = parameter(
        1e-3,
        "a tool no farther from its target has reached it",
        unit="m",
        at_least=1e-9,
        at_most=1e3,
        settable=True,
    )
    reached_within_angle: float = parameter(
        5e-3, "the same of its orientation", unit="rad", at_least=1e-9, at_most=10.0, settable=True
    )
    tool_speed: float = parameter(
        0.25, "of the tool along paths", unit="m/s", at_least=1e-6, at_most=100.0, settable=True
    )
    tool_turn_speed: float = parameter(
        1.0, "of its turning along paths", unit="rad/s", at_least=1e-6, at_most=100.0, settable=True
    )
    tool_acceleration: float = parameter(
        1.0,
        "of the tool along paths, and across them",
        unit="m/s2",
        at_least=1e-6,
        at_most=1e4,
        settable=True,
    )
    tool_jerk: float = parameter(
        10.0, "of the tool along paths", unit="m/s3", at_least=1e-6, at_most=1e6, settable=True
    )
    path_arcs: bool = parameter(
        False,
        "whether each three poses of a path (0 1 2, 2 3 4, ...) are on an arc of a circle; else "
        "there are lines between them",
        settable=True,
    )
    path_blend: float = parameter(
        0.0,
        "where two lines of a path meet, an arc begins so far before the corner; 0: through it",
        unit="m",
        at_least=0.0,
        at_most=100.0,
        settable=True,
    )
    path_tolerance: float = parameter(
        0.0,
        "joints farther from a joint trajectory end it; 0: however far",
        unit="rad",
        at_least=0.0,
        at_most=1e3,
        settable=True,
    )
    tool_path_tolerance: float = parameter(
        5e-3,
        "a tool farther beside its tool path gives it up; 0: however far",
        unit="m",
        at_least=0.0,
        at_most=1e3,
        settable=True,
    )
    trajectory_limits: str = parameter(
        "scale",
        "joint trajectories, and tool paths with times, that are faster than the joints' limits: "
        "scale, they take longer; refuse",
        choices=("scale", "refuse"),
        settable=True,
    )
    goal_tolerance: float = parameter(
        0.0,
        "joints this near to the end of a joint trajectory have reached it; 0: however far",
        unit="rad",
        at_least=0.0,
        at_most=1e3,
        settable=True,
    )
    goal_time: float = parameter(
        0.0,
        "how long after its time a joint trajectory may take to reach its end; 0: for ever",
        unit="s",
        at_least=0.0,
        at_most=1e6,
        settable=True,
    )
    may_end_moving: bool = parameter(
        False, "whether the last point of a joint trajectory may have a speed", settable=True
    )
    jog_command_in_type: str = parameter(
        "unitless",
        "jog commands; unitless: parts of the scales, from -1 to 1; speed_units: m/s and rad/s",
        choices=("unitless", "speed_units"),
        settable=True,
    )
    jog_scale_linear: float = parameter(
        0.4,
        "largest speed of a jogged tool",
        unit="m/s",
        at_least=0.0,
        at_most=100.0,
        settable=True,
    )
    jog_scale_rotational: float = parameter(
        0.8, "the same of its turning", unit="rad/s", at_least=0.0, at_most=100.0, settable=True
    )
    jog_scale_joint: float = parameter(
        0.5,
        "speed of a joint for a unitless command of 1",
        unit="rad/s",
        at_least=0.0,
        at_most=100.0,
        settable=True,
    )
    jog_incoming_command_timeout: float = parameter(
        0.1, "a jog command holds so long", unit="s", at_least=1e-3, at_most=3600.0, settable=True
    )
    jog_lower_singularity_threshold: float = parameter(
        17.0,
        "condition number of the Jacobian from which on a jog is slowed down",
        at_least=1.0,
        at_most=1e9,
        settable=True,
    )
    jog_hard_stop_singularity_threshold: float = parameter(
        30.0,
        "condition number at which a jog towards a singular pose ends",
        at_least=1.0,
        at_most=1e9,
        settable=True,
    )
    jog_joint_limit_margin: float = parameter(
        0.1,
        "so far from their position limits jogged joints stop",
        unit="rad",
        at_least=0.0,
        at_most=10.0,
        settable=True,
    )
    collisions: str = parameter(
        "auto",
        "whether the arm stops before its parts touch each other or an obstacle; auto: where the "
        "section `obstacles` is given",
        choices=("auto", "off", "stop"),
    )
    collision_margin: float = parameter(
        0.01, "so far apart parts and obstacles stay", unit="m", at_least=0.0, at_most=10.0
    )
    obstacles: tuple[Obstacle, ...] = ()
    """A floor and boxes in the world. In files it is the section `obstacles`."""
    drives: Drives = field(default_factory=dict)
    """Gears and friction of joints by name, for the feed-forward `full`; a joint that is not there
    has a rigid gear and no friction. In files it is the section `joints`."""
    where: str = field(default=NODE, compare=False)
    """Its name in refusals: its file, or the node."""

    @property
    def watches_collisions(self) -> bool:
        """Whether the arm stops before parts touch."""
        return self.collisions == "stop" or (self.collisions == "auto" and bool(self.obstacles))

    def beside(self, sections: Mapping[str, Any], where: str) -> MotionConfig:
        """Return the parameters with what stands in sections of their own.

        Raises:
            Refusal: a section with unknown keys or impossible values.
        """
        drives = drives_of(sections.get(SECTION, {}), where)
        obstacles = obstacles_of(sections.get(OBSTACLES, {}), where)
        return replace(self, where=where, drives=drives, obstacles=obstacles)

    def method_for(self, joints: int) -> str:
        """Return the method, way or paper, for an arm of so many joints."""
        return self.method if self.method != "auto" else "way"

    def feedforward_for(self, joints: int) -> str:
        """Return what is given beside joint angles: none, speed, torque (and speed), or full."""
        if self.feedforward != "auto":
            return self.feedforward
        if self.method_for(joints) == "paper":
            return "speed"
        return "full" if self.drives else "torque"


def load_motion_config(path: Path) -> MotionConfig:
    """Read a ROS parameter file of the node `motion_controller`.

    Raises:
        Refusal: a value that is not taken.
    """
    config, tables = load_parameters(path, NODE, MotionConfig, beside=SECTIONS)
    return config.beside(tables, path.name)
