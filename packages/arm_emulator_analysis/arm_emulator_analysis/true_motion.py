"""The true motion of a machine and its uncertainty, by halving steps.

The first of the schemes, with located events, is of order 2 if its events are separate. The order
is measured: the differences between runs with n, 2 n, 4 n steps must fall, and their ratio gives an
estimate of the remaining error. The largest step resolves the fastest small motion: with longer
steps, differences may fall while an error stays. The motion is computed once with smaller steps,
for a mode that began and ended within a step. Then the same scheme with events at the ends of
steps, which uses other code to decide them, must approach the same motion.
"""

import dataclasses
import math
import time
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from arm_emulator.extension.base import Array
from arm_emulator.extension.machine import SCHEMES, Diverged, Integrator, Plant, Scene, SmallMotions

# Differences that fall by less when a step is halved show no convergence.
MIN_FALL = 1.4
MAX_FALL = 4.0  # of order 2; a larger fall is chance
RESERVE = 2.0  # on the remaining error
FEWEST = 4  # steps per servo period to begin with, at least
RESOLVED = 1.0  # of the fastest small motion in a step, by its rate
ROUNDING = 1e-10  # rad or m: differences below, which do not fall any more, are of rounding
CLOSER = 4  # times the steps in the second look at a motion
HALVED = 6  # times at least that the first step can be halved
NEARER = 0.1  # of its first distance: required of the scheme with events at the ends
COARSER = 64  # times the steps of the truth: range of the steps of that check
PLANTS = 24  # that are kept


@dataclass(frozen=True)
class IntegrationMethod:
    """Integration of a machine, except for its step."""

    scheme: str
    events: str
    threads: int = 1

    def make_integrator(self, scene: Scene, steps: int) -> Integrator:
        """Return it with this number of steps per servo period."""
        return dataclasses.replace(
            scene.integrator,
            scheme=self.scheme,
            events=self.events,
            dt=scene.servo_period / steps,
        )

    def __str__(self) -> str:
        located = ", located" if self.events == "located" else ""
        return f"{self.scheme}{located}{', 2 threads' if self.threads == 2 else ''}"


FINEST = IntegrationMethod(SCHEMES[0], "located")
OTHERWISE = IntegrationMethod(SCHEMES[0], "step")


class Runs:
    """Runs of one scene from rest at its start, with any method and step.

    Args:
        scene: the machine.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self._plants: dict[tuple[IntegrationMethod, int], Plant] = {}
        self._times: dict[
            tuple[IntegrationMethod, int], list[float]
        ] = {}  # wall, and simulated [s]

    def make_plant(self, method: IntegrationMethod, steps: int) -> Plant:
        """Return the machine with `steps` steps per servo period."""
        key = method, steps
        if key not in self._plants:
            if len(self._plants) >= PLANTS:
                del self._plants[next(iter(self._plants))]
            integrator = method.make_integrator(self.scene, steps)
            scene = dataclasses.replace(self.scene, integrator=integrator, threads=method.threads)
            self._plants[key] = Plant(scene)
        return self._plants[key]

    @cached_property
    def rate(self) -> float:
        """Rate of the fastest small motion about the start [1/s]."""
        plant = self.make_plant(FINEST, FEWEST)
        try:
            J = SmallMotions(plant, self.scene.start).J
            return float(np.abs(np.linalg.eigvals(J)).max())
        except np.linalg.LinAlgError:  # numbers so far apart that something overflows
            return np.inf

    def simulate_q(self, method: IntegrationMethod, steps: int, commands: Array) -> Array | None:
        """Return link positions after each row (K, N) [rad or m]; None if it diverges."""
        plant = self.make_plant(method, steps)
        plant.reset()
        began = time.perf_counter()
        try:
            q = plant.run(commands, steps)
        except Diverged:
            return None
        times = self._times.setdefault((method, steps), [0.0, 0.0])
        times[0] += time.perf_counter() - began
        times[1] += self.scene.servo_period * len(commands)
        return q

    def compute_cost(self, method: IntegrationMethod, steps: int) -> float:
        """Return the wall time per simulated second [s] of all runs with this setting."""
        wall, simulated = self._times[method, steps]
        return wall / simulated

    def estimate_min_cost(self, method: IntegrationMethod, steps: int) -> float:
        """Return a lower bound of that time, from the cheapest step of this method; 0: unknown."""
        costs = [self.compute_cost(*key) / key[1] for key in self._times if key[0] == method]
        return steps * min(costs, default=0.0)


@dataclass(frozen=True)
class Truth:
    """Link positions after each row (K, N), and a bound of their error."""

    q: Array
    error: float
    steps: int  # per servo period


def find_truth(runs: Runs, commands: Array, max_error: float, max_steps: int) -> Truth | str:
    """Return the true motion, or why it cannot be determined.

    Args:
        runs: of the scene.
        commands: (K, N).
        max_error: required accuracy [rad or m].
        max_steps: steps per servo period.
    """
    resolved = min(runs.scene.servo_period * runs.rate / RESOLVED, max_steps / 2**HALVED)
    steps, last, left = max(FEWEST, math.ceil(resolved)), None, np.inf
    differences = list[float]()
    while steps <= max_steps:
        q = runs.simulate_q(FINEST, steps, commands)
        if q is None:
            differences = []
        elif last is not None:
            differences.append(float(np.abs(q - last).max()))
            left = RESERVE * estimate_remainder(differences)
            closer = (
                runs.simulate_q(FINEST, CLOSER * steps, commands) if left <= max_error else None
            )
            if closer is not None and (off := float(np.abs(closer - q).max())) <= max_error:
                return Truth(closer, max(0.5 * off, left / CLOSER), CLOSER * steps)
            if len(differences) > 3 and differences[-2] <= differences[-1] < ROUNDING:
                break
        last, steps = q, 2 * steps
    if last is None:
        return "it diverges at every step that can be tried"
    return (
        f"steps that are halved agree to {differences[-1] if differences else np.inf:.1e} at best"
    )


def estimate_remainder(differences: list[float]) -> float:
    """Return the error of the last run, from the differences of halved steps."""
    if len(differences) < 3:
        return np.inf
    before, middle, last = differences[-3:]
    # A difference that is small by chance must not count.
    last = max(last, middle / MAX_FALL / 2.0, before / MAX_FALL**2 / 2.0)
    if last == 0.0:
        return 0.0
    fall = min(np.sqrt(max(before, middle) / last), middle / last, MAX_FALL)
    return last / (fall - 1.0) if fall >= MIN_FALL else np.inf


def is_confirmed(runs: Runs, commands: Array, truth: Truth, enough: float, max_steps: int) -> bool:
    """Whether the scheme with events at the ends of steps converges to the same motion.

    Args:
        runs: of the scene.
        commands: (K, N).
        truth: the motion with events located.
        enough: required distance [rad or m].
        max_steps: steps per servo period.
    """
    steps, errors = max(1, truth.steps // COARSER), list[float]()
    while steps <= min(max_steps, COARSER * truth.steps):
        q = runs.simulate_q(OTHERWISE, steps, commands)
        errors.append(np.inf if q is None else float(np.abs(q - truth.q).max()))
        if errors[-1] <= enough:
            return True
        steps *= CLOSER
    # Not that near, but converging.
    return errors[-1] == min(errors) and errors[-1] < NEARER * errors[0]
