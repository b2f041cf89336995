"""Spoiled files of every kind that a command reads: taken, or refused in one line that names it.

python -m fuzz.files SEED FIRST STEP: case FIRST, FIRST + STEP, ... of a seed, until it is ended.
The kinds take turns.
"""

from __future__ import annotations

import itertools
import shutil
import sys
import tempfile
import traceback
from pathlib import Path

import numpy as np
from spoiled_files import KINDS
from spoiled_files import case as case_of

from fuzz.line import FAILED, REFUSED, TAKEN, tell


def case(seed: int, number: int, folder: Path) -> str:
    """Return the line that refuses case `number` of a seed, an empty one if it is taken."""
    turn, kind = divmod(number, len(KINDS))
    return case_of(list(KINDS)[kind], np.random.default_rng([seed, kind, turn]), folder)


def main() -> None:
    """Tell of each case before and after it."""
    seed, first, step = map(int, sys.argv[1:])
    scratch = Path(tempfile.mkdtemp(prefix="fuzz-files-"))
    try:
        for number in itertools.count(first, step):
            folder = scratch / str(number)
            tell(begin=number)
            try:
                line = case(seed, number, folder)
            except Exception:  # whatever it is, it is what is looked for
                tell(outcome=FAILED, count=1, what=traceback.format_exc(limit=-4))
            else:
                tell(outcome=REFUSED if line else TAKEN, count=1)
            shutil.rmtree(folder, ignore_errors=True)
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


if __name__ == "__main__":
    main()
