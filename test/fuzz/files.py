"""Spoiled files of every kind that a command reads: taken, or refused in one line that names it.

python -m fuzz.files SEED FIRST STEP: case FIRST, FIRST + STEP, ... of a seed, until it is ended.
The kinds take turns.
"""

from pathlib import Path

import numpy as np
from spoiled_files import KINDS
from spoiled_files import case as case_of

from fuzz.in_folders import run


def case(seed: int, number: int, folder: Path) -> str:
    """Return the line that refuses case `number` of a seed, an empty one if it is taken."""
    turn, kind = divmod(number, len(KINDS))
    return case_of(list(KINDS)[kind], np.random.default_rng([seed, kind, turn]), folder)


if __name__ == "__main__":
    run("files", case)
