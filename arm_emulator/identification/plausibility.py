"""Whether a record can be of this machine: units, order of axes, signs.

Each slip that people make is tried. If the record fits the machine better once the slip is undone,
it was made. The fits are linear; what they cost is the torque that stays unexplained, how far
bodies and rotors are from the scene's, and friction that would drive.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np

from arm_emulator.identification import inertia
from arm_emulator.identification.filtered import Filtered, Mask, filtered
from arm_emulator.identification.link_regressor import LinkRegressor
from arm_emulator.identification.measured_run import MeasuredRun
from arm_emulator.identification.spring_torque import known_torque
from emulator_node.chain import Array
from emulator_node.scene import Scene
from words.refusal import Refusal

ROWS = 120  # of the record: enough to tell a slip
SHARE = 0.3  # of a body's numbers, to which they are taken to be good
BETTER = 0.9  # a slip undone costs less than this share
NOISE = 0.1  # of a joint's torque: what may stay unexplained
DRIVES = 0.02  # of a joint's torque: friction below minus this is none
SCALE = 4.0  # times as large as the scene's a machine is not
LEAST_WAY = 1.0e-3  # rad or m: what moves less does not move
SPEEDS_AGREE = 0.7  # correlation, and within a factor of 1.5
POOR = 50.0  # %: of a fit that nobody should use


def check_movement(run: MeasuredRun, data: Filtered) -> None:
    """Refuse a record in which a joint hardly moves, or only one way at one speed.

    Raises:
        Refusal: says which joint, and how much it moves.
    """
    for j, joint in enumerate(run.joints):
        way = float(np.ptp(run.q_motor[:, j]))
        rule = "move, so that its friction and inertia show"
        if way < LEAST_WAY:
            raise Refusal(run.where, joint, rule, f"a way of {way:.3g} rad or m in all")
        v = data.v[data.moving[:, j], j]
        if len(v) < 10:
            raise Refusal(run.where, joint, rule, f"{len(v)} samples in motion after filtering")
        if v.min() > 0.0 or v.max() < 0.0:
            rule = "move both ways, so that friction and weight can be told apart"
            raise Refusal(run.where, joint, rule, "one direction")
        if np.quantile(np.abs(v), 0.95) < 1.3 * np.quantile(np.abs(v), 0.05):
            rule = (
                "move at different speeds, so that Coulomb and viscous friction can be told apart"
            )
            raise Refusal(run.where, joint, rule, f"{np.abs(v).mean():.3g} rad/s or m/s throughout")


def check_speeds(run: MeasuredRun, data: Filtered) -> None:
    """Refuse speeds that are not those of the angles, where a record has both.

    Raises:
        Refusal: says which joint, and what they look like.
    """
    if run.v_motor is None:
        return
    own = np.gradient(run.q_motor, run.period, axis=0)
    for j, joint in enumerate(run.joints):
        told, found = run.v_motor[:, j], own[:, j]
        size = float(told @ told) ** 0.5 * float(found @ found) ** 0.5
        alike = float(told @ found) / size if size > 0.0 else 0.0
        rule = "be the rate of q_mot"
        if alike < -SPEEDS_AGREE:
            raise Refusal(run.where, f"v_mot of {joint}", rule, "its opposite sign")
        if alike < SPEEDS_AGREE:
            others = np.corrcoef(np.column_stack([told, own]).T)[0, 1:]
            best = int(np.argmax(np.abs(others)))
            what = f"a correlation of {alike:.2f}"
            if abs(others[best]) > SPEEDS_AGREE:
                what = f"that of {run.joints[best]}"
            raise Refusal(run.where, f"v_mot of {joint}", rule, what)
        factor = float(told @ found) / float(told @ told)
        if not 1.0 / 1.5 < factor < 1.5:
            got = f"a rate {factor:.4g} times as large; are units the same?"
            raise Refusal(run.where, f"v_mot of {joint}", rule, got)


class Plausibility:
    """Fits of a record to a machine, as it is and with slips undone."""

    def __init__(self, scene: Scene, run: MeasuredRun, frequency: float) -> None:
        self.scene, self.run, self.frequency = scene, run, frequency
        self.ratio = scene.gear_ratios
        self._regressor = LinkRegressor(scene)
        self._phi = np.concatenate([inertia.dynamic(joint.body) for joint in scene.chain.joints])
        Jm = [getattr(joint.motor, "rotor_inertia", 0.0) for joint in scene.joints]
        self._carried = np.array(Jm) / self.ratio**2
        widths = []
        for joint in scene.chain.joints:
            body = joint.body
            length = np.sqrt(max(np.trace(body.inertia), 1e-12) / max(body.mass, 1e-12))
            second = max(float(np.trace(body.inertia)), 1e-12)
            widths += [body.mass, *(3 * [body.mass * length]), *(6 * [second])]
        self._widths = SHARE * np.array(widths)

    def cost(self, run: MeasuredRun) -> float:
        """Return how badly a record fits the machine."""
        q, v, a, direction, tau, rows = self._some(run)
        N, spread = len(self.ratio), np.maximum(tau.std(axis=0), 1e-12)
        X = np.zeros((len(q), N, 3 * N))
        for j in range(N):
            X[:, j, j], X[:, j, N + j], X[:, j, 2 * N + j] = (
                self._carried[j] * a[:, j], direction[:, j], v[:, j]
            )  # fmt: skip
        top = np.maximum(np.abs(v).max(axis=0), 1e-12)
        of_friction = 3.0 * spread, 3.0 * spread / top
        widths = np.concatenate([self._widths, np.full(N, SHARE), *of_friction])
        per_noise = 1.0 / (NOISE * spread)
        A = np.concatenate([self._regressor(q, v, a), X], axis=2) * widths * per_noise[:, None]
        b = (tau - self._torques(q, v, a)) * per_noise
        A, b = A[rows], b[rows]
        U = A.shape[1]
        both = np.vstack([A, np.eye(U)]), np.concatenate([b, np.zeros(U)])
        found = np.linalg.lstsq(*both, rcond=None)[0]
        error = b - A @ found
        coulomb = widths[-2 * N : -N] * found[-2 * N : -N]
        driven = rows[:, coulomb < -DRIVES * spread].sum()
        return float(error @ error + found @ found + driven)

    def check(self) -> None:
        """Refuse a record that is of this machine once a slip is undone.

        Raises:
            Refusal: says which slip.
        """
        self._check_size()
        least = BETTER * self.cost(self.run)
        found = None
        for run, quantity, got in self._slips():
            cost = self.cost(run)
            if cost < least:
                least, found = cost, (quantity, got)
        if found is not None:
            valid = "the record the other way round, or --as-is if it is right as it is"
            raise Refusal(self.run.where, found[0], "be those of the scene", found[1], valid)

    def _some(self, run: MeasuredRun) -> tuple[Array, Array, Array, Array, Array, Mask]:
        """Return q, v, a, direction, tau and rows in motion of some samples."""
        data = filtered(run, self.ratio, self.frequency)
        some = slice(None, None, max(1, len(data.t) // ROWS))
        q, v, a = data.q[some], data.v[some], data.a[some]
        return q, v, a, data.direction[some], data.tau[some], data.moving[some]

    def _torques(self, q: Array, v: Array, a: Array) -> Array:
        """Return the torques of the scene's machine without friction (K, N)."""
        tau: Array = self._regressor(q, v, a) @ self._phi + self._carried * a
        for j, joint in enumerate(self.scene.joints):
            tau[:, j] -= known_torque(joint, q[:, j])
        return tau

    def _check_size(self) -> None:
        """Refuse torques many times as large as the machine's."""
        q, v, a, _, tau, _ = self._some(self.run)
        base = self._torques(q, v, a)
        own, told = np.sqrt(np.mean(base**2, axis=0)), np.sqrt(np.mean(tau**2, axis=0))
        factor = float(np.exp(np.median(np.log(np.maximum(told, 1e-12) / np.maximum(own, 1e-12)))))
        if factor < 1.0 / (2.5 * SCALE) or factor > 2.5 * SCALE:
            rule = "be in N m at the motors' shafts, of angles in the unit told"
            got = f"{factor:.3g} times what this motion takes"
            raise Refusal(self.run.where, "torques", rule, got, "check units, and the gear ratios")

    def _slips(self) -> Iterator[tuple[MeasuredRun, str, str]]:
        run, joints = self.run, self.run.joints
        every = list(range(len(joints)))

        def other(**changes: Any) -> MeasuredRun:
            return dataclasses.replace(run, **changes)

        deg = np.pi / 180.0
        yield other(q_motor=run.q_motor * deg), "angles", "deg, told as rad"
        yield other(q_motor=run.q_motor / deg), "angles", "rad, told as deg"
        yield other(tau=-run.tau), "signs of all torques", "the opposite ones"
        yield other(q_motor=-run.q_motor), "signs of all angles", "the opposite ones"
        for j, name in enumerate(joints):
            flip = np.where(np.array(every) == j, -1.0, 1.0)
            yield other(tau=run.tau * flip), f"signs of {name}'s torque", "the opposite ones"
            yield other(q_motor=run.q_motor * flip), f"signs of {name}'s angle", "the opposite ones"
        for i, j in itertools.combinations(every, 2):
            order = every.copy()
            order[i], order[j] = j, i
            names = f"{joints[i]} and {joints[j]}"
            tau, q_motor = run.tau[:, order], run.q_motor[:, order]
            yield other(tau=tau), f"torques of {names}", "swapped ones"
            yield other(q_motor=q_motor), f"angles of {names}", "swapped ones"
            yield other(tau=tau, q_motor=q_motor), f"columns of {names}", "swapped ones"


def check_fit(where: str, joints: tuple[str, ...], explained: Array) -> None:
    """Refuse a fit that explains too little.

    Raises:
        Refusal: says of which joint.
    """
    for joint, share in zip(joints, explained, strict=True):
        if not share >= POOR:
            rule = f"be explained by the machine to {POOR:g} % at least"
            valid = "look for wrong units, signs, order of axes, or a part that the scene has not"
            raise Refusal(where, f"torque of {joint}", rule, f"{share:.1f} %", valid)
