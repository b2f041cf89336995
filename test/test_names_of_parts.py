"""Knowledge of a part or a scheme stands in its own files: no other code imports or names it."""

from __future__ import annotations

import re
from pathlib import Path

from arm_emulator.machine.parts.known import PARTS
from arm_emulator.machine.parts.sensors import ANALOG
from arm_emulator.machine.schemes.known import KNOWN as SCHEMES

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("arm_emulator", "emulator_node", "servo_node", "motion_controller_node")
# Sections of a joint of which the core, every door or every robot has exactly one, and a truth that
# is independent of the core and knows the parts that it solves.
KNOWN_THERE = {
    "arm_emulator/machine/joint.py": {"brake", "encoder", "end_stops", "torque_motor"},
    "arm_emulator/machine/outputs.py": {"encoder"},
    "arm_emulator/design/sizing.py": {"encoder"},
    "arm_emulator/analysis/rest_shares.py": {"encoder"},
    "arm_emulator/analysis/reference.py": {
        *("brake", "current_loop", "dc_motor", "elastic_gear", "end_stops", "progressive_gear"),
    },
}
# Files that have bases beside a part.
BASES = {"friction", "gear", "sensors"}


def _code() -> list[Path]:
    return [file for name in PACKAGES for file in sorted((ROOT / name).rglob("*.py"))]


def test_no_code_imports_a_part_but_by_the_list_of_parts() -> None:
    files = {kind.__module__.rpartition(".")[2] for kind in (*PARTS, *ANALOG)} - BASES
    files |= {"encoder"}
    found: dict[str, set[str]] = {}
    for file in _code():
        place = file.relative_to(ROOT).as_posix()
        if not place.startswith("arm_emulator/machine/parts/"):
            names = set(re.findall(r"machine\.parts\.(\w+) import", file.read_text()))
            if names & files:
                found[place] = names & files
    assert found == KNOWN_THERE, "knowledge of a part belongs to its own file"


def test_no_code_outside_the_schemes_names_one() -> None:
    """But the motion controller, one of whose methods is called as the paper, too."""
    words = re.compile(f'"({"|".join(SCHEMES)})"|arm::({"|".join(map(str.title, SCHEMES))})\\b')
    named = {
        file.relative_to(ROOT).as_posix()
        for file in _code()
        if "machine/schemes" not in file.as_posix() and words.search(file.read_text())
    }
    assert named == {"arm_emulator/motion/motion_config.py"}
    core = ROOT / "arm_emulator" / "core"
    own = {f"{name}.hpp" for name in SCHEMES}
    types = re.compile(rf"\b({'|'.join(one.__name__ for one in SCHEMES.values())})\b(?! \w)")
    for file in core.rglob("*.hpp"):
        lines = (line.partition("//")[0] for line in file.read_text().splitlines())
        assert file.name in own or not types.search("\n".join(lines)), file.name


def test_a_scheme_has_its_header_and_its_page() -> None:
    for name, one in SCHEMES.items():
        header = (ROOT / "arm_emulator" / "core" / one.header()).read_text()
        assert f"struct {one.__name__} : AnyScheme" in header, name
        page = ROOT / "docs" / "reference" / "schemes" / f"{name}.md"
        assert page.read_text().startswith(f"# `{name}`"), name
    pages = {page.stem for page in (ROOT / "docs" / "reference" / "schemes").glob("*.md")}
    assert pages == set(SCHEMES), "a page of each, and no other"
