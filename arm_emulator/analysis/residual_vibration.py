"""Motion of a tool that remains after its reference has ended."""

from dataclasses import dataclass

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.base.refusal import Refusal

WHERE = "residual vibration"
QUANTITIES = {"largest": "m", "swing": "m", "rms": "m", "settled": "s"}
_PADDED = 8  # times as many samples as there are, for the spectrum
_PROMINENT = 0.05  # of the spectrum's largest value: what counts as a peak
_MIN_SAMPLES = 4  # samples
_STILL = 1e-3  # of the largest change of targets


@dataclass(frozen=True)
class ResidualVibration:
    """Motion of a tool after the end of its reference, against where it comes to rest."""

    largest: float
    """Largest deviation [m]."""
    swing: float
    """Half of the largest way from one turning point to the next [m]; 0: it only creeps."""
    rms: float
    """Root of the mean square of the deviation [m]."""
    frequency: float
    """Frequency at which its speed has the largest peak [Hz]: the undamped frequency of a mode that
    decays. NaN: there is no peak."""
    settled: float
    """Time from which on it stays within the band [s]."""


def measure_vibration(places: Array, period: float, band: float) -> ResidualVibration:
    """Return the vibration of a tool.

    Args:
        places: of the tool from the end of its reference on (K, 3) [m]; it rests at the last one.
        period: from one to the next [s].
        band: distance from there that counts as rest [m].

    Raises:
        Refusal: too few places, or numbers that are not finite.
    """
    if len(places) < _MIN_SAMPLES or not np.isfinite(places).all():
        rule = f"be followed by {_MIN_SAMPLES} samples of finite numbers at least"
        raise Refusal(WHERE, "the end of the reference", rule, len(places))
    off = places - places[-1]
    distance = np.linalg.norm(off, axis=1)
    outside = np.flatnonzero(distance > band)
    return ResidualVibration(
        largest=float(distance.max()),
        swing=max(_find_swing(row) for row in _rotate_to_main_axes(off).T),
        rms=float(np.sqrt((distance**2).mean())),
        frequency=_find_frequency(np.diff(off, axis=0), period),
        settled=period * float(outside[-1] + 1) if len(outside) else 0.0,
    )


def find_reference_end(targets: Array) -> int:
    """Return the sample at which joint targets (K, N) are reached at the earliest.

    It is as long after their last change as that is after the change before; 0: they never change.
    Changes below a thousandth of the largest do not count, such as those by a learned load at rest.
    """
    steps = np.linalg.norm(np.diff(targets, axis=0), axis=1)
    changes = np.flatnonzero(steps > _STILL * steps.max(initial=0.0)) + 1
    if not len(changes):
        return 0
    return int(changes[-1] + (changes[-1] - changes[-2] if len(changes) > 1 else 0))


def _rotate_to_main_axes(off: Array) -> Array:
    axes = np.linalg.svd(off, full_matrices=False)[2]
    return np.asarray(off @ axes.T)


def _find_swing(x: Array) -> float:
    """Return half of the largest way between two turning points that follow each other."""
    moves = np.concatenate([[True], np.diff(x) != 0.0])
    x = x[moves]
    reversals = np.flatnonzero(np.diff(np.sign(np.diff(x))) != 0.0) + 1
    return 0.5 * float(np.abs(np.diff(x[reversals])).max(initial=0.0))


def _find_frequency(speeds: Array, period: float) -> float:
    from scipy import signal  # takes long to import

    count = _PADDED * len(speeds)
    size = np.sqrt((np.abs(np.fft.rfft(speeds, count, axis=0)) ** 2).sum(axis=1))
    peaks, about = signal.find_peaks(size, prominence=_PROMINENT * float(size.max()))
    if not len(peaks):
        return float("nan")
    k = int(peaks[np.argmax(about["prominences"])])
    left, top, right = size[k - 1 : k + 2]
    return float((k + 0.5 * (left - right) / (left - 2.0 * top + right)) / (count * period))
