"""Archives of arrays (.npz), sound and spoiled, as records for identification."""

import io
import pickle
import struct
import tempfile
import warnings
import zipfile
import zlib
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from machines import make_link_urdf, write_scene

from arm_emulator.machine.scene.scene import load_scene
from arm_emulator_identification.measured_run import MeasuredRun
from oracles.synthetic_record import make_record

Rng = np.random.Generator


def pendulum(folder: Path) -> Path:
    motor = {
        "kind": "torque",
        "rotor_inertia": 1e-3,
        "friction": {"viscous": 0.01, "coulomb": 0.02},
    }
    return write_scene(
        folder, make_link_urdf(), {"joint": {"motor": motor, "gear": {"ratio": 0.05}}},
        gravity=[0.0, 0.0, -9.81], servo_period=4e-3,
        integrator={"scheme": "rosenbrock", "dt": 1e-3},
    )  # fmt: skip


@cache
def _motion() -> MeasuredRun:
    with tempfile.TemporaryDirectory() as folder:
        return make_record(load_scene(pendulum(Path(folder))), 3, 4.0, 1e-6, 0.02)


def sound_signals() -> dict[str, npt.NDArray[Any]]:
    """Return a record that `identify` takes."""
    run = _motion()
    return {"t": run.t.copy(), "q_mot": run.q_motor.copy(), "tau": run.tau.copy()}


@cache
def _bomb(name: str) -> bytes:
    """Return an archive of a MiB that unpacks to a GiB."""
    bytes_io = io.BytesIO()
    with zipfile.ZipFile(bytes_io, "w", zipfile.ZIP_DEFLATED) as archive:
        head = _npy_head(f"{{'descr': '<f8', 'fortran_order': False, 'shape': ({1 << 27},)}}")
        with archive.open(f"{name}.npy", "w", force_zip64=True) as entry:
            entry.write(head)
            for _ in range(1 << 6):
                entry.write(bytes(1 << 24))
    return bytes_io.getvalue()


def write_archive(rng: Rng, folder: Path) -> Path:
    file = folder / "spoiled.npz"
    save = np.savez if rng.random() < 0.5 else np.savez_compressed
    save(file, **sound_signals())
    return file


def archive_odd(rng: Rng, file: Path) -> None:
    signals = sound_signals()
    name = str(rng.choice(list(signals)))
    array = signals[name]
    many = int(10 ** rng.uniform(3, 6))
    match int(rng.integers(16)):
        case 0:
            file.write_bytes(_bomb(name))
        case 1:  # a heading that promises what it likes
            shape = str(rng.choice(["(1099511627776,)", "(4294967296, 4294967296)", "(-1,)", "(0,)",
                                    "(1001, 1, 1)", "()", "(2.0,)", "x"]))  # fmt: skip
            kind = str(
                rng.choice(["<f8", "|O", "<c16", "|S8", "<U4", "<M8[s]", "|V9", "x", "<f2", ">f4"])
            )
            head = _npy_head(f"{{'descr': {kind!r}, 'fortran_order': False, 'shape': {shape}, }}")
            _write_entries(file, {name: head + array.tobytes()})
        case 2:
            _write_entries(file, {name: _npy_head("(" * min(many, 60_000))})
        case 3:
            signals[name] = np.array([[{}]] * len(array), dtype=object)
            np.savez(file, **signals)
        case 4:
            _write_entries(file, {name: pickle.dumps(array)})
        case 5:
            method = zipfile.ZIP_LZMA if rng.random() < 0.5 else zipfile.ZIP_BZIP2
            with zipfile.ZipFile(file, "w", method) as archive:
                archive.writestr("t.npy", bytes(1000))
        case 6:
            with zipfile.ZipFile(file, "w") as archive:
                for k in range(many // 100):
                    archive.writestr(f"{k}.npy", b"")
        case 7:
            with warnings.catch_warnings(action="ignore"), zipfile.ZipFile(file, "a") as archive:
                archive.writestr(f"{name}.npy", b"\x93NUMPY")
        case 8:
            np.save(file.with_suffix(".npy"), array)
            file.with_suffix(".npy").replace(file)
        case 9:
            signals[name] = array * float(rng.choice([np.nan, np.inf, 1e300, 1e-320, 0.0]))
            np.savez(file, **signals)
        case 10:
            kinds = ["f2", "f4", "g", "i1", "u8", "?", "c16", "U9", "S3", "m8[s]", ">f8"]
            with np.errstate(all="ignore"), warnings.catch_warnings(action="ignore"):
                signals[name] = array.astype(str(rng.choice(kinds)))
            np.savez(file, **signals)
        case 11:
            shapes = [array.T, array[:1], array[:, None], array.ravel(), array[()], array[..., 0]]
            signals[name] = shapes[int(rng.integers(len(shapes)))]
            np.savez(file, **signals)
        case 12:
            del signals[name]
            np.savez(file, **signals)
        case 13:  # a heading of the archive that is not that of the entry
            body = bytearray(file.read_bytes())
            at = body.rfind(b"PK\x01\x02")
            place = at + int(rng.integers(4, 46))
            body[place : place + 4] = rng.bytes(4)
            file.write_bytes(bytes(body))
        case 14:
            array.flat[int(rng.integers(array.size))] = rng.choice([np.nan, np.inf, 1e30])
            np.savez(file, **signals)
        case _:
            _write_entries(file, {name: zlib.compress(bytes(many))})


def _npy_head(text: str) -> bytes:
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text) + 1) + text.encode() + b"\n"


def _write_entries(file: Path, entries: dict[str, bytes]) -> None:
    with zipfile.ZipFile(file, "w") as archive:
        for name, body in entries.items():
            archive.writestr(f"{name}.npy", body)
