"""Runs of the emulated machine under measured torques, from measured states.

Nothing corrects them: every difference between the machine and the real one accumulates.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from arm_emulator.extension.base import Array, Refusal
from arm_emulator.extension.machine import Scene
from arm_emulator_fleet import Fleet
from arm_emulator_identification.filtered import EDGE, filter_low_pass, smooth_motion
from arm_emulator_identification.link_regressor import compute_link_torques
from arm_emulator_identification.measured_run import MeasuredRun

SPEED_BELOW = 40.0  # Hz: bandwidth of the initial speeds
LOAD_BELOW = 10.0  # Hz: bandwidth of the initial gear torques


@dataclass(frozen=True)
class Starts:
    """States of a record at some samples: rows (S, N)."""

    at: Array  # sample numbers (S,)
    q: Array  # rad or m, links
    v: Array
    theta_m: Array  # rad, motors
    omega_m: Array


def find_starts(run: MeasuredRun, scene: Scene, seconds: float, every: float,
           faster: float = 0.0) -> Starts:  # fmt: skip
    """Return states in motion from which runs of some seconds can start, evenly over the record.

    Speeds are those of the motors. The gears are wound up by weight and friction of the links.

    Args:
        run: the record.
        scene: the machine.
        seconds: of a run.
        every: seconds from start to start.
        faster: at a start some joint is faster than this [rad/s or m/s].

    Raises:
        Refusal: the record is too short for such runs.
    """
    period = run.period
    edge = EDGE / LOAD_BELOW
    last = run.t[-1] - run.t[0] - seconds - edge
    if last < edge:
        rule = f"last at least {seconds + 2.0 * edge:g} s for free runs of {seconds:g} s"
        raise Refusal(run.where, "record", rule, f"{run.t[-1] - run.t[0]:.3g} s")
    at = np.round(np.arange(edge, last, every) / period).astype(int)
    quick = min(SPEED_BELOW, 0.2 / period)
    speeds = np.gradient(filter_low_pass(run.q_motor, period, quick), period, axis=0)
    at = at[np.abs(speeds[at]).max(axis=1) >= faster]
    if not at.size:
        raise Refusal(run.where, "record", f"be faster than {faster:g} rad/s or m/s", "at rest")
    v = speeds[at]
    slow, speed, a = smooth_motion(run.q_motor, period, min(LOAD_BELOW, 0.2 / period))
    load = compute_link_torques(scene, run.t, slow, speed, a)[at]
    ratio = scene.gear_ratios
    q_motor = run.q_motor[at]
    give = np.array([scene.wind_up(row) for row in load])
    return Starts(at, q_motor - give, v, q_motor / ratio, v / ratio)


def simulate_free_runs(
    scene: Scene, run: MeasuredRun, begin: Starts, looks: Sequence[int]
) -> Array:
    """Return the motors' angles, at the link, after some samples (looks, S, N) [rad or m].

    Args:
        scene: a machine with torque-commanded motors.
        run: the record.
        begin: the S starts.
        looks: numbers of samples, increasing.
    """
    S, N = begin.q.shape
    fleet = Fleet(scene, S, q=begin.q)
    for k in range(S):
        fleet[k].put("free_runs", {
            "q": begin.q[k], "v": begin.v[k], "theta_m": begin.theta_m[k],
            "omega_m": begin.omega_m[k],
        })  # fmt: skip
    ratio = scene.gear_ratios
    steps = round(run.period / scene.integrator.dt)
    angles, done = np.empty((len(looks), S, N)), 0
    for row, look in enumerate(looks):
        at = begin.at + np.arange(done, look)[:, None]
        fleet.run(average_torques(run, at), steps)
        angles[row], done = fleet.state.theta_m * ratio, look
    return angles


def average_torques(run: MeasuredRun, at: Array) -> Array:
    """Return the torques from samples to the next ones: the means of both (..., N)."""
    mean: Array = 0.5 * (run.tau[at] + run.tau[at + 1])
    return mean


@dataclass(frozen=True)
class Drift:
    """Deviations of free runs from the measured motion, by joint (N,)."""

    share: Array  # root of mean square error at the end over the joint's standard deviation
    errors: Array  # at the end, (S, N) rad or m


def compute_drift(run: MeasuredRun, begin: Starts, samples: int, ends: Array) -> Drift:
    """Compare free runs after some samples (S, N) [rad or m] with the record."""
    errors = ends - run.q_motor[begin.at + samples]
    root = np.sqrt(np.mean(errors**2, axis=0))
    return Drift(root / run.q_motor.std(axis=0), errors)
