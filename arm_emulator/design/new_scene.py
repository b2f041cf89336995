"""A new scene with servo, motion control and a demo, from a robot description.

Each section of a scene is computed from the sections before it, hence the length.
"""

import re
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml

from arm_emulator.analysis.holding import Overload, find_overloads
from arm_emulator.base.arrays import Array
from arm_emulator.base.io.config_files import check_own
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.urdf.urdf_text import UNLIMITED, parse_urdf
from arm_emulator.base.validation.number import list_numbers
from arm_emulator.design.assumed_bodies import DENSITY, AssumedBody, assume_bodies, has_shape
from arm_emulator.design.choose_joints import JointChoice, choose_joints
from arm_emulator.design.data_sheets import JointSheet, find_published
from arm_emulator.design.inertia_check import Doubt, check_inertias, list_doubtful_inertias
from arm_emulator.design.joint_data import choose_joint_data
from arm_emulator.design.mesh_file import move_meshes
from arm_emulator.design.rated_tool import RatedTool, add_tools, list_rated_tools
from arm_emulator.design.robot_file import (
    forget_impossible,
    read_limits,
    read_robot_text,
    write_limits,
)
from arm_emulator.design.scene_text import (
    SceneSources,
    write_demo_text,
    write_motion_text,
    write_scene_text,
    write_servo_text,
)
from arm_emulator.design.sizing import Demand, Sized, choose_full_speed, size_drives
from arm_emulator.design.survey import Survey, inspect_arm
from arm_emulator.design.tuned import make_data_sheet, tune_servo
from arm_emulator.machine.parts.motors.motor import Motor
from arm_emulator.machine.scene.joint import Joint
from arm_emulator.machine.scene.known_parts import SIZED_MOTORS
from arm_emulator.machine.scene.scene import Scene, load_scene
from arm_emulator.machine.scene.urdf_bodies import LARGEST_MASS
from arm_emulator.machine.scene.urdf_chain import MovedBody, collect_moved_bodies
from arm_emulator.motion.collision.collisions import Collisions
from arm_emulator.motion.model.config import MotionConfig
from arm_emulator.motion.model.drive_parameters import DriveParameters
from arm_emulator.motion.model.kinematics import Kinematics
from arm_emulator.servo.servo_config import JointServo, ServoConfig

SERVO_PERIOD = 1e-3  # s
MAX_DENSITY = 3e4  # kg/m3: denser than any material
PLACES = ("{}.yaml", "servo/{}.yaml", "motion/{}.yaml", "demo/{}.yaml", "urdf/{}.urdf")
HOLD_AFTER, CUT_AFTER = 0.2, 2.0  # s
MOTION_PERIOD = 0.01  # s
SETTLE, OBSERVED = 1.0, 3.0  # s, of the demo
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
    """The files written, and the reasons for their numbers."""

    file: Path
    choice: JointChoice
    drives: list[Sized]
    overloads: list[Overload]
    assumed: list[AssumedBody]
    tools: list[RatedTool]
    """For which torques that are guessed are sized; the first is at the arm's tool."""


