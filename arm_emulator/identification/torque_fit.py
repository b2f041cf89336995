"""The unknowns that explain measured torques best, beside what is known of them before.

Least squares, each joint weighted by its own unexplained torque; what the scene says counts as a
measurement with a standard deviation of its own. So a number of which the motion tells nothing
keeps the scene's value, and its confidence says so.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from arm_emulator.identification.filtered import Filtered, Mask
from arm_emulator.identification.torque_model import MotionTorques, TorqueModel, Unknown
from emulator_node.chain import Array

TURNS = 4  # in which fit and weights are found in turn
BEGIN = 0.3  # of each torque, at first taken to be noise
INSIDE = 0.03  # of their widths, by which the search begins away from bounds
NOT_TOLD = 0.7  # of the width before: what stays as uncertain is not identifiable


@dataclass(frozen=True)
class TorqueFit:
    """Found values and how sure they are."""

    unknowns: list[Unknown]
    fitted: Mask  # which of them were looked for (U,)
    values: Array  # (U,)
    covariance: Array  # (U, U); 0 where not looked for
    noise: Array  # N m or N at the links (N,): what stays unexplained, as of independent samples
    independent: Array  # (N,) samples that are worth one, since errors last
    directions: int  # of the unknowns' space that the motion tells of, by SVD
    explained: Array  # (N,) %, see `explained`

    @property
    def deviations(self) -> Array:
        """Standard deviation of each value (U,)."""
        deviations: Array = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        return deviations

    @property
    def identifiable(self) -> Mask:
        """Which of the unknowns the motion tells of by themselves (U,)."""
        widths = np.array([one.width for one in self.unknowns])
        told: Mask = self.fitted & (self.deviations < NOT_TOLD * widths)
        return told


def explained(torque: Array, error: Array, moving: Mask) -> Array:
    """Return 100 (1 - |error| / |torque - its mean|) of each joint where it moves (N,) [%]."""
    found = []
    for y, e, rows in zip(torque.T, error.T, moving.T, strict=True):
        spread = np.linalg.norm(y[rows] - y[rows].mean()) if rows.any() else 0.0
        found.append(100.0 * (1.0 - np.linalg.norm(e[rows]) / spread) if spread > 0.0 else np.nan)
    return np.array(found)


def fit_torques(model: TorqueModel, data: Filtered, fitted: Mask,
                motion: MotionTorques | None = None) -> TorqueFit:  # fmt: skip
    """Return the unknowns that explain the torques of a motion.

    Args:
        model: the machine.
        data: the motion, low-passed.
        fitted: which unknowns to look for (U,).
        motion: of `model.of(data)`, if it is there already.
    """
    motion = motion or model.of(data)
    start, widths = model.start, model.widths
    least = np.array([one.least for one in model.unknowns])[fitted]
    rows = data.moving
    spread = np.array([_spread(y[r]) for y, r in zip(data.tau.T, rows.T, strict=True)])
    noise, independent = BEGIN * spread, np.ones(len(spread))
    values = start.copy()
    # Well inside the bounds, near which steps become short.
    values[fitted] = np.maximum(values[fitted], least + INSIDE * widths[fitted])

    def whole(some: Array) -> Array:
        every = start.copy()
        every[fitted] = some
        return every

    def residuals(some: Array) -> Array:
        every = whole(some)
        error = (motion.torques(every) - data.tau) / noise
        return np.concatenate([error[rows], (every - start)[fitted] / widths[fitted]])

    def slopes(some: Array) -> Array:
        per_noise = motion.slopes(whole(some))[:, :, fitted] / noise[:, None]
        return np.concatenate([per_noise[rows], np.diag(1.0 / widths[fitted])])

    for _ in range(TURNS):
        inside = np.maximum(values[fitted], least + 1e-6 * widths[fitted])
        found = least_squares(
            residuals, inside, slopes, bounds=(least, np.inf), x_scale=widths[fitted], max_nfev=60
        )
        values = whole(found.x)
        error = motion.torques(values) - data.tau
        last = [_lasting(e, r) for e, r in zip(error.T, rows.T, strict=True)]
        independent = np.array(last)
        of_error = [_spread(e[r], 0.0) for e, r in zip(error.T, rows.T, strict=True)]
        # What the fit has bent to itself is missing in the residual.
        told = _directions(slopes(values[fitted])[: rows.sum()] * widths[fitted])
        samples = float((rows.sum(axis=0) / independent).sum())
        bent = np.sqrt(samples / max(samples - told, 0.2 * samples))
        noise = np.array(of_error) * np.sqrt(independent) * bent
        noise = np.clip(noise, 1e-9 * spread, spread)
    J = slopes(values[fitted])
    covariance = np.zeros((len(values), len(values)))
    covariance[np.ix_(fitted, fitted)] = np.linalg.inv(J.T @ J)
    told = _directions(J[: rows.sum()] * widths[fitted])
    error = motion.torques(values) - data.tau
    return TorqueFit(
        model.unknowns, fitted, values, covariance, noise, independent, told,
        explained(data.tau, error, rows),
    )  # fmt: skip


def _directions(per_width: Array) -> int:
    """Return in how many directions of the unknowns the record tells more than was known."""
    return int((np.linalg.svd(per_width, compute_uv=False) > 1.0).sum())


def _spread(values: Array, mean: float | None = None) -> float:
    if not len(values):
        return 1.0
    about = values.mean() if mean is None else mean
    return max(float(np.sqrt(np.mean((values - about) ** 2))), 1e-12)


def _lasting(error: Array, rows: Mask) -> float:
    """Return of how many samples an error lasts: 1 + 2 sum of its correlations, while positive."""
    some = np.where(rows, error, 0.0)
    power, total = float(some @ some), 1.0
    if power == 0.0:
        return 1.0
    for lag in range(1, len(some) // 4):
        correlation = float(some[lag:] @ some[:-lag]) / power
        if correlation < 0.05:
            break
        total += 2.0 * correlation
    return total
