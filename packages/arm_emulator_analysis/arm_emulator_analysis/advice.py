"""Cheapest scheme, event handling and step for a requested error.

Every setting is compared with the true motion (true_motion.py) on several motions, and the error of
that truth is added: the largest error is a bound for these motions. For other motions of the same
kinds it is an estimate from the spread of the errors.
"""

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from arm_emulator.extension.base import Array, Refusal
from arm_emulator.extension.machine import (
    INTEGRATOR_EVENTS,
    KNOWN_SCHEMES,
    SCHEMES,
    Diverged,
    Plant,
    Scene,
    format_mismatch,
)
from arm_emulator_analysis.judged_motions import JudgedMotion
from arm_emulator_analysis.true_motion import (
    FINEST,
    OTHERWISE,
    IntegrationMethod,
    Runs,
    Truth,
    find_truth,
    is_confirmed,
)

MAX_STEPS = 3e7  # of one motion: some seconds of computing
SHARE = 0.05  # of the requested error, permitted in the truth
LOOK = 4  # steps per servo period at which events are looked for
SPACING = 1.04  # between numbers of steps tried
ROUNDS = 7  # of timing
DEARER = 2.0  # than the cheapest by preliminary timing: not tried further
MIN_RESERVE = 5.0
ENOUGH = 12  # motions, for an estimate of others


@dataclass(frozen=True)
class Setting:
    """A method at a step, its cost and its distance from the truth."""

    method: IntegrationMethod
    dt: float  # s
    error: float  # rad or m, largest of a link on the way: a bound for the motions judged
    others: float  # rad or m, the same for other motions of these kinds: an estimate; inf: unknown
    cost: float  # s, wall per simulated second


@dataclass(frozen=True)
class Advice:
    """Settings found for an error.

    Attributes:
        settings: each method's cheapest, the cheapest of all first; empty: none keeps the error.
        why_none: reason if there are no settings.
        now: the scene's own setting, timed along with them; None where no setting keeps the error.
    """

    settings: list[Setting]
    why_none: str = ""
    now: Setting | None = None


class Judge:
    """Compares methods with the true motions of a scene.

    Args:
        scene: the machine; its own integrator is ignored, except for two threads.
        motions: all test motions.
    """

    def __init__(self, scene: Scene, motions: Sequence[JudgedMotion]) -> None:
        self.scene = scene
        self.motions = tuple(motions)
        self.runs = Runs(scene)
        self._truths: dict[int, Truth] = {}
        self._confirmed: dict[int, float] = {}  # the error for which each was
        self._errors: dict[tuple[IntegrationMethod, int, int], float] = {}
        self._hardest = list(range(len(self.motions)))

    @property
    def methods(self) -> list[IntegrationMethod]:
        """All methods that the scene may use: with two threads if it has two now.

        Motions without an event need no event location.
        """
        methods = []
        for threads in sorted({1, self.scene.threads}):
            kinds = reversed(INTEGRATOR_EVENTS) if self._has_events else INTEGRATOR_EVENTS[:1]
            for events in kinds:
                for scheme in SCHEMES:
                    method = IntegrationMethod(scheme, events, threads)
                    if format_mismatch(method.make_integrator(self.scene, 1), threads) is None:
                        methods.append(method)
        return methods

    @property
    def now(self) -> tuple[IntegrationMethod, int]:
        """The scene's own method, and its steps per servo period."""
        scene = self.scene
        own = IntegrationMethod(scene.integrator.scheme, scene.integrator.events, scene.threads)
        return own, scene.steps_per_period

    @cached_property
    def _has_events(self) -> bool:
        rows = [motion.commands for motion in self.motions]
        pairs = (
            (self.runs.simulate_q(method, LOOK, row) for method in (FINEST, OTHERWISE))
            for row in rows
        )
        return not all(np.array_equal(positions, second) for positions, second in pairs)  # type: ignore[arg-type]

    def compute_max_error(
        self, method: IntegrationMethod, steps: int, limit: float = math.inf
    ) -> float:
        """Return the largest error on the motions, inf where one diverges.

        Beyond `limit` the error of the first motion beyond it is enough.
        """
        worst = 0.0
        for m in tuple(self._hardest):
            error_on_motion = self._compute_error_on(method, steps, m)
            worst = max(worst, error_on_motion)
            if error_on_motion > limit:
                # Ask this motion first from now on.
                self._hardest.remove(m)
                self._hardest.insert(0, m)
                break
        return worst

    def _compute_error_on(self, method: IntegrationMethod, steps: int, m: int) -> float:
        key = method, steps, m
        if key not in self._errors:
            q, truth = (
                self.runs.simulate_q(method, steps, self.motions[m].commands),
                self._truths[m],
            )
            off = math.inf if q is None else float(np.abs(q - truth.q).max())
            self._errors[key] = off + truth.error
        return self._errors[key]

    def compute_errors(self, method: IntegrationMethod, steps: int) -> Array:
        """Return the error on each motion (M,)."""
        return np.array(
            [self._compute_error_on(method, steps, m) for m in range(len(self.motions))]
        )

    def find_truths(self, error: float) -> str:
        """Find the truths to a share of an error; return why that is impossible, or nothing."""
        for m, motion in enumerate(self.motions):
            max_steps = int(MAX_STEPS / len(motion.commands))
            truth = self._truths.get(m)
            if truth is None or truth.error > SHARE * error:
                better_truth = find_truth(self.runs, motion.commands, SHARE * error, max_steps)
                if isinstance(better_truth, str):
                    return f"motion {motion.name}: {better_truth}"
                self._truths[m] = truth = better_truth
                self._errors = {
                    key: stored_error for key, stored_error in self._errors.items() if key[2] != m
                }
            if error < self._confirmed.get(m, math.inf):
                if not is_confirmed(self.runs, motion.commands, truth, error, max_steps):
                    return (
                        f"motion {motion.name}: with events at the ends of steps it does not come "
                        "nearer to what it is with events located"
                    )
                self._confirmed[m] = error
        return ""

    def find_cheapest_steps(
        self, method: IntegrationMethod, error: float, max_cost: float
    ) -> int | None:
        """Return the fewest steps per servo period that keep the error; None: none found.

        Args:
            method: the integration method.
            error: on the motions judged.
            max_cost: settings expected to cost more are not tried [s/s].
        """
        max_steps = MAX_STEPS / max(len(motion.commands) for motion in self.motions)
        failed, steps = 0, 1
        while (off := self.compute_max_error(method, steps, error)) > error:
            failed, steps = (
                steps,
                _choose_next_steps(steps, off / error, KNOWN_SCHEMES[method.scheme].order),
            )
            if steps > max_steps or self.runs.estimate_min_cost(method, steps) > max_cost:
                return None
        for fewer in step_counts(failed + 1, steps):
            if self.compute_max_error(method, fewer, error) <= error:
                return fewer
        return steps

    def measure_costs(self, chosen: Sequence[tuple[IntegrationMethod, int]]) -> list[float]:
        """Return wall times per simulated second [s]: of each motion the least of some rounds.

        All take turns on each motion, so that a changing speed of the machine affects all alike.
        """
        plants = [(self.runs.make_plant(method, steps), steps) for method, steps in chosen]
        min_times = np.full((len(plants), len(self.motions)), math.inf)
        for _ in range(ROUNDS):
            for m, motion in enumerate(self.motions):
                for k, (plant, steps) in enumerate(plants):
                    min_times[k, m] = min(min_times[k, m], _measure_time(plant, steps, motion))
        seconds = self.scene.servo_period * sum(len(motion.commands) for motion in self.motions)
        return [float(time_sum) / seconds for time_sum in min_times.sum(axis=1)]

    def measure_settings(self, chosen: Sequence[tuple[IntegrationMethod, int]]) -> list[Setting]:
        """Return error and cost of methods with this number of steps per servo period."""
        costs = self.measure_costs(chosen)
        settings = []
        for (method, steps), cost in zip(chosen, costs, strict=True):
            errors = self.compute_errors(method, steps)
            dt, worst = self.scene.servo_period / steps, float(errors.max())
            settings.append(Setting(method, dt, worst, compute_reserve(errors) * worst, cost))
        return settings


