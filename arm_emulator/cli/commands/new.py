"""Make a scene, with servo and motion control, from a robot description."""

import hashlib
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from arm_emulator.base.packages import refuse_missing_package
from arm_emulator.base.refusal import Refusal
from arm_emulator.cli.command import command, load_command
from arm_emulator.cli.output import output
from arm_emulator.design.new_scene import NewScene, choose_scene_name, write_new
from arm_emulator.design.robot_file import read_robot_text


@command(
    keys=(
        "`scene`, `joints`, `chosen`, `held`, `guessed`, `rated` (tools that guessed torques are"
        " for), `sources`, `assumed`, `weak`; with the option ros2-control"
        " `ros2_control` (as that command)"
    ),
)
def make_scene(
    robot: Path,
    /,
    *arguments: Annotated[str, Parameter(metavar="NAME:=VALUE")],
    tool: Annotated[str | None, Parameter(metavar="LINK")] = None,
    joints: Annotated[list[str] | None, Parameter(metavar="JOINT ...")] = None,
    tree: bool = False,
    payload: Annotated[float | None, Parameter(metavar="KG")] = None,
    density: Annotated[float, Parameter(metavar="KG/M3")] = 1200.0,
    motor: Annotated[str | None, Parameter(metavar="KIND")] = None,
    joint: Annotated[list[str] | None, Parameter(metavar="[JOINT=]NAME ...")] = None,
    out: Annotated[Path | None, Parameter(metavar="FOLDER")] = None,
    replace_inertias: bool = False,
    trust_inertias: bool = False,
    force: bool = False,
    ros2_control: bool = False,
) -> int:
    """Make a scene from a robot description.

    Args:
        robot: URDF or xacro source.
        arguments: arguments of the xacro source.
        tool: link of the tool (default: chosen).
        joints: moving joints; the others are held (default: chosen).
        tree: move all joints: a second arm, a gripper.
        payload: mass at the tool, for which the drives are sized (default: none, and drives for a
            tool by the arm's mass).
        density: density of bodies without inertia in the description.
        motor: kind of all motors, as `motor.kind` in scenes (default: that of scenes).
        joint: joints that exist, by a data file of config/joints: NAME for all, JOINT=NAME for one.
        out: folder of the scene's files (default: the robot's name, here).
        replace_inertias: compute impossible and doubtful inertias from shapes.
        trust_inertias: take them as they are, such as regrouped or identified parameters.
        force: overwrite existing files.
        ros2_control: compile the scene for ros2_control, too, and write its robot description and
            controllers into the same folder.
    """
    values = dict[str, str]()
    for argument in arguments:
        name, sign, value = argument.partition(":=")
        if not sign or not name:
            raise Refusal("new", "argument", "be NAME:=VALUE", argument)
        values[name] = value
    export = load_command("ros2-control") if ros2_control else None
    if ros2_control and export is None:
        raise refuse_missing_package("new", "export")
    written = write_new(
        robot, out, tool, joints, values, payload=payload, density=density, motor=motor, tree=tree,
        force=force, replace_inertias=replace_inertias, trust_inertias=trust_inertias,
        joint_data=joint or (),
    )  # fmt: skip
    facts = _report_scene(written)
    if export is not None:
        export.function(str(written.file), into=written.file.parent / "ros2_control")
        facts["ros2_control"] = dict(output.collected)
        output.collected.clear()
    output.add_facts(facts)
    return 0


def _report_scene(written: NewScene) -> dict[str, Any]:
    """Print how a scene was made, and return it for programs."""
    choice, report = written.choice, output.print_line
    report(f"moves    {', '.join(choice.joints)}")
    for guess in choice.guesses:
        report(f"chosen   {guess}")
    for name, locked in choice.locked.items():
        report(f"held     {name} at {locked.position:g}: {locked.reason}")
    guesses, sources = dict[str, dict[str, float]](), dict[str, None]()
    for drive in written.drives:
        for quantity, value in (("torque", drive.peak_torque), ("speed", drive.speed)):
            how, _, source = drive.notes[quantity].partition(", ")
            if how == "guess":
                guesses.setdefault(drive.joint.name, {})[quantity] = value
                report(f"guessed  {drive.joint.name}: {quantity} {value:.3g}: {source}")
            elif how == "published":
                sources[source] = None
    rated = written.tools if any("torque" in of_joint for of_joint in guesses.values()) else []
    for tool in rated:
        report(
            f"rated    torques that are guessed: for a tool of {tool.mass:.3g} kg at {tool.link}"
        )
    for source in sources:
        report(f"taken    torques and speeds that are published: {source}")
    others = [drive.joint.name for drive in written.drives if not drive.text]
    if others:
        of_some = "" if len(others) == len(written.drives) else f" of {', '.join(others)}"
        report(
            f"guessed  all motors, gears, friction, encoders{of_some}: "
            "rules are in the scene's heading"
        )
    for body in written.assumed:
        report(f"assumed  body of {body.link}: {body.how}")
    for overload in written.overloads:
        report(f"weak     {overload}")
    report(f"written  {written.file}, and servo/, motion/, demo/ in its folder")
    report(f"next     arm_emulator demo {written.file}")
    return {
        "scene": written.file, "joints": choice.joints, "chosen": choice.guesses,
        "held": choice.locked, "guessed": guesses, "rated": rated, "sources": list(sources),
        "assumed": written.assumed, "weak": [str(overload) for overload in written.overloads],
    }  # fmt: skip


def find_or_make_scene(robot: Path, out: Path) -> Path:
    """Return the scene of a robot below `out`: one made from this description, or a new one.

    Its folder is named after the robot, and the path and content of its description. Another
    robot's file of the same name, or an older version, therefore has another folder.

    Raises:
        Refusal: see `write_new`.
    """
    description = f"{robot.resolve().parent}\n{read_robot_text(robot, {})}"
    digest = hashlib.sha256(description.encode(errors="surrogateescape")).hexdigest()[:8]
    folder = out / f"{choose_scene_name(robot)}_{digest}"
    file = folder / f"{choose_scene_name(robot)}.yaml"
    if file.exists():
        output.print_line(f"taken    {file}, which was there (remove {folder} to start again)")
        return file
    output.add_facts(_report_scene(write_new(robot, folder)))
    return file
