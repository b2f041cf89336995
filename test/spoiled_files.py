"""Files from outside, spoiled at random: damaged, odd, huge, empty, or none at all.

`case(kind, rng, folder)` writes a sound file of a kind, spoils it and hands it to the command that
reads it, by the command line's own entry in this process. It returns the line that refuses the file
and "" if it was taken, and raises AssertionError if the outcome is another: a traceback, a warning,
more than one line, a line that does not name the file, more than some seconds or more memory than
the bounds allow.
"""

from __future__ import annotations

import contextlib
import io
import os
import pickle
import resource
import signal
import socket
import struct
import sys
import tempfile
import time
import traceback
import warnings
import zipfile
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import FrameType
from typing import Any

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import numpy.typing as npt
import yaml
import zstandard
from machines import one_link_urdf, write_scene
from made_bags import synthetic
from mcap.data_stream import RecordBuilder
from mcap.records import Chunk
from mcap.stream_reader import StreamReader
from mcap.writer import MCAP0_MAGIC, CompressionType, Writer
from random_scenes import SCENE, URDF

from arm_emulator.cli.command_line import main
from arm_emulator.identification.measured_run import MeasuredRun
from arm_emulator.identification.synthetic import make_record
from arm_emulator.machine.scene import load_scene

Rng = np.random.Generator

CONFIG = Path(__file__).resolve().parents[1] / "config"
PATIENCE = 10.0  # s of this process's time, or ten times that by the clock
MEMORY = 3 << 29  # bytes above what the process has: an archive's 512 MiB, its doubles, and some
NUMBERS = (0, 1, 2**15, 2**16 - 1, 2**31 - 1, 2**31, 2**32 - 1, 2**63 - 1, 2**64 - 1)


@dataclass(frozen=True)
class Kind:
    """A kind of files.

    Attributes:
        write: writes a sound one, and what it needs, into a folder; returns its path.
        words: of the command that reads it.
        odd: writes one that is wrong in a way of its kind, of a sound one.
        taken: whether a sound one is; False: it is refused for what it has a machine.
    """

    write: Callable[[Rng, Path], Path]
    words: Callable[[Path], list[object]]
    odd: Callable[[Rng, Path], None]
    taken: bool = True


def case(kind: str, rng: Rng, folder: Path) -> str:
    """Return the line that refuses a spoiled file, "" if it is taken."""
    folder.mkdir(parents=True)
    one = KINDS[kind]
    file = one.write(rng, folder)
    spoil(rng, file, one.odd)
    return verdict(file, one.words(file))


def verdict(file: Path, words: list[object]) -> str:
    """Run a command on a file; return the line that refuses it, "" if it is taken."""
    out, err = io.StringIO(), io.StringIO()
    before, sys.argv = sys.argv, ["arm_emulator", *map(str, words)]
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    started, began = time.process_time(), time.monotonic()
    code: object = None
    try:
        with (
            contextlib.redirect_stdout(out),
            contextlib.redirect_stderr(err),
            warnings.catch_warnings(),
            _bounded(),
        ):
            warnings.simplefilter("error")
            try:
                main()
            except SystemExit as end:
                code = end.code
    except BaseException:  # whatever it is, it is what is looked for
        raise AssertionError(f"{sys.argv[1:]}: {traceback.format_exc(limit=-6)}") from None
    finally:
        sys.argv = before
        for number, handler in handlers.items():
            signal.signal(number, handler)
    seconds = max(time.process_time() - started, 0.1 * (time.monotonic() - began))
    assert seconds < PATIENCE, f"{words} took {seconds:.1f} s"
    printed = err.getvalue()
    if code != 2:
        assert code in (0, 1, None), f"{words}: exit code {code}, {printed}"
        assert "Traceback" not in printed and "Warning" not in printed, printed
        return ""
    lines = printed.splitlines()
    assert len(lines) == 1 and lines[0].isprintable(), f"{words}: not one line: {printed!r}"
    named = file.name in lines[0] or str(file.parent) in lines[0]  # a bag is a folder
    assert named, f"{words}: no file is named: {printed!r}"
    return lines[0]


