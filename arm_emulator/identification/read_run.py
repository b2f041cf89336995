"""Records of motion in files: NumPy archives and tables."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from arm_emulator.base.array_file import read_arrays
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.table_file import read_table
from arm_emulator.identification.measured_run import MeasuredRun, check_samples
from arm_emulator.machine.chain import Array
from arm_emulator.machine.scene import Scene

# Contents of a record, by their names in files. Arrays and groups of columns have equal names.
NAMES = {
    "q_mot": "q_motor", "tau": "tau", "tau_abs": "tau", "current": "current", "q_link": "q_link",
    "q_ref": "q_ref", "v_mot": "v_motor",
}  # fmt: skip
ANGLES = {"rad": 1.0, "deg": np.pi / 180.0}
OF_ANGLE = ("q_motor", "q_link", "q_ref", "v_motor")


def read_run(path: Path, scene: Scene, angles: str = "rad", side: str = "link") -> MeasuredRun:
    """Read a record of a scene's machine.

    An archive (``.npz``) has arrays ``t`` (K,) [s], ``q_mot`` (K, N), and ``tau`` (or ``tau_abs``)
    [N m] or ``current`` [A] at the motors' shafts; it may have ``q_link``, ``q_ref`` and ``v_mot``.
    A table (``.csv``) has columns ``t``, ``q_mot.JOINT``, ``tau.JOINT`` and so on. Columns of
    ``q_link`` that are 0 throughout are no encoders.

    Args:
        path: of the file.
        scene: the machine.
        angles: unit of revolute joints' angles in the file, rad or deg.
        side: where ``q_mot`` and ``v_mot`` are given: at the motor's shaft, or as seen at the link.

    Raises:
        Refusal: it cannot be read, something is missing, or samples are not sound.
    """
    where = path.name
    if path.suffix == ".npz":
        signals = _from_archive(path)
    elif path.suffix == ".csv":
        signals = _from_table(path, scene)
    else:
        raise Refusal(where, "file", "be a record", path.suffix or "nothing", ".npz, .csv, bag")
    _to_radians(signals, scene, angles, side)
    return run_of(signals, scene, where)


def run_of(signals: dict[str, Array], scene: Scene, where: str) -> MeasuredRun:
    """Return the record made of signals.

    Args:
        signals: by the names of `MeasuredRun`, and ``current`` [A] instead of ``tau``.
        scene: the machine.
        where: name in refusals.

    Raises:
        Refusal: something is missing, or samples are not sound.
    """
    N, t = len(scene.joints), signals.pop("t", np.zeros(0))
    if "current" in signals and "tau" not in signals:
        signals["tau"] = _torques(signals.pop("current"), scene, where)
    signals.pop("current", None)
    for name, shown in (("q_motor", "q_mot"), ("tau", "tau, tau_abs or current")):
        if name not in signals:
            raise Refusal(where, "record", f"have {shown}", ", ".join(signals) or "nothing")
    if t.ndim != 1:
        raise Refusal(where, "t", "have one number per sample [s]", f"shape {t.shape}")
    for name, rows in signals.items():
        if rows.shape != (len(t), N):
            rule = f"have shape ({len(t)}, {N}): samples of t, joints of {scene.where}"
            raise Refusal(where, name, rule, rows.shape)
    if "q_link" in signals:
        absent = ~signals["q_link"].any(axis=0)
        signals["q_link"] = np.where(absent, np.nan, signals["q_link"])
    run = MeasuredRun(where=where, joints=scene.joint_names, t=t, **signals)
    check_samples(run)
    return run


def _to_radians(signals: dict[str, Array], scene: Scene, angles: str, side: str) -> None:
    turns = np.array([joint.kind == "revolute" for joint in scene.chain.joints])
    ratio = scene.gear_ratios
    for name in OF_ANGLE:
        rows = signals.get(name)
        if rows is not None and rows.ndim == 2 and rows.shape[1] == len(turns):
            at_motor = side == "motor" and name in ("q_motor", "v_motor")
            scale = np.where(turns | at_motor, ANGLES[angles], 1.0)
            signals[name] = rows * scale * (ratio if at_motor else 1.0)


def _torques(current: Array, scene: Scene, where: str) -> Array:
    """Return torques from currents (K, N) [A] by the motors' constants."""
    constants = [getattr(joint.motor, "torque_constant", None) for joint in scene.joints]
    if None in constants or current.shape[-1:] != (len(constants),):
        joint = scene.joint_names[constants.index(None)] if None in constants else "joints"
        rule = "come with torque constants of all motors in the scene, or be torques"
        raise Refusal(where, "current", rule, f"no torque constant of {joint}")
    torques: Array = current * np.array(constants)
    return torques


def _from_archive(path: Path) -> dict[str, Array]:
    arrays = read_arrays(path, {"t", *NAMES})
    if "t" not in arrays:
        raise Refusal(path.name, "archive", "have t [s]", ", ".join(arrays) or "nothing known")
    return {NAMES.get(name, name): values for name, values in arrays.items()}


def _from_table(path: Path, scene: Scene) -> dict[str, Array]:
    table = read_table(path, {"t": "s"})
    if "t" not in table.columns:
        got = ", ".join(table.columns) or "nothing"
        raise Refusal(path.name, "heading", "have a column t [s]", got)
    if len(set(table.columns)) < len(table.columns):
        raise Refusal(path.name, "heading", "name each column once", ", ".join(table.columns))
    signals = {"t": table.column("t")}
    for group, name in NAMES.items():
        there = [f"{group}.{joint}" in table.columns for joint in scene.joint_names]
        if not any(there):
            continue
        if not all(there) and name != "q_link":
            missing = scene.joint_names[there.index(False)]
            raise Refusal(path.name, "heading", f"have {group}.{missing}, as of the others", "none")
        none = np.full(len(table.lines), np.nan)
        of = [
            table.column(f"{group}.{joint}") if known else none
            for joint, known in zip(scene.joint_names, there, strict=True)
        ]
        signals[name] = np.column_stack(of)
    return signals
