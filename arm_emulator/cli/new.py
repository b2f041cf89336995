"""`arm_emulator new`: from a robot description to a scene with servo, motion control and a demo."""

from __future__ import annotations

import hashlib
import re
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import yaml
from rich.console import Console

from arm_emulator.base.config_files import check_own
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.urdf_text import parse_urdf
from arm_emulator.design.choose_joints import Choice, choose_joints
from arm_emulator.design.joint_gains import design
from arm_emulator.design.robot_file import robot_text
from arm_emulator.design.robot_limits import move_meshes, read_limits, write_limits
from arm_emulator.design.scene_text import demo_text, motion_text, scene_text, servo_text
from arm_emulator.design.sizing import Demand, Sized, rounded, size
from arm_emulator.design.survey import survey
from arm_emulator.design.tuned import data_of, data_sheet
from arm_emulator.machine.scene import Scene, load_scene
from arm_emulator.motion.kinematics import Kinematics
from arm_emulator.servo.servo_config import JointServo, ServoConfig

SERVO_PERIOD = 1e-3  # s
PLACES = ("{}.yaml", "servo/{}.yaml", "motion/{}.yaml", "demo/{}.yaml", "urdf/{}.urdf")
HOLD_AFTER, CUT_AFTER = 0.2, 2.0  # s
MOTION_PERIOD = 0.01  # s
SETTLE, WATCHED = 1.0, 3.0  # s, of the demo
SERVO_HEADING = """\
Servo of {name}: data sheets as in {name}.yaml; gains as in docs/how_to/gains.md."""
MOTION_COMMENTS = {
    "tool": "link that is the tool",
    "period": "s, between joint targets",
    "method": "within all joint limits, for any number of joints",
    "velocity_limit": "rad/s or m/s; what counts are the limits in the robot description",
    "acceleration_limit": "rad/s2 or m/s2, likewise",
}


@dataclass(frozen=True)
class NewScene:
    """What was written, and how it came about."""

    file: Path
    choice: Choice
    drives: list[Sized]


def new(
    robot: Path,
    out: Path | None,
    tool: str | None,
    joints: Sequence[str] | None,
    arguments: Mapping[str, str],
    *,
    force: bool,
) -> int:
    """Write a scene for a robot, and report what was taken from it and what was guessed.

    Raises:
        Refusal: see `write_new`.
    """
    console = Console(highlight=False, markup=False, soft_wrap=True)
    written = write_new(robot, out, tool, joints, arguments, force=force)
    choice = written.choice
    console.print(f"moves    {', '.join(choice.joints)}")
    for guess in choice.guesses:
        console.print(f"chosen   {guess}")
    for name, held in choice.held.items():
        console.print(f"held     {name} at {held.position:g}: {held.reason}")
    for drive in written.drives:
        for what, value in (("torque", drive.peak_torque), ("speed", drive.speed)):
            if (note := drive.notes[what]) != "URDF":
                console.print(f"guessed  {drive.joint.name}: {what} {value:.3g}: {note}")
    console.print(
        "guessed  all motors, gears, friction, encoders: rules are in the scene's heading"
    )
    console.print(f"written  {written.file}, and servo/, motion/, demo/ beside it")
    console.print(f"now try  python -m arm_emulator demo {written.file}")
    return 0


def scene_of_robot(robot: Path, out: Path) -> Path:
    """Return the scene of a robot below `out`: one made of this very description, else a new one.

    Its folder is named after the robot, and the place and content of its description, so that
    neither another robot's file of the same name nor an older state of this one is taken for it.

    Raises:
        Refusal: see `write_new`.
    """
    description = f"{robot.resolve().parent}\n{robot_text(robot, {})}"
    digest = hashlib.sha256(description.encode(errors="surrogateescape")).hexdigest()[:8]
    folder = out / f"{_name(robot)}_{digest}"
    file = folder / f"{_name(robot)}.yaml"
    if file.exists():
        print(f"taken    {file}, which was there (remove {folder} to begin anew)")
        return file
    new(robot, folder, None, None, {}, force=False)
    return file


