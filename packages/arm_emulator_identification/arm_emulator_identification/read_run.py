"""Records of motion in files: NumPy archives and tables."""

import io
import struct
import warnings
import zipfile
from collections.abc import Collection
from pathlib import Path
from typing import IO

import numpy as np
from numpy.lib.format import read_array

from arm_emulator.extension.base import Array, Refusal, open_file, read_table
from arm_emulator.extension.machine import Scene
from arm_emulator_identification.measured_run import MeasuredRun, check_samples

# Contents of a record, by their names in files. Arrays and groups of columns have equal names.
NAMES = {
    "q_mot": "q_motor", "tau": "tau", "tau_abs": "tau", "current": "current", "q_link": "q_link",
    "v_mot": "v_motor",
}  # fmt: skip
ANGLES = {"rad": 1.0, "deg": np.pi / 180.0}
OF_ANGLE = ("q_motor", "q_link", "v_motor")


def read_run(path: Path, scene: Scene, angles: str = "rad", side: str = "link") -> MeasuredRun:
    """Read a record of a scene's machine.

    An archive (``.npz``) has the arrays ``t`` (K,) [s] and ``q_mot`` (K, N). At the motors' shafts
    it has ``tau`` (or ``tau_abs``) [N m] or ``current`` [A]; it may have ``q_link`` and ``v_mot``.
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
        signals = _read_archive(path)
    elif path.suffix == ".csv":
        signals = _read_table(path, scene)
    else:
        raise Refusal(where, "file", "be a record", path.suffix or "nothing", ".npz, .csv, bag")
    _convert_angles(signals, scene, angles, side)
    return make_run(signals, scene, where)


def make_run(signals: dict[str, Array], scene: Scene, where: str) -> MeasuredRun:
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
        signals["tau"] = _convert_currents(signals.pop("current"), scene, where)
    signals.pop("current", None)
    for name, columns_text in (("q_motor", "q_mot"), ("tau", "tau, tau_abs or current")):
        if name not in signals:
            raise Refusal(where, "record", f"have {columns_text}", ", ".join(signals) or "nothing")
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


def _convert_angles(signals: dict[str, Array], scene: Scene, angles: str, side: str) -> None:
    revolute = np.array([joint.kind == "revolute" for joint in scene.chain.joints])
    ratio = scene.gear_ratios
    for name in OF_ANGLE:
        rows = signals.get(name)
        if rows is not None and rows.ndim == 2 and rows.shape[1] == len(revolute):
            at_motor = side == "motor" and name in ("q_motor", "v_motor")
            scale = np.where(revolute | at_motor, ANGLES[angles], 1.0)
            signals[name] = rows * scale * (ratio if at_motor else 1.0)


def _convert_currents(current: Array, scene: Scene, where: str) -> Array:
    """Return torques from currents (K, N) [A] by the motors' constants."""
    constants = [getattr(joint.motor, "torque_constant", None) for joint in scene.joints]
    if None in constants or current.shape[-1:] != (len(constants),):
        joint = scene.joint_names[constants.index(None)] if None in constants else "joints"
        rule = "come with torque constants of all motors in the scene, or be torques"
        raise Refusal(where, "current", rule, f"no torque constant of {joint}")
    torques: Array = current * np.array(constants)
    return torques


def _read_archive(path: Path) -> dict[str, Array]:
    arrays = read_arrays(path, {"t", *NAMES})
    if "t" not in arrays:
        raise Refusal(path.name, "archive", "have t [s]", ", ".join(arrays) or "nothing known")
    return {NAMES.get(name, name): values for name, values in arrays.items()}


def _read_table(path: Path, scene: Scene) -> dict[str, Array]:
    table = read_table(path, {"t": "s"})
    if "t" not in table.columns:
        names = ", ".join(table.columns) or "nothing"
        raise Refusal(path.name, "heading", "have a column t [s]", names)
    if len(set(table.columns)) < len(table.columns):
        raise Refusal(path.name, "heading", "name each column once", ", ".join(table.columns))
    signals = {"t": table.get_column("t")}
    for group, name in NAMES.items():
        there = [f"{group}.{joint}" in table.columns for joint in scene.joint_names]
        if not any(there):
            continue
        if not all(there) and name != "q_link":
            missing = scene.joint_names[there.index(False)]
            raise Refusal(path.name, "heading", f"have {group}.{missing}, as of the others", "none")
        none = np.full(len(table.lines), np.nan)
        of = [
            table.get_column(f"{group}.{joint}") if is_present else none
            for joint, is_present in zip(scene.joint_names, there, strict=True)
        ]
        signals[name] = np.column_stack(of)
    return signals


