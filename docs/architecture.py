"""Pictures of the page on the architecture: rooms and their imports, and one tick.

Rooms and floors follow from the contract of layers in pyproject.toml, imports from the sources.
The stations of a tick are a table here; each one's function must be defined in its file.
"""

import ast
import re
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from xml.sax.saxutils import escape

from docs.hooks import ROOT, Missing

NAMESPACE = "arm_emulator"  # imported itself, it gives the public names
INK, FAINT, PAPER = "#263238", "#90a4ae", "#ffffff"
BANDS = ("#eceff1", "#ffffff")


# ------------------------------------------------------------------------------------------ rooms


def list_floors() -> list[list[str]]:
    """Return the rooms of each floor, from the top, by the contract of layers.

    The public names lie above all rooms of the namespace.
    """
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    contracts = project["tool"]["importlinter"]["contracts"]
    layers = next(contract["layers"] for contract in contracts if contract["type"] == "layers")
    rooms = [[name.strip() for name in re.split("[|:]", layer)] for layer in layers]
    inside = (k for k, floor in enumerate(rooms) if floor[0].startswith(f"{NAMESPACE}."))
    rooms.insert(next(inside), [NAMESPACE])
    return rooms


def list_sources(room: str) -> list[Path]:
    """Return the Python files of a room.

    Raises:
        Missing: the contract names a room that has no file.
    """
    package, *rest = room.split(".")
    for top in (ROOT / package, ROOT / "packages" / package / package):
        place = top.joinpath(*rest)
        if room == NAMESPACE:
            return [top / "__init__.py"]
        if place.is_dir():
            return sorted(place.rglob("*.py"))
        if place.with_suffix(".py").is_file():
            return [place.with_suffix(".py")]
    raise Missing(f"files of the room {room}, which pyproject.toml names")


def _list_imports(file: Path) -> Iterator[str]:
    """Yield the dotted names that a file imports, each with the name that it takes from there."""
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def list_imports_of_rooms() -> dict[str, set[str]]:
    """Return the rooms that each room imports."""
    rooms = [room for floor in list_floors() for room in floor]
    imports: dict[str, set[str]] = {}
    for room in rooms:
        imports[room] = set()
        for file in list_sources(room):
            for name in _list_imports(file):
                parts = name.split(".")
                prefixes = (".".join(parts[:k]) for k in range(len(parts), 0, -1))
                target = next((prefix for prefix in prefixes if prefix in rooms), None)
                if target and target != room:
                    imports[room].add(target)
    return imports


def draw_rooms() -> str:
    """Draw the matrix of imports: a row imports the columns that have a dot."""
    rows, imports = list_floors(), list_imports_of_rooms()
    rooms = [room for floor in rows for room in floor]
    cell, left, top = 22, 260, 190
    width, height = left + cell * len(rooms) + 120, top + cell * len(rooms) + 20
    parts = [_draw_text(14, 26, "A row imports the columns that have a dot.", 14, weight="bold")]
    parts.append(_draw_text(14, 46, "Bands are floors: imports go down,", 12))
    parts.append(_draw_text(14, 62, "so every dot is right of the diagonal.", 12))
    y = top
    for k, floor in enumerate(rows):
        x = left + cell * rooms.index(floor[0])
        deep = cell * len(floor)
        parts.append(_draw_rectangle(8, y, width - 128, deep, BANDS[k % 2]))
        parts.append(_draw_rectangle(x, y, deep, deep, "#cfd8dc"))
        y += deep
    for k, room in enumerate(rooms):
        across, down = left + cell * k + cell // 2, top + cell * k + 15
        label = "public names" if room == NAMESPACE else room
        parts.append(_draw_text(left - 8, down, label, 12, anchor="end"))
        short = label.removeprefix(f"{NAMESPACE}.")
        parts.append(
            f'<text x="{across + 4}" y="{top - 8}" font-size="12" fill="{INK}" '
            f'transform="rotate(-60 {across + 4} {top - 8})">{escape(short)}</text>'
        )
        for target in sorted(imports[room]):
            x = left + cell * rooms.index(target) + cell // 2
            parts.append(
                f'<circle cx="{x}" cy="{down - 4}" r="6" fill="#00695c">'
                f"<title>{escape(room)} imports {escape(target)}</title></circle>"
            )
    return _write_svg(width, height, "Rooms and their imports", parts)


