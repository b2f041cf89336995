"""The pictures of the architecture follow from the sources."""

from __future__ import annotations

import re
import tomllib
from dataclasses import replace

import grimp
import pytest
from documents import DOCS, ROOT

from docs import architecture
from docs.hooks import Missing

STATIONS = [one for band in (*architecture.TICK, architecture.NEWTON_EULER)
            for one in (*band.down, *band.up)]  # fmt: skip


def test_the_matrix_has_the_imports_that_import_linter_sees() -> None:
    """Truth: the graph of grimp, by which import-linter judges the contracts."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
    graph = grimp.build_graph(*project["root_packages"], cache_dir=None)
    result = architecture.imports_of_rooms()
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


@pytest.mark.parametrize("station", STATIONS, ids=lambda one: f"{one.file}-{one.function}")
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
    station = architecture.Station("", "servo_node/c/answered_states.c", "answered_states_aim")
    architecture.check_stations([architecture.Band("", (station,), ())])
    wrong = replace(station, **change)
    with pytest.raises(Missing, match=missing):
        architecture.check_stations([architecture.Band("", (wrong,), ())])


def test_a_room_without_files_is_refused() -> None:
    with pytest.raises(Missing, match=r"arm_emulator\.no_room"):
        architecture.sources("arm_emulator.no_room")
