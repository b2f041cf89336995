"""The second stage: unknowns for which the emulator itself follows the measured motion.

Gauss-Newton (with Levenberg's damping) on the distance between the record and free runs driven by
the measured torques, with exact derivatives (analysis/sensitivities.py). The scene's own numbers
count as in the first stage.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from arm_emulator.analysis.sensitivities import SensitiveMachine
from arm_emulator.identification import inertia
from arm_emulator.identification.free_run import Starts, held_torques, starts
from arm_emulator.identification.measured_run import MeasuredRun
from arm_emulator.identification.torque_fit import TorqueFit, with_discrepancy
from arm_emulator.machine.chain import Array
from arm_emulator.machine.possible import could_vary
from arm_emulator.machine.scene import Scene
from arm_emulator.machine.varied import of_child

Indices = NDArray[np.signedinteger[Any]]

SECONDS = 0.6  # of a run
EVERY = 0.2  # s, from start to start
FASTER = 0.2  # of the largest speed: from which the arm counts as moving
LOOKS = (1.0 / 3.0, 2.0 / 3.0, 1.0)  # of the run: instants of the comparison
TURNS = 6  # iterations
ENOUGH = 1e-2  # relative improvement required of an iteration


def torque_driven(scene: Scene, period: float, sought: Collection[str]) -> Scene:
    """Return a scene with torque-commanded motors, otherwise unchanged.

    Args:
        scene: the machine.
        period: of the commands [s].
        sought: names of numbers to vary.
    """
    joints = tuple(joint.torque_driven() for joint in scene.joints)
    steps = max(1, round(period / scene.integrator.dt))
    varied = tuple(one for one in could_vary(joints, scene.chain, ()) if one.name in sought)
    return dataclasses.replace(
        scene, joints=joints, servo_period=period, varied=varied, load=None,
        integrator=dataclasses.replace(scene.integrator, dt=period / steps),
    )  # fmt: skip


def fit_free_runs(
    fit: TorqueFit, scene: Scene, run: MeasuredRun, report: Callable[[str], None] = print
) -> TorqueFit:
    """Return a fit whose free runs end closer to the record.

    Args:
        fit: of the first stage, where the search begins.
        scene: the nominal machine.
        run: the record.
        report: gets the final distance of each iteration.
    """
    sought = numbers_of(fit, scene, fit.values)
    scene = torque_driven(scene, run.period, sought)
    speeds = np.abs(np.gradient(run.q_motor, run.period, axis=0))
    begin = starts(run, scene, SECONDS, EVERY, FASTER * float(np.quantile(speeds, 0.999)))
    least = np.array([one.least for one in fit.unknowns])
    most = np.array([one.most for one in fit.unknowns])
    before = np.array([one.value for one in fit.unknowns])
    widths = np.array([one.width for one in fit.unknowns])
    which = np.flatnonzero(fit.fitted)
    spread = run.q_motor.std(axis=0)
    values, damping = fit.values.copy(), 0.1
    machine = SensitiveMachine(scene, [one.name for one in scene.varied])
    errors, J = _errors(fit, machine, scene, run, begin, values, which)
    # Errors of overlapping runs are correlated: an error counts for this many samples.
    lasting = max(1.0, SECONDS / EVERY) * len(LOOKS)
    noise = np.sqrt(np.mean(errors**2, axis=0) * lasting)
    report(f"free runs of {SECONDS:g} s end {_shown(errors, spread)} off")

    def cost(errors: Array, values: Array) -> float:
        """With the noise of the iteration."""
        known = (values - before)[which] / widths[which]
        return float(np.sum((errors / noise) ** 2) + known @ known)

    now = cost(errors, values)
    for _ in range(TURNS):
        A = (J / noise[:, None]).reshape(-1, len(which))
        H = A.T @ A + np.diag(1.0 / widths[which] ** 2)
        g = A.T @ (errors / noise).ravel() + (values - before)[which] / widths[which] ** 2
        step = -np.linalg.solve(H + damping * np.diag(np.diag(H)), g)
        tried = values.copy()
        tried[which] = np.clip(values[which] + step, least[which], most[which])
        new_errors, new_J = _errors(fit, machine, scene, run, begin, tried, which)
        new = cost(new_errors, tried)
        if new < now:
            done = now - new < ENOUGH * now
            values, errors, J, damping = tried, new_errors, new_J, 0.1 * damping
            noise = np.sqrt(np.mean(errors**2, axis=0) * lasting)
            now = cost(errors, values)
            report(f"free runs of {SECONDS:g} s end {_shown(errors, spread)} off")
            if done:
                break
        else:
            damping *= 5.0
    A = (J / noise[:, None]).reshape(-1, len(which))
    covariance = np.zeros_like(fit.covariance)
    H = A.T @ A + np.diag(1.0 / widths[which] ** 2)
    covariance[np.ix_(which, which)] = np.linalg.inv(H)
    return with_discrepancy(fit, values, covariance)


def _shown(errors: Array, spread: Array) -> str:
    """Return the root mean square at the end of the runs over each joint's spread."""
    end = errors.reshape(len(LOOKS), -1, errors.shape[1])[-1]
    share = 100.0 * np.sqrt(np.mean(end**2, axis=0)) / spread
    return ", ".join(f"{one:.1f}" for one in share) + " %"