# An archive may unpack to far more than its size, which is checked before memory is allocated. What
# an array's header states beyond that is never written to. Nothing in the file is executed: pickled
# objects are refused.

MAX_BYTES = 2**29  # of the file, and of all that is unpacked from it
MAX_ENTRIES = 1000
_END = struct.Struct("<4sHHHHIIH")  # of an archive: entries are the fifth number
_END_SIGNATURE, _ZIP64_SIGNATURE = b"PK\x05\x06", b"PK\x06\x07"
_ZIP64_SIZE, _LONGEST_COMMENT = 20, 2**16
_METHODS = {zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED}  # the memory of the others is unbounded
_NUMBERS = "fiub"  # kinds of NumPy's types that are real numbers


def read_arrays(file: Path, names: Collection[str]) -> dict[str, Array]:
    """Return those of the named arrays that an archive holds, as doubles.

    Raises:
        Refusal: the file is missing, not an archive, damaged or too large, or an array does not
            hold real numbers.
    """
    where = file.name
    with open_file(file) as stream:
        try:
            _check_entries(stream, where)
            with zipfile.ZipFile(stream) as archive:
                return _read_arrays(archive, names, where)
        except Refusal:
            raise
        except Exception as error:  # zipfile, zlib and NumPy raise various ones
            reason = f"{type(error).__name__} {error}"
            raise Refusal(where, "file", "be an archive of NumPy arrays", reason) from None


def _check_entries(stream: IO[bytes], where: str) -> None:
    """Refuse an archive whose table of contents is large, before the archive is read."""
    size = stream.seek(0, io.SEEK_END)
    if size > MAX_BYTES:
        raise Refusal(where, "file", f"have at most {MAX_BYTES // 2**20} MiB", "more")
    start = max(0, size - _END.size - _LONGEST_COMMENT - _ZIP64_SIZE)
    stream.seek(start)
    tail = stream.read()
    at = len(tail) - _END.size  # as zipfile: without a comment, else the last one
    if tail[max(0, at) :][:4] != _END_SIGNATURE:
        at = tail.rfind(_END_SIGNATURE)
    if not 0 <= at <= len(tail) - _END.size:
        raise Refusal(where, "file", "be an archive of NumPy arrays", "no end of an archive")
    _, _, _, _, entries, table, *_ = _END.unpack_from(tail, at)
    large = tail[max(0, at - _ZIP64_SIZE) :][:4] == _ZIP64_SIGNATURE
    if large or entries > MAX_ENTRIES or table > MAX_ENTRIES * 1000:
        rule = f"hold at most {MAX_ENTRIES} arrays"
        raise Refusal(where, "archive", rule, "more" if large else entries)


def _read_arrays(archive: zipfile.ZipFile, names: Collection[str], where: str) -> dict[str, Array]:
    arrays: dict[str, Array] = {}
    left = MAX_BYTES
    for entry in archive.infolist():
        name = entry.filename.removesuffix(".npy")
        if name not in names:
            continue
        if name in arrays:
            raise Refusal(where, "archive", "hold each array once", f"{name} again")
        if entry.compress_type not in _METHODS:
            raise Refusal(where, name, "be stored or deflated", "another method")
        if entry.file_size > left:
            rule = f"unpack to at most {MAX_BYTES // 2**20} MiB"
            raise Refusal(where, "archive", rule, f"{entry.file_size} bytes of {name}")
        # NumPy warns of archives by Python 2, and of numbers of more than 64 bits.
        quiet = warnings.catch_warnings(action="ignore"), np.errstate(over="ignore")
        with archive.open(entry) as packed, quiet[0], quiet[1]:
            values = read_array(packed, allow_pickle=False)
            if values.dtype.kind not in _NUMBERS:
                raise Refusal(where, name, "be real numbers", f"type {values.dtype}")
            if values.size * 8 > left:
                raise Refusal(where, name, f"have at most {left // 8} numbers", values.size)
            arrays[name] = values.astype(np.float64)
        left -= max(entry.file_size, arrays[name].nbytes)
    return arrays