@contextlib.contextmanager
def _bounded() -> Iterator[None]:
    """Bound memory, and time by an alarm."""

    def late(number: int, frame: FrameType | None) -> None:
        raise TimeoutError(f"it takes more than {10.0 * PATIENCE} s")

    own = 4096 * int(Path("/proc/self/statm").read_text().split()[0])
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (own + MEMORY, hard))
    handler = signal.signal(signal.SIGALRM, late)
    signal.setitimer(signal.ITIMER_REAL, 10.0 * PATIENCE)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, handler)
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


# Ways that any file is spoiled in


def spoil(rng: Rng, file: Path, odd: Callable[[Rng, Path], None]) -> None:
    """Spoil a sound file: its bytes, what lies in its place, or in a way of its kind."""
    way = rng.random()
    if way < 0.35:
        odd(rng, file)
        if rng.random() < 0.2 and file.is_file() and file.stat().st_size < 1 << 22:
            file.write_bytes(damaged(rng, file.read_bytes()))
    elif way < 0.93:
        file.write_bytes(damaged(rng, file.read_bytes()))
    else:
        _in_its_place(rng, file)


def damaged(rng: Rng, data: bytes) -> bytes:
    """Return some bytes, spoiled in one to four places."""
    body = bytearray(data)
    for _ in range(int(rng.integers(1, 5))):
        size = len(body)
        if size == 0:
            break
        # Often at the begin or the end, where headings and indices are.
        at = int(rng.choice([rng.integers(size), min(size - 1, int(rng.exponential(100.0))),
                             max(0, size - 1 - int(rng.exponential(100.0)))]))  # fmt: skip
        much = int(rng.integers(1, 65))
        match int(rng.integers(10)):
            case 0:
                body[at] ^= 1 << int(rng.integers(8))
            case 1:
                del body[at:]
            case 2:
                del body[at : at + much]
            case 3:
                body[at:at] = rng.bytes(much)
            case 4:
                body[at : at + much] = rng.bytes(len(body[at : at + much]))
            case 5:
                body[at : at + much] = bytes(len(body[at : at + much]))
            case 6:
                other = int(rng.integers(size))
                body[at:at] = body[other : other + int(rng.integers(1, size + 1))]
            case 7:
                number = int(rng.choice(np.array(NUMBERS, dtype=object)))
                width = int(rng.choice([2, 4, 8]))
                number &= (1 << 8 * width) - 1
                body[at : at + width] = number.to_bytes(width, "little")
            case 8:
                body += bytes(int(10 ** rng.uniform(0, 6)))
            case _:
                whole = (b"", rng.bytes(size), bytes(size), body + body, body[::-1])
                body[:] = whole[int(rng.integers(len(whole)))]
    return bytes(body)


def _in_its_place(rng: Rng, file: Path) -> None:
    """Put something that is no file into the place of one."""
    file.unlink()
    match int(rng.integers(8)):
        case 0:
            file.mkdir()
        case 1:
            os.mkfifo(file)
        case 2:
            file.symlink_to(file)
        case 3:
            file.symlink_to("/dev/zero")
        case 4:
            file.symlink_to("/proc/self/mem")
        case 5:
            with contextlib.closing(socket.socket(socket.AF_UNIX)) as one:
                place = Path.cwd()
                os.chdir(file.parent)  # a socket's path is short
                try:
                    one.bind(file.name)
                finally:
                    os.chdir(place)
        case 6:
            with file.open("wb") as stream:
                stream.truncate(1 << 40)
        case _:
            pass  # nothing


# Kinds


def _scene(folder: Path) -> Path:
    (folder / "urdf").mkdir(exist_ok=True)
    (folder / "urdf" / "three_axis.urdf").write_text(URDF)
    file = folder / "spoiled.yaml"
    file.write_text(SCENE)
    return file


