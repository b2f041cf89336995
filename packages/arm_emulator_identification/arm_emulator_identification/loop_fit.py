"""Gears whose torque depends on the way of their twist, from encoders at both sides.

T = c + Kg w + Dg dw/dt + bend(w)     with the twist w = q_motor - q_link

T is the torque on the link that the fitted links take; c has in it the zero of the encoder. The
whole path of the twist counts, also where the link stands; rows of T count where it moves.

T is linear in the stiffness and in the size of the loop. Its shape has a likelihood with several
maxima, since elements slip one after the other: a grid of it carries the whole distribution, and at
each of its points that of the other numbers is normal.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from arm_emulator.extension.base import Array
from arm_emulator.extension.machine import Joint, Part, Scene
from arm_emulator_identification.filtered import FOR_SIGN, Filtered, Mask, smooth_motion
from arm_emulator_identification.found import Found
from arm_emulator_identification.measured_run import MeasuredRun
from arm_emulator_identification.residual_effects import estimate_correlation
from arm_emulator_identification.torque_fit import IDENTIFIED

SETTLED = 0.9  # of the twist's range, after whose passage the gear's history is known
COARSE, GRID = 81, 31  # shapes in the first turn, and in each further one
REFINEMENTS = 4  # of the grid, each where the last one had weight
AROUND = 4.0  # deviations of its prior: range of the first grid
MIN_SHARE = 0.2  # of the scene's number: its least
LIGHT = 1e-4  # of the largest weight: left out of the next grid
FIXED = 1e-9  # relative deviation of a number that is held
SMALL = 1e-2  # of the largest: errors of the load that are left out
DRAWS = 3  # of noise of the encoders
BLOCKS = 8  # of time, in which errors are taken for independent
# By which deviations of records of drawn machines fall short: what noise of the encoders does to
# elements that slip is corrected in the mean alone (bench/identification.py).
SHORT = 1.5
SLOPE = 0.01  # of the shape's number, for differences


@dataclass(frozen=True)
class GearLoads:
    """Torques of the gears on the links, at the rows of a motion.

    Attributes:
        load: as the fitted links take them (K, N) [N m or N].
        errors: by which they may be off, by a standard deviation each (M, K, N).
    """

    load: Array
    errors: Array


def list_gear_numbers(joint: Joint) -> dict[str, tuple[Part, str]]:
    """Return part and key of each number of a gear that shows in its wind-up, by name."""
    of_loops = [(part, key) for part in joint.parts for key in part.loop_keys]
    pairs: list[tuple[Part, str]] = [(joint.gear, "stiffness"), *of_loops]
    return {f"joints.{joint.name}.{part.section}.{key}": (part, key) for part, key in pairs}


def list_loops(scene: Scene, run: MeasuredRun, motion: Filtered, loads: GearLoads,
               is_requested: Callable[[str], bool], trust: float) -> list[Found]:  # fmt: skip
    """Return the numbers of gears that bend by the way of their twist.

    Args:
        scene: the nominal machine.
        run: the record.
        motion: the same, filtered.
        loads: of its gears.
        is_requested: whether a number of this name is to be found; others are held.
        trust: relative deviation of the scene's numbers.
    """
    loops = list[Found]()
    for j, joint in enumerate(scene.joints):
        numbers = list_gear_numbers(joint)
        if len(numbers) == 1 or not any(map(is_requested, numbers)):
            continue
        before = np.array([float(getattr(part, key)) for part, key in numbers.values()])
        values, off, left = before, np.full(len(before), np.nan), ""
        if not joint.gear.is_linear:
            left = "left as it was: loops are fitted to gears with a linear spring alone"
        elif run.q_link is None or np.isnan(run.q_link[:, j]).any():
            left = "left as it was: its loop needs an encoder at the link"
        else:
            widths = before * [trust if is_requested(name) else FIXED for name in numbers]
            values, off = _Loop(j, joint, run, motion).fit_loads(loads, before, widths)
        loop_kind = next(
            part.list_numbers()[key].excitation for part, key in numbers.values() if part.loop_keys
        )
        for k, (name, (part, key)) in enumerate(numbers.items()):
            if is_requested(name):
                width = trust * float(before[k])
                identified = bool(off[k] < IDENTIFIED * width)
                loops.append(
                    Found(name, part.list_numbers()[key].unit, float(before[k]), float(values[k]),
                          float(off[k]), identified, width, left, loop_kind)
                )  # fmt: skip
    return loops


class _Loop:
    """The gear of a joint in a record."""

    def __init__(self, j: int, joint: Joint, run: MeasuredRun, motion: Filtered) -> None:
        assert run.q_link is not None
        self.j, self.motion, self.damping = j, motion, joint.gear.damping
        self.part = next(part for part in joint.parts if part.loop_keys)
        self.period = run.period
        self.quick = min(FOR_SIGN * motion.fine.frequency, 0.2 / run.period)
        measured = (run.q_motor - run.q_link)[:, j]
        self.twist, self.rate = self.smooth_twist(measured)
        ranges = np.maximum.accumulate(self.twist) - np.minimum.accumulate(self.twist)
        settled = (ranges >= SETTLED * ranges[-1])[motion.fine.kept]
        self.rows: Mask = motion.moving[:, j] & settled
        rest = measured - self.twist
        noise = np.std(rest) / np.sqrt(1.0 - 2.0 * self.quick * run.period)
        draws = noise * np.random.default_rng(j).standard_normal((DRAWS, len(rest)))
        self.noisy = [self.smooth_twist(measured + draw)[0] for draw in draws]

    def smooth_twist(self, twist: Array) -> tuple[Array, Array]:
        """Return a measured twist and its rate at every sample (K,), low-passed."""
        smooth, rate, _ = smooth_motion(twist[:, None], self.period, self.quick)
        return smooth[:, 0], rate[:, 0]

    def smooth_samples(self, samples: Array) -> Array:
        """Return samples (K,) low-passed as the load is, in the rows that count (R,)."""
        rows: Array = self.motion.smooth_samples(samples)[self.rows]
        return rows

    def compute_loop_torque(self, shape: float) -> tuple[Array, Array]:
        """Return the torque of a loop of size 1, and what noise of the encoders took from it.

        Elements that slip follow the peaks of noise, which makes loops narrower: by as much as the
        same noise again does.
        """
        part = self.part.replace_numbers(
            **dict(zip(self.part.loop_keys, (1.0, shape), strict=True))
        )
        once = part.compute_loop_torque(self.twist)
        taken = self.smooth_samples(
            once - np.mean([part.compute_loop_torque(twist) for twist in self.noisy], axis=0)
        )
        return self.smooth_samples(once) + taken, taken

    def fit_loads(self, loads: GearLoads, before: Array, widths: Array) -> tuple[Array, Array]:
        """Return means and standard deviations of stiffness, size and shape (3,).

        Args:
            loads: of all gears.
            before: the scene's numbers.
            widths: their standard deviations.
        """
        load = loads.load[self.rows, self.j] - self.smooth_samples(self.damping * self.rate)
        errors = _reduce_errors(loads.errors[:, self.rows, self.j])
        twist, noise = self.smooth_samples(self.twist), float(np.std(load))
        low, high = before[2] - AROUND * widths[2], before[2] + AROUND * widths[2]
        shapes = np.geomspace(max(low, MIN_SHARE * before[2]), high, COARSE)
        for turn in range(REFINEMENTS):
            points = [
                _Point(
                    shape,
                    np.vstack([twist, self.compute_loop_torque(shape)[0], -errors]),
                    load,
                    before,
                    widths,
                )
                for shape in shapes
            ]
            noise = min(point.estimate_noise(noise, self.rows) for point in points)
            weights = np.array([point.weigh_shape(noise) for point in points])
            weights = np.exp(weights - weights.max())
            heavy = np.flatnonzero(weights > LIGHT)
            if turn == REFINEMENTS - 1 or (turn > 0 and len(heavy) > GRID // 2):
                break
            ends = max(heavy[0] - 1, 0), min(heavy[-1] + 1, len(shapes) - 1)
            shapes = np.linspace(float(shapes[ends[0]]), float(shapes[ends[1]]), GRID)
        share = weights / weights.sum()
        means, squares = np.zeros(3), np.zeros(3)
        for part, point in zip(share, points, strict=True):
            mean, variance = point.solve_shape(noise)
            means += part * mean
            squares += part * (variance + mean**2)
        variances = np.maximum(squares - means**2, (1e-12 * means) ** 2)
        by_blocks = self.estimate_by_blocks(means, load, twist, errors, noise, widths)
        return means, SHORT * np.sqrt(np.maximum(variances, by_blocks))

    def estimate_by_blocks(self, means: Array, load: Array, twist: Array, errors: Array,
                           noise: float, widths: Array) -> Array:  # fmt: skip
        """Return variances (3,) that hold where errors last long, and of what noise has taken.

        The sum over blocks of time of their own shift of the numbers, squared (W. K. Newey and
        K. D. West, Econometrica 55, 1987, with blocks in the place of lags).
        """
        stiffness, size, shape = means
        bent, taken = self.compute_loop_torque(shape)
        by = SLOPE * shape
        slope = (
            (self.compute_loop_torque(shape + by)[0] - self.compute_loop_torque(shape - by)[0])
            * size
            / (2.0 * by)
        )
        A = np.vstack([twist, bent, slope, -errors])
        A -= A.mean(axis=1, keepdims=True)
        left = load - stiffness * twist - size * bent
        per = np.append(widths, np.ones(len(errors))) ** -2.0
        gain = np.linalg.inv(A @ A.T / noise**2 + np.diag(per)) @ A / noise**2
        left = left - left.mean()
        blocks = np.array_split(np.arange(len(left)), BLOCKS)
        shifts = np.array([gain[:, block] @ left[block] for block in blocks])[:, :3]
        more = 0.5 * gain[:3] @ (size * (taken - taken.mean()))
        # Errors of the load are unknowns of `gain`, which has their part of the deviations.
        own = np.diag(np.linalg.inv(A @ A.T / noise**2 + np.diag(per)))[:3]
        variances: Array = own + BLOCKS / (BLOCKS - 3.0) * (shifts**2).sum(axis=0) + more**2
        return variances


class _Point:
    """Normal distribution of the numbers in which the torque is linear, at one shape of the loop.

    Args:
        shape: of the loop.
        columns: torques per stiffness, per size, and of each error of the load (P, R).
        load: torque (R,).
        before: the scene's numbers, stiffness, size and shape.
        widths: their standard deviations.
    """

    def __init__(self, shape: float, columns: Array, load: Array, before: Array,
                 widths: Array) -> None:  # fmt: skip
        self.shape, self.apart = shape, (shape - before[2]) / widths[2]
        self.A = (columns - columns.mean(axis=1, keepdims=True)).T
        self.load = load - load.mean()
        errors = len(columns) - 2
        self.prior = np.append(before[:2], np.zeros(errors))
        self.per = np.append(widths[:2], np.ones(errors)) ** -2.0

    def infer_point(self, noise: float) -> tuple[Array, Array]:
        """Return means (P,) and their precision (P, P)."""
        precision = self.A.T @ self.A / noise**2 + np.diag(self.per)
        means: Array = np.linalg.solve(
            precision, self.A.T @ self.load / noise**2 + self.per * self.prior
        )
        return means, precision

    def estimate_noise(self, noise: float, rows: Mask) -> float:
        """Return the standard deviation of the load per independent row, where `noise` weighs."""
        left = self.load - self.A @ self.infer_point(noise)[0]
        every = np.zeros(len(rows))
        every[rows] = left
        independent = len(left) / estimate_correlation(every, rows) - len(self.prior) - 1.0
        return max(float(np.sqrt(left @ left / max(independent, 1.0))), 1e-300)

    def weigh_shape(self, noise: float) -> float:
        """Return the logarithm of the likelihood of this shape."""
        means, precision = self.infer_point(noise)
        left = (self.load - self.A @ means) / noise
        far = self.per * (means - self.prior) ** 2
        log_det = np.linalg.slogdet(precision)[1]
        return float(-0.5 * (left @ left + far.sum() + log_det + self.apart**2))

    def solve_shape(self, noise: float) -> tuple[Array, Array]:
        """Return means and variances of stiffness, size and shape (3,)."""
        means, precision = self.infer_point(noise)
        variances = np.diag(np.linalg.inv(precision))
        return np.append(means[:2], self.shape), np.append(variances[:2], 0.0)


def _reduce_errors(errors: Array) -> Array:
    """Return the fewest errors (M, R) of the same covariance, but for small ones."""
    if not errors.size:
        return errors
    _, sizes, rows = np.linalg.svd(errors, full_matrices=False)
    fewest: Array = (sizes[:, None] * rows)[sizes > SMALL * sizes[0]]
    return fewest
