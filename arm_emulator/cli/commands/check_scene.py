"""Check scene files, and that servo and motion control fit them."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from arm_emulator.analysis.holding import find_overloads
from arm_emulator.analysis.mode_loops import (
    LoopFigure,
    ModeLoops,
    describe_withheld_modes,
    list_withheld_modes,
)
from arm_emulator.analysis.servo_loop import warn_of_loops
from arm_emulator.base.io.config_files import find_beside, find_scene
from arm_emulator.base.io.yaml_file import read_yaml
from arm_emulator.base.packages import MODES, load_all
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.urdf.urdf_text import parse_urdf
from arm_emulator.base.warning import print_warnings
from arm_emulator.cli.command import command
from arm_emulator.cli.options import SceneName
from arm_emulator.cli.output import convert_to_plain, output
from arm_emulator.design.inertia_check import check_inertias, list_doubtful_inertias
from arm_emulator.machine.scene.scene import Scene, load_scene
from arm_emulator.machine.scene.urdf_file import find_urdf
from arm_emulator.motion.model.config import MotionConfig
from arm_emulator.runs.gains import check_fit, check_servo, load_gains, warn_of_gravity
from arm_emulator.servo.servo_config import ServoConfig


@command(keys="`scenes` (each with its loops after the option modes)")
def check_scenes(
    scene: SceneName,
    /,
    *more: Annotated[str, Parameter(metavar="SCENE", help="further ones")],
    modes: bool = False,
) -> int:
    """Check scene files, and the servo and motion parameters that belong to them.

    Args:
        modes: show the eigenvalues of every loop that the modes of the scene's drives select.
    """
    facts = list[dict[str, object]]()
    for name in (scene, *more):
        checked = check_scene(name)
        output.print_line(checked.line)
        fact: dict[str, object] = convert_to_plain(checked)
        if modes:
            machine, servo = _load_with_loops(name)
            fact["modes"] = list_mode_facts(machine, servo)
            if not output.as_json:
                print(format_page_table(build_mode_rows(machine, servo)))
        facts.append(fact)
    output.add_facts({"scenes": facts})
    return 0


@dataclass(frozen=True)
class CheckedScene:
    """A valid scene, and the files that belong to it.

    Attributes:
        scene: its file's name.
        joints: their names.
        assumed: links whose bodies are assumed.
        servo: the file of the servo's parameters, if there is one.
        motion: that of the motion controller's.
        missing: missing files, as text.
    """

    scene: str
    joints: tuple[str, ...]
    assumed: tuple[str, ...]
    servo: Path | None
    motion: Path | None
    missing: tuple[str, ...]

    @property
    def line(self) -> str:
        """The same as text."""
        line = f"{self.scene}: valid, {len(self.joints)} joints: {', '.join(self.joints)}"
        if self.assumed:
            line += f"; bodies assumed: {', '.join(self.assumed)}"
        for kind, file in (("servo", self.servo), ("motion", self.motion)):
            if file is not None:
                line += f"; {kind}: {file}"
        return "; ".join((line, *self.missing))


def check_scene(name: str) -> CheckedScene:
    """Return the files of a scene; compare its gains with it.

    Raises:
        Refusal: the scene or a file of it is invalid, or they do not fit together.
    """
    file = find_scene(name)
    scene = load_scene(file)
    _check_links(scene, file)
    for overload in find_overloads(scene):
        print_warnings(f"{scene.where}: {overload}")
    files: dict[str, Path | None] = {}
    missing = []
    for kind in ("servo", "motion"):
        try:
            files[kind] = find_beside(file, kind)
        except Refusal as reason:
            files[kind] = None
            missing.append(f"no {kind} parameters: they must {reason.rule}")
    checked = CheckedScene(
        scene.where, scene.joint_names, tuple(scene.assumed), **files, missing=tuple(missing)
    )
    if missing:
        print_warnings(*scene.warnings)
        return checked
    gains = load_gains(file)
    check_fit(scene, gains.servo, gains.motion)
    _check_controller(scene.urdf, scene.joint_names, gains.motion)
    warn_of_loops(scene, gains.servo)
    for drive_modes in load_all(MODES):
        for text in describe_withheld_modes(
            scene, list_withheld_modes(scene, gains.servo, drive_modes())
        ):
            print_warnings(text)
    warn_of_gravity(scene, gains.motion)
    return checked


def _check_links(scene: Scene, file: Path) -> None:
    """Check that the links of a scene can be bodies; where the scene trusts them, they need not."""
    folder = find_urdf(str(read_yaml(file).get("urdf")), file).parent
    trusted = (*scene.assumed, *scene.trusted_inertias)
    robot = parse_urdf(scene.urdf, scene.where)
    doubtful = list_doubtful_inertias(robot, scene.where, folder, scene.chain, trusted)
    check_inertias(doubtful, scene.where)


def _load_with_loops(name: str) -> tuple[Scene, ServoConfig]:
    """Return a scene and its servo if all joints have loops.

    Raises:
        Refusal: the scene or its servo's gains are not valid, do not fit together, or a joint has
            no motor.
    """
    file = find_scene(name)
    scene, servo = load_scene(file), load_gains(file).servo
    check_servo(scene, servo)
    for joint in scene.joints:
        if joint.motor is None:
            rule = "have a motor, to have loops"
            raise Refusal(scene.where, f"joints.{joint.name}", rule, "none")
    return scene, servo


def _check_controller(urdf: str, joint_names: tuple[str, ...], motion: MotionConfig) -> None:
    # Pinocchio, which is slow to import, only where there is a motion controller to check.
    from arm_emulator.motion.planner.tool_controller import make_controller

    make_controller(urdf, joint_names, motion)


HEADS = (
    "joint",
    "loop",
    "largest",
    "slowest swing",
    "brake closed: largest",
    "slowest swing",
    "growth, 1/s",
    "",
)
_NONE = 1e-3  # 1/s: rounding of an eigenvalue 0


def build_mode_rows(scene: Scene, servo: ServoConfig) -> list[tuple[str, ...]]:
    """Return a row of `HEADS` for each joint and loop, and one of all joints in each loop."""
    rows = []
    figures = ModeLoops(scene, servo).figures
    for alike in (True, False):
        of_rows: dict[tuple[int, str], list[LoopFigure]] = {}
        for figure in figures:
            if figure.alike is alike:
                key = -1 if alike else figure.joint, figure.loop.value
                of_rows.setdefault(key, []).append(figure)
        for (j, loop), pair in sorted(of_rows.items(), key=lambda item: item[0][0]):
            name = "all" if alike else scene.joint_names[j]
            rows.append((name, loop, *_format_cells(pair)))
    return rows


def list_mode_facts(scene: Scene, servo: ServoConfig) -> list[dict[str, object]]:
    """Return the same for programs, a row for each loop with brakes open or closed."""
    return [
        {
            "joint": "all" if figure.alike else scene.joint_names[figure.joint],
            "loop": figure.loop.value,
            "braked": figure.braked,
            "radius": figure.radius,
            "swing": figure.swing,
            "frequency": figure.frequency,
            "growth": figure.beyond,
            "gain": figure.gain,
            "holds": figure.is_stable,
        }
        for figure in ModeLoops(scene, servo).figures
    ]


def _format_cells(pair: Iterable[LoopFigure]) -> tuple[str, ...]:
    by_brake = {cell.braked: cell for cell in pair}
    cells: list[str] = []
    for braked in (False, True):
        cell = by_brake.get(braked)
        cells.append("" if cell is None else f"{cell.radius:.4f}")
        swings = cell is not None and cell.swing > 0.0
        cells.append(f"{cell.swing:.4f} at {cell.frequency:.3g} Hz" if cell and swings else "")
    worst = max(by_brake.values(), key=lambda cell: cell.beyond)
    gain = f", {worst.gain:g} of the command" if worst.gain != 1.0 else ""
    cells.append(f"{worst.beyond if abs(worst.beyond) > _NONE else 0.0:.3g}{gain}")
    cells.append("" if worst.is_stable else "withheld")
    return tuple(cells)


def format_page_table(rows: list[tuple[str, ...]]) -> str:
    """Return rows as a table in Markdown."""
    lines = [HEADS, ("---",) * len(HEADS), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
