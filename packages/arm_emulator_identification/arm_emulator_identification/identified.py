"""From a record to numbers: looked over, and fitted by torques."""

import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml

from arm_emulator.extension.base import (
    LARGEST_YAML_FILE,
    Array,
    Refusal,
    check_own,
    edited_yaml,
    read_text,
    read_yaml,
    yaml_nodes,
)
from arm_emulator.extension.machine import (
    Body,
    Frame,
    Scene,
    load_scene,
    make_inertial,
    override_keys,
)
from arm_emulator_identification import inertia
from arm_emulator_identification.filtered import Filtered
from arm_emulator_identification.found import Found
from arm_emulator_identification.loop_fit import GearLoads, list_gear_numbers
from arm_emulator_identification.measured_run import MeasuredRun
from arm_emulator_identification.plausibility import check_fit, filter_record
from arm_emulator_identification.torque_fit import TorqueFit, fit_torques
from arm_emulator_identification.torque_model import MotionTorques, TorqueModel, has_match


@dataclass(frozen=True)
class FitRequest:
    """Numbers to identify, and the way to do so.

    Attributes:
        fit, hold: patterns of numbers to identify, and to keep.
        low_pass: cut-off frequency [Hz].
        trust: relative accuracy of the scene's inertias and springs.
        as_is: skip the check of axes, signs and units.
    """

    fit: Sequence[str]
    hold: Sequence[str]
    low_pass: float
    trust: float
    as_is: bool


@dataclass(frozen=True)
class Identified:
    """Result of a record.

    Attributes:
        run: the record, without outliers.
        motion: its filtered motion, K rows.
        fit: the numbers.
        torques: at the links, as they explain them (K, N) [N m or N].
        loads: of the gears.
        doubts: about the record.
    """

    run: MeasuredRun
    motion: Filtered
    fit: TorqueFit
    torques: Array
    loads: GearLoads
    doubts: list[str]


def list_gears(scene: Scene) -> list[str]:
    """Return the names of the gears' numbers that encoders at the links show, not torques."""
    return [name for joint in scene.joints for name in list_gear_numbers(joint)]


def identify_numbers(
    nominal: Scene,
    record: MeasuredRun,
    request: FitRequest,
    stage: Callable[[str], None],
) -> Identified:
    """Return the numbers with which a scene explains a record.

    Args:
        nominal: the scene.
        record: as it was measured.
        request: what is sought.
        stage: is called with each stage when it begins.

    Raises:
        Refusal: the record is not one of this machine, or there is nothing to identify.
    """
    stage("look the record over")
    run, motion, warnings = filter_record(nominal, record, request.low_pass, as_is=request.as_is)
    stage("fit torques")
    typical = motion.tau.std(axis=0), np.abs(motion.v).max(axis=0)
    model = TorqueModel(nominal, typical, request.trust)
    gears = list_gears(nominal)
    by_torques = [pattern for pattern in request.fit if not _is_of_gears(gears, pattern)]
    fitted = model.choose_unknowns(by_torques, "identify")
    fitted = fitted & ~np.array(
        [has_match(unknown.name, request.hold) for unknown in model.unknowns]
    )
    torques = model.bind_motion(motion)
    fit = fit_torques(model, motion, fitted, torques)
    check_fit(run.where, run.joints, fit.explained)
    loads = _find_loads(model, motion, fit, torques)
    return Identified(run, motion, fit, torques.compute_torques(fit.values), loads, warnings)


def _find_loads(
    model: TorqueModel, motion: Filtered, fit: TorqueFit, torques: MotionTorques
) -> GearLoads:
    """Return the torques of the gears on the links, which fitted links and parts there take."""
    load = motion.smooth_samples(torques.update_loads(fit.values).load)
    at = model.at_links
    sizes, axes = np.linalg.eigh(fit.covariance[np.ix_(at, at)])
    slopes = torques.compute_slopes(fit.values)[:, :, at]
    errors = np.moveaxis(slopes @ (axes * np.sqrt(np.maximum(sizes, 0.0))), 2, 0)
    return GearLoads(load, errors)