# ----------------------------------------------------------------------------------------- a tick


@dataclass(frozen=True)
class Station:
    """A place that a tick passes.

    Attributes:
        text: what happens there.
        file: the source, below the repository.
        function: that does it.
    """

    text: str
    file: str
    function: str


@dataclass(frozen=True)
class Band:
    """A thread or layer: stations of the command, and of the measurement.

    Attributes:
        title: of the band.
        down: stations of the command, in their order.
        up: stations of the measurement, in their order, from the bottom.
    """

    title: str
    down: Sequence[Station]
    up: Sequence[Station]


_SERVO_C = "arm_emulator/servo/c/servo.c"
_SERVO_NODE = "servo_node/c/answered_states.c"
_EMULATOR = "emulator_node/c/answered_ticks.c"
_BOUNDARY = "arm_emulator/core/boundary"
_SCHEMES = "arm_emulator/core/schemes"
_TICK_C = "arm_emulator/tick/c/tick.c"
_PUBLISH = "arm_emulator/ros/c/middleware.c"

TICK: tuple[Band, ...] = (
    Band(
        "servo node: one period in C",
        (
            Station("takes joint_targets", _SERVO_NODE, "answered_states_receive_target"),
            Station("judges stamp and rows", _SERVO_NODE, "answered_states_classify_target"),
            Station("keeps q, v and tau of each joint", _SERVO_C, "servo_aim"),
            Station("position, speed, current loop: volts", _SERVO_C, "servo_command"),
            Station("writes the message motor_commands", _SERVO_NODE, "publish_command"),
            Station("sends it through rcl: motor_commands", _PUBLISH, "ros_publish"),
        ),
        (
            Station("takes motor_states of this tick", _SERVO_NODE, "answered_states_receive"),
            Station("begins the servo period", _SERVO_NODE, "answered_states_accept"),
            Station("counts to angles, speeds, loads", _SERVO_C, "servo_measure"),
            Station("publishes joint_states, servo_states", _SERVO_NODE, "report"),
        ),
    ),
    Band(
        "emulator node: one tick in C",
        (
            Station("takes motor_commands", _EMULATOR, "answered_ticks_receive"),
            Station("reads the volts and their tick",
                    "emulator_node/c/motor_commands.c", "motor_commands_read"),
        ),
        (
            Station("writes the message motor_states", _EMULATOR, "report"),
            Station("sends it through rcl: motor_states", _PUBLISH, "ros_publish"),
        ),
    ),
    Band(
        "tick layer: two calls, for every door",
        (Station("the command of tick k leads to tick k + 1", _TICK_C, "tick_exchange"),),
        (Station("measures the present tick; tick_exchange the next", _TICK_C, "tick_measure"),),
    ),
    Band(
        "arm.h: a scene's library",
        (
            Station("checks the command", f"{_BOUNDARY}/boundary.hpp", "arm_exchange"),
            Station("power, brakes, delays", f"{_BOUNDARY}/arm_machine.hpp", "apply_commands"),
            Station("limits to the supply and the motor",
                    "arm_emulator/core/mechanics/command_bounds.hpp", "bound_commands"),
        ),
        (
            Station("sensors measure", "arm_emulator/core/mechanics/sensors.hpp", "measure"),
            Station("the encoder counts",
                    "arm_emulator/core/parts/measuring/encoder.hpp", "count_on_disc"),
            Station("fills arm_measurement", f"{_BOUNDARY}/arm_machine.hpp", "measure_machine"),
        ),
    ),
    Band(
        "motor thread: the steps of the period",
        (
            Station("runs the steps, checks energy and bounds",
                    "arm_emulator/core/machine/machine.hpp", "advance"),
            Station("one step after the other",
                    "arm_emulator/core/machine/command_schedule.hpp", "advance_steps"),
            Station("one step: motors, then links", f"{_SCHEMES}/two_threads.hpp", "step"),
            Station("motors by eq. (3)", f"{_SCHEMES}/paper.hpp", "step_drives"),
            Station("volts drive the winding, eq. (1)",
                    "arm_emulator/core/parts/motors/dc_motor.hpp", "rates"),
        ),
        (
            Station("waits for M and nle", f"{_SCHEMES}/two_threads.hpp", "receive_links"),
            Station("links' accelerations by eq. (4)", f"{_SCHEMES}/paper.hpp",
                    "compute_accelerations"),
            Station("q and v of the next sample", f"{_SCHEMES}/paper.hpp", "integrate"),
            Station("hands the sample to the other thread",
                    f"{_SCHEMES}/two_threads.hpp", "send_state"),
        ),
    ),
)  # fmt: skip
# Beside the motor thread; with `threads: 1` one_thread.hpp calls `dynamics` itself.
NEWTON_EULER = Band(
    "Newton-Euler thread, with threads: 2",
    (
        Station(
            "takes each sample that is handed over",
            f"{_SCHEMES}/two_threads.hpp",
            "evaluate_samples",
        ),
    ),
    (
        Station(
            "M and nle of the links",
            "arm_emulator/core/mechanics/links/link_tree.hpp",
            "compute_dynamics",
        ),
    ),
)


