"""Identify a scene's numbers from measured motion."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from cyclopts import Parameter

from arm_emulator.extension.bags import Bag, RecordedTopics
from arm_emulator.extension.base import Refusal, find_scene
from arm_emulator.extension.base import given_warnings as given
from arm_emulator.extension.commands import SceneName, command, convert_to_plain, output
from arm_emulator.extension.machine import Scene, compute_count_angle, load_scene
from arm_emulator_identification.found import Found, list_bodies, list_numbers, list_unfitted
from arm_emulator_identification.identified import (
    FitRequest,
    Identified,
    add_followers,
    draw_torques,
    identify_numbers,
    list_gears,
    list_warnings,
    write_fitted,
)
from arm_emulator_identification.loop_fit import list_loops
from arm_emulator_identification.measured_run import MeasuredRun
from arm_emulator_identification.read_run import make_run, read_run
from arm_emulator_identification.stages import show_stages
from arm_emulator_identification.torque_fit import TorqueFit
from arm_emulator_identification.torque_model import has_match
from arm_emulator_identification.wind_up import list_stiffness

DELAYED = ("tau", "q_link")
LONGEST_DELAY = 0.1  # s


@command(
    keys=(
        "`record`, `samples`, `period`, `rows`, `explained`, `directions`, `numbers`, `scene`, "
        "`picture`"
    ),
)
def identify_scene(
    scene: SceneName,
    data: Path,
    /,
    *,
    fit: Annotated[str, Parameter(metavar="NAMES")] = "*",
    hold: Annotated[str, Parameter(metavar="NAMES")] = "",
    out: Annotated[Path, Parameter(metavar="SCENE")] = Path("fitted.yaml"),
    angles: Literal["rad", "deg"] = "rad",
    side: Literal["link", "motor"] = "link",
    delay: Annotated[list[str] | None, Parameter(metavar="SIGNAL=S ...")] = None,
    low_pass: Annotated[float, Parameter(metavar="HZ")] = 10.0,
    trust: float = 0.5,
    as_is: bool = False,
) -> int:
    """Find a scene's numbers from a record of its machine's motion.

    Args:
        scene: scene file or name: the nominal machine.
        data: record: .npz, .csv, or a bag's folder.
        fit: numbers to identify, separated by commas.
        hold: numbers to keep, separated by commas.
        out: the scene to write.
        angles: unit in the data.
        side: of the gear on which motor angles are measured.
        delay: delays of tau or q_link.
        low_pass: cut-off frequency.
        trust: relative accuracy of the scene's inertias and springs.
        as_is: skip the check of axes, signs and units.
    """
    if not 0.0 < trust <= 10.0:
        raise Refusal("identify", "--trust", "be > 0 and <= 10", trust)
    file = find_scene(scene)
    nominal = load_scene(file)
    if out.suffix != ".yaml":
        raise Refusal("identify", "--out", "end in .yaml", out)
    if out.resolve() == file.resolve():
        raise Refusal("identify", "--out", "be another file than the scene", out)
    patterns, hold_patterns = (
        [pattern for pattern in names.split(",") if pattern] for names in (fit, hold)
    )
    late = _read_delays(delay or ())
    with show_stages() as stage:
        stage("read")
        record = _read_record(data, nominal, angles, side).shift_back(late)
        request = FitRequest(patterns, hold_patterns, low_pass, trust, as_is)
        identified = identify_numbers(nominal, record, request, stage)
        stage("write")
        numbers = list_numbers(nominal, identified.fit)
        warnings = identified.doubts + list_warnings(nominal, identified.fit, numbers)
        _write_result(out, file, nominal, identified.fit, numbers, warnings, data.name)
        # Gears wind up under the load of the fitted links.
        springs = [gear for gear in list_gears(nominal) if has_match(gear, patterns)]
        numbers += list_stiffness(load_scene(out), identified.run, springs, hold_patterns)

        def is_fitted(name: str) -> bool:
            return has_match(name, patterns) and not has_match(name, hold_patterns)

        numbers += list_loops(
            nominal, identified.run, identified.motion, identified.loads, is_fitted, trust
        )
        fitted_names = {number.name for number in numbers}
        numbers += list_unfitted(
            nominal,
            identified.fit.unknowns,
            lambda name: is_fitted(name) and name not in fitted_names,
        )
        _write_result(out, file, nominal, identified.fit, numbers, warnings, data.name)
        picture = out.with_suffix(".png")
        title = f"{data.name}: torques at the links, below {low_pass:g} Hz"
        draw_torques(identified.motion, identified.torques, nominal.joint_names, picture, title)
    console = output.make_console(110)
    console.print(_write_heading(identified, late, low_pass))
    heads = "number", "unit", "before", "found", "+-", ""
    rows = (
        (number.name, number.unit, f"{number.before:.5g}", f"{number.value:.5g}",
         f"{number.deviation:.2g}", number.brief)
        for number in numbers
    )  # fmt: skip
    output.print_table(heads, rows, title="Found, with standard deviations", left=2)
    for reason in dict.fromkeys(number.reason for number in numbers if number.reason):
        names = ", ".join(number.name for number in numbers if number.reason == reason)
        console.print(f"not identifiable: {names}: {reason}", markup=False, highlight=False)
    for doubt in warnings:
        console.print(f"warning: {doubt}", markup=False, highlight=False)
    console.print(f"scene: {out}\npicture: {picture}")
    given.extend(warnings)
    output.add_facts(_list_facts(identified, numbers, nominal) | {"scene": out, "picture": picture})
    return 0


def _read_record(data: Path, nominal: Scene, angles: str, side: str) -> MeasuredRun:
    if not data.is_dir() and data.suffix not in (".mcap", ".db3"):
        return read_run(data, nominal, angles, side)

    return read_bag_run(data, nominal)


def _list_facts(identified: Identified, numbers: Sequence[Found], nominal: Scene) -> dict[str, Any]:
    explained = dict(zip(nominal.joint_names, identified.fit.explained, strict=True))
    return {
        "record": identified.run.where,
        "samples": len(identified.run.t),
        "period": identified.run.period,
        "rows": len(identified.motion.t),
        "explained": explained,
        "directions": identified.fit.directions,
        "numbers": [{**convert_to_plain(number), "remark": number.remark} for number in numbers],
    }


def _read_delays(options: Sequence[str]) -> dict[str, float]:
    delays = dict[str, float]()
    for option in options:
        name, sign, text = option.partition("=")
        try:
            value = float(text)
        except ValueError:
            value = np.nan
        if name not in DELAYED or not sign or not abs(value) <= LONGEST_DELAY:
            rule = f"be {' or '.join(DELAYED)}=SECONDS, at most {LONGEST_DELAY:g}"
            raise Refusal("identify", "--delay", rule, option)
        delays[name] = value
    return delays


def _write_heading(identified: Identified, delays: dict[str, float], low_pass: float) -> str:
    run, fit = identified.run, identified.fit
    late = ", ".join(f"{name} {1e3 * value:g} ms late" for name, value in delays.items())
    explained = ", ".join(f"{share:.1f}" for share in fit.explained)
    return (
        f"{run.where}: {len(run.t)} samples every {1e3 * run.period:g} ms; "
        f"{late or 'no delays taken out'}; low-pass {low_pass:g} Hz both ways (Butterworth, order "
        f"4), {len(identified.motion.t)} rows used\n"
        f"torque explained in motion: {explained} %\n"
        f"{int(fit.fitted.sum())} numbers looked for; the motion has {fit.directions} "
        "combinations of them, the rest is as uncertain as before"
    )


def _write_result(out: Path, file: Path, scene: Scene, fit: TorqueFit, numbers: Sequence[Found],
           warnings: Sequence[str], record: str) -> None:  # fmt: skip
    changed = [number for number in numbers if not np.isnan(number.deviation)]
    values = {number.name: number.value for number in changed if number.name.startswith("joints.")}
    values = {name: value for name, value in values.items() if "measured_torque" not in name}
    heading = [f"Made of {scene.where} by `arm_emulator identify`, of the record {record}.", ""]
    heading += [number.line for number in numbers]
    heading += [f"warning: {doubt}" for doubt in warnings]
    values = add_followers(scene, values)
    write_fitted(out, file, scene, values, list_bodies(scene, fit), "\n".join(heading))


def read_bag_run(path: Path, scene: Scene) -> MeasuredRun:
    """Read the motor states of a bag: counts and currents, or commanded torques.

    Raises:
        Refusal: it cannot be read, something is missing, or samples are not sound.
    """
    t = list[float]()
    counts, current, command, at_link = (list[list[float]]() for _ in range(4))
    tick = -1
    for _, state in RecordedTopics(Bag(path)).read_messages("motor_states"):
        if state.tick == tick:
            continue  # published again, as no answer came
        tick = state.tick
        names = list(state.joint_names)
        for joint in scene.joint_names:
            if joint not in names:
                raise Refusal(str(path), "joints", f"be those of {scene.where}", ", ".join(names))
        order = [names.index(joint) for joint in scene.joint_names]
        t.append(state.header.stamp.sec + 1e-9 * state.header.stamp.nanosec)
        for into, of in (
            (counts, state.encoder_counts), (current, state.current),
            (command, state.applied), (at_link, state.link_encoder_counts),
        ):  # fmt: skip
            into.append([of[k] if len(of) else 0 for k in order])
    if not t:
        raise Refusal(str(path), "bag", "have motor_states", "none")
    q_motor = (np.array(counts, np.float64) + 0.5) * compute_count_angle(scene)
    units = np.array([joint.unit == "N m" for joint in scene.joints])
    Kt = np.array([getattr(joint.motor, "torque_constant", np.nan) for joint in scene.joints])
    tau = np.array(current, np.float64) * np.nan_to_num(Kt)
    # A command is reported at the end of the period in which it held: here, half of it before.
    applied = np.array(command, np.float64)
    later = np.vstack([applied[1:], applied[-1:]])
    tau = np.where(units, 0.5 * (applied + later), tau)
    signals = {"t": np.array(t), "q_motor": q_motor, "tau": tau}
    link = np.array(at_link, np.float64)
    if link.any():
        per = [joint.sensors.link_encoder for joint in scene.joints]
        scale = [2.0 * np.pi / encoder.counts_per_turn if encoder else np.nan for encoder in per]
        signals["q_link"] = (link + 0.5) * np.array(scale)
    return make_run(signals, scene, str(path))