def _is_of_gears(gears: Sequence[str], pattern: str) -> bool:
    return any(has_match(name, [pattern]) for name in gears) and "gear" in pattern


FAR = 3.0  # prior deviations, beyond which a number is doubted


def list_warnings(scene: Scene, fit: TorqueFit, numbers: Sequence[Found]) -> list[str]:
    """Return objections to the numbers found, as text."""
    names, warnings = scene.joint_names, list[str]()
    for of, body in zip(scene.chain.links, scene.bare, strict=True):
        if not inertia.is_body(body):
            warnings.append(f"links.{of.link}: no body has its inertia; the scene's number is kept")
    for effect in fit.effects:
        joints = ", ".join(names[j] for j in effect.joints)
        if len(effect.joints) == len(names) > 1:
            joints = "all joints"
        size = f", by {effect.size:.3g} {effect.unit}" if effect.unit else ""
        warnings.append(
            f"{joints}: {effect.name}{size}: {100.0 * effect.share:.0f} % of what the scene does "
            "not explain; deviations have in them what this may hide"
        )
    for joint, count in zip(names, fit.far_out, strict=True):
        if count:
            warnings.append(f"{joint}: {count} rows stand out, and count little")
    for number in numbers:
        if number.identified and number.far > FAR:
            warnings.append(
                f"{number.name}: {number.value:.4g} {number.unit} is {number.far:.1f} of the "
                f"deviations known before from {number.before:.4g}; is the record in the units and "
                "scale given?"
            )
        if number.left:
            warnings.append(f"{number.name}: {number.left}")
    return warnings


def draw_torques(data: Filtered, torques: Array, names: tuple[str, ...], file: Path,
                 title: str) -> None:  # fmt: skip
    """Draw measured torques, those of the fit, and their difference."""
    from matplotlib.figure import Figure  # not pyplot: no screen, no global state

    N = len(names)
    figure = Figure(figsize=(10, 1.7 * N + 0.6), layout="constrained")
    axes = figure.subplots(N, 1, sharex=True, squeeze=False)
    for j, (axis, name) in enumerate(zip(axes[:, 0], names, strict=True)):
        moving = np.where(data.moving[:, j], 1.0, np.nan)
        axis.plot(data.t, data.tau[:, j], color="0.6", lw=1.0, label="measured")
        axis.plot(data.t, torques[:, j] * moving, "C0", lw=1.2, label="computed, in motion")
        axis.plot(data.t, (data.tau - torques)[:, j] * moving, "C3", lw=0.8, label="residual")
        axis.set_ylabel(f"{name}\nN m")
        axis.grid(alpha=0.3)
    axes[0, 0].set_title(title)
    axes[0, 0].legend(fontsize="small", ncols=3)
    axes[-1, 0].set_xlabel("s")
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=100)


def add_followers(scene: Scene, numbers: Mapping[str, float]) -> dict[str, float]:
    """Return numbers together with those that follow them and differ from them."""
    extended = dict(numbers)
    for joint in scene.joints:
        for part in joint.parts:
            place = f"joints.{joint.name}.{part.section}"
            own_numbers = part.list_numbers()
            own = {
                key: extended[f"{place}.{key}"]
                for key in own_numbers
                if f"{place}.{key}" in extended
            }
            new = part.replace_numbers(**own)
            for key, number in own_numbers.items():
                if number.follows in own and getattr(part, key) != getattr(part, number.follows):
                    extended[f"{place}.{key}"] = getattr(new, key)
    return extended


