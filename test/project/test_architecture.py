"""The pictures of the architecture follow from the sources; headers include lower floors alone."""

import re
import tomllib
from dataclasses import replace
from pathlib import Path

import grimp
import pytest
from documents import DOCS, ROOT

from arm_emulator.core import CORE
from docs import architecture
from docs.hooks import Missing

STATIONS = [station for band in (*architecture.TICK, architecture.NEWTON_EULER)
            for station in (*band.down, *band.up)]  # fmt: skip


@pytest.mark.slow
def test_the_matrix_has_the_imports_that_import_linter_sees() -> None:
    """Truth: the graph of grimp, by which import-linter judges the contracts."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
    graph = grimp.build_graph(*project["root_packages"], cache_dir=None)
    result = architecture.list_imports_of_rooms()
    rooms = set(result) - {architecture.NAMESPACE}
    for room in rooms:
        if graph.find_children(room):
            graph.squash_module(room)
    for room in rooms:
        # A package that imports itself has no dot.
        imported = graph.find_modules_directly_imported_by(room) & rooms - {room}
        assert result[room] - {architecture.NAMESPACE} == imported, room
    picture = (DOCS / "contribute" / "rooms.svg").read_text()
    pictured = set(re.findall("<title>(\\S+) imports (\\S+)</title>", picture))
    assert pictured == {(room, to) for room, targets in result.items() for to in targets}


def test_every_floor_of_the_contract_is_a_row_of_the_picture() -> None:
    picture = (DOCS / "contribute" / "rooms.svg").read_text()
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
    layers = next(contract for contract in project["contracts"] if contract["type"] == "layers")[
        "layers"
    ]
    for room in " | ".join(layers).split(" | "):
        assert f">{room}</text>" in picture, room


@pytest.mark.parametrize(
    "station", STATIONS, ids=lambda station: f"{station.file}-{station.function}"
)
def test_a_station_names_a_function_of_its_file(station: architecture.Station) -> None:
    """A definition begins a line with a type, and no statement; its parameters lead to a body."""
    text = re.sub(r"\s+", " ", (ROOT / station.file).read_text())
    assert re.search(rf"[\w>*&] {station.function}\([^;{{}}]*\)[\w ()]*\{{", text)
    picture = (DOCS / "contribute" / "tick.svg").read_text()
    assert f"{station.file}: {station.function}</text>" in picture


@pytest.mark.parametrize(
    ("change", "missing"),
    [
        ({"function": "servo_commands"}, "definition of servo_commands in"),
        ({"function": "drive"}, "definition of drive in servo_node"),
        ({"file": "arm_emulator/tick/c/ticks.c"}, "file arm_emulator/tick/c/ticks.c"),
        # It is called there, and defined in servo.c.
        ({"function": "servo_command"}, "definition of servo_command in servo_node"),
    ],
)
def test_a_station_whose_function_is_elsewhere_is_refused(
    change: dict[str, str], missing: str
) -> None:
    station = architecture.Station(
        "", "servo_node/c/answered_states.c", "answered_states_set_target"
    )
    architecture.check_stations([architecture.Band("", (station,), ())])
    wrong = replace(station, **change)
    with pytest.raises(Missing, match=missing):
        architecture.check_stations([architecture.Band("", (wrong,), ())])


def test_a_room_without_files_is_refused() -> None:
    with pytest.raises(Missing, match=r"arm_emulator\.no_room"):
        architecture.list_sources("arm_emulator.no_room")


FLOORS = ("numerics", "parts", "mechanics", "schemes", "machine", "boundary")


def floor_of(file: Path) -> str:
    return file.relative_to(CORE).parts[0]


def test_a_header_includes_headers_of_its_floor_or_below() -> None:
    files = [file for file in CORE.rglob("*") if file.suffix in (".hpp", ".cpp", ".h", ".c")]
    assert {floor_of(file) for file in files} == set(FLOORS), "the floors"
    wrong, observed = [], 0
    for file in files:
        floor = FLOORS.index(floor_of(file))
        for name in re.findall(r'^#include "(.+)"', file.read_text(), re.M):
            target = CORE / name if "/" in name else file.parent / name
            assert target.is_file(), f"{file.name}: {name}"
            to = FLOORS.index(floor_of(target))
            observed += 1
            if to > floor:
                wrong.append(f"{file.relative_to(CORE)} includes {name}")
    assert observed > 100 and not wrong, wrong


def included(file: Path, observed: set[Path]) -> set[Path]:
    for name in re.findall(r'^#include "(.+)"', file.read_text(), re.M):
        if (CORE / name).is_file() and CORE / name not in observed:
            observed.add(CORE / name)
            included(CORE / name, observed)
    return observed


def test_a_header_includes_the_number_that_it_uses() -> None:
    """In a scene any part may come first."""
    real = CORE / "numerics" / "real.hpp"
    files = [file for file in CORE.rglob("*.hpp") if file.name not in ("real.hpp", "dual.hpp")]
    users = [file for file in files if re.search(r"\bReal\b", re.sub("//.*", "", file.read_text()))]
    assert len(users) > 50
    assert not [user_file.name for user_file in users if real not in included(user_file, set())]
