"""Effects in the residual torque that the model lacks: their names, and their uncertainty.

An effect is one or more columns beside the model's, at one joint or the same at all: friction that
falls with speed, a wave over the angle, a delay. The effect that explains most of the residual, by
likelihood with the number of independent samples, is added; then the next. The difference between
the numbers fitted with and without these columns is their uncertainty.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from arm_emulator.extension.base import Array
from arm_emulator_identification.filtered import Filtered, Mask

MAX_EFFECTS = 12  # added one after the other
ENOUGH = 14.0  # of twice the logarithm of a likelihood, beyond a share for each column
SHARE = 0.04  # of a joint's residual: required of an effect
MATERIAL = 0.005  # of a joint's torque: smaller effects widen the deviations, but are not named
LIKELY = 0.75  # of the best one's likelihood: effects as likely are named, too
CLOSELY = 8  # candidates examined closely in each round
SLOW = (0.01, 0.03, 0.08, 0.2)  # of the top speed: where Stribeck's friction has fallen
SHORT = (0.003, 0.01, 0.03, 0.1)  # of the way: after which hysteresis is over
WAVES = 3  # largest ones tried
MIN_WAVES = 1.2  # waves required over the path

FALLS = "friction is higher near reversals and falls with speed (Stribeck?)"
RISES = "friction is lower near reversals and rises with speed (not Coulomb's alone)"
BENDS = "friction is not linear in speed"
TRAVEL = "torque depends on the way since the last reversal (hysteresis, bristles, play?)"
LOAD = "friction depends on the load of the gear (load friction?)"
ZERO = "torque has an offset, or friction differs between the two ways"
WARMS = "friction drifts over the record (temperature?)"
WEAKENS = "torque per ampere drifts over the record (temperature of magnets?)"
DRIFTS = "the zero of the torque drifts over the record"
LATE = "torque comes late"
EARLY = "torque comes early"
RIPPLE = "torque has waves over the angle (cogging, ripple, gear?)"


@dataclass(frozen=True)
class Columns:
    """Contribution of an effect to the torques, with the same coefficients at some joints."""

    name: str
    of: dict[int, Array]  # (K, m) by joint
    opposite: str = ""  # its name if the first coefficient is negative
    scale: float = 1.0  # from the first coefficient to the displayed value
    unit: str = ""


@dataclass(frozen=True)
class Effect:
    """An effect found in the residual."""

    name: str
    joints: tuple[int, ...]
    share: float  # of the residual of these joints that it explains
    size: float
    unit: str


@dataclass(frozen=True)
class ResidualEffects:
    """Analysis of the residual of a fit."""

    effects: tuple[Effect, ...]
    shift: Array  # (U,) shift of the sought unknowns beside these effects
    covariance: Array  # (U, U) of the shifted unknowns


@dataclass
class _Normal:
    """Normal equations with a growing number of columns, each joint's rows weighted by its
    residual.

    Unknowns are in units of their widths.
    """

    rows: list[Array]  # per joint: (n, U + effects)
    left: list[Array]  # per joint: residual (n,)
    prior: Array  # (U + effects,) prior, in units of its width

    def compute_inverse(self) -> Array:
        return _invert_matrix(sum(A.T @ A for A in self.rows) + np.diag(self.prior))


def _invert_matrix(H: Array) -> Array:
    """Return the inverse of a positive definite matrix, after scaling."""
    size = 1.0 / np.sqrt(np.maximum(np.diag(H), 1e-300))
    within = H * size[:, None] * size[None, :] + 1e-12 * np.eye(len(H))
    inverse: Array = np.linalg.inv(within) * size[:, None] * size[None, :]
    return inverse


def find_structure(data: Filtered, slopes: Array, error: Array, weights: Array, widths: Array,
                   load: Array) -> ResidualEffects:  # fmt: skip
    """Return the analysis of a fit's residual.

    Args:
        data: the motion.
        slopes: of the torques in the sought unknowns (K, N, U).
        error: computed less measured torques (K, N).
        weights: of the rows (K, N), from 0 to 1.
        widths: of the priors (U,).
        load: of the gears on the links (K, N).
    """
    masks = [data.moving[:, j] & (weights[:, j] > 0.0) for j in range(error.shape[1])]
    noise = np.array([
        _estimate_noise(-error[m, j], weights[m, j], estimate_correlation(error[:, j], m))
        for j, m in enumerate(masks)
    ])  # fmt: skip
    per = [np.sqrt(weights[m, j]) / noise[j] for j, m in enumerate(masks)]
    normal = _Normal(
        [slopes[m, j] * widths * per[j][:, None] for j, m in enumerate(masks)],
        [-error[m, j] * per[j] for j, m in enumerate(masks)],
        np.ones(len(widths)),
    )
    U = len(widths)
    shift = np.zeros(U)
    size_of = [float(np.std((data.tau[m, j]) * per[j])) for j, m in enumerate(masks)]
    effects = list[Effect]()
    candidates = [
        (effect, {j: C[masks[j]] * per[j][:, None] for j, C in effect.of.items()})
        for effect in _list_candidates(data, load, error, masks)
    ]
    for _ in range(MAX_EFFECTS):
        best = _find_best(normal, candidates, masks)
        if best is None:
            break
        names, index, share = best
        candidate, columns = candidates.pop(index)
        before = [float(r @ r) for r in normal.left]
        moved, coefficients = _add_effect(normal, columns)
        shift += moved[:U]
        size = float(coefficients[0]) * candidate.scale
        lost_sizes = [
            np.sqrt(max(before[j] - float(normal.left[j] @ normal.left[j]), 0.0) / len(C))
            for j, C in columns.items() if len(C)
        ]  # fmt: skip
        if any(lost > MATERIAL * size_of[j] for lost, j in zip(lost_sizes, columns, strict=False)):
            effects.append(
                Effect(" or ".join(names), tuple(columns), share, abs(size), candidate.unit)
            )
    independent = np.array(
        [_find_correlation_time(r, m) for r, m in zip(normal.left, masks, strict=True)]
    )
    covariance = _estimate_covariance(normal, masks, independent)[:U, :U]
    scaled = covariance * widths[:, None] * widths[None, :]
    return ResidualEffects(tuple(effects), shift * widths, scaled)


def estimate_correlation(error: Array, rows: Mask) -> float:
    """Return the correlation length of an error (K,) in some rows [samples]."""
    return _find_correlation_time(error[rows], rows)


def _find_correlation_time(left: Array, rows: Mask) -> float:
    """Return 1 + 2 sum of the residual's correlations in some rows, while positive."""
    some = np.zeros(len(rows))
    some[rows] = left
    power, total = float(some @ some), 1.0
    if power == 0.0:
        return 1.0
    for lag in range(1, max(2, len(some) // 4)):
        correlation = float(some[lag:] @ some[:-lag]) / power
        if correlation < 0.05:
            break
        total += 2.0 * correlation
    return total


def _estimate_noise(left: Array, weights: Array, independent: float) -> float:
    if not len(left):
        return 1.0
    power = float(np.sum(weights * left**2) / max(np.sum(weights), 1.0))
    return max(float(np.sqrt(power * independent)), 1e-12)


def _find_best(normal: _Normal, candidates: list[tuple[Columns, dict[int, Array]]],
          masks: list[Mask]) -> tuple[list[str], int, float] | None:  # fmt: skip
    """Return names, index and share of the likeliest effect, if one is likely enough."""
    inverse = normal.compute_inverse()
    gains = np.array([_compute_gain(normal, inverse, columns) for _, columns in candidates])
    ranking = []
    for index in np.argsort(-gains)[:CLOSELY]:
        candidate, columns = candidates[int(index)]
        dx, b = _solve_effect(normal, inverse, columns)
        before = after = likelihood = 0.0
        count = 0.0
        for j, C in columns.items():
            left = normal.left[j] - normal.rows[j] @ dx - C @ b
            was, now = float(normal.left[j] @ normal.left[j]), float(left @ left)
            before, after = before + was, after + now
            n = len(left) / _find_correlation_time(left, masks[j])
            count += n
            likelihood += n * np.log(max(was, 1e-300) / max(now, 1e-300))
        share = 1.0 - after / max(before, 1e-300)
        m = len(b)
        likelihood -= m * np.log(max(count, 2.0))
        name = candidate.opposite if candidate.opposite and b[0] < 0.0 else candidate.name
        ranking.append((likelihood, share, int(index), name))
    ranking.sort(reverse=True)
    if not ranking or ranking[0][0] < ENOUGH or ranking[0][1] < SHARE:
        return None
    likely = [ranked for ranked in ranking if ranked[0] > LIKELY * ranking[0][0]]
    names = list(dict.fromkeys(name for *_, name in likely))
    return names, ranking[0][2], ranking[0][1]


def _compute_products(normal: _Normal, columns: dict[int, Array]) -> tuple[Array, Array, Array]:
    """Return A'C, C'C and C'left."""
    g: Array = np.array([normal.rows[j].T @ C for j, C in columns.items()]).sum(axis=0)
    S: Array = np.array([C.T @ C for C in columns.values()]).sum(axis=0)
    c: Array = np.array([C.T @ normal.left[j] for j, C in columns.items()]).sum(axis=0)
    return g, S, c


def _compute_gain(normal: _Normal, inverse: Array, columns: dict[int, Array]) -> float:
    """Return the share of its joints' residual that an effect would explain, linearly."""
    g, S, c = _compute_products(normal, columns)
    own = S - g.T @ inverse @ g
    own += np.diag(1e-3 * np.diag(S) + 1e-300)  # effects within the model
    left = sum(float(normal.left[j] @ normal.left[j]) for j in columns)
    return float(c @ np.linalg.solve(own, c)) / max(left, 1e-300)


def _solve_effect(
    normal: _Normal, inverse: Array, columns: dict[int, Array]
) -> tuple[Array, Array]:
    """Return the shift of the unknowns beside an effect, and its coefficients."""
    g, S, c = _compute_products(normal, columns)
    own = S - g.T @ inverse @ g + np.diag(1e-3 * np.diag(S) + 1e-300)
    b = np.array(np.linalg.solve(own, c), np.float64)
    return np.array(-inverse @ g @ b, np.float64), b


def _add_effect(normal: _Normal, columns: dict[int, Array]) -> tuple[Array, Array]:
    """Add an effect to the model; return the shift of the unknowns, and its coefficients."""
    dx, b = _solve_effect(normal, normal.compute_inverse(), columns)
    m = len(b)
    size = sum(np.sum(C**2, axis=0) for C in columns.values())
    for j, A in enumerate(normal.rows):
        C = columns.get(j, np.zeros((len(A), m)))
        normal.left[j] = normal.left[j] - A @ dx - C @ b
        normal.rows[j] = np.column_stack([A, C])
    normal.prior = np.concatenate([normal.prior, 1e-3 * size + 1e-300])
    return dx, b


def _estimate_covariance(normal: _Normal, masks: list[Mask], independent: Array) -> Array:
    """Return the covariance of the unknowns and effects.

    Rows count by their number of independent samples in the present residual; if blocks of rows
    show longer correlations of the errors with a column, by those blocks.
    """
    rows, left = list[Array](), list[Array]()
    for A, r, last in zip(normal.rows, normal.left, independent, strict=True):
        power = float(r @ r) / max(len(r), 1)
        bent = max(len(r) / last, 1.0)
        per = 1.0 / max(
            np.sqrt(power * last * bent / max(bent - count_directions(A), 0.3 * bent)), 1e-150
        )
        rows.append(A * per)
        left.append(r * per)
    inverse = _invert_matrix(sum(A.T @ A for A in rows) + np.diag(normal.prior))
    K = len(masks[0])
    block = int(np.clip(2.0 * float(np.max(independent)), 1, max(1, K // 12)))
    scores = np.zeros((-(-K // block), len(inverse)))
    for A, r, mask in zip(rows, left, masks, strict=True):
        np.add.at(scores, np.flatnonzero(mask) // block, A * r[:, None])
    meat = scores.T @ scores + np.diag(normal.prior)
    robust = np.diag(inverse @ meat @ inverse) / np.maximum(np.diag(inverse), 1e-300)
    wider = np.sqrt(np.clip(robust, 1.0, 16.0))
    covariance: Array = inverse * wider[:, None] * wider[None, :]
    return covariance


def count_directions(A: Array) -> int:
    """Return the number of directions of the unknowns (U,) that rows (R, U) determine."""
    return int((np.linalg.eigvalsh(A.T @ A) > 1.0).sum()) if A.size else 0


def _list_candidates(data: Filtered, load: Array, error: Array,
               masks: list[Mask]) -> Iterator[Columns]:  # fmt: skip
    """Return the effects to try, at each joint and at all of them."""
    fine = data.fine
    N = error.shape[1]
    T = max(float(data.t[-1] - data.t[0]), 1e-12)
    since = (fine.t - data.t[0]) / T - 0.5
    settle = data.smooth_samples
    computed = data.tau + error
    rate = np.gradient(computed, data.t, axis=0)
    every = dict[int, Array]()
    for j in range(N):
        v, q, sign = fine.v[:, j], fine.q[:, j], np.sign(fine.v[:, j])
        top = max(float(np.quantile(np.abs(v), 0.99)), 1e-12)
        travel = max(float(np.ptp(q)), 1e-12)
        here = data.direction[:, j]

        def make_columns(name: str, *columns: Array, opposite: str = "", joint: int = j) -> Columns:
            return Columns(name, {joint: np.column_stack(columns)}, opposite)

        for share in SLOW:
            fallen = sign * np.exp(-np.minimum((v / (share * top)) ** 2, 700.0))
            yield make_columns(FALLS, settle(fallen), opposite=RISES)
        yield make_columns(BENDS, settle(v * np.abs(v)))
        yield make_columns(BENDS, settle(sign * np.sqrt(np.abs(v))))
        after = _measure_travel(q, sign)
        for share in SHORT:
            yield make_columns(TRAVEL, settle(sign * np.exp(-after / (share * travel))))
        yield make_columns(LOAD, here * np.abs(load[:, j]))
        yield make_columns(ZERO, np.ones(len(data.t)))
        yield make_columns(WARMS, settle(sign * since))
        yield make_columns(WARMS, settle(v * since))
        yield make_columns(WEAKENS, computed[:, j] * ((data.t - data.t[0]) / T - 0.5))
        yield make_columns(DRIFTS, (data.t - data.t[0]) / T - 0.5)
        every[j] = rate[:, j : j + 1]
        yield Columns(EARLY, {j: every[j]}, LATE, 1e3, "ms")
        for order in _find_orders(data, error[:, j], masks[j], j):
            wave = settle(np.column_stack([np.sin(order * q), np.cos(order * q)]))
            yield make_columns(RIPPLE, wave)
            yield make_columns(RIPPLE, wave * computed[:, j : j + 1])
    if N > 1:
        yield Columns(EARLY, every, LATE, 1e3, "ms")


def _measure_travel(q: Array, sign: Array) -> Array:
    """Return the distance of a joint from its last reversal (K,)."""
    distance = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(q)))])
    reversals = np.concatenate([[0], np.flatnonzero(np.diff(sign) != 0.0) + 1])
    last = reversals[np.searchsorted(reversals, np.arange(len(q)), side="right") - 1]
    travel: Array = distance - distance[last]
    return travel


def _find_orders(data: Filtered, error: Array, rows: Mask, j: int) -> list[float]:
    """Return the orders, in waves per turn of the link, of the largest waves in an error."""
    q, v, e = data.q[rows, j], np.abs(data.v[rows, j]), error[rows]
    travel = float(np.ptp(q)) if len(q) else 0.0
    if travel == 0.0:
        return []
    slow = max(float(np.quantile(v, 0.2)), 1e-9)
    highest = min(2.0 * np.pi * data.fine.frequency / slow, 2000.0 * np.pi / travel)
    orders = np.arange(MIN_WAVES * 2.0 * np.pi / travel, highest, np.pi / travel)
    if not len(orders):
        return []
    # Waves faster than the low-pass are removed.
    resolved = orders[:, None] * v[None, :] < 2.0 * np.pi * data.fine.frequency
    waves = np.exp(1j * orders[:, None] * q[None, :]) * resolved
    size = np.abs(waves @ e) ** 2 / np.maximum(resolved.sum(axis=1), 8.0)
    return [float(orders[k]) for k in np.argsort(-size)[:WAVES]]
