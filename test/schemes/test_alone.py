"""Random mixtures of laws that stand alone, against a solution without decisions."""

import pytest
from draws import some

from oracles.alone import judge_mixture


# 15: a gap and friction with the load, where teeth part within a step.
@pytest.mark.slow
@pytest.mark.parametrize("seed", some([15, 1, 4, 7, 23, *range(30, 60)], 1))
def test_the_motion_is_that_of_smooth_equations_and_converges_to_it(seed: int) -> None:
    verdict = judge_mixture(seed)
    broken = [name for name, holds in verdict.claims.items() if not holds]
    assert not broken, f"{broken}: {verdict}"
