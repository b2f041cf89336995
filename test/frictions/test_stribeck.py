"""Friction that falls as a shaft begins to slide."""

from pathlib import Path

import numpy as np
import pytest
from draws import some
from stick_slip import assert_order_two, draw


@pytest.mark.parametrize(
    ("seed", "scheme"),
    some([(0, "rosenbrock"), (1, "extrapolated"), (2, "rosenbrock"), (3, "extrapolated")], 1),
)
def test_sticking_and_slipping_is_of_order_two_where_located(
    tmp_path: Path, seed: int, scheme: str
) -> None:
    friction, towed = draw(np.random.default_rng([seed, 31]))
    assert_order_two(tmp_path, towed, friction, scheme, stops=2)
