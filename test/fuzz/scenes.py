"""Random scenes and URDFs: taken, or refused in one line that names the file, within 2 s.

python -m fuzz.scenes SEED FIRST STEP: case FIRST, FIRST + STEP, ... of a seed, until it is ended.
"""

from pathlib import Path

import numpy as np
from random_scenes import draw, verdict

from fuzz.in_folders import run


def case(seed: int, number: int, folder: Path) -> str:
    """Return the line that refuses case `number` of a seed, an empty one if it is taken."""
    return verdict(draw(np.random.default_rng([seed, number]), folder))


if __name__ == "__main__":
    run("scenes", case)
