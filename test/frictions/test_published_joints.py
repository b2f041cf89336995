"""Friction of published joints, measured by motions."""

from pathlib import Path

import numpy as np
import pytest
from draws import some

from bench.physics.published_joints import JOINTS, RAMP, WORDS, Stand


@pytest.mark.slow
@pytest.mark.parametrize("name", some(JOINTS, 1))
def test_a_joint_takes_the_published_friction_at_rest_and_in_motion(
    tmp_path: Path, name: str
) -> None:
    published, stand = JOINTS[name], Stand(name, tmp_path)
    rng = np.random.default_rng([*name.encode()])
    for kind in WORDS:
        load, part = rng.uniform(0.1, 1.0, 2) * (published.load, 1.0)
        # The ramp has steps and swings the disk; the figures of the data file have six digits.
        step = 4.0 * RAMP * published.load
        stiction = stand.measure_friction(kind, 0.0, load, published.load)
        assert stiction == pytest.approx(published.solve_balance(kind, 0.0, load), abs=step), (
            f"{kind}, {load}"
        )
        w = part * published.speed
        taken = stand.measure_friction(kind, w, load, published.load)
        assert taken == pytest.approx(published.solve_balance(kind, w, load), rel=1e-5), (
            f"{kind}, {w}"
        )
