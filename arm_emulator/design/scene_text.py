"""A scene and what lies beside it, written as files that people read and change."""

import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, fields

from arm_emulator.base.escape import escape_to_line
from arm_emulator.design.assumed_bodies import AssumedBody
from arm_emulator.design.choose_joints import JointChoice
from arm_emulator.design.rated_tool import RatedTool
from arm_emulator.design.sizing import Demand, Sized, round_figure
from arm_emulator.machine.parts.motors.motor import Motor
from arm_emulator.machine.parts.part import Part
from arm_emulator.machine.scene.joint import Joint
from arm_emulator.machine.schemes.known import SCHEMES
from arm_emulator.motion.model.drive_parameters import SECTION, DriveParameters
from arm_emulator.servo.servo_config import JointServo, ServoConfig

_PLAIN = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
# Words that YAML takes for something else than a text.
_NOT_TEXTS = ("true", "false", "yes", "no", "on", "off", "null", "y", "n")

STOP_DEPTH, STOP_DEPTH_OF_SLIDE = 0.05, 0.005  # rad, m
# Three times what the peak torque winds up a gear by (1/170 rad): limits of a description are those
# of software, set so that the arm does not hit its stops.
STOPS_BEYOND, STOPS_BEYOND_OF_SLIDE = 0.02, 0.002  # rad, m
STOP_DAMPING = 0.2  # of critical

UNITS_OF_TURN = ("N m", "rad/s", "kg m2", "rad")

_RULES = """\
# Made by `arm_emulator new` from {robot}. Links are the description's.
# Motors, gears, friction and encoders are not in it: all numbers under `motor`, `gear`, `friction`
# and `encoder` are guesses of the right size, by these rules (docs/tutorials/your_robot.md), from
# the peak torque and the speed beside each joint (motor and ratio of a published servo: its own;
# joints with sources, [1] and so on, are those of a data file, by --joint):
#   torque       where none is given: 1.3 times the weight and full speed in 0.25 s, with a tool
#   ratio        the joint's full speed at 3000 rpm of the motor
#   motor        rotor accelerates with 14 000 rad/s2, at least 1/20 of the heaviest link's inertia;
{motor}
#   gear         170 times the peak torque per rad, as strain wave gears; lowest resonance at least
#                12 Hz (30 Hz of a slide), damped to 5 % of critical
#   friction     10 % of the peak torque at full speed
#   encoder      13 bit on the motor; up to 15, where a count of wind-up would accelerate the link
#                by more than 5 % of its limit
#   end_stops    where the description has limits, 0.02 rad (2 mm) beyond them: 0.05 rad (5 mm)
#                deep at full speed with the most inertia, damped to 20 % of critical
# Replace what you know, then `arm_emulator tune {file} --write`.
"""


@dataclass(frozen=True)
class SceneSources:
    """Content of a new scene."""

    robot: str  # name of its file
    choice: JointChoice
    payload: float  # kg
    assumed: list[AssumedBody]
    trusted: list[str]  # links whose inertia is taken as it is
    tools: list[RatedTool]


