"""Unknowns of one's own from a record: any function of them may set the scene's numbers.

The emulator itself follows the record: its commands drive an arm per unknown side by side, and
Gauss-Newton brings its signals to the measured ones.
"""

import dataclasses
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import least_squares

from arm_emulator.extension.base import ANY_COMMANDS, ANY_STATE, Array, Refusal, coerce_array
from arm_emulator.extension.machine import (
    KNOWN_OUTPUTS,
    STATE_ROWS,
    Scene,
    coerce_scene,
    list_outputs,
    list_variable_numbers,
)
from arm_emulator_fleet import Fleet
from arm_emulator_identification.residual_effects import estimate_correlation

WHERE = "fit_numbers"
STEP = 0.01  # of an unknown's width, for the derivative
ROUNDS = 3  # of fit and weights in alternation

Modifier = Callable[[Mapping[str, float]], Mapping[str, float]]


@dataclass(frozen=True)
class Sought:
    """An unknown.

    Attributes:
        value: where the search begins.
        width: standard deviation with which that is known.
        least, most: its range.
    """

    value: float
    width: float
    least: float = -math.inf
    most: float = math.inf


@dataclass(frozen=True)
class FittedNumbers:
    """Unknowns found.

    Attributes:
        values, deviations: of the unknowns, by name.
        numbers: what the modifier makes of them, by the names of the scene's numbers.
        errors: root mean square of each signal's residual, by name.
    """

    values: dict[str, float]
    deviations: dict[str, float]
    numbers: dict[str, float]
    errors: dict[str, float]


def fit_numbers(
    scene: Scene | str | Path,
    commands: ArrayLike,
    signals: Mapping[str, ArrayLike],
    sought: Mapping[str, Sought],
    modifier: Modifier = dict,
) -> FittedNumbers:
    """Return the unknowns with which the machine follows a record.

    Args:
        scene: the nominal machine, at rest in its start when the record begins.
        commands: of the motors in each servo period (K, N) [V, N m or A].
        signals: measured after each period (K, N), by names of `Plant.measured` or `Plant.state`.
        sought: the unknowns, by names of one's own.
        modifier: makes the scene's numbers, by names that could be `varied`, of values of the
            unknowns. Without one the unknowns are such numbers themselves.

    Raises:
        Refusal: unknown names, wrong shapes, numbers out of their ranges.
    """
    scene = coerce_scene(scene, WHERE)
    rows = ANY_COMMANDS.check_numbers(WHERE, commands)
    if rows.ndim != 2 or rows.shape[1] != len(scene.joints) or not len(rows):
        raise Refusal(WHERE, "commands", f"have shape (K, {len(scene.joints)})", rows.shape)
    if not isinstance(signals, Mapping) or not isinstance(sought, Mapping):
        value = signals if isinstance(sought, Mapping) else sought
        raise Refusal(WHERE, "sought and signals", "be given by names", value)
    if not callable(modifier):
        raise Refusal(WHERE, "modifier", "be a function of the unknowns", modifier)
    measured = {name: _check_signal(scene, name, values, rows) for name, values in signals.items()}
    if not (sought and measured):
        raise Refusal(WHERE, "sought and signals", "be one or more", "none")
    fit = _Fit(scene, rows, measured, sought, modifier)
    x = fit.begin
    for _ in range(ROUNDS):
        x = fit.solve_least_squares(x, fit.estimate_noise(x))
    left = np.split(np.mean(fit.followed(x.tobytes())[0] ** 2, axis=0), len(measured))
    return FittedNumbers(
        dict(zip(sought, x.tolist(), strict=True)),
        dict(zip(sought, fit.compute_deviations(x).tolist(), strict=True)),
        fit.make_numbers(x),
        {
            name: float(np.sqrt(np.mean(residual)))
            for name, residual in zip(measured, left, strict=True)
        },
    )