def _errors(fit: TorqueFit, machine: SensitiveMachine, scene: Scene, run: MeasuredRun,
            begin: Starts, values: Array, which: Indices) -> tuple[Array, Array]:  # fmt: skip
    """Return errors of runs (R, N) and their slopes (R, N, unknowns looked for)."""
    looks = np.array([max(1, round(look * SECONDS / run.period)) for look in LOOKS])
    steps = round(run.period / scene.integrator.dt)
    numbers, by_values = numbers_of(fit, scene, values), _slopes(fit, scene, values, machine.names)
    errors, slopes = [], []
    for k, at in enumerate(begin.at):
        motors = begin.theta_m[k], begin.omega_m[k]
        torques = held_torques(run, np.arange(at, at + looks[-1]))
        motion = machine.run(torques, steps, begin.q[k], begin.v[k], motors, numbers)
        errors.append(motion.theta_m[looks - 1] * scene.gear_ratios - run.q_motor[at + looks])
        by = motion.by["theta_m"][looks - 1] * scene.gear_ratios[:, np.newaxis]
        slopes.append(by @ by_values[:, which])
    N = len(scene.joints)
    of_looks, of_slopes = np.swapaxes(errors, 0, 1), np.swapaxes(slopes, 0, 1)
    return of_looks.reshape(-1, N), of_slopes.reshape(-1, N, len(which))


def _slopes(fit: TorqueFit, scene: Scene, values: Array, names: Sequence[str]) -> Array:
    """Return the derivatives of the numbers with these names by all unknowns, see `numbers_of`."""
    rows, n = {name: np.zeros(len(values)) for name in names}, inertia.NUMBERS
    for k, joint in enumerate(scene.chain.links):
        here = slice(n * k, n * (k + 1))
        if not fit.fitted[here].any():
            continue
        # A body's numbers are linear in those of `dynamic`.
        units = [of_child(joint, inertia.body_of(unit)) for unit in np.eye(n)]
        slope = inertia.slope(values[here])
        for name in units[0]:
            rows[f"links.{joint.link}.{name}"][here] = [one[name] for one in units] @ slope
    first = n * len(scene.chain.links)
    for k, one in enumerate(fit.unknowns[first:], first):
        if one.name in rows:
            rows[one.name][k] = 1.0
    return np.array([rows[name] for name in names])


def numbers_of(fit: TorqueFit, scene: Scene, values: Array) -> dict[str, float]:
    """Return the scene's numbers of some values of the unknowns, by the names of varied ones.

    Those of links are with the payload.
    """
    numbers, n = dict[str, float](), inertia.NUMBERS
    for k, (joint, bare) in enumerate(zip(scene.chain.links, scene.bare, strict=True)):
        here = slice(n * k, n * (k + 1))
        if not fit.fitted[here].any():
            continue
        body = inertia.body_of(inertia.exponential(values[here]))
        of = of_child(joint, body + joint.body + bare.scaled(-1.0)).items()
        numbers |= {f"links.{joint.link}.{name}": value for name, value in of}
    first = n * len(scene.chain.links)
    pairs = zip(fit.unknowns[first:], values[first:], strict=True)
    return numbers | {one.name: float(value) for one, value in pairs}
