"""Every room has its floor in the contracts of pyproject.toml and its row in CONTRIBUTING.md."""

import ast
import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
from banned_words import ROOMS
from documents import ROOT

PROJECT: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]
LAYERS = next(
    contract for contract in PROJECT["importlinter"]["contracts"] if contract["type"] == "layers"
)
FLOORS = {name.strip() for floor in LAYERS["layers"] for name in floor.split("|")}
NO_ROOMS = {"test", "docs"}  # at the top level: nothing imports them


def packages(folder: Path) -> set[str]:
    """Return the names of a folder's packages."""
    return {path.parent.name for path in folder.glob("*/__init__.py")} - NO_ROOMS


BESIDE = {
    path.parent.name: path.parent
    for path in (ROOT / "packages").glob("*/arm_emulator_*/__init__.py")
}


def test_every_package_and_module_has_a_floor() -> None:
    """import-linter checks nothing of a room that no layer names."""
    inside = packages(ROOT / "arm_emulator")
    inside |= {path.stem for path in (ROOT / "arm_emulator").glob("*.py")} - {"__init__"}
    outside = packages(ROOT) - {"arm_emulator"} | set(BESIDE)
    assert {f"arm_emulator.{name}" for name in inside} | outside == FLOORS


def test_every_package_is_registered_with_import_linter_mypy_and_the_check_of_words() -> None:
    top, linter, mypy = packages(ROOT), PROJECT["importlinter"], PROJECT["mypy"]
    assert top | set(BESIDE) == set(linter["root_packages"])
    assert top | {"packages/*/arm_emulator_*"} <= set(mypy["files"])
    assert top | {"packages"} <= set(ROOMS)
    (public,) = (contract for contract in linter["contracts"] if contract["type"] == "forbidden")
    assert set(public["source_modules"]) == set(BESIDE)
    rooms = {f"arm_emulator.{name}" for name in packages(ROOT / "arm_emulator")}
    assert rooms - {"arm_emulator.extension"} <= set(public["forbidden_modules"])


def test_no_list_of_packages_is_incomplete() -> None:
    """Code that mypy does not find, circles that no contract checks."""
    linter, mypy = PROJECT["importlinter"], PROJECT["mypy"]
    (circles,) = (
        contract for contract in linter["contracts"] if contract["type"] == "acyclic_siblings"
    )
    assert set(circles["ancestors"]) == set(linter["root_packages"])
    folders = {path.parent.relative_to(ROOT).as_posix() for path in BESIDE.values()}
    assert folders == set(mypy["mypy_path"])


def test_every_room_has_a_row_in_the_table() -> None:
    table = (ROOT / "CONTRIBUTING.md").read_text().split("## The rooms")[1].split("\n- **")[0]
    firsts = re.findall(r"^\| (`.+?) \|", table, re.M)
    named = {
        name.rstrip("/").split("/")[-1] for row in firsts for name in re.findall("`(.+?)`", row)
    }
    rooms = packages(ROOT) - {"arm_emulator"} | packages(ROOT / "arm_emulator")
    assert named == rooms | {"arm_emulator_*", "arm_emulator_hardware"}
    for name, folder in BESIDE.items():
        assert re.match(rf"# {name}\n\n\w.*\.$", (folder.parent / "README.md").read_text(), re.M)


@pytest.mark.slow
def test_no_room_imports_the_public_names() -> None:
    """They lie above all rooms; the contracts do not see an import of the namespace itself."""
    for room in (*packages(ROOT) - {"bench", "oracles"},):
        for file in (ROOT / room).rglob("*.py"):
            if file == ROOT / "arm_emulator" / "__init__.py":
                continue
            for node in ast.walk(ast.parse(file.read_text())):
                assert not (isinstance(node, ast.ImportFrom) and node.module == "arm_emulator"), (
                    file
                )