def has_definition(text: str, function: str, suffix: str) -> bool:
    """Return whether a source defines a function, not merely calls or declares it."""
    name = re.escape(function)
    if suffix == ".py":
        return bool(re.search(rf"^\s*def {name}\(", text, re.M))
    # A type before the name, and a body after the parameters.
    head = rf"^[ \t]*(?!return\b|else\b)(?:[\w:<>,&*]+[ \t]+)+[&*]?{name}\("
    for match in re.finditer(head, text, re.M):
        end = re.compile(r"\)[\w\s()]*\{|;").search(text, match.end())
        if end and end[0] != ";":
            return True
    return False


def check_stations(bands: Sequence[Band] = (*TICK, NEWTON_EULER)) -> None:
    """Check that each station's function is defined in its file.

    Raises:
        Missing: a file or a function does not exist.
    """
    for band in bands:
        for station in (*band.down, *band.up):
            file = ROOT / station.file
            if not file.is_file():
                raise Missing(f"file {station.file} of the station '{station.text}'")
            if not has_definition(file.read_text(encoding="utf-8"), station.function, file.suffix):
                raise Missing(f"definition of {station.function} in {station.file}")


def tick_picture() -> str:
    """Draw the way of a command down to the motors, and of the measurement back."""
    check_stations()
    left, right, box, high, gap = 30, 520, 450, 40, 14
    parts = [
        _draw_text(left, 30, "joint_targets: down to volts at the motor", 14, weight="bold"),
        _draw_text(
            right, 30, "encoder counts: up to motor_states and joint_states", 14, weight="bold"
        ),
    ]
    y = 46
    tops: dict[Station, int] = {}
    for k, band in enumerate((*TICK, NEWTON_EULER)):
        deep = 30 + max(len(band.down), len(band.up)) * (high + gap)
        parts.append(_draw_rectangle(10, y, 980, deep, BANDS[k % 2], FAINT))
        parts.append(_draw_text(20, y + 18, band.title, 12, weight="bold"))
        for x, column in ((left, band.down), (right, tuple(reversed(band.up)))):
            for i, station in enumerate(column):
                at = tops[station] = y + 28 + i * (high + gap)
                parts.append(_draw_rectangle(x, at, box, high, PAPER, "#00695c"))
                parts.append(_draw_text(x + 10, at + 16, station.text, 12))
                called = f"{station.file}: {station.function}"
                parts.append(_draw_text(x + 10, at + 32, called, 10.5, family="monospace"))
        y += deep
    down = [station for band in TICK for station in band.down]
    up = [station for band in reversed(TICK) for station in band.up]
    at = left + box - 30
    for above, below in pairwise(down):
        parts.append(_draw_arrow(at, tops[above] + high, at, tops[below]))
    at = right + box - 30
    for below, above in pairwise(up):
        parts.append(_draw_arrow(at, tops[below], at, tops[above] + high))
    (takes,), (links,) = NEWTON_EULER.down, NEWTON_EULER.up
    by_name = {station.function: station for station in (*down, *up)}
    across = (  # from the right column to the left, or the other way
        (by_name["servo_measure"], by_name["servo_command"]),
        (down[-1], up[0]),
        (by_name["send_state"], takes),
        (takes, links),
    )
    for start, end in across:
        from_left = start in down or start is takes
        x1, x2 = (left + box, right) if from_left else (right, left + box)
        parts.append(_draw_arrow(x1, tops[start] + high // 2, x2, tops[end] + high // 2))
    parts.append(_draw_arrow(right + 60, tops[links], right + 60, tops[up[0]] + high))
    return _write_svg(1000, y + 10, "One tick, from joint target to volts and back", parts)


def tick_table() -> str:
    """Return the stations of a tick as a table with links to their files."""
    check_stations()
    rows = ["| way | station | file | function |", "|---|---|---|---|"]
    for name, stations in (
        ("down", [station for band in TICK for station in band.down]),
        ("up", [station for band in reversed(TICK) for station in band.up]),
        ("beside", [*NEWTON_EULER.down, *NEWTON_EULER.up]),
    ):
        for station in stations:
            link = f"[{station.file}](../../{station.file})"
            rows.append(f"| {name} | {station.text} | {link} | `{station.function}` |")
    return "\n".join(rows)


# --------------------------------------------------------------------------------------- drawing


def _draw_text(
    x: float,
    y: float,
    text: str,
    size: float,
    *,
    anchor: str = "start",
    weight: str = "normal",
    family: str = "",
) -> str:
    shape = f' font-family="{family}"' if family else ""
    return (
        f'<text x="{x}" y="{y}" font-size="{size}" font-weight="{weight}" fill="{INK}" '
        f'text-anchor="{anchor}"{shape}>{escape(text)}</text>'
    )


def _draw_rectangle(x: int, y: int, width: int, height: int, fill: str, line: str = "none") -> str:
    return (
        f'<rect x="{x}" y="{y}" width="{width}" height="{height}" fill="{fill}" stroke="{line}"/>'
    )


def _draw_arrow(x1: int, y1: int, x2: int, y2: int) -> str:
    return (
        f'<line x1="{x1}" y1="{y1}" x2="{x2}" y2="{y2}" stroke="{INK}" stroke-width="1.5" '
        'marker-end="url(#head)"/>'
    )


def _write_svg(width: int, height: int, title: str, parts: Sequence[str]) -> str:
    head = (
        '<marker id="head" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="7" markerHeight="7" '
        f'orient="auto"><path d="M0 0 L8 4 L0 8 z" fill="{INK}"/></marker>'
    )
    return "\n".join(
        (
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" '
            f'viewBox="0 0 {width} {height}" font-family="sans-serif">',
            f"<title>{escape(title)}</title>",
            f"<defs>{head}</defs>",
            _draw_rectangle(0, 0, width, height, PAPER),
            *parts,
            "</svg>\n",
        )
    )


def draw_pictures() -> Iterator[tuple[str, str]]:
    """Yield the path below docs/ and the text of each picture."""
    yield "contribute/rooms.svg", draw_rooms()
    yield "contribute/tick.svg", tick_picture()
