"""Tables and pictures of the pages, measured anew by one command: `make pages`.

A table stands on its page between two comments,

    <!-- tool_paths: measured by make pages -->
    ...
    <!-- end tool_paths -->

and what stands between them is the report of the bench of that name. Pictures are files in
docs/pictures. Nothing else on a page is changed.
"""

from __future__ import annotations

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

from rich.console import Console

from arm_emulator.base.refusal import Refusal
from bench import import_bench
from bench.measure import choose_compiler
from docs.hooks import list_page_files

ROOT = Path(__file__).resolve().parents[1]
PICTURES = ROOT / "docs" / "pictures"
BEGIN = r"<!-- {}: measured by make pages -->\n"
END = "<!-- end {} -->"
ANY_BEGIN = re.compile(BEGIN.format(r"(\w+)"))


def find_tables() -> dict[str, Path]:
    """Return the page of each measured table, by the name of its bench."""
    page_by_table = {}
    for page in (ROOT / "README.md", *list_page_files().values()):
        for name in ANY_BEGIN.findall(page.read_text(encoding="utf-8")):
            page_by_table[name] = page
    return page_by_table


def put_table(text: str, name: str, table: str) -> str:
    """Return a page's text with a table in its place.

    Raises:
        Refusal: the page has no such place.
    """
    place = re.compile(f"({BEGIN.format(name)})(.*?)({END.format(name)})", re.S)
    changed, count = place.subn(lambda match: f"{match[1]}{table.strip()}\n{match[3]}", text)
    if count != 1:
        raise Refusal("pages", f"place of {name}", "stand on one page once", count)
    return changed


def _write_table(name: str, page: Path) -> None:
    section = import_bench(name)
    table = section.write_report(section.run_bench(False))
    page.write_text(put_table(page.read_text(encoding="utf-8"), name, table), encoding="utf-8")


def _make_command(file: str, *words: str, into: str = "--out") -> Callable[[Path], Path]:
    """Return what makes a picture by a command, which writes it as `file` into a folder."""

    def make_file(scratch: Path) -> Path:
        command = [sys.executable, "-m", "arm_emulator", *words, into, str(scratch)]
        subprocess.run(command, check=True, cwd=ROOT)
        return scratch / file

    return make_file


def _draw_by_bench(name: str, function: str = "draw_picture") -> Callable[[Path], Path]:
    """Return what makes a picture by a bench that draws at once."""

    def make_file(scratch: Path) -> Path:
        file: Path = getattr(import_bench(name), function)(scratch)
        return file

    return make_file


def _draw_by_section(name: str, file: str, quick: bool = False) -> Callable[[Path], Path]:
    """Return what makes a picture of what a bench measures."""

    def make_file(scratch: Path) -> Path:
        section = import_bench(name)
        section.draw_figures(section.run_bench(quick), scratch)
        return scratch / file

    return make_file


PAINTERS: dict[str, Callable[[Path], Path]] = {
    "arm.gif": _draw_by_bench("moving_picture"),
    "campaign.png": _make_command(
        "influences.png", "campaign", "examples/campaign.yaml", into="--into"
    ),
    "faults.png": _draw_by_section("fault_matrix", "faults.png"),
    "feedforward.png": _draw_by_section("feedforward", "feedforward.png", quick=True),
    "fig4.png": _make_command("fig4.png", "demo", "three_axis"),
    "kuka_kr300_run_B.png": _make_command("kuka_kr300_run_B.png", "validate", "kuka_kr300"),
    "live_page.png": _draw_by_bench("page_picture", "live"),
    "look.png": _draw_by_bench("page_picture", "look"),
    "manutec_r3.png": _make_command("manutec_r3.png", "validate", "manutec_r3"),
    "published_joints.png": _draw_by_section("published_joints", "published_joints.png"),
    "published_responses.png": _draw_by_section("published_responses", "published_responses.png"),
    "tool_paths.png": _draw_by_bench("tool_paths"),
    "vibration.png": _draw_by_section("vibration", "vibration.png"),
    "tune_ur5.png": _make_command("tune_ur5.png", "tune", "ur5"),
}


def main() -> int:
    """Measure and draw all, or what is named; exit code 1 where something failed."""
    names = [*find_tables(), *PAINTERS]
    parser = argparse.ArgumentParser(prog="pages", description="Measure the pages' figures anew.")
    parser.add_argument("names", nargs="*", help=f"of {', '.join(names)} (default: all)")
    chosen = parser.parse_args().names or names
    console, failed = Console(), []
    for name in chosen:
        if name not in names:
            print(Refusal("pages", "name", "be known", name, ", ".join(names)), file=sys.stderr)
            return 2
        try:
            choose_compiler()
            if name in PAINTERS:
                with tempfile.TemporaryDirectory() as scratch:
                    shutil.copy(PAINTERS[name](Path(scratch)), PICTURES / name)
            else:
                _write_table(name, find_tables()[name])
        except (Refusal, subprocess.CalledProcessError) as error:
            failed.append(name)
            console.print(f"[red]{name}: {error}")
            continue
        console.print(f"{name}: done")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
