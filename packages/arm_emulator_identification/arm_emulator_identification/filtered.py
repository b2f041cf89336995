"""Low-pass filter of a record, to the bandwidth of rigid links.

It filters forward and backward, without a lag; or causally, with the same lag in all signals and
no influence of later samples.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter1d

from arm_emulator.extension.base import Array, Refusal
from arm_emulator_identification.measured_run import SLOWEST, MeasuredRun

Mask = NDArray[np.bool_]

ORDER = 4
FOR_SIGN = 4.0  # times the low-pass: bandwidth of the speed whose sign directs friction
EDGE = 2.0  # periods of the low-pass, at either end, in which the filter is not yet settled
REACH = 0.1  # periods of the low-pass
MAX_ROWS = 5000  # of a fit, for any length of the record
ROWS_PER_PERIOD = 2.5  # of the low-pass: more add nothing


@dataclass(frozen=True)
class FineMotion:
    """Every sample of a record, with a bandwidth that keeps reversals sharp. Arrays are (K, N).

    Nonlinear functions of speed or angle are computed here, then low-passed as the torque is.
    """

    t: Array  # s, (K,)
    q: Array  # rad or m, at the link
    v: Array  # 0 where a joint stands
    a: Array
    tau: Array  # N m, at the motor's shaft
    period: float  # s
    frequency: float  # Hz, of the low-pass
    kept: slice  # samples that are rows of `Filtered`
    causal: bool  # of the low-pass


@dataclass(frozen=True)
class Filtered:
    """Every few samples of a record. Arrays are (K, N)."""

    t: Array  # s, (K,)
    q: Array  # rad or m, at the link
    v: Array
    a: Array
    direction: Array  # of the motion, -1 to 1, filtered as the torque is
    tau: Array  # N m or N, of the motors, times the gears' ratios
    moving: Mask  # where friction has a direction
    fine: FineMotion

    def smooth_samples(self, rows: Array) -> Array:
        """Return samples of `fine` (K, ...), low-passed, at the rows of this."""
        fine = self.fine
        smooth: Array = filter_low_pass(rows, fine.period, fine.frequency, fine.causal)[fine.kept]
        return smooth


def filter_low_pass(rows: Array, period: float, frequency: float, causal: bool = False) -> Array:
    """Return rows (K, ...) low-passed at `frequency` [Hz]; without a lag unless causal."""
    from scipy import signal

    b, a = _design_low_pass(2.0 * frequency * period)
    smooth: Array
    if causal:
        # As if the first row had lasted.
        settled = np.multiply.outer(signal.lfilter_zi(b, a), rows[0])
        smooth = signal.lfilter(b, a, rows, axis=0, zi=settled)[0]
    else:
        smooth = signal.filtfilt(b, a, rows, axis=0)
    return smooth


@cache  # a fit filters thousands of columns alike
def _design_low_pass(cutoff: float) -> tuple[Array, Array]:
    """Return numerator and denominator for a share of the highest frequency."""
    from scipy import signal

    b, a = signal.butter(ORDER, cutoff)
    return b, a


def smooth_motion(
    q: Array, period: float, frequency: float, causal: bool = False
) -> tuple[Array, Array, Array]:
    """Return angles (K, N) low-passed at `frequency` [Hz], and their two rates."""
    smooth = filter_low_pass(q, period, frequency, causal)
    v = _differentiate_rows(smooth, period, causal)
    return smooth, v, _differentiate_rows(v, period, causal)


def _differentiate_rows(rows: Array, period: float, causal: bool) -> Array:
    """Return differences of second order: central ones, or, causally, backward ones."""
    rate: Array = np.gradient(rows, period, axis=0)
    if causal:
        rate[2:] = (1.5 * rows[2:] - 2.0 * rows[1:-1] + 0.5 * rows[:-2]) / period
    return rate


def filter_run(run: MeasuredRun, ratio: Array, frequency: float, slowest: float | None = None,
             every: int | None = None, causal: bool = False) -> Filtered:  # fmt: skip
    """Return a record low-passed.

    Args:
        run: the record.
        ratio: link turns per motor turn (N,).
        frequency: of the low-pass [Hz].
        slowest: speed from which a joint moves [rad/s or m/s]; None: a share of its top speed,
            without the samples near reversals.
        every: one of this many samples is kept; None: chosen by the low-pass.
        causal: filter forward only; the samples in motion are found in the two-way record.

    Raises:
        Refusal: the record is too coarse or too short for this frequency.
    """
    period = run.period
    if not 0.0 < frequency < 0.2 / period:
        rule = f"be > 0 and < {0.2 / period:.3g} Hz with samples every {period:g} s"
        raise Refusal(run.where, "low-pass", rule, frequency)
    if run.t[-1] - run.t[0] < 4.0 * EDGE / frequency:
        rule = f"last at least {4.0 * EDGE / frequency:.3g} s for a low-pass of {frequency:g} Hz"
        raise Refusal(run.where, "record", rule, f"{run.t[-1] - run.t[0]:.3g} s")
    q, v, a = smooth_motion(run.q_motor, period, frequency, causal)
    quick = min(FOR_SIGN * frequency, 0.2 / period)
    sharp, speed, acceleration = smooth_motion(run.q_motor, period, quick)
    top = np.quantile(np.abs(speed), 0.99, axis=0)
    turning = speed * (np.abs(speed) > 1e-3 * top)
    from_speed = SLOWEST * top if slowest is None else np.full_like(top, slowest)
    moving = np.abs(speed) > np.maximum(from_speed, 1e-12)
    if slowest is None:
        # The exact instant of a reversal cannot be observed.
        reach = int(REACH / (frequency * period))
        moving = minimum_filter1d(moving, 2 * reach + 1, axis=0)
    edge = int(EDGE / (frequency * period))
    few = max(int(1.0 / (ROWS_PER_PERIOD * frequency * period)), len(q) // MAX_ROWS)
    step = every or max(1, few)
    inside = slice(edge, len(q) - edge, step)
    tau = filter_low_pass(run.tau / ratio, period, frequency, causal)
    direction = filter_low_pass(np.sign(turning), period, frequency, causal)
    fine = FineMotion(
        run.t, sharp, turning, acceleration, run.tau, period, frequency, inside, causal
    )
    return Filtered(
        run.t[inside],
        q[inside],
        v[inside],
        a[inside],
        direction[inside],
        tau[inside],
        moving[inside],
        fine,
    )