def _text_odd(rng: Rng, file: Path) -> None:
    """Spoiled versions of any text."""
    text = file.read_text()
    many = int(10 ** rng.uniform(1, 6))
    lines = text.splitlines()
    line = int(rng.integers(len(lines)))
    word = str(
        rng.choice(["nan", "inf", "1e999", "-", "1_0", "[", "{", "\x00", "\u2028", "é", "💥"])
    )
    match int(rng.integers(8)):
        case 0:
            file.write_bytes(text.encode("utf-16"))
        case 1:
            file.write_bytes(text.encode() + b"\xff\xfe")
        case 2:
            file.write_text(text * (1 + many // 1000))
        case 3:
            file.write_text(word * many)
        case 4:
            file.write_text("\n".join([*lines[:line], word * many, *lines[line:]]))
        case 5:
            file.write_text(text.replace("0", word, int(rng.integers(1, 4))))
        case 6:
            file.write_text("\r".join(lines))
        case _:
            file.write_text("[" * many if rng.random() < 0.5 else "<a>" * many)


TABLE_HEAD = "t,waist,shoulder,elbow"


def _table(rng: Rng, folder: Path) -> Path:
    file = folder / "spoiled.csv"
    rows = [f"{0.01 * k:g},0,{0.5 + 0.001 * k:.4f},0.8" for k in range(int(rng.integers(1, 20)))]
    file.write_text("\n".join([TABLE_HEAD, *rows]) + "\n")
    return file


def _table_odd(rng: Rng, file: Path) -> None:
    text = file.read_text()
    many = int(10 ** rng.uniform(1, 6))
    match int(rng.integers(7)):
        case 0:
            _text_odd(rng, file)
        case 1:
            file.write_text(text + "," * many + "\n")
        case 2:
            file.write_text(",".join(f"a{k}" for k in range(many)) + "\n" + text)
        case 3:
            file.write_text(text + '"' + "x\n" * many)
        case 4:
            file.write_text(text.replace(",", str(rng.choice([";", "\t", " , ", ",,"]))))
        case 5:
            file.write_text(TABLE_HEAD + "\n" + "\n" * many + text)
        case _:
            cells = text.split(",")
            cells[int(rng.integers(len(cells)))] = str(rng.choice(["", " ", "nan", "1e7", "-1"]))
            file.write_text(",".join(cells))


def _pendulum(folder: Path) -> Path:
    motor = {
        "kind": "torque",
        "rotor_inertia": 1e-3,
        "friction": {"viscous": 0.01, "coulomb": 0.02},
    }
    return write_scene(
        folder, one_link_urdf(), {"joint": {"motor": motor, "gear": {"ratio": 0.05}}},
        gravity=[0.0, 0.0, -9.81], servo_period=4e-3,
        integrator={"scheme": "rosenbrock", "dt": 1e-3},
    )  # fmt: skip


@cache
def _motion() -> MeasuredRun:
    with tempfile.TemporaryDirectory() as folder:
        return make_record(load_scene(_pendulum(Path(folder))), 3, 4.0, 1e-6, 0.02)


def _signals() -> dict[str, npt.NDArray[Any]]:
    """Return a record that `identify` takes."""
    run = _motion()
    return {"t": run.t.copy(), "q_mot": run.q_motor.copy(), "tau": run.tau.copy()}


def _identify(file: Path) -> list[object]:
    scene = _pendulum(file.parent)
    return ["identify", scene, file, "--out", file.parent / "fitted.yaml"]


@cache
def _bomb(name: str) -> bytes:
    """Return an archive of a MiB that unpacks to a GiB."""
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as archive:
        head = _npy_head(f"{{'descr': '<f8', 'fortran_order': False, 'shape': ({1 << 27},)}}")
        with archive.open(f"{name}.npy", "w", force_zip64=True) as entry:
            entry.write(head)
            for _ in range(1 << 6):
                entry.write(bytes(1 << 24))
    return made.getvalue()


def _archive(rng: Rng, folder: Path) -> Path:
    file = folder / "spoiled.npz"
    save = np.savez if rng.random() < 0.5 else np.savez_compressed
    save(file, **_signals())
    return file


def _archive_odd(rng: Rng, file: Path) -> None:
    signals = _signals()
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


def _record_table(rng: Rng, folder: Path) -> Path:
    file = folder / "spoiled.csv"
    rows = np.column_stack(list(_signals().values()))
    head = "t,q_mot.joint,tau.joint"
    np.savetxt(file, rows, "%.9g", ",", header=head, comments="")
    return file


JOINTS = "waist", "shoulder", "elbow"


def _board(rng: Rng, folder: Path) -> Path:
    board = {
        "clock": 168e6, "interrupts": 82, "cycles_per_instruction": 1,
        "memory": {
            "flash": {"at": 0x08000000, "size": 1 << 16},
            "ram": {"at": 0x20000000, "size": 1 << 16},
        },
        "registers": {"all": {"at": 0x40000000, "size": 0x8000}},
        "encoders": {name: {"at": 0x40000000 + 4 * k, "bits": 16} for k, name in enumerate(JOINTS)},
        "pwm": {
            name: {"kind": "float", "compare": 0x40000100 + 4 * k} for k, name in enumerate(JOINTS)
        },
    }  # fmt: skip
    (folder / "firmware.elf").write_bytes(_elf())
    file = folder / "spoiled.yaml"
    file.write_text(yaml.safe_dump(board))
    return file


def _elf() -> bytes:
    """Return firmware that sleeps: vectors, `wfi`, a jump back, and a table of symbols."""
    code = struct.pack("<2I", 0x20010000, 0x08000201) + bytes(0x1F8) + b"\x30\xbf\xfd\xe7"
    strings = b"\0main\0"
    symbols = bytes(16) + struct.pack("<IIIBBH", 1, 0x08000201, 4, 0x12, 0, 1)
    names = b"\0.text\0.symtab\0.strtab\0.shstrtab\0"
    at = 52 + 32
    places = [at, at + len(code)]
    places += [places[1] + len(symbols), places[1] + len(symbols) + len(strings)]
    table = places[3] + len(names)
    head = b"\x7fELF\x01\x01\x01" + bytes(9) + struct.pack(
        "<HHIIIIIHHHHHH", 2, 40, 1, 0x08000201, 52, table, 0x5000400, 52, 32, 1, 40, 5, 4
    )  # fmt: skip
    program = struct.pack("<8I", 1, at, 0x08000000, 0x08000000, len(code), len(code), 5, 4)
    sections = bytes(40)
    for name, kind, address, place, size, link, info, each in (
        (1, 1, 0x08000000, places[0], len(code), 0, 0, 0),
        (7, 2, 0, places[1], len(symbols), 3, 1, 16),
        (15, 3, 0, places[2], len(strings), 0, 0, 0),
        (23, 3, 0, places[3], len(names), 0, 0, 0),
    ):
        sections += struct.pack("<10I", name, kind, 0, address, place, size, link, info, 4, each)
    return head + program + code + symbols + strings + names + sections


def _firmware(rng: Rng, folder: Path) -> Path:
    _board(rng, folder).rename(folder / "board.yaml")
    file = folder / "spoiled.elf"
    file.write_bytes(_elf())
    return file


def _elf_odd(rng: Rng, file: Path) -> None:
    """Change a number in one of the headings."""
    body = bytearray(file.read_bytes())
    table = len(body) - 5 * 40
    at = int(rng.choice([rng.integers(16, 84), rng.integers(table, len(body) - 4)]))
    width = int(rng.choice([1, 2, 4]))
    number = int(rng.choice([0, 1, 2**16 - 1, 2**31, 2**32 - 1, rng.integers(2**32), len(body)]))
    body[at : at + width] = (number & (1 << 8 * width) - 1).to_bytes(width, "little")
    file.write_bytes(bytes(body))
    if rng.random() < 0.1:
        with file.open("ab") as stream:
            stream.truncate(1 << int(rng.integers(20, 30)))


def _config(kind: str, rng: Rng, folder: Path) -> Path:
    _scene(folder).rename(folder / "scene.yaml")
    for one in ("servo", "motion"):
        (folder / one).mkdir()
        (folder / one / "scene.yaml").write_text((CONFIG / one / "three_axis.yaml").read_text())
    return (folder / kind / "scene.yaml").rename(folder / kind / "spoiled.yaml")


def _run_words(kind: str) -> Callable[[Path], list[object]]:
    def words(file: Path) -> list[object]:
        scene = file.parents[1] / "scene.yaml"
        if f"\n{kind}:" not in (text := scene.read_text()):
            scene.write_text(f"{text}\n{kind}: {kind}/spoiled.yaml\n")
        return ["run", scene, "--seconds", 0.05]

    return words


def _urdf(rng: Rng, folder: Path) -> Path:
    file = folder / "spoiled.urdf"
    file.write_text(URDF)
    return file


XACRO = """<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:property name="m" value="${2 * 0.5}"/>
  <xacro:macro name="one" params="n parent">
    <link name="${n}"><inertial><mass value="${m}"/><origin xyz="0.1 0 0"/>
      <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
    <joint name="${n}_joint" type="revolute"><parent link="${parent}"/><child link="${n}"/>
      <axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="10" velocity="1"/></joint>
  </xacro:macro>
  <link name="base"/>
  <xacro:one n="a" parent="base"/>
  <xacro:one n="b" parent="a"/>
</robot>
"""


def _xacro(rng: Rng, folder: Path) -> Path:
    file = folder / "spoiled.xacro"
    file.write_text(XACRO)
    return file


def _xacro_odd(rng: Rng, file: Path) -> None:
    laughs = "".join(f'<!ENTITY a{i} "{f"&a{i - 1};" * 10}">' for i in range(1, 10))
    odd = (
        ("${2 * 0.5}", "${'a' * 10**10}"), ("${2 * 0.5}", "${[0] * 10**11}"),
        ("${2 * 0.5}", "${9**9**9}"), ("${2 * 0.5}", "${list(range(10**12))}"),
        ("${2 * 0.5}", "${1/0}"), ("${2 * 0.5}", "${().__class__.__bases__}"),
        ("${2 * 0.5}", "${load_yaml('/dev/zero')}"), ("${2 * 0.5}", "${xacro.load_yaml('a')}"),
        ("${2 * 0.5}", "$(find nowhere)"), ("${2 * 0.5}", "$(env HOME)"),
        ("${2 * 0.5}", "$(eval 1"), ("${2 * 0.5}", "${m}"), ("${2 * 0.5}", "${exit()}"),
        ('<link name="base"/>', '<xacro:include filename="/dev/zero"/>'),
        ('<link name="base"/>', '<xacro:include filename="spoiled.xacro"/>'),
        ('<link name="base"/>', '<xacro:include filename="/"/>'),
        ('<link name="${n}">', '<xacro:one n="c" parent="c"/><link name="${n}">'),
        ("<robot", f'<!DOCTYPE r [<!ENTITY a0 "ha">{laughs}]><robot a="&a9;"'),
        ("<link name=\"base\"/>", '<xacro:call macro="one"/>'),
        ("xmlns:xacro", "xmlns:x"),
    )  # fmt: skip
    old, new = odd[int(rng.integers(len(odd)))]
    file.write_text(XACRO.replace(old, new))


@cache
def _sound_bag(ticks: int = 15) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        bag = synthetic(Path(folder) / "bag", [True] * ticks, runs=1)
        return (bag / "bag_0.mcap").read_bytes()


def _bag(rng: Rng, folder: Path, ticks: int = 15) -> Path:
    file = folder / "bag" / "spoiled_0.mcap"
    file.parent.mkdir()
    body = _sound_bag(ticks)
    if rng.random() < 0.3:  # of a recorder that was killed
        body = body[: -int(rng.integers(1, len(body)))]
    file.write_bytes(body)
    return file


def _bag_odd(rng: Rng, file: Path) -> None:
    """Write chunks that are sound by their heading and their CRC, and not by what is in them."""
    stream = io.BytesIO(_sound_bag(210))
    ((packed,),) = [
        (one.data,)
        for one in StreamReader(stream, emit_chunks=True).records
        if isinstance(one, Chunk)
    ]
    inner = zstandard.decompress(packed)
    match int(rng.integers(9)):
        case 0:
            inner = damaged(rng, inner)
        case 1:
            inner = bytes(int(10 ** rng.uniform(1, 8)))
        case 2:  # a bomb
            _write_chunks(file, [_packed_zeros("zstd")] * 50)
            return
        case 3:
            _write_chunks(file, [(*_packed_zeros("lz4")[:2], bytes(100))])
            return
        case 4:
            _write_chunks(file, [(str(rng.choice(["lz4", "bz2", "", "zstd"])), packed, inner)])
            return
        case 5:
            size = int(rng.choice(np.array([0, 1, 2**31, 2**40, 2**63, 2**64 - 1], dtype=object)))
            inner += struct.pack("<BQ", int(rng.integers(256)), size)
        case 6:  # messages of another content
            at = inner.find(b"joint") % len(inner)
            inner = inner[:at] + damaged(rng, inner[at:])
        case 7:  # records of all kinds, without a chunk
            body = io.BytesIO()
            for _ in range(int(rng.integers(1, 100))):
                content = rng.bytes(int(rng.integers(100)))
                body.write(struct.pack("<BQ", int(rng.integers(1, 16)), len(content)) + content)
            file.write_bytes(MCAP0_MAGIC + body.getvalue() + MCAP0_MAGIC)
            return
        case _:
            many = int(10 ** rng.uniform(1, 7))
            text = str(rng.choice(["[", "{a: ", "- &a [*a]\n", "x", "&", "- depth: 1e99\n"])) * many
            writer = Writer(str(file), compression=CompressionType.NONE)
            writer.start("ros2")
            schema = writer.register_schema("std_msgs/msg/String", "ros2msg", text.encode())
            qos = {"offered_qos_profiles": text[: 1 << 16]}
            writer.add_message(writer.register_channel("/a", "cdr", schema, qos), 1, b"", 1)
            writer.finish()
            return
    _write_chunks(file, [("zstd", zstandard.compress(inner), inner)])


@cache
def _packed_zeros(compression: str) -> tuple[str, bytes, bytes]:
    zeros = bytes(1 << 28)
    pack = zstandard.compress if compression == "zstd" else lz4.frame.compress
    return compression, pack(zeros), zeros


def _write_chunks(file: Path, chunks: list[tuple[str, bytes, bytes]]) -> None:
    with file.open("wb") as stream:
        stream.write(MCAP0_MAGIC)
        for compression, packed, inner in chunks:
            builder = RecordBuilder()
            Chunk(compression, packed, 1, 0, zlib.crc32(inner), len(inner)).write(builder)
            stream.write(builder.end())


KINDS: dict[str, Kind] = {
    "scene": Kind(lambda _, folder: _scene(folder), lambda f: ["check-scene", f], _text_odd),
    "urdf": Kind(_urdf, lambda f: ["new", f, "--out", f.parent / "out"], _text_odd),
    "xacro": Kind(_xacro, lambda f: ["new", f, "--out", f.parent / "out"], _xacro_odd),
    "servo": Kind(lambda r, f: _config("servo", r, f), _run_words("servo"), _text_odd),
    "motion": Kind(lambda r, f: _config("motion", r, f), _run_words("motion"), _text_odd),
    "targets": Kind(
        _table, lambda f: ["run", "three_axis", "--targets", f, "--seconds", 0.02], _table_odd
    ),
    "archive": Kind(_archive, _identify, _archive_odd),
    "record": Kind(_record_table, _identify, _table_odd),
    "board": Kind(
        _board, lambda f: ["firmware", f, f.parent / "firmware.elf", "--seconds", 0.005], _text_odd
    ),
    "firmware": Kind(
        _firmware, lambda f: ["firmware", f.parent / "board.yaml", f, "--seconds", 0.005], _elf_odd
    ),
    "bag": Kind(_bag, lambda f: ["check-bag", f.parent, "--scene", "three_axis"], _bag_odd),
    "repaired": Kind(_bag, lambda f: ["repair", f.parent], _bag_odd),
    "identified": Kind(
        lambda r, f: _bag(r, f, 210),
        lambda f: ["identify", "three_axis", f.parent, "--out", f.parents[1] / "fitted.yaml"],
        _bag_odd,
        taken=False,
    ),
}  # fmt: skip