def write_new(
    robot: Path,
    out: Path | None,
    tool: str | None = None,
    joints: Sequence[str] | None = None,
    arguments: Mapping[str, str] | None = None,
    *,
    payload: float | None = None,
    density: float = DENSITY,
    motor: str | None = None,
    tree: bool = False,
    force: bool = False,
    replace_inertias: bool = False,
    trust_inertias: bool = False,
    joint_data: Sequence[str] = (),
) -> NewScene:
    """Write a scene for a robot.

    Args:
        robot: URDF or xacro source.
        out: folder to write to; None: one with the robot's name, here.
        tool: link of the tool; None: chosen.
        joints: moving joints; None: chosen.
        arguments: of the xacro source.
        payload: mass at the tool, for which the drives are sized [kg]; None: none at the tool,
            and drives for a tool by the arm's mass.
        density: density of bodies without inertia in the description [kg/m3].
        motor: kind of all motors; None: that of a scene that gives none.
        tree: whether the joints beside the arm move, too.
        force: whether to overwrite existing files.
        replace_inertias: whether impossible and doubtful inertias are computed from shapes.
        trust_inertias: whether they are taken as they are; the scene names their links.
        joint_data: joints that exist, NAME for all or JOINT=NAME for one, see `joint_data.py`.

    Raises:
        Refusal: a robot that cannot be emulated, a joint without a data file, or files that
            exist already or are shipped.
    """
    if payload is not None and not 0.0 <= payload <= LARGEST_MASS:
        raise Refusal("new", "--payload", f"be from 0 to {LARGEST_MASS:g} kg", payload)
    kinds = {kind.kind: kind for kind in SIZED_MOTORS}
    kind = SIZED_MOTORS[0] if motor is None else kinds.get(motor)
    if kind is None:
        raise Refusal(
            "new", "--motor", "be a kind of motor that our servo drives", motor, ", ".join(kinds)
        )
    text = read_robot_text(robot, arguments or {})
    description = parse_urdf(text, robot.name)
    choice = choose_joints(description, robot.name, tool, joints, tree=tree)
    sheets = {
        joint: JointSheet.load_sheet(data)
        for joint, data in choose_joint_data(joint_data, choice.joints).items()
    }
    if motor is not None and sheets.keys() >= set(choice.joints):
        rule = "be left out where --joint names the motor of each joint"
        raise Refusal("new", "--motor", rule, motor)
    mended = forget_impossible(description)
    assumed = _assume_missing_bodies(description, robot, choice, density)
    if replace_inertias and trust_inertias:
        raise Refusal("new", "--trust-inertias", "stand without --replace-inertias", "both")
    doubtful = _list_doubtful(description, robot, choice, assumed)
    if replace_inertias and doubtful:
        assumed += _replace_inertias(description, robot, choice, density, doubtful)
        doubtful = _list_doubtful(description, robot, choice, assumed)
    if not trust_inertias:
        check_inertias(doubtful, robot.name)
    trusted = [*dict.fromkeys(doubt.link for doubt in doubtful)] if trust_inertias else []
    if mended or assumed:
        text = ET.tostring(description, encoding="unicode")
    name = choose_scene_name(robot)
    folder = Path(name) if out is None else out
    file = folder / f"{name}.yaml"
    for place in PLACES:
        there = folder / place.format(name)
        check_own("new", there)
        if there.exists() and not force:
            valid = "--force writes over it, --out names another folder"
            raise Refusal("new", f"file {there}", "not be there yet", "one", valid)
    bodies = assumed, trusted
    drives, tools, texts = _make_texts(
        robot, text, description, choice, payload, bodies, kind, sheets
    )
    with tempfile.TemporaryDirectory() as trial:
        scene_file = Path(trial) / f"{name}.yaml"
        _write_files(Path(trial), {place.format(name): content for place, content in texts.items()})
        scene = load_scene(scene_file)
        servo = tune_servo(scene_file, _make_servo(scene, drives))
    texts[PLACES[1]] = write_servo_text(servo, SERVO_HEADING.format(name=name))
    _write_files(folder, {place.format(name): content for place, content in texts.items()})
    return NewScene(file, choice, drives, find_overloads(scene), assumed, tools)


def _assume_missing_bodies(
    description: ET.Element, robot: Path, choice: JointChoice, density: float
) -> list[AssumedBody]:
    """Add a body in the description to each moving link without one; return these links."""
    if not 0.0 < density <= MAX_DENSITY:
        raise Refusal("new", "--density", f"be > 0 and at most {MAX_DENSITY:g} kg/m3", density)
    shapes = {link.get("name", ""): has_shape(link) for link in description.findall("link")}
    tips: dict[str, Array] = {}
    for body in _find_moved(description, robot, choice):
        if body.fault is not None:
            lacking = [link for link in body.links if shapes[link]] or list(body.links[:1])
            tips |= {link: body.tip for link in lacking}
    return assume_bodies(description, robot.parent, tips, density)


def _list_doubtful(
    description: ET.Element, robot: Path, choice: JointChoice, assumed: list[AssumedBody]
) -> list[Doubt]:
    """Return what is wrong with inertias that the description gives."""
    text = ET.tostring(description, encoding="unicode")
    chain = _load_links(text, robot.name, choice).chain
    trusted = [body.link for body in assumed]
    return list_doubtful_inertias(description, robot.name, robot.parent, chain, trusted)


def _replace_inertias(
    description: ET.Element, robot: Path, choice: JointChoice, density: float, doubtful: list[Doubt]
) -> list[AssumedBody]:
    """Give links with doubtful inertias those of their shapes; return these links.

    A mass that is in doubt goes, too, and so does an inertia without a mass.
    """
    of_mass = {doubt.link for doubt in doubtful if doubt.is_of_mass}
    tips: dict[str, Array] = {}
    for body in _find_moved(description, robot, choice):
        for link in body.links:
            if any(doubt.link == link for doubt in doubtful):
                tips[link] = body.tip
    for element in description.findall("link"):
        name = element.get("name", "")
        for inertial in element.findall("inertial") if name in tips else ():
            mass = inertial.find("mass")
            if mass is not None and name in of_mass:
                mass.set("value", "0")
            elif mass is None or (float(mass.get("value", "0")) <= 0.0 and not has_shape(element)):
                element.remove(inertial)
                tips.pop(name, None)
    return assume_bodies(description, robot.parent, tips, density)


def _find_moved(description: ET.Element, robot: Path, choice: JointChoice) -> list[MovedBody]:
    """Return what each moving joint of a choice moves."""
    locked = {name: joint.position for name, joint in choice.locked.items()}
    return collect_moved_bodies(description, robot.name, "new", locked=locked, tool=choice.tool)


