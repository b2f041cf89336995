"""Parameters of the motion controller."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Self

from arm_emulator.base.saved_objects import SharedObject
from arm_emulator.base.validation.parameters import load_parameters, parameter
from arm_emulator.motion.model.drive_parameters import SECTION, Drives, read_drives
from arm_emulator.motion.model.input_shaper import (
    KINDS,
    MODES,
    InputShaper,
    ShapedMode,
    check_shaper,
    read_modes,
)
from arm_emulator.motion.model.obstacles import OBSTACLES, Obstacle, read_obstacles

NODE = "motion_controller"
SECTIONS = SECTION, OBSTACLES, MODES


@dataclass(frozen=True)
class MotionConfig(SharedObject):
    """Parameters of the motion controller."""

    tool: str = parameter("tool", "link of the robot description that is the tool")
    calibration: str = parameter(
        "",
        "file of the machine's calibration, which corrects the robot description; a relative name: "
        "beside the parameter file; empty: the description holds",
    )
    period: float = parameter(
        0.05, "logical time between joint targets", unit="s", ends=(1e-4, 10.0)
    )
    method: str = parameter(
        "way",
        "control law: way, motions planned before they begin, within all limits; paper, eq. (6) of "
        "the paper",
        choices=("way", "paper"),
    )
    weight: float = parameter(
        0.5,
        "paper: w of eq. (6), share of the tool's error that one instruction removes",
        ends=(1e-6, 1.0),
        settable=True,
    )
    task: str = parameter(
        "auto",
        "controlled part of the pose: position (3 rows), pose (6); auto: pose from 6 joints on",
        choices=("auto", "position", "pose"),
    )
    step_limit: float = parameter(
        0.2,
        "paper: largest joint step per instruction; longer steps are scaled down",
        unit="rad",
        ends=(1e-6, 100.0),
        settable=True,
    )
    singular_below: float = parameter(
        0.02,
        "paper: singular values of the Jacobian below this are damped",
        ends=(1e-9, 1.0),
        settable=True,
    )
    velocity_limit: float = parameter(
        3.0,
        "largest joint speed, in addition to the limits of the robot description",
        unit="rad/s",
        ends=(1e-6, 1e3),
        settable=True,
    )
    acceleration_limit: float = parameter(
        10.0,
        "largest joint acceleration, in addition to those of the robot description",
        unit="rad/s2",
        ends=(1e-6, 1e5),
        settable=True,
    )
    jerk_limit: float = parameter(
        0.0,
        "largest joint jerk; 0: the acceleration reaches its limit in 50 ms",
        unit="rad/s3",
        ends=(0.0, 1e8),
        settable=True,
    )
    feedforward: str = parameter(
        "auto",
        "derivatives sent with the joint angles: none; speed; torque, speed and the torque of the "
        "links' gravity and motion; full, the same for elastic gears and friction by the section "
        "joints; auto: speed with the method paper, else full with that section, else torque",
        choices=("auto", "none", "speed", "torque", "full"),
    )
    gravity_x: float = parameter(
        0.0, "gravity in the world, that of the scene", unit="m/s2", ends=(-1e3, 1e3)
    )
    gravity_y: float = parameter(
        0.0, "gravity in the world, that of the scene", unit="m/s2", ends=(-1e3, 1e3)
    )
    gravity_z: float = parameter(
        -9.81, "gravity in the world, that of the scene", unit="m/s2", ends=(-1e3, 1e3)
    )
    reached_within: float = parameter(
        1e-3,
        "largest distance of a tool that has reached its target",
        unit="m",
        ends=(1e-9, 1e3),
        settable=True,
    )
    reached_within_angle: float = parameter(
        5e-3, "the same for its orientation", unit="rad", ends=(1e-9, 10.0), settable=True
    )
    tool_speed: float = parameter(
        0.25, "speed of the tool along paths", unit="m/s", ends=(1e-6, 100.0), settable=True
    )
    tool_turn_speed: float = parameter(
        1.0,
        "angular speed of the tool along paths",
        unit="rad/s",
        ends=(1e-6, 100.0),
        settable=True,
    )
    tool_acceleration: float = parameter(
        1.0,
        "acceleration of the tool along and across paths",
        unit="m/s2",
        ends=(1e-6, 1e4),
        settable=True,
    )
    tool_jerk: float = parameter(
        10.0, "jerk of the tool along paths", unit="m/s3", ends=(1e-6, 1e6), settable=True
    )
    path_arcs: bool = parameter(
        False,
        "whether arcs of circles join each three poses of a path (0 1 2, 2 3 4, ...); otherwise "
        "lines join each two",
        settable=True,
    )
    path_blend: float = parameter(
        0.0,
        "distance from a corner of a path at which an arc begins to round it; 0: no arc",
        unit="m",
        ends=(0.0, 100.0),
        settable=True,
    )
    path_tolerance: float = parameter(
        0.0,
        "deviation of a joint that aborts a joint trajectory; 0: none does",
        unit="rad",
        ends=(0.0, 1e3),
        settable=True,
    )
    tool_path_tolerance: float = parameter(
        5e-3,
        "deviation of the measured tool that aborts a tool path; 0: none does",
        unit="m",
        ends=(0.0, 1e3),
        settable=True,
    )
    trajectory_limits: str = parameter(
        "scale",
        "treatment of joint trajectories and tool paths with times that exceed the joint limits: "
        "scale, they take longer; refuse",
        choices=("scale", "refuse"),
        settable=True,
    )
    goal_tolerance: float = parameter(
        0.0,
        "largest distance of joints that have reached the end of a joint trajectory; 0: any",
        unit="rad",
        ends=(0.0, 1e3),
        settable=True,
    )
    goal_time: float = parameter(
        0.0,
        "time after its end that a joint trajectory may take to reach it; 0: any",
        unit="s",
        ends=(0.0, 1e6),
        settable=True,
    )
    may_end_moving: bool = parameter(
        False, "whether the last point of a joint trajectory may have a speed", settable=True
    )
    shaper: str = parameter(
        "none",
        "input shaper of the joint targets, for the modes of the section modes: none, zv, zvd; a "
        "motion ends by its delay later; taken over at rest",
        choices=KINDS,
        settable=True,
    )
    jog_command_in_type: str = parameter(
        "unitless",
        "unit of jog commands: unitless, shares of the scales; speed_units, m/s and rad/s",
        choices=("unitless", "speed_units"),
        settable=True,
    )
    jog_scale_linear: float = parameter(
        0.4, "largest speed of a jogged tool", unit="m/s", ends=(0.0, 100.0), settable=True
    )
    jog_scale_rotational: float = parameter(
        0.8,
        "largest angular speed of a jogged tool",
        unit="rad/s",
        ends=(0.0, 100.0),
        settable=True,
    )
    jog_scale_joint: float = parameter(
        0.5,
        "speed of a joint for a unitless command of 1",
        unit="rad/s",
        ends=(0.0, 100.0),
        settable=True,
    )
    jog_incoming_command_timeout: float = parameter(
        0.1, "time for which a jog command holds", unit="s", ends=(1e-3, 3600.0), settable=True
    )
    jog_lower_singularity_threshold: float = parameter(
        17.0,
        "condition number of the Jacobian above which a jog slows down",
        ends=(1.0, 1e9),
        settable=True,
    )
    jog_hard_stop_singularity_threshold: float = parameter(
        30.0,
        "condition number at which a jog towards a singular pose stops",
        ends=(1.0, 1e9),
        settable=True,
    )
    jog_joint_limit_margin: float = parameter(
        0.1,
        "distance from their position limits at which jogged joints stop, a tenth of their range "
        "at most",
        unit="rad",
        ends=(0.0, 10.0),
        settable=True,
    )
    collisions: str = parameter(
        "auto",
        "stop: the arm stops before its parts touch each other or an obstacle; auto: stop with a "
        "section obstacles, else off",
        choices=("auto", "off", "stop"),
    )
    collision_margin: float = parameter(
        0.01, "smallest distance between parts and obstacles", unit="m", ends=(0.0, 10.0)
    )
    obstacles: tuple[Obstacle, ...] = ()
    """A floor and boxes in the world. In files it is the section `obstacles`."""
    drives: Drives = field(default_factory=dict)
    """Gears and friction of joints by name, for the feed-forward `full`; a joint that is not there
    has a rigid gear and no friction. In files it is the section `joints`."""
    modes: tuple[ShapedMode, ...] = ()
    """Modes that the shaper suppresses. In files it is the section `modes`."""
    where: str = field(default=NODE, compare=False)
    """Name of the parameters in refusals: their file, or the node."""

    @property
    def has_collision_stop(self) -> bool:
        """Whether the arm stops before parts touch."""
        return self.collisions == "stop" or (self.collisions == "auto" and bool(self.obstacles))

    def design_shaper(self) -> InputShaper:
        """Return the input shaper.

        Raises:
            Refusal: one that is not taken, see `check_shaper`.
        """
        check_shaper(self.shaper, self.modes, self.method, self.where)
        return InputShaper.compute_shaper(self.shaper, self.modes)

    def add_sections(self, sections: Mapping[str, Any], where: str) -> Self:
        """Return the parameters with those of the sections."""
        drives = read_drives(sections.get(SECTION, {}), where)
        obstacles = read_obstacles(sections.get(OBSTACLES, {}), where)
        modes = read_modes(sections.get(MODES, {}), where)
        check_shaper(self.shaper, modes, self.method, where)
        return replace(self, where=where, drives=drives, obstacles=obstacles, modes=modes)

    @property
    def gives(self) -> str:
        """Feed-forward of joint angles: none, speed, torque (and speed), or full."""
        if self.feedforward != "auto":
            return self.feedforward
        if self.method == "paper":
            return "speed"
        return "full" if self.drives else "torque"


def load_motion_config(path: Path) -> MotionConfig:
    """Read a ROS parameter file of the node `motion_controller`."""
    config, tables = load_parameters(path, NODE, MotionConfig, beside=SECTIONS)
    if config.calibration:
        config = replace(config, calibration=str(path.parent / config.calibration))
    return config.add_sections(tables, path.name)
