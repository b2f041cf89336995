"""Files from outside, spoiled at random: damaged, odd, huge, empty, or none at all.

`case(kind, rng, folder)` writes a sound file of a kind, spoils it and passes it to the command that
reads it. The command runs by the command line's own entry in this process. `case` returns the line
that refuses the file, or "" if it was accepted. It raises AssertionError at another outcome: a
traceback; a warning; more than one line; a line that does not name the file; more than some seconds
or more memory than the bounds allow.
"""

import contextlib
import io
import os
import resource
import signal
import socket
import sys
import time
import traceback
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

import numpy as np
from damaged_bytes import damaged
from random_scenes import SCENE, URDF
from spoiled_archives import archive_odd, pendulum, sound_signals, write_archive
from spoiled_bags import bag_odd, write_bag
from spoiled_firmware import elf_odd, write_board, write_firmware

from arm_emulator.cli.command_line import main

Rng = np.random.Generator

CONFIG = Path(__file__).resolve().parents[2] / "config"
PATIENCE = 10.0  # s of this process's time, or ten times that by the clock
MEMORY = 3 << 29  # bytes above what the process has: an archive's 512 MiB, its doubles, and some


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
    file_kind = KINDS[kind]
    file = file_kind.write(rng, folder)
    spoil(rng, file, file_kind.odd)
    return verdict(file, file_kind.words(file))


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
    choice = rng.random()
    if choice < 0.35:
        odd(rng, file)
        if rng.random() < 0.2 and file.is_file() and file.stat().st_size < 1 << 22:
            file.write_bytes(damaged(rng, file.read_bytes()))
    elif choice < 0.93:
        file.write_bytes(damaged(rng, file.read_bytes()))
    else:
        _in_its_place(rng, file)


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
            with contextlib.closing(socket.socket(socket.AF_UNIX)) as unix_socket:
                place = Path.cwd()
                os.chdir(file.parent)  # a socket's path is short
                try:
                    unix_socket.bind(file.name)
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


def _identify(file: Path) -> list[object]:
    scene = pendulum(file.parent)
    return ["identify", scene, file, "--out", file.parent / "fitted.yaml"]


def _record_table(rng: Rng, folder: Path) -> Path:
    file = folder / "spoiled.csv"
    rows = np.column_stack(list(sound_signals().values()))
    head = "t,q_mot.joint,tau.joint"
    np.savetxt(file, rows, "%.9g", ",", header=head, comments="")
    return file


def _config(kind: str, rng: Rng, folder: Path) -> Path:
    _scene(folder).rename(folder / "scene.yaml")
    for part in ("servo", "motion"):
        (folder / part).mkdir()
        (folder / part / "scene.yaml").write_text((CONFIG / part / "three_axis.yaml").read_text())
    return (folder / kind / "scene.yaml").rename(folder / kind / "spoiled.yaml")


def _run_words(kind: str) -> Callable[[Path], list[object]]:
    def words(file: Path) -> list[object]:
        scene = file.parents[1] / "scene.yaml"
        if f"\n{kind}:" not in (text := scene.read_text()):
            scene.write_text(f"{text}\n{kind}: {kind}/spoiled.yaml\n")
        return ["run", scene, "--seconds", 0.05]

    return words


ONE = """<link name="${n}"><inertial><mass value="${m}"/><origin xyz="0.1 0 0"/>
      <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
    <joint name="${n}_joint" type="revolute"><parent link="${parent}"/><child link="${n}"/>
      <axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="10" velocity="1"/></joint>"""


def _urdf(rng: Rng, folder: Path) -> Path:
    """Write what XACRO stands for, so that both share their libraries."""
    links = ['<robot name="r">\n  <link name="base"/>']
    for name, parent in (("a", "base"), ("b", "a")):
        links.append(ONE.replace("${n}", name).replace("${parent}", parent).replace("${m}", "1.0"))
    file = folder / "spoiled.urdf"
    file.write_text("\n  ".join([*links, "</robot>\n"]))
    return file


XACRO = f"""<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:property name="m" value="${{2 * 0.5}}"/>
  <xacro:macro name="one" params="n parent">
    {ONE}
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


KINDS: dict[str, Kind] = {
    "scene": Kind(lambda _, folder: _scene(folder), lambda f: ["check-scene", f], _text_odd),
    "urdf": Kind(_urdf, lambda f: ["new", f, "--out", f.parent / "out"], _text_odd),
    "xacro": Kind(_xacro, lambda f: ["new", f, "--out", f.parent / "out"], _xacro_odd),
    "servo": Kind(lambda r, f: _config("servo", r, f), _run_words("servo"), _text_odd),
    "motion": Kind(lambda r, f: _config("motion", r, f), _run_words("motion"), _text_odd),
    "targets": Kind(
        _table, lambda f: ["run", "three_axis", "--targets", f, "--seconds", 0.02], _table_odd
    ),
    "archive": Kind(write_archive, _identify, archive_odd),
    "record": Kind(_record_table, _identify, _table_odd),
    "board": Kind(
        write_board, lambda f: ["firmware", f, f.parent / "firmware.elf", "--seconds", 0.005],
        _text_odd,
    ),
    "firmware": Kind(
        write_firmware, lambda f: ["firmware", f.parent / "board.yaml", f, "--seconds", 0.005],
        elf_odd,
    ),
    "bag": Kind(write_bag, lambda f: ["check-bag", f.parent, "--scene", "three_axis"], bag_odd),
    "repaired": Kind(write_bag, lambda f: ["repair", f.parent], bag_odd),
    "identified": Kind(
        lambda r, f: write_bag(r, f, 210),
        lambda f: ["identify", "three_axis", f.parent, "--out", f.parents[1] / "fitted.yaml"],
        bag_odd,
        taken=False,
    ),
}  # fmt: skip