class _Fit:
    """Errors of the machine against a record, as functions of the unknowns x (U,).

    Args:
        scene: the nominal machine.
        rows: commands (K, N).
        measured: signals (K, N) by name, C columns in all.
        unknowns: the unknowns.
        modifier: makes the scene's numbers of them.
    """

    def __init__(
        self,
        scene: Scene,
        rows: Array,
        measured: Mapping[str, Array],
        unknowns: Mapping[str, Sought],
        modifier: Modifier,
    ) -> None:
        ranges = [_check_unknown(name, unknown) for name, unknown in unknowns.items()]
        self.begin, self._width, self._low, self._high = np.array(ranges).T
        self._names, self._modifier = list(unknowns), modifier
        self._rows, self._signals = rows, list(measured)
        self._machine = _make_varied_scene(scene, self.make_numbers(self.begin))
        self._truth = np.concatenate([*measured.values()], axis=1)
        self.followed = lru_cache(4)(self._compute_errors)

    def make_numbers(self, x: Array) -> dict[str, float]:
        """Return the scene's numbers that the unknowns make.

        Raises:
            Refusal: the modifier returns something else.
        """
        numbers = self._modifier(dict(zip(self._names, x.tolist(), strict=True)))
        if not isinstance(numbers, Mapping) or not numbers:
            raise Refusal(WHERE, "modifier", "return numbers by name", numbers)
        return dict(numbers)

    def _compute_errors(self, at: bytes) -> tuple[Array, Array]:
        """Return the errors at some unknowns (K, C), and their slopes (K, C, U)."""
        x = np.frombuffer(at)
        steps = _choose_steps(x, self._width, self._low, self._high)
        variations = [self.make_numbers(values) for values in (x, *(x + np.diag(steps)))]
        outputs = _simulate_fleet(self._machine, variations, self._rows, self._signals)
        slopes = np.moveaxis((outputs[1:] - outputs[0]) / steps[:, None, None], 0, -1)
        return outputs[0] - self._truth, slopes

    def estimate_noise(self, x: Array) -> Array:
        """Return the root mean square of the errors (C,)."""
        size = np.sqrt(np.mean(self.followed(x.tobytes())[0] ** 2, axis=0))
        noise: Array = np.maximum(size, 1e-12 * (1.0 + np.abs(self._truth).max()))
        return noise

    def _weigh_errors(self, x: Array, noise: Array) -> tuple[Array, Array]:
        """Return errors and prior in units of their deviations, and the slopes."""
        error, slopes = self.followed(x.tobytes())
        rows = (slopes / noise[:, None]).reshape(-1, len(x))
        left = np.concatenate([(error / noise).ravel(), (x - self.begin) / self._width])
        return left, np.vstack([rows, np.diag(1.0 / self._width)])

    def solve_least_squares(self, x: Array, noise: Array) -> Array:
        """Return the unknowns of least squares with this noise, from x on."""
        solution: Array = least_squares(
            lambda x: self._weigh_errors(x, noise)[0],
            x,
            lambda x: self._weigh_errors(x, noise)[1],
            bounds=(self._low, self._high),
            x_scale=self._width,
        ).x
        return solution

    def compute_deviations(self, x: Array) -> Array:
        """Return the standard deviations of the unknowns (U,)."""
        error, every = self.followed(x.tobytes())[0], np.ones(len(self._rows), bool)
        # Errors that last over several periods count once.
        independent = np.sqrt([estimate_correlation(column, every) for column in error.T])
        A = self._weigh_errors(x, self.estimate_noise(x) * independent)[1]
        deviations: Array = np.sqrt(np.diag(np.linalg.inv(A.T @ A)))
        return deviations


def _check_unknown(name: str, unknown: object) -> tuple[float, float, float, float]:
    """Return value, width and range of an unknown."""
    of = (
        (unknown.value, unknown.width, unknown.least, unknown.most)
        if isinstance(unknown, Sought)
        else None
    )
    row = None if of is None else coerce_array(of)
    if row is not None and np.isfinite(row[:2]).all():
        value, width, low, high = row.tolist()
        if low <= value <= high and low < high and width > 0.0:
            return value, width, low, high
    rule = "be Sought, with a value from least to most, and a width > 0"
    raise Refusal(WHERE, f"sought {name}", rule, unknown)


def _choose_steps(x: Array, width: Array, low: Array, high: Array) -> Array:
    """Return the steps of the unknowns for their derivatives, which stay in their ranges (U,)."""
    step, up, down = STEP * width, high - x, x - low
    within: Array = np.where(up >= down, up, -down)
    return np.where(step <= up, step, np.where(step <= down, -step, within))


def _check_signal(scene: Scene, name: str, values: ArrayLike, commands: Array) -> Array:
    reported = [output.name for output in list_outputs(scene) if not output.per_unit]
    if name not in (*STATE_ROWS, *reported):
        raise Refusal(WHERE, "signal", "be a quantity", name, ", ".join((*STATE_ROWS, *reported)))
    rows = ANY_STATE.rename(name).check_numbers(WHERE, values)
    ANY_STATE.rename(name).check_values(WHERE, rows)
    if rows.shape != commands.shape:
        raise Refusal(WHERE, name, f"have the shape of the commands, {commands.shape}", rows.shape)
    return rows


def _make_varied_scene(scene: Scene, numbers: Mapping[str, float]) -> Scene:
    """Return the scene with these numbers as data of each machine."""
    possible = {
        number.name: number
        for number in list_variable_numbers(scene.joints, scene.chain, scene.imus)
    }
    possible |= {number.name: number for number in scene.varied}
    for name in numbers:
        if name not in possible:
            raise Refusal(WHERE, "number", "be one that can be varied", name, ", ".join(possible))
    varied = tuple(number for name, number in possible.items() if name in numbers)
    return dataclasses.replace(scene, varied=varied)


def _simulate_fleet(
    scene: Scene, variations: list[dict[str, float]], rows: Array, names: list[str]
) -> Array:
    """Return signals (ways, K, C) of machines with these numbers under commands."""
    varied = {name: np.array([values[name] for values in variations]) for name in variations[0]}
    fleet = Fleet(scene, len(variations), varied=varied)
    outputs = np.empty((len(variations), len(rows), len(names) * rows.shape[1]))
    for k, row in enumerate(rows):
        fleet.exchange(row)
        measured, state = fleet.measured, fleet.state
        of = (getattr(measured if name in KNOWN_OUTPUTS else state, name) for name in names)
        outputs[:, k] = np.concatenate([*of], axis=1)
    return outputs
