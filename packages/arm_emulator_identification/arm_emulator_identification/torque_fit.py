"""The unknowns that explain measured torques best, given their priors.

Least squares, each joint weighted by its own unexplained torque; the scene's values count as
measurements with standard deviations of their own. A number that the motion does not determine
keeps the scene's value, and its confidence shows it. Outlying rows count little. The residual
is searched for effects that the model lacks, and the confidence includes them.
"""

from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import least_squares

from arm_emulator.extension.base import Array
from arm_emulator_identification.filtered import Filtered, Mask
from arm_emulator_identification.residual_effects import (
    Effect,
    count_directions,
    estimate_correlation,
    find_structure,
)
from arm_emulator_identification.torque_model import MotionTorques, TorqueModel, Unknown

ITERATIONS = 5  # of fit, weights and loads in alternation
BEGIN = 0.3  # of each torque: initial assumption of noise
INSIDE = 0.03  # of their widths: initial distance from bounds
IDENTIFIED = 0.7  # of the prior width: a number that stays as uncertain is not identifiable
STANDS_OUT = 3.0  # times the usual residual: from here on rows count less
FAR_OUT = 6.0  # times: rows that are counted
AT_BOUND = 0.02  # of its width: distance at which a number is at its bound


@dataclass(frozen=True)
class TorqueFit:
    """Identified values and their confidence."""

    unknowns: list[Unknown]
    fitted: Mask  # which of them were sought (U,)
    values: Array  # (U,)
    covariance: Array  # (U, U); 0 where not sought
    directions: int  # of the unknowns' space that the motion determines, by SVD
    explained: Array  # (N,) %, see `compute_explained`
    effects: tuple[Effect, ...] = ()  # that the model lacks
    far_out: Array = field(default_factory=lambda: np.zeros(0))  # rows that stand out (N,)
    left: dict[int, str] = field(default_factory=dict)  # reasons for keeping numbers

    @property
    def deviations(self) -> Array:
        """Standard deviation of each value (U,)."""
        deviations: Array = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        return deviations


def compute_explained(torque: Array, error: Array, moving: Mask) -> Array:
    """Return 100 (1 - |error| / |torque - its mean|) of each joint where it moves (N,) [%]."""
    shares = []
    for y, e, rows in zip(torque.T, error.T, moving.T, strict=True):
        norm = np.linalg.norm(y[rows] - y[rows].mean()) if rows.any() else 0.0
        shares.append(100.0 * (1.0 - np.linalg.norm(e[rows]) / norm) if norm > 0.0 else np.nan)
    return np.array(shares)


def fit_torques(model: TorqueModel, data: Filtered, fitted: Mask,
                motion: MotionTorques | None = None) -> TorqueFit:  # fmt: skip
    """Return the unknowns that explain the torques of a motion.

    A number above 0 that the record drives to its bound keeps its value.

    Args:
        model: the machine.
        data: the motion, low-passed.
        fitted: which unknowns to seek (U,).
        motion: of `model.bind_motion(data)`, if already computed.
    """
    motion = motion or model.bind_motion(data)
    fitted = fitted.copy()
    left = dict[int, str]()
    while True:
        values, weights, motion = _search_values(model, data, fitted, motion)
        driven = _find_driven(model, fitted, values)
        if not driven:
            break
        for u, bound in driven.items():
            left[u] = f"left as it was: this record drives it to {bound:.3g}"
            fitted[u] = False
    error = motion.compute_torques(values) - data.tau
    slopes = motion.compute_slopes(values)[:, :, fitted]
    widths = model.widths[fitted]
    structure = find_structure(data, slopes, error, weights, widths, motion.load[data.fine.kept])
    covariance = np.zeros((len(values), len(values)))
    # Effects that the model lacks shift the numbers: the confidence includes the shift.
    shift = structure.shift
    covariance[np.ix_(fitted, fitted)] = structure.covariance + np.outer(shift, shift)
    noise = [_find_deviation(error[r, j]) for j, r in enumerate(data.moving.T)]
    rows = data.moving
    per_noise = (slopes / np.array(noise)[:, None])[rows] * widths
    far_out = np.array([int(((weights[:, j] < STANDS_OUT / FAR_OUT) & r).sum())
                        for j, r in enumerate(rows.T)])  # fmt: skip
    return TorqueFit(
        model.unknowns, fitted, values, covariance, count_directions(per_noise),
        compute_explained(data.tau, error, rows), structure.effects, far_out, left,
    )  # fmt: skip