def _write_files(folder: Path, contents: Mapping[str, str]) -> None:
    """Write files below a folder."""
    try:
        for place, content in contents.items():
            file = folder / place
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(content, encoding="utf-8")
    except OSError as error:
        raise Refusal("new", f"folder {folder}", "be writable", error.strerror) from None


def choose_scene_name(robot: Path) -> str:
    """Return the name of a robot's scene: that of its file, as it fits a file and a folder."""
    stem = robot.name.removesuffix(robot.suffix).removesuffix(".urdf")
    return re.sub(r"\W+", "_", stem).strip("_") or "arm"


def _load_links(text: str, where: str, choice: JointChoice, payload: float = 0.0) -> Scene:
    """Return the robot as a machine without motors; `where`: its name in refusals."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / where).write_text(text, encoding="utf-8")
        scene = {
            "name": "links",
            "urdf": where,
            "tool": choice.tool,
            "gravity": [0.0, 0.0, -9.81],
            "supply_voltage": 1.0,
            "locked": {name: joint.position for name, joint in choice.locked.items()},
            "joints": {name: {} for name in choice.joints},
            "integrator": {"dt": SERVO_PERIOD},
            "servo_period": SERVO_PERIOD,
            "payload": {"mass": payload},
        }
        file = Path(folder) / "robot.yaml"
        file.write_text(yaml.safe_dump(scene, allow_unicode=True), encoding="utf-8")
        return load_scene(file)


def _make_texts(
    robot: Path,
    text: str,
    description: ET.Element,
    choice: JointChoice,
    payload: float | None,
    bodies: tuple[list[AssumedBody], list[str]],
    kind: type[Motor],
    sheet_by_joint: Mapping[str, JointSheet],
) -> tuple[list[Sized], list[RatedTool], dict[str, str]]:
    """Return the drives, the tools that they are sized for, and the files to write by their places.

    The `description` gets limits; `bodies` are links whose body is assumed, and those whose inertia
    is trusted; `sheet_by_joint` has the drives of joints that exist.

    The servo is not among them: its gains are those of the scene as it is written.
    """
    name = choose_scene_name(robot)
    move_meshes(description, robot.parent)
    links = _load_links(ET.tostring(description, encoding="unicode"), robot.name, choice)
    kinematics = Kinematics(links.urdf, links.joint_names, links.tool)
    shapes = _read_own_shapes(links.urdf, links.joint_names)
    bare = inspect_arm(links, kinematics, shapes)
    surveyed = bare
    if payload:
        surveyed = inspect_arm(_load_links(text, robot.name, choice, payload), kinematics)
    limits = read_limits(description)
    count = len(links.joints)
    of_arm = find_published(description.get("name", ""), count) or (None,) * count
    for joint in links.chain.joints:
        if joint.name in sheet_by_joint and joint.kind != "revolute":
            rule = "be of a joint that turns"
            raise Refusal("new", "--joint", rule, f"{joint.name}, a {joint.kind} one")
    sheets = tuple(
        sheet_by_joint.get(joint.name, sheet)
        for joint, sheet in zip(links.chain.joints, of_arm, strict=True)
    )
    speeds = {
        joint.name: choose_full_speed(joint.kind, limits[joint.name]["velocity"], sheet)[0]
        for joint, sheet in zip(links.chain.joints, sheets, strict=True)
    }
    tools = list_rated_tools(links.chain, choice.tool, speeds, payload)
    loaded = add_tools(parse_urdf(text, robot.name), tools)
    rated = inspect_arm(
        _load_links(ET.tostring(loaded, encoding="unicode"), robot.name, choice), kinematics
    )
    demands = _collect_demands(limits, sheets, links, kinematics, (bare, surveyed, rated))
    supply, drives = size_drives(demands, kind)
    motion = {
        "tool": choice.tool,
        "period": MOTION_PERIOD,
        "method": "way",
        "velocity_limit": max(drive.speed for drive in drives),
        "acceleration_limit": max(drive.acceleration for drive in drives),
    }
    # The motion controller reads the joints' limits from the robot description.
    write_limits(description, {drive.joint.name: drive for drive in drives})
    motion["collisions"], why = _choose_collisions(shapes, bare.start)
    comments = MOTION_COMMENTS | {"collisions": why}
    sources = SceneSources(robot.name, choice, payload or 0.0, *bodies, tools)
    scene = write_scene_text(name, sources, supply, demands, drives, SERVO_PERIOD)
    displacement = bare.displacement.tolist()
    contents = (
        scene,
        "",
        write_motion_text(motion, comments, list_drive_parameters(drive.joint for drive in drives)),
        write_demo_text(displacement, SETTLE, round(OBSERVED / MOTION_PERIOD)),
        ET.tostring(description, encoding="unicode") + "\n",
    )
    return drives, tools, dict(zip(PLACES, contents, strict=True))


def _collect_demands(
    limits: dict[str, dict[str, float | None]],
    sheets: Sequence[JointSheet | None],
    links: Scene,
    kinematics: Kinematics,
    surveys: tuple[Survey, Survey, Survey],
) -> list[Demand]:
    """Return what each joint's drive must do.

    Args:
        limits: of the joints in the description, by name.
        sheets: of the joints' drives.
        links: the robot without motors.
        kinematics: of the same.
        surveys: of the links alone, with the payload, and with the tools they are rated for.
    """
    bare, surveyed, rated = surveys
    return [
        Demand(
            name=joint.name,
            kind=joint.kind,
            start=float(bare.start[j]),
            inertia=(float(bare.inertia[j, 0]), float(surveyed.inertia[j, 1])),
            coupling=tuple(surveyed.coupling[j].tolist()),
            gravity_torque=float(surveyed.gravity_torque[j]),
            bare_torque=float(bare.gravity_torque[j]),
            tool_weight=float(rated.gravity_torque[j]),
            tool_inertia=float(rated.inertia[j, 1]),
            effort=limits[joint.name]["effort"],
            velocity=limits[joint.name]["velocity"],
            sheet=sheets[j],
            limited=bool(kinematics.lower[j] < bare.start[j] < kinematics.upper[j])
            and max(-kinematics.lower[j], kinematics.upper[j]) < UNLIMITED
            and joint.name in links.chain.coupling.apart,
        )
        for j, joint in enumerate(links.chain.joints)
    ]


def _make_servo(scene: Scene, drives: list[Sized]) -> ServoConfig:
    """Return the servo of a scene with its data sheets, without gains."""
    return ServoConfig(
        period=SERVO_PERIOD,
        motion_period=MOTION_PERIOD,
        hold_after=HOLD_AFTER,
        cut_after=CUT_AFTER,
        supply_voltage=scene.supply_voltage,
        joints=tuple(
            JointServo(
                name=joint.name,
                **make_data_sheet(joint, scene.supply_voltage),
                velocity_limit=drive.speed,
                position_gain=1.0,
                velocity_gain=1.0,
                integral_time=1.0,
                observer_bandwidth=1.0,
            )
            for joint, drive in zip(scene.joints, drives, strict=True)
        ),
    )


def list_drive_parameters(joints: Iterable[Joint]) -> dict[str, DriveParameters]:
    """Return the data sheet of each joint's gear and friction, by names."""
    return {joint.name: _read_drive_numbers(joint) for joint in joints}