def write_scene_text(
    name: str,
    sources: SceneSources,
    supply: float,
    demands: list[Demand],
    drives: list[Sized],
    servo_period: float,
) -> str:
    """Return the scene file, with where each number comes from."""
    choice = sources.choice
    kinds = {type(drive.joint.motor) for drive in drives if drive.joint.motor}
    rules = "\n".join(f"#                {rule}" for kind in kinds for rule in kind.rules)
    lines = [
        _RULES.format(robot=escape_to_line(sources.robot), file=f"{name}.yaml", motor=rules),
        f"name: {_quote_text(name)}",
        f"urdf: {_quote_text(f'urdf/{name}.urdf')}",
        f"tool: {_quote_text(choice.tool)}",
        "gravity: [0.0, 0.0, -9.81]  # m/s2, z up",
        f"supply_voltage: {supply:g}  # V, "
        + (
            "of the servos"
            if any(demand.sheet and demand.sheet.supply for demand in demands)
            else "guess"
        ),
    ]
    if sources.payload:
        lines.append(f"payload: {{mass: {sources.payload!r}}}  # kg, at the tool")
    if any(drive.notes["torque"].startswith("guess") for drive in drives):
        for tool in sources.tools:
            lines.append(f"# Torques that are guessed are for a tool of {tool.mass:.3g} kg at")
            lines.append(
                f"# {tool.link}, whose centre is half an edge off: a cube as dense as water."
            )
    if sources.assumed:
        lines += ["", "assumed:  # links whose bodies are of one density, from"]
        lines += [
            f"  - {_quote_text(body.link)}  # {escape_to_line(body.how)}"
            for body in sources.assumed
        ]
    if sources.trusted:
        lines += [
            "",
            "trusted_inertias:  # as in the description, though no body of its shape has them",
        ]
        lines += [f"  - {_quote_text(link)}" for link in sources.trusted]
    if choice.locked:
        lines += ["", "locked:"]
        for joint, locked in choice.locked.items():
            lines.append(
                f"  {_quote_text(joint)}: {locked.position!r}  # {escape_to_line(locked.reason)}"
            )
    lines += ["", "joints:"]
    for demand, drive in zip(demands, drives, strict=True):
        lines += _format_joint(demand, drive)
    lines += [
        "",
        f"integrator: {{scheme: {SCHEMES[0]}, dt: 5.0e-4}}  "
        "# `arm_emulator advise` finds the cheapest",
        f"servo_period: {servo_period!r}  # s",
    ]
    return "\n".join(lines) + "\n"


def _format_joint(demand: Demand, drive: Sized) -> list[str]:
    slide = demand.kind == "prismatic"
    torque, speed, inertia, angle = ("N", "m/s", "kg", "m") if slide else UNITS_OF_TURN
    ratio = "m of the slide per rad of the motor" if slide else "link turns per turn of the motor"
    joint = drive.joint
    assert joint.motor is not None and joint.encoder is not None
    smallest, largest = demand.inertia
    parts = drive.text or _format_parts(joint, (torque, speed, angle), ratio)
    return [
        f"  # {drive.peak_torque:.3g} {torque} ({drive.notes['torque']}),",
        f"  # {drive.speed:.3g} {speed} ({drive.notes['speed']});",
        f"  # feels {smallest:.3g} to {largest:.3g} {inertia}, weight up to "
        f"{demand.gravity_torque:.3g} {torque}",
        f"  {_quote_text(joint.name)}:",
        f"    start: {joint.start!r}  # {angle}",
        *parts,
        f"    encoder: {{counts_per_turn: {joint.encoder.counts_per_turn}}}",
        *(_format_end_stops(largest, drive.speed, slide) if demand.limited else ()),
    ]


def _format_parts(joint: Joint, units: tuple[str, str, str], ratio: str) -> tuple[str, ...]:
    """Return the sections of motor, gear and friction of a drive that was sized.

    Args:
        joint: the joint.
        units: of torque, speed and angle.
        ratio: what the gear's ratio is.
    """
    torque, _, angle = units
    gear = joint.gear
    assert joint.motor is not None
    return (
        *_format_motor(joint.motor, joint.decorators),
        "    gear:",
        f"      ratio: {gear.ratio!r}  # {ratio}",
        f"      stiffness: {gear.stiffness!r}  # {torque}/{angle}",
        f"      damping: {gear.damping!r}  # {torque} s/{angle}",
        f"    friction: {{viscous: {joint.friction.viscous!r}}}  # {torque} s/{angle}",
    )


def _format_motor(motor: Motor, decorators: tuple[Part, ...]) -> list[str]:
    """Return the section of a motor and of what is around it."""
    kind = [] if motor.is_default else [f"      kind: {motor.kind}"]
    lines = ["    motor:", *kind, *_format_numbers(motor, "      ")]
    for decorator in decorators:
        lines += [
            f"      {decorator.section.rpartition('.')[2]}:",
            *_format_numbers(decorator, "        "),
        ]
    return lines