def check_error(error: float) -> None:
    """Refuse an error outside the range [rad or m]."""
    if not 1e-11 <= error <= 1.0:
        raise Refusal("advise", "error", "be from 1e-11 to 1 rad", error)


def find_cheapest_settings(judge: Judge, error: float) -> Advice:
    """Return each method's cheapest setting for an error, the cheapest of all first.

    Args:
        judge: of the scene and its motions.
        error: largest error of a link on the way [rad or m].

    Raises:
        Refusal: the error is out of range.
    """
    check_error(error)
    why = judge.find_truths(error)
    if why:
        return Advice([], why)
    cheapest, best = list[tuple[IntegrationMethod, int]](), math.inf
    for method in judge.methods:
        steps = judge.find_cheapest_steps(method, error, DEARER * best)
        if steps is not None:
            cheapest.append((method, steps))
            best = min(best, judge.runs.compute_cost(method, steps))
    if not cheapest:
        return Advice([], "no step that can be tried is small enough")
    *settings, now = judge.measure_settings([*cheapest, judge.now])
    return Advice(sorted(settings, key=lambda setting: setting.cost), now=now)


def compute_reserve(errors: Array) -> float:
    """Return the ratio of the errors of other motions to the largest of some errors, at most.

    `MIN_RESERVE`, or more if the largest stands out: the next one may stand out as much.
    `python -m bench.claims advice` measures how often that is enough. Few motions permit no
    estimate.
    """
    if len(errors) < ENOUGH or not np.isfinite(errors).all():
        return math.inf
    second, largest = np.sort(errors)[-2:].tolist()
    return max(MIN_RESERVE, largest / second if second > 0.0 else 0.0)


def _measure_time(plant: Plant, steps: int, motion: JudgedMotion) -> float:
    """Return the wall time of a motion [s]; inf if it diverges."""
    plant.reset()
    began = time.perf_counter()
    try:
        plant.run(motion.commands, steps)
    except Diverged:
        return math.inf
    return time.perf_counter() - began


def _choose_next_steps(steps: int, off: float, order: int) -> int:
    """Return the number of steps to try if this one is `off` times too far from the truth."""
    # Less than its order requires: a method may be lucky, or not yet converge at its order.
    factor = 0.7 * off ** (1.0 / order) if math.isfinite(off) else 2.0
    return max(steps + 1, math.ceil(steps * min(max(factor, SPACING), 2.0)))


def step_counts(low: int, high: int) -> Iterator[int]:
    """Yield numbers of steps from `low` to below `high`, a few per cent apart."""
    while low < high:
        yield low
        low = max(low + 1, round(SPACING * low))
