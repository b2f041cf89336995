"""The Manutec r3 with its published controllers, beside an independent solution."""

import numpy as np
import pytest
from draws import FULL, some

from arm_emulator_identification.validation.manutec_r3 import compare, simulate


@pytest.mark.slow
@pytest.mark.parametrize("scheme", some(["rosenbrock", "extrapolated"], 1))
def test_six_axes_stick_and_slip_as_others_have_computed_with_order_two(scheme: str) -> None:
    """Axes 1 to 3 at their motors, 4 to 6 at their links; peak friction at the wrist."""
    comparisons = [compare(simulate(period, scheme=scheme)) for period in (1e-4, 5e-5, 2.5e-5)]
    errors = [comparison.q.max() for comparison in comparisons]
    # Rows at the instants of change, of which the solution has two each, may be either way.
    assert comparisons[-1].other_modes <= 22, (
        f"{comparisons[-1].other_modes} of {comparisons[-1].rows}"
    )
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert orders == pytest.approx(2.0, abs=0.2), errors
    # By order 2 from 9e-9 rad at 10 us; the solution is good to 5e-9 rad.
    assert errors[-1] < 1e-7, errors
    # A held voltage makes the current of a period a bow; the solution's is smooth.
    assert comparisons[-1].current.max() < 1e-3, comparisons[-1].current
    assert comparisons[-1].wind_up.max() < 1e-5, comparisons[-1].wind_up


@pytest.mark.skipif(not FULL, reason="six axes are compiled once more for it")
def test_events_that_are_not_located_cost_accuracy() -> None:
    located, taken = (compare(simulate(2.5e-5, events=events)) for events in ("located", "step"))
    assert taken.q.max() > 3.0 * located.q.max()