def _format_numbers(part: Part, indent: str) -> list[str]:
    """Return the numbers of a part that are not what an absent key gives, a line each."""
    values = {key: (getattr(part, key), number) for key, number in part.list_numbers().items()}
    return [
        f"{indent}{key}: {value!r}  # {number.unit}"
        for key, (value, number) in values.items()
        if value is not None and value != number.default
    ]


def _format_end_stops(inertia: float, speed: float, slide: bool) -> list[str]:
    """Return stops that an arm at full speed presses in by their depth."""
    stiffness = inertia * (speed / (STOP_DEPTH_OF_SLIDE if slide else STOP_DEPTH)) ** 2
    damping = 2.0 * STOP_DAMPING * math.sqrt(stiffness * inertia)
    beyond = STOPS_BEYOND_OF_SLIDE if slide else STOPS_BEYOND
    values = f"stiffness: {round_figure(stiffness)!r}, damping: {round_figure(damping)!r}"
    unit = "m, N/m, N s/m" if slide else "rad, N m/rad, N m s/rad"
    return [f"    end_stops: {{at: limits, beyond: {beyond!r}, {values}}}  # {unit}"]


def write_servo_text(config: ServoConfig, heading: str) -> str:
    """Return the ROS parameter file of a servo; `heading`: comment lines at the top."""
    lines = [
        *(f"# {line}" for line in heading.splitlines()),
        "/**/servo:",
        "  ros__parameters:",
        f"    period: {config.period!r}  # s, servo period",
        f"    motion_period: {config.motion_period!r}  # s, of the joint targets in lock-step",
        f"    hold_after: {config.hold_after!r}  # s of silence, then the joints are held",
        f"    cut_after: {config.cut_after!r}  # s of silence, then the power is cut",
        f"    supply_voltage: {config.supply_voltage!r}  # V",
        f"    joint_names: [{', '.join(_quote_text(name) for name in config.joint_names)}]",
    ]
    lines += _format_by_joint("joints", {joint.name: joint for joint in config.joints})
    return "\n".join(lines) + "\n"


def _format_by_joint(section: str, joints: Mapping[str, JointServo | DriveParameters]) -> list[str]:
    """Return a section of a ROS parameter file with the numbers of joints that are no defaults."""
    dotted = any("." in name for name in joints)  # ROS's reader loses its way
    lines = [] if dotted else [f"    {section}:"]
    for name, joint in joints.items():
        if not dotted:
            lines.append(f"      {_quote_text(name)}:")
        for field in fields(joint):
            value = getattr(joint, field.name)
            if field.name != "name" and value != field.default:
                path = _quote_text(f"{section}.{name}.{field.name}")
                key = f"    {path}" if dotted else f"        {field.name}"
                lines.append(f"{key}: {value!r}")
    return lines


def write_motion_text(
    parameters: Mapping[str, object],
    comments: Mapping[str, str],
    drives: Mapping[str, DriveParameters],
) -> str:
    """Return the ROS parameter file of a motion controller."""
    lines = ["/**/motion_controller:", "  ros__parameters:"]
    for key, value in parameters.items():
        text = _quote_text(value) if isinstance(value, str) else repr(value)
        comment = f"  # {comments[key]}" if key in comments else ""
        lines.append(f"    {key}: {text}{comment}")
    specified = {name: drive for name, drive in drives.items() if drive != DriveParameters()}
    if specified:
        about = "for feed-forward, as in the scene; seen at the links, in N m, rad, s (a slide: m)"
        lines += [f"    # {about}", *_format_by_joint(SECTION, specified)]
    return "\n".join(lines) + "\n"


def write_demo_text(displacement: list[float], settle: float, instructions: int) -> str:
    """Return what the demo does."""
    return (
        f"displacement: {displacement!r}  # m, of the tool in the world\n"
        f"settle: {settle!r}  # s of logical time: the arm takes its weight up first\n"
        f"instructions: {instructions}  # motion periods that are watched\n"
    )


def _quote_text(value: str) -> str:
    """Return a text as YAML takes it for one."""
    if _PLAIN.fullmatch(value) and value.lower() not in _NOT_TEXTS:
        return value
    return json.dumps(value, ensure_ascii=False)