def _read_drive_numbers(joint: Joint) -> DriveParameters:
    gear, values = joint.gear, dict[str, float]()
    names = list_numbers(DriveParameters)
    if gear.stiffness is not None:
        values |= {key: getattr(gear, key) for key in gear.list_numbers() if key in names}
    for law, prefix, per in (
        (joint.friction, "", 1.0),
        (joint.rotor_friction, "rotor_", abs(gear.ratio)),
    ):
        if law is not None:
            values[f"{prefix}viscous"] = getattr(law, "viscous", 0.0) / per**2
            values[f"{prefix}coulomb"] = getattr(law, "coulomb", 0.0) / per
    return DriveParameters(**values)


_SAMPLES = 100  # poses within the limits
_MAX_SHARE = 0.8  # share of them: shapes that overlap nearly everywhere are not those of the arm


def _read_own_shapes(urdf_xml: str, joint_names: tuple[str, ...]) -> Collisions | None:
    """Return the test of an arm against itself; None: its shapes cannot be read.

    Args:
        urdf_xml: the robot description, with meshes that can be found.
        joint_names: the joints commanded.
    """
    try:
        return Collisions(urdf_xml, joint_names, (), MotionConfig().collision_margin)
    except Refusal:
        return None


def _choose_collisions(tested: Collisions | None, start: Array) -> tuple[str, str]:
    """Return the parameter `collisions` for an arm, and the reason.

    Args:
        tested: of `_read_own_shapes`.
        start: angles of the joints at the start (N,) [rad or m].
    """
    if tested is None:
        return "off", "the shapes of the description cannot be read"
    if not tested.pairs:
        return "auto", "no parts of the arm can touch each other; stop with obstacles"
    if touching := tested.find_first_contact(start):
        return "off", f"{touching} touch wherever it could start"
    rng = np.random.default_rng(0)
    share = np.mean(
        [bool(tested.find_first_contact(tested.sample_configuration(rng))) for _ in range(_SAMPLES)]
    )
    if share > _MAX_SHARE:
        return "off", f"parts of the arm touch in {share:.0%} of its poses"
    return "stop", "before parts of the arm touch each other"
