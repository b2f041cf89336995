"""The benchmark: `python -m bench`, in a source tree."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from arm_emulator.base.refusal import Refusal
from bench.measure import choose_compiler
from bench.report import run_benches


def main() -> int:
    """Measure; exit code 2 and one line for input that is not taken."""
    parser = argparse.ArgumentParser(prog="bench", description="Measure speed and accuracy.")
    parser.add_argument("--quick", action="store_true", help="fewer cases, to try it out")
    parser.add_argument(
        "--only",
        action="append",
        default=[],
        metavar="SECTION",
        help="measure this section (may be given several times)",
    )
    parser.add_argument("--out", type=Path, default=Path("out/bench"), help="folder for the report")
    parser.add_argument("--publish", type=Path, help="folder for a copy, docs/validation/report")
    arguments = parser.parse_args()
    try:
        choose_compiler()
        return run_benches(arguments.quick, arguments.only, arguments.out, arguments.publish)
    except Refusal as refusal:
        print(refusal, file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
