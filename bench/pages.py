"""Tables and pictures of the pages, measured anew by one command: `make pages`.

A table stands on its page between two comments,

    <!-- tool_line: measured by make pages -->
    ...
    <!-- end tool_line -->

and what stands between them is the report of the bench of that name. Pictures are files in
docs/pictures. Nothing else on a page is changed.
"""

from __future__ import annotations

import argparse
import importlib
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

from rich.console import Console

from arm_emulator.base.refusal import Refusal

ROOT = Path(__file__).resolve().parents[1]
PICTURES = ROOT / "docs" / "pictures"
BEGIN = r"<!-- {}: measured by make pages -->\n"
END = "<!-- end {} -->"
ANY_BEGIN = re.compile(BEGIN.format(r"(\w+)"))


def tables() -> dict[str, Path]:
    """Return the page of each measured table, by the name of its bench."""
    found = {}
    for page in sorted((ROOT / "docs").rglob("*.md")):
        for name in ANY_BEGIN.findall(page.read_text(encoding="utf-8")):
            found[name] = page
    return found


def put(text: str, name: str, table: str) -> str:
    """Return a page's text with a table in its place.

    Raises:
        Refusal: the page has no such place.
    """
    place = re.compile(f"({BEGIN.format(name)})(.*?)({END.format(name)})", re.S)
    changed, count = place.subn(lambda found: f"{found[1]}{table.strip()}\n{found[3]}", text)
    if count != 1:
        raise Refusal("pages", f"place of {name}", "stand on one page once", count)
    return changed


def _write_table(name: str, page: Path) -> None:
    section = importlib.import_module(f"bench.{name}")
    table = section.report(section.run(False))
    page.write_text(put(page.read_text(encoding="utf-8"), name, table), encoding="utf-8")


def _command(*words: str) -> None:
    subprocess.run([sys.executable, "-m", "arm_emulator", *words], check=True)


def _fig4(scratch: Path) -> Path:
    _command("demo", "three_axis", "--out", str(scratch))
    return scratch / "fig4.png"


def _arm(scratch: Path) -> Path:
    from bench import moving_picture

    return moving_picture.draw(scratch)


def _tune(scratch: Path) -> Path:
    _command("tune", "ur5", "--out", str(scratch))
    return scratch / "tune_ur5.png"


def _convergence(scratch: Path) -> Path:
    from bench import convergence

    convergence.draw(convergence.run(False), scratch)
    return scratch / "convergence.png"


def _feedforward(scratch: Path) -> Path:
    from bench import feedforward

    feedforward.draw(feedforward.run(True), scratch)
    return scratch / "feedforward.png"


def _faults(scratch: Path) -> Path:
    from bench import fault_matrix

    return fault_matrix.draw(fault_matrix.run(False), scratch)


def _manutec(scratch: Path) -> Path:
    _command("validate", "manutec_r3", "--out", str(scratch))
    return scratch / "manutec_r3.png"


def _kuka(scratch: Path) -> Path:
    _command("validate", "kuka_kr300", "--out", str(scratch))
    return scratch / "kuka_kr300_run_B.png"


def _tool_paths(scratch: Path) -> Path:
    from bench import tool_paths

    return tool_paths.draw(scratch)


def _kinds_of_moves(scratch: Path) -> Path:
    from bench import kinds_of_moves

    return kinds_of_moves.draw(scratch)


def _look(scratch: Path) -> Path:
    from bench import page_picture

    return page_picture.draw(scratch)


def _live_page(scratch: Path) -> Path:
    from bench import live_page_picture

    return live_page_picture.draw(scratch)


def _campaign(scratch: Path) -> Path:
    words = ["campaign", "examples/campaign.yaml", "--into", str(scratch)]
    subprocess.run([sys.executable, "-m", "arm_emulator", *words], check=True, cwd=ROOT)
    return scratch / "influences.png"


DRAWN: dict[str, Callable[[Path], Path]] = {
    "arm.gif": _arm,
    "campaign.png": _campaign,
    "convergence.png": _convergence,
    "faults.png": _faults,
    "feedforward.png": _feedforward,
    "fig4.png": _fig4,
    "kuka_kr300_run_B.png": _kuka,
    "kinds_of_moves.png": _kinds_of_moves,
    "live_page.png": _live_page,
    "look.png": _look,
    "manutec_r3.png": _manutec,
    "tool_paths.png": _tool_paths,
    "tune_ur5.png": _tune,
}


def main() -> int:
    """Measure and draw all, or what is named; exit code 1 where something failed."""
    names = [*tables(), *DRAWN]
    parser = argparse.ArgumentParser(prog="pages", description="Measure the pages' figures anew.")
    parser.add_argument("names", nargs="*", help=f"of {', '.join(names)} (default: all)")
    chosen = parser.parse_args().names or names
    console, failed = Console(), []
    for name in chosen:
        if name not in names:
            print(Refusal("pages", "name", "be known", name, ", ".join(names)), file=sys.stderr)
            return 2
        try:
            if name in DRAWN:
                with tempfile.TemporaryDirectory() as scratch:
                    shutil.copy(DRAWN[name](Path(scratch)), PICTURES / name)
            else:
                _write_table(name, tables()[name])
        except (Refusal, subprocess.CalledProcessError) as error:
            failed.append(name)
            console.print(f"[red]{name}: {error}")
            continue
        console.print(f"{name}: done")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
