"""No room outside the files of a part knows the part by its name.

What others need, a part declares. The names are those of the registry: classes, C++ types and
headers, kinds of motors, sections and keys.
"""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from arm_emulator.machine.parts.frictions.brake import Brake
from arm_emulator.machine.parts.measuring.encoder import Encoder, LinkEncoder
from arm_emulator.machine.parts.measuring.imu import Imu
from arm_emulator.machine.parts.measuring.sensors import SENSORS
from arm_emulator.machine.parts.part import Part
from arm_emulator.machine.scene.known_parts import MOTORS, PARTS

ROOT = Path(__file__).resolve().parents[2]
OWN = ("arm_emulator/machine/parts/", "arm_emulator/core/parts/", "oracles/parts/")
ROOMS = (
    "arm_emulator", "bench", "docs", "emulator_node", "examples", "launch",
    "motion_controller_node", "oracles", "packages", "servo_node", "tools",
)  # fmt: skip
TEXTS = (
    "bench/",
    "examples/",
    "oracles/",
    "packages/arm_emulator_identification/arm_emulator_identification/validation/",
    "arm_emulator/machine/faults/",
)
"""Rooms that write scenes, or name numbers of scenes, as users do."""

# Of the device itself, not of a drive: arm.h has a field for each in every machine.
OF_THE_DEVICE: tuple[type[Part] | type[Imu], ...] = (Brake, Encoder, LinkEncoder, Imu)
KINDS = tuple(kind for kind in (*PARTS, *SENSORS) if kind not in OF_THE_DEVICE)

# Kinds of motors that are called as what they are commanded: the words are quantities, too.
QUANTITIES = {"current", "torque"}
CLASSES = {kind.__name__ for kind in KINDS}
CXX = {kind.cxx for kind in KINDS if issubclass(kind, Part)}
HEADERS = {kind.header for kind in KINDS if issubclass(kind, Part)}
SHARED = {"motor", "gear", "friction"}  # sections of any motor, gear, friction
WORDS = {
    *(kind.kind for kind in MOTORS),
    *(kind.section.rpartition(".")[2] for kind in KINDS if issubclass(kind, Part)),
    *(key for kind in PARTS for key in getattr(kind, "named_by", ())),
} - {*SHARED, *QUANTITIES, "stiffness", "load"}  # the last: keys of many things

INDEPENDENT = "an independent solution or peer, whose equations must not follow from the parts"
ABOUT = "a bench about these very parts"
ALLOWED = {
    "arm_emulator/machine/scene/known_parts.py": "the list of all parts, by bases of kinds",
    "oracles/reference.py": INDEPENDENT,
    "oracles/smoothed_reference.py": INDEPENDENT,
    "oracles/alone.py": "draws what the smoothed reference solves",
    "bench/speed/bare.py": "the parts that peers have, too",
    "bench/speed/mujoco_peer.py": INDEPENDENT,
    "packages/arm_emulator_analysis/bench/advice.py": ABOUT,
    "packages/arm_emulator_identification/bench/doubtful_records.py": ABOUT,
    "arm_emulator/motion/model/elastic_arm.py": "the key of a number of its own data sheet",
    "arm_emulator/servo/servo_numbers.py": "a coefficient of the servo's law, called winding",
    "arm_emulator/core/mechanics/imu.hpp": "three sensors of the kind of any quantity",
    "arm_emulator/core/mechanics/sensors.hpp": "rows of the kind of any quantity",
}


def is_text(path: str) -> bool:
    return path.startswith(TEXTS) or "/bench/" in path


def in_python(text: str, with_words: bool) -> set[str]:
    """Return the names of parts in a Python source: what it imports and, if asked, its words."""
    tree = ast.parse(text)
    words = set()
    prose = {
        id(node.body[0].value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
        and node.body
        and isinstance(node.body[0], ast.Expr)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and "machine.parts" in (node.module or ""):
            words |= {name.name for name in node.names} & CLASSES
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and with_words:
            if id(node) not in prose and re.fullmatch(r"[\w.*{}]+", node.value):
                words |= set(node.value.split(".")) & WORDS
    return words


def in_cxx(text: str) -> set[str]:
    """Return the names of parts in a source of the core, beside its comments."""
    code = re.sub(r"//[^\n]*|/\*.*?\*/", "", text, flags=re.S)
    types = set(re.findall(r"(?:arm::|<|^|(?<=[\s(,]))(\w+)\b(?!::)", code)) & CXX
    aliases = set(re.findall(r"\busing (\w+) =", code))
    return (types - aliases) | set(re.findall(r'"parts/(\S+)"', code)) & HEADERS


def names_in(path: str) -> set[str]:
    text = (ROOT / path).read_text()
    return in_python(text, not is_text(path)) if path.endswith(".py") else in_cxx(text)


def sources() -> Iterator[str]:
    for room in ROOMS:
        for file in sorted((ROOT / room).rglob("*.*")):
            path = file.relative_to(ROOT).as_posix()
            if path.startswith(OWN) or "/build/" in path or "/test/" in path:
                continue
            if file.suffix in (".py", ".hpp", ".cpp", ".h", ".c"):
                yield path


@pytest.mark.slow
def test_no_room_names_a_part() -> None:
    found = {path: names_in(path) for path in sources()}
    assert len(found) > 500, "the rooms are there"
    named = {path: names for path, names in found.items() if names and path not in ALLOWED}
    assert not named, f"what these need of a part the part declares: {named}"


def test_every_exception_is_needed() -> None:
    assert not {path for path in ALLOWED if not names_in(path)}
