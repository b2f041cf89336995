"""The second stage: unknowns that let the emulator itself follow the measured motion.

Gauss-Newton (with Levenberg's damping) on how far free runs, driven by the measured torques, leave
the record. Differences are those of a `Fleet`, an arm for each unknown and start, so that what is
fitted is what is run. What the scene says counts as in the first stage.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from arm_emulator.identification import inertia
from arm_emulator.identification.free_run import Starts, free_runs, starts
from arm_emulator.identification.measured_run import MeasuredRun
from arm_emulator.identification.torque_fit import TorqueFit
from emulator_node.chain import Array
from emulator_node.scene import Scene, load_scene
from emulator_node.varied_body import of_child

Indices = NDArray[np.signedinteger[Any]]

SECONDS = 0.6  # that runs last
EVERY = 0.2  # s, from start to start
FASTER = 0.2  # of the largest speed: where some joint is as fast, the arm moves
LOOKS = (1.0 / 3.0, 2.0 / 3.0, 1.0)  # of the time, when the runs are looked at
TURNS = 6  # of the search
NUDGE = 0.05  # of each deviation, by which it is changed for the differences
ENOUGH = 1e-2  # share by which a turn must still be better


def torque_driven(file: Path, period: float) -> Scene:
    """Return a scene with motors that are commanded torques, and with its numbers varied.

    Args:
        file: the scene.
        period: of the commands [s].
    """
    scene = load_scene(file)
    changes: dict[str, Any] = {"servo_period": period}
    steps = max(1, round(period / scene.integrator.dt))
    changes["integrator.dt"] = period / steps
    for joint in scene.joints:
        if joint.motor is None or joint.command == "N m":
            continue
        motor: dict[str, Any] = {"kind": "torque"}
        motor["rotor_inertia"] = vars(joint.motor)["rotor_inertia"]
        if joint.rotor_friction is not None:
            own = joint.rotor_friction
            motor["friction"] = {"viscous": own.viscous, "coulomb": own.coulomb}
        changes[f"joints.{joint.name}.motor"] = motor
    names = ["links.*", "joints.*.motor.rotor_inertia"]
    if any(joint.rotor_friction is not None for joint in scene.joints):
        names += ["joints.*.motor.friction.viscous", "joints.*.motor.friction.coulomb"]
    names += ["joints.*.friction.viscous", "joints.*.friction.coulomb"]
    if any(part.section == "counterbalance" for joint in scene.joints for part in joint.extras):
        names += ["joints.*.counterbalance.force"]
    return load_scene(file, changes | {"payload": None, "varied": names})


def fit_free_runs(
    fit: TorqueFit, scene: Scene, run: MeasuredRun, told: Callable[[str], None] = print
) -> TorqueFit:
    """Return a fit whose free runs end nearer to the record.

    Args:
        fit: of the first stage, where the search begins.
        scene: see `torque_driven`; its links are those of the fit or of the scene before.
        run: the record.
        told: is told how far runs end, turn by turn.
    """
    speeds = np.abs(np.gradient(run.q_motor, run.period, axis=0))
    begin = starts(run, scene, SECONDS, EVERY, FASTER * float(np.quantile(speeds, 0.999)))
    least = np.array([one.least for one in fit.unknowns])
    before = np.array([one.value for one in fit.unknowns])
    widths = np.array([one.width for one in fit.unknowns])
    which = np.flatnonzero(fit.fitted)
    spread = run.q_motor.std(axis=0)
    values, damping = fit.values.copy(), 0.1
    errors, J = _errors(fit, scene, run, begin, values, which)
    # Runs that overlap err together: an error counts as of so many samples.
    lasting = max(1.0, SECONDS / EVERY) * len(LOOKS)
    noise = np.sqrt(np.mean(errors**2, axis=0) * lasting)
    told(f"free runs of {SECONDS:g} s end {_shown(errors, spread)} off")

    def cost(errors: Array, values: Array) -> float:
        """With the noise of the turn."""
        known = (values - before)[which] / widths[which]
        return float(np.sum((errors / noise) ** 2) + known @ known)

    now = cost(errors, values)
    for _ in range(TURNS):
        A = (J / noise[:, None]).reshape(-1, len(which))
        H = A.T @ A + np.diag(1.0 / widths[which] ** 2)
        g = A.T @ (errors / noise).ravel() + (values - before)[which] / widths[which] ** 2
        step = -np.linalg.solve(H + damping * np.diag(np.diag(H)), g)
        tried = values.copy()
        tried[which] = np.maximum(values[which] + step, least[which])
        new_errors, new_J = _errors(fit, scene, run, begin, tried, which)
        new = cost(new_errors, tried)
        if new < now:
            done = now - new < ENOUGH * now
            values, errors, J, damping = tried, new_errors, new_J, 0.1 * damping
            noise = np.sqrt(np.mean(errors**2, axis=0) * lasting)
            now = cost(errors, values)
            told(f"free runs of {SECONDS:g} s end {_shown(errors, spread)} off")
            if done:
                break
        else:
            damping *= 5.0
    A = (J / noise[:, None]).reshape(-1, len(which))
    covariance = np.zeros_like(fit.covariance)
    H = A.T @ A + np.diag(1.0 / widths[which] ** 2)
    covariance[np.ix_(which, which)] = np.linalg.inv(H)
    return dataclasses.replace(fit, values=values, covariance=covariance)


def _shown(errors: Array, spread: Array) -> str:
    """Return the root of mean square at the end of the runs over each joint's spread."""
    end = errors.reshape(len(LOOKS), -1, errors.shape[1])[-1]
    share = 100.0 * np.sqrt(np.mean(end**2, axis=0)) / spread
    return ", ".join(f"{one:.1f}" for one in share) + " %"


def _errors(fit: TorqueFit, scene: Scene, run: MeasuredRun, begin: Starts, values: Array,
            which: Indices) -> tuple[Array, Array]:  # fmt: skip
    """Return errors of runs (R, N) and their slopes (R, N, unknowns looked for)."""
    deviations = np.sqrt(np.maximum(np.diag(fit.covariance), 0.0))
    nudge = NUDGE * deviations[which]
    rows = np.tile(values, (len(which) + 1, 1))
    rows[np.arange(1, len(rows)), which] += nudge
    numbers = [numbers_of(fit, scene, row) for row in rows]
    known = {one.name for one in scene.varied}
    varied = {name: [one[name] for one in numbers] for name in numbers[0] if name in known}
    looks = [max(1, round(look * SECONDS / run.period)) for look in LOOKS]
    angles = free_runs(scene, run, begin, looks, varied, len(rows))
    measured = np.array([run.q_motor[begin.at + k] for k in looks])
    errors = (angles - measured).reshape(len(rows), -1, angles.shape[-1])
    slopes = (errors[1:] - errors[0]) / nudge[:, None, None]
    return errors[0], np.moveaxis(slopes, 0, 2)


def numbers_of(fit: TorqueFit, scene: Scene, values: Array) -> dict[str, float]:
    """Return the scene's numbers of some values of the unknowns, by the names of varied ones."""
    numbers, n = dict[str, float](), inertia.NUMBERS
    for k, joint in enumerate(scene.chain.joints):
        body = inertia.body_of(inertia.exponential(values[n * k : n * k + n]))
        of = of_child(joint, body).items()
        numbers |= {f"links.{joint.link}.{name}": value for name, value in of}
    first = n * len(scene.chain.joints)
    pairs = zip(fit.unknowns[first:], values[first:], strict=True)
    return numbers | {one.name: float(value) for one, value in pairs}