def _search_values(model: TorqueModel, data: Filtered, fitted: Mask,
            motion: MotionTorques) -> tuple[Array, Array, MotionTorques]:  # fmt: skip
    """Return values (U,), weights of rows (K, N), and the motion under the gears' loads then."""
    start, widths = model.start, model.widths[fitted]
    low = np.array([unknown.least for unknown in model.unknowns])[fitted]
    high = np.array([unknown.most for unknown in model.unknowns])[fitted]
    inner = np.minimum(INSIDE * widths, 0.1 * (high - low))
    rows = data.moving
    deviation = np.array([_find_deviation(y[r] - y[r].mean() if r.any() else y[r])
                       for y, r in zip(data.tau.T, rows.T, strict=True)])  # fmt: skip
    noise, weights = BEGIN * deviation, np.ones_like(data.tau)
    values = start.copy()
    # Well inside the bounds, near which steps become short.
    values[fitted] = np.clip(values[fitted], low + inner, high - inner)

    def fill_values(some: Array) -> Array:
        every = start.copy()
        every[fitted] = some
        return every

    for _ in range(ITERATIONS):
        per = (np.sqrt(weights) / noise)[rows]

        def compute_residuals(some: Array, per: Array = per, at: MotionTorques = motion) -> Array:
            every = fill_values(some)
            error = (at.compute_torques(every) - data.tau)[rows] * per
            return np.concatenate([error, (every - start)[fitted] / widths])

        def compute_slopes(some: Array, per: Array = per, at: MotionTorques = motion) -> Array:
            scaled = at.compute_slopes(fill_values(some))[:, :, fitted][rows] * per[:, None]
            return np.concatenate([scaled, np.diag(1.0 / widths)])

        inside = np.clip(values[fitted], low + 1e-4 * inner, high - 1e-4 * inner)
        solution = least_squares(
            compute_residuals,
            inside,
            compute_slopes,
            bounds=(low, high),
            x_scale=widths,
            max_nfev=60,
        )
        values = fill_values(solution.x)
        motion = motion.update_loads(values)
        error = motion.compute_torques(values) - data.tau
        samples = used = 0.0
        for j, r in enumerate(rows.T):
            typical = max(1.4826 * float(np.median(np.abs(error[r, j]))) if r.any() else 1.0, 1e-12)
            weights[:, j] = np.minimum(
                1.0, STANDS_OUT * typical / np.maximum(np.abs(error[:, j]), 1e-300)
            )
            last = estimate_correlation(error[:, j], r)
            noise[j] = _find_deviation(np.sqrt(weights[r, j]) * error[r, j]) * np.sqrt(last)
            samples += r.sum() / last
        used = count_directions(compute_slopes(values[fitted])[: rows.sum()] * widths)
        # The residual lacks the part absorbed by the fit.
        noise *= np.sqrt(samples / max(samples - used, 0.2 * samples))
        noise = np.clip(noise, 1e-9 * deviation, deviation)
    return values, weights, motion


def _find_driven(model: TorqueModel, fitted: Mask, values: Array) -> dict[int, float]:
    """Return the bounds reached by numbers above 0, by unknown."""
    driven = {}
    for u in np.flatnonzero(fitted):
        unknown = model.unknowns[u]
        near = AT_BOUND * min(unknown.width, abs(unknown.value))
        for bound in (unknown.least, unknown.most):
            if np.isfinite(bound) and unknown.value and bound and abs(values[u] - bound) < near:
                driven[int(u)] = bound
    return driven


def _find_deviation(values: Array) -> float:
    if not len(values):
        return 1.0
    return max(float(np.sqrt(np.mean(values**2))), 1e-12)