def write_new(
    robot: Path,
    out: Path | None,
    tool: str | None = None,
    joints: Sequence[str] | None = None,
    arguments: Mapping[str, str] | None = None,
    *,
    force: bool = False,
) -> NewScene:
    """Write a scene for a robot.

    Args:
        robot: URDF or xacro source.
        out: folder to write to; None: one with the robot's name, here.
        tool: link that is the tool; None: chosen.
        joints: that move; None: chosen.
        arguments: of the xacro source.
        force: whether to write over files that are there.

    Raises:
        Refusal: a robot that cannot be emulated, or files that exist already or are shipped.
    """
    text = robot_text(robot, arguments or {})
    description = parse_urdf(text, robot.name)
    choice = choose_joints(description, robot.name, tool, joints)
    name = _name(robot)
    folder = Path(name) if out is None else out
    file = folder / f"{name}.yaml"
    for place in PLACES:
        there = folder / place.format(name)
        check_own("new", there)
        if there.exists() and not force:
            valid = "--force writes over it, --out names another folder"
            raise Refusal("new", f"file {there}", "not be there yet", "one", valid)
    drives, texts = _texts(robot, _links_alone(text, robot.name, choice), description, choice)
    files = {folder / place.format(name): content for place, content in texts.items()}
    try:
        for one, content in files.items():
            one.parent.mkdir(parents=True, exist_ok=True)
            one.write_text(content, encoding="utf-8")
    except OSError as error:
        raise Refusal("new", f"folder {folder}", "be writable", error.strerror) from None
    return NewScene(file, choice, drives)


def _name(robot: Path) -> str:
    """Return the name of a robot's scene: that of its file, as it fits a file and a folder."""
    stem = robot.name.removesuffix(robot.suffix).removesuffix(".urdf")
    return re.sub(r"\W+", "_", stem).strip("_") or "arm"


def _links_alone(text: str, where: str, choice: Choice) -> Scene:
    """Return the robot as a machine without motors; `where`: what to call it in refusals."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / where).write_text(text, encoding="utf-8")
        scene = {
            "name": "links",
            "urdf": where,
            "tool": choice.tool,
            "gravity": [0.0, 0.0, -9.81],
            "supply_voltage": 1.0,
            "locked": {name: held.position for name, held in choice.held.items()},
            "joints": {name: {} for name in choice.joints},
            "integrator": {"dt": SERVO_PERIOD},
            "servo_period": SERVO_PERIOD,
        }
        file = Path(folder) / "robot.yaml"
        file.write_text(yaml.safe_dump(scene, allow_unicode=True), encoding="utf-8")
        return load_scene(file)


def _texts(
    robot: Path, links: Scene, description: ET.Element, choice: Choice
) -> tuple[list[Sized], dict[str, str]]:
    """Return the drives, and the files to write by their places; `description` gets limits."""
    name = _name(robot)
    kinematics = Kinematics(links.urdf, links.joint_names, links.tool)
    seen = survey(links, kinematics)
    limits = read_limits(description)
    demands = [
        Demand(
            name=joint.name,
            kind=joint.kind,
            start=float(seen.start[j]),
            inertia=(float(seen.inertia[j, 0]), float(seen.inertia[j, 1])),
            coupling=tuple(seen.coupling[j].tolist()),
            gravity_torque=float(seen.gravity_torque[j]),
            effort=limits[joint.name]["effort"],
            velocity=limits[joint.name]["velocity"],
        )
        for j, joint in enumerate(links.chain.joints)
    ]
    supply, drives = size(demands)
    servo = ServoConfig(
        period=SERVO_PERIOD,
        motion_period=MOTION_PERIOD,
        hold_after=HOLD_AFTER,
        cut_after=CUT_AFTER,
        supply_voltage=supply,
        joints=tuple(_servo_of(*pair, supply) for pair in zip(demands, drives, strict=True)),
    )
    motion = {
        "tool": choice.tool,
        "period": MOTION_PERIOD,
        "method": "qp",
        "velocity_limit": max(drive.speed for drive in drives),
        "acceleration_limit": max(drive.acceleration for drive in drives),
    }
    # The robot description is where the motion controller has the joints' limits from.
    write_limits(description, {drive.joint.name: drive for drive in drives})
    move_meshes(description, robot.parent)
    contents = (
        scene_text(name, robot.name, choice, supply, demands, drives, SERVO_PERIOD),
        servo_text(servo, SERVO_HEADING.format(name=name)),
        motion_text(motion, MOTION_COMMENTS),
        demo_text(seen.displacement.tolist(), SETTLE, round(WATCHED / MOTION_PERIOD)),
        ET.tostring(description, encoding="unicode") + "\n",
    )
    return drives, dict(zip(PLACES, contents, strict=True))


def _servo_of(demand: Demand, drive: Sized, supply: float) -> JointServo:
    """Return the servo of a joint: the data sheet's numbers, and gains that follow from them."""
    friction, sheet = drive.joint.friction.viscous, data_sheet(drive.joint, supply)
    limit = sheet["current_limit"]
    gains = design(*data_of(drive.joint), demand.inertia, SERVO_PERIOD, friction, supply, limit)
    return JointServo(
        name=demand.name,
        **sheet,
        velocity_limit=drive.speed,
        position_gain=rounded(gains.position_gain),
        velocity_gain=rounded(gains.velocity_gain),
        integral_time=rounded(gains.integral_time),
        observer_bandwidth=rounded(gains.observer_bandwidth),
        link_inertia=rounded(gains.link_inertia),
    )
