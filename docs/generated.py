"""Generated text of the pages: tables of keys, messages, commands and doors, and examples.

It stands on its page between two comments,

    <!-- generated: KIND ARGUMENT -->
    ...
    <!-- end generated -->

and follows from the code by `GENERATORS[KIND]`. It is kept in the repository, so that the pages can
be read there, and so are the pictures of docs/architecture.py. `make tables` writes both; `make
lint` refuses what has fallen behind.
"""

import json
import posixpath
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

from docs import architecture, tables
from docs.hooks import DOCS, ROOT, Missing, list_page_files, read_code_block

PLACE = re.compile(
    r"^(<!-- generated: (\w+)(?: (\S+))? -->\n)(.*?)^(<!-- end generated -->)$", re.M | re.S
)
BEGIN = re.compile(r"^<!-- generated: ", re.M)
FAULT_HEADS = {
    "late": "command late on its line, by 2 periods",
    "lost": "all commands lost on their line",
    "stale": "answer to an earlier tick",
    "silence": "no command",
    "name": "wrong name of a joint",
    "nan": "NaN",
    "power": "power cut",
    "breakpoint": "breakpoint",
}
DOOR = re.compile(r"^<!-- door: (.+?) \| (.+) -->$", re.M)


def _write_help(_: str) -> str:
    from arm_emulator.cli.arguments import write_page
    from arm_emulator.cli.command import command_names, load_command

    pages = (
        (name, write_page(command)) for name in command_names() if (command := load_command(name))
    )
    return "\n\n".join(f"## {name}\n\n```text\n{page.rstrip()}\n```" for name, page in pages)


def _command_keys(_: str) -> str:
    from arm_emulator.cli.command import command_names, load_command

    rows = (
        f"| `{name}` | {command.keys} |"
        for name in command_names()
        if (command := load_command(name))
    )
    return "\n".join(("| command | keys |", "|---|---|", *rows))


def _write_interfaces(place: str) -> str:
    files = sorted((ROOT / place).glob("*.msg")) or sorted((ROOT / place).glob("*.srv"))
    if not files:
        raise Missing(f"messages in {place}")
    return "\n\n".join(
        f"### {file.stem}\n\n```text\n{file.read_text().rstrip()}\n```" for file in files
    )


def _list_doors(which: str) -> str:
    """Return a row for each page that states what its door offers, in a comment `door: ...`.

    Args:
        which: what it `needs`, the last of the columns; or nothing, for the others.
    """
    heads = ["door", "control law", "time", "measurements", "true state", "record",
             "needs beside Python and a compiler"]  # fmt: skip
    rows = [heads, ["---"] * len(heads)]
    for _, page in sorted(list_page_files().items(), reverse=True):
        if stated := DOOR.search(page.read_text()):
            at = posixpath.relpath(page.relative_to(ROOT).as_posix(), "docs/reference")
            rows.append([f"[{stated[1]}]({at})", *stated[2].split(" | ")])
    if len(rows) < 3:
        raise Missing("pages of doors")
    cells = ([row[0], row[-1]] if which == "needs" else row[:-1] for row in rows)
    return "\n".join(f"| {' | '.join(row)} |" for row in cells)


def _list_faults_at_doors(_: str) -> str:
    """Return what each door does about the same faults (packages/test/faults_at_doors.json)."""
    faults = json.loads((ROOT / "packages/test/faults_at_doors.json").read_text())
    words: dict[str, int] = {}  # of refusals, numbered

    def write_cell(outcome: str) -> str:
        if not outcome.startswith("refused: "):
            return outcome
        line = outcome.removeprefix("refused: ")
        return f"refused ({words.setdefault(line, len(words) + 1)})"

    rows = [["door", *FAULT_HEADS.values()], ["---"] * (1 + len(FAULT_HEADS))]
    for door in sorted(faults, key=lambda door: door.strip("`").lower()):
        rows.append([door, *(write_cell(faults[door][fault]) for fault in FAULT_HEADS)])
    lines = [f"| {' | '.join(row)} |" for row in rows]
    return "\n".join([*lines, "", *(f"{number}. `{line}`" for line, number in words.items())])


def _write_campaign_table(table: str) -> str:
    """Return a table of what a campaign's file may have, from its declaration."""
    from docs.campaign_tables import TABLES

    if table not in TABLES:
        raise Missing(f"{table} of campaigns; valid: {', '.join(TABLES)}")
    return TABLES[table]()


def _write_parameters(_: str) -> str:
    """Return a table for each node."""
    from docs.parameter_tables import write_parameters  # which imports ROS

    return write_parameters()


GENERATORS: dict[str, Callable[[str], str]] = {
    "campaign": _write_campaign_table,
    "command_keys": _command_keys,
    "commands": _write_help,
    "doors": _list_doors,
    "faults": tables.list_faults,
    "faults_at_doors": _list_faults_at_doors,
    "file": read_code_block,
    "inputs": tables.list_inputs,
    "interfaces": _write_interfaces,
    "joint_keys": tables.list_joint_keys,
    "keys": tables.list_keys,
    "outputs": tables.list_outputs,
    "parameters": _write_parameters,
    "parts": tables.list_parts,
    "scene_keys": tables.list_scene_keys,
    "schemes": tables.list_schemes,
    "sensors": tables.list_sensors,
    "tick": lambda _: architecture.tick_table(),
}


def fill_page(text: str) -> str:
    """Return the text of a page with its generated parts as the code has them.

    Raises:
        Missing: a generator or its subject does not exist, or a part has no end.
    """

    def write_part(place: re.Match[str]) -> str:
        if place[2] not in GENERATORS:
            raise Missing(f"generator {place[2]}; valid: {', '.join(GENERATORS)}")
        return f"{place[1]}\n{GENERATORS[place[2]](place[3] or '').strip()}\n\n{place[5]}"

    filled, count = PLACE.subn(write_part, text)
    if count != len(BEGIN.findall(text)):
        raise Missing("<!-- end generated --> of a generated part")
    return filled


def list_outdated_pages() -> Iterator[tuple[Path, str]]:
    """Yield the file and the new text of each page or picture that is outdated."""
    for page in list_page_files().values():
        text = page.read_text(encoding="utf-8")
        if (filled := fill_page(text)) != text:
            yield page, filled
    for path, text in architecture.draw_pictures():
        picture = DOCS / path
        if not picture.is_file() or picture.read_text(encoding="utf-8") != text:
            yield picture, text


def main(check: bool) -> int:
    """Write the pages that have fallen behind the code, or name them.

    Args:
        check: name them alone.

    Returns:
        1 if `check` found a page, else 0.
    """
    outdated = dict(list_outdated_pages())
    for path, text in outdated.items():
        state = "behind the code; run make tables" if check else "written"
        print(f"{path.relative_to(ROOT)}: {state}")
        if not check:
            path.write_text(text, encoding="utf-8")
    return int(check and bool(outdated))


if __name__ == "__main__":
    sys.exit(main("--check" in sys.argv[1:]))