def write_fitted(file: Path, scene_file: Path, scene: Scene, numbers: Mapping[str, float],
                 bodies: Sequence[Body], heading: str) -> None:  # fmt: skip
    """Write a scene with other numbers, and a URDF with other bodies beside it.

    Args:
        file: the scene to write; its URDF goes to ``urdf/NAME.urdf`` beside it.
        scene_file: the original scene.
        scene: the same, loaded.
        numbers: values by their dotted names below the scene.
        bodies: bodies moved by its joints, without the payload, in the core's frames.
        heading: lines to stand at its top, as comments.

    Raises:
        Refusal: it cannot be written, is shipped, or does not read back equal.
    """
    urdf = file.parent / "urdf" / f"{file.stem}.urdf"
    for path in (file, urdf):
        check_own("identify", path)
    values: dict[str, float | str] = {name: float(f"{v:.9g}") for name, v in numbers.items()}
    values |= {"name": file.stem, "urdf": f"urdf/{urdf.name}"}
    comments = "".join(f"# {line}".rstrip() + "\n" for line in heading.splitlines())
    try:
        urdf.parent.mkdir(parents=True, exist_ok=True)
        urdf.write_text(_insert_bodies(scene, rotate_to_links(scene, bodies)), encoding="utf-8")
        text = comments + _replace_values(scene_file, values)
        if not scene.trusted_inertias:
            text = text.rstrip() + "\n" + _write_trust([joint.link for joint in scene.chain.links])
        file.write_text(text, encoding="utf-8")
    except OSError as error:
        raise Refusal("identify", f"file {file}", "be writable", error.strerror) from None
    _check_written(load_scene(file), numbers)


def _write_trust(links: Sequence[str]) -> str:
    """Return the key that exempts links: parameters that fit torques need not fit shapes."""
    listed = yaml.safe_dump({"trusted_inertias": list(links)}, sort_keys=False)
    return f"\n# Identified parameters, not those of bodies.\n{listed}"


def _check_written(scene: Scene, numbers: Mapping[str, float]) -> None:
    """Refuse a scene without the numbers that were to be written."""
    for joint in scene.joints:
        for part in joint.parts:
            for key in part.list_numbers():
                name = f"joints.{joint.name}.{part.section}.{key}"
                expected, actual = numbers.get(name), getattr(part, key)
                if expected is not None and abs(actual - expected) > 1e-6 * abs(expected):
                    raise Refusal(scene.where, name, f"be {expected:g}, as found", actual)


def _replace_values(file: Path, values: Mapping[str, float | str]) -> str:
    """Return a scene's text with some values by their dotted places.

    If each has a place of its own, the rest of the text is kept. Where joints share a
    section by an alias, or a place is not there yet, the scene is written anew.
    """
    text = read_text(file, LARGEST_YAML_FILE)
    nodes = {place: value for place, (_, value) in yaml_nodes(text).items()}
    shared = Counter(id(node) for node in nodes.values())
    targets = [nodes.get(name) for name in values]
    if not all(isinstance(node, yaml.ScalarNode) and shared[id(node)] == 1 for node in targets):
        data = read_yaml(file)
        for name, value in values.items():
            override_keys(data, name, value, file.name)
        return yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=100)
    edits = [
        (node.start_mark.index, node.end_mark.index, str(value))
        for node, value in zip(targets, values.values(), strict=True)
        if node is not None
    ]
    return edited_yaml(text, edits)


def _insert_bodies(scene: Scene, bodies: Mapping[str, Body]) -> str:
    """Return the URDF with the bodies of its moving links; links fixed to them get none."""
    robot = ET.fromstring(scene.urdf)
    links = {element.get("name"): element for element in robot.findall("link")}
    for joint in scene.chain.links:
        body = bodies.get(joint.link)
        if body is None:
            continue
        for name in joint.links:
            for old in links[name].findall("inertial"):
                links[name].remove(old)
        links[joint.link].insert(0, make_inertial(body, 12))
    ET.indent(robot)
    return ET.tostring(robot, encoding="unicode") + "\n"


def rotate_to_links(scene: Scene, bodies: Sequence[Body]) -> dict[str, Body]:
    """Return the bodies of the joints' child links, in their frames, by name.

    Args:
        scene: the machine.
        bodies: of its chain, in the core's frames.
    """
    pairs = zip(scene.chain.links, bodies, strict=True)
    return {joint.link: body.transform_to(Frame(joint.axes.T)) for joint, body in pairs}
