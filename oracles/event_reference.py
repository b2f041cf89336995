"""An independent solution for machines that stick and whose currents meet limits.

It solves the equations of `oracles.reference` in pieces. In each piece the modes of the joints are
held. SciPy finds the end of the first of these modes, on the dense output of its own steps. It
shares no line with the core.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike
from scipy.integrate import solve_ivp

from arm_emulator.base.arrays import Array
from arm_emulator.machine.scene.scene import Scene
from oracles.reference import ROWS, STIFF, ReferenceMachine

ROUNDING = 1e-9  # of a breakaway torque or a limit: what is nearer to it is at it
MAX_PIECES = 1000  # in one row
MAX_ROUNDS = 10  # per joint, of freeing and locking

Margin = Callable[[float, Array], float]


class MachineWithModes(ReferenceMachine):
    """The equations with each joint sliding or locked, its current free or at its limit."""

    def __init__(self, scene: Scene) -> None:
        super().__init__(scene, smooth=False)
        frictions = [joint.friction for joint in scene.joints]
        self.Dc = np.array([friction.coulomb for friction in frictions])
        self.Ds = np.array([friction.breakaway for friction in frictions])
        self.armature = np.array(self.model.armature)
        self.model.armature = np.zeros(self.N)
        self.locked = np.zeros(self.N, dtype=bool)
        self.direction = np.zeros(self.N)
        self.side = np.zeros(self.N)

    def compute_currents(self, x: Array, V: Array) -> tuple[Array, Array]:
        """Return the currents in these modes, and the voltage that remains to raise them."""
        i, _, wm, _, v, integral = x
        wm = np.where(self.rigid, v / self.Ng, wm)
        V, _ = self.compute_applied(i, wm, integral, V)
        i = np.where(self.inductive, i, (V - self.Kb * wm) / self.R)
        i = np.where(self.side != 0.0, self.side * np.where(self.side != 0.0, self.limit, 0.0), i)
        return i, V - self.R * i - self.Kb * wm

    def compute_forces(self, x: Array, V: Array) -> tuple[Array, Array, Array]:
        """Return the gears' torques, accelerations, and what the locks hold."""
        _, tm, wm, q, v, _ = x
        i, _ = self.compute_currents(x, V)
        T = np.where(
            self.rigid,
            self.Kt * i / self.Ng,
            self.compute_gear_torques(tm, wm, q, v),
        )
        M = pin.crba(self.model, self.data, q)
        M = np.triu(M) + np.triu(M, 1).T + np.diag(self.armature)
        free = ~self.locked
        tau = T - self.Dl * v - self.Dc * self.direction * free
        tau -= pin.rnea(self.model, self.data, q, v, np.zeros(self.N))
        a = np.zeros(self.N)
        a[free] = np.linalg.solve(M[np.ix_(free, free)], tau[free])
        return T, a, np.where(self.locked, tau - M @ a, 0.0)

    def compute_motor_accelerations(self, i: Array, T: Array, a: Array) -> Array:
        """Return how the motors accelerate under currents and gears' torques [rad/s2]."""
        elastic: Array = (self.Kt * i - self.Ng * T) / self.Mm
        return np.where(self.elastic, elastic, a / self.Ng)

    def compute_rates(self, t: float, flat: Array, V: Array) -> Array:
        """Return dx/dt in these modes, flat."""
        x = flat.reshape(ROWS, self.N)
        i, surplus = self.compute_currents(x, V)
        T, a, _ = self.compute_forces(x, V)
        dx = np.zeros((ROWS, self.N))
        np.divide(surplus, self.L, out=dx[0], where=self.inductive & (self.side == 0.0))
        dx[1] = np.where(self.elastic, x[2], 0.0)
        dx[2] = np.where(self.elastic, self.compute_motor_accelerations(i, T, a), 0.0)
        dx[3], dx[4] = x[4], a
        wm = np.where(self.rigid, x[4] / self.Ng, x[2])
        dx[5] = self.compute_applied(x[0], wm, x[5], V)[1]
        return dx.ravel()

    def choose_locks(self, x: Array, V: Array, freed: int | None = None) -> None:
        """Lock every joint at rest but `freed`, then free what is overloaded, the worst first.

        Joints that the others would then drive backwards are locked again.
        """
        hold = self.compute_forces(x, V)[2]
        v = x[4]
        rests = (self.Dc > 0.0) & (v == 0.0)
        self.locked = rests.copy()
        self.direction = np.sign(v)
        if freed is not None:
            self.locked[freed], self.direction[freed] = False, np.sign(hold[freed])
            rests[freed] = False  # how it sets out is within rounding
        for _ in range(MAX_ROUNDS * self.N):
            _, a, hold = self.compute_forces(x, V)
            over = np.where(self.locked, np.abs(hold) - self.Ds * (1.0 + ROUNDING), -1.0)
            worst = int(np.argmax(over))
            if over[worst] > 0.0:
                self.locked[worst], self.direction[worst] = False, np.sign(hold[worst])
                continue
            ahead = np.where(rests & ~self.locked, a * self.direction, 0.0)
            worst = int(np.argmin(ahead))
            if ahead[worst] >= 0.0:
                return
            self.locked[worst] = True
        raise RuntimeError(f"reference: no locks hold at v = {v}")

    def choose_sides(self, x: Array, V: Array) -> None:
        """Let each current be free, or held at its limit."""
        self.side[:] = 0.0
        i, _ = self.compute_currents(x, V)
        at = np.where(np.abs(i) >= self.limit * (1.0 - ROUNDING), np.sign(i), 0.0)
        self.side = at
        _, surplus = self.compute_currents(x, V)
        self.side = np.where(at * surplus >= 0.0, at, 0.0)

    def hold_limit(self, j: int, x: Array, V: Array) -> None:
        """Hold the current of joint j at its limit, unless it has left it, beyond by rounding."""
        currents, surplus = self.compute_currents(x, V)
        side = np.sign(currents[j])
        # Without inductance there is no surplus before it is held; whether there will be decides
        # how the back-EMF changes. One that just touches its limit is not held.
        T, a, _ = self.compute_forces(x, V)
        back_emf_rate = self.Kb * self.compute_motor_accelerations(currents, T, a)
        ahead = surplus[j] if self.inductive[j] else -back_emf_rate[j]
        leaves = side * ahead < 0.0
        self.side[j] = 0.0 if leaves else side
        if self.inductive[j]:
            x[0, j] = side * self.limit[j] * (1.0 - ROUNDING * 1e-3 if leaves else 1.0)

    def list_margins(self, V: Array) -> list[tuple[str, int, Margin]]:
        """Return what ends each mode, by falling through zero."""
        out: list[tuple[str, int, Margin]] = []
        for j in range(self.N):
            if self.locked[j]:
                out.append(("away", j, self._make_grip_margin(V, j)))
            elif self.Dc[j] > 0.0:
                out.append(("rest", j, self._make_speed_margin(j)))
            if np.isfinite(self.limit[j]):
                name = "within" if self.side[j] else "limit"
                out.append((name, j, self._make_limit_margin(V, j)))
        return out

    def _make_grip_margin(self, V: Array, j: int) -> Margin:
        return lambda t, y: float(
            self.Ds[j] - abs(self.compute_forces(y.reshape(ROWS, self.N), V)[2][j])
        )

    def _make_speed_margin(self, j: int) -> Margin:
        return lambda t, y: float(y[4 * self.N + j] * self.direction[j])

    def _make_limit_margin(self, V: Array, j: int) -> Margin:
        def evaluate_margin(t: float, y: Array) -> float:
            i, surplus = self.compute_currents(y.reshape(ROWS, self.N), V)
            return float(self.side[j] * surplus[j] if self.side[j] else self.limit[j] - abs(i[j]))

        return evaluate_margin


def solve_with_events(
    scene: Scene, commands: ArrayLike, period: float, rtol: float = 1e-12
) -> tuple[Array, int]:
    """Return the link positions after each row (K, N) from rest at the scene's start, and events.

    Args:
        scene: the machine, without a payload.
        commands: (K, N) [V, N m, A], each row held for a period.
        period: how long [s].
        rtol: relative error per step; absolute: a hundredth of it.
    """
    machine = MachineWithModes(scene)
    x = machine.make_rest_state(scene.start, None)
    rate = machine.compute_fastest_rate(x)
    method = "Radau" if rate > STIFF else "DOP853"
    # A mode that ends for less than a step is not seen: as when a swinging gear breaks a link away.
    longest = min(period / 40.0, 0.2 / rate)
    rows = np.clip(np.atleast_2d(commands), -machine.largest, machine.largest)
    out, events = np.empty((len(rows), machine.N)), 0
    for k, V in enumerate(rows):
        t = 0.0
        machine.choose_sides(x, V)
        machine.choose_locks(x, V)
        for _ in range(MAX_PIECES):
            margins = machine.list_margins(V)
            stops = [margin for _, _, margin in margins]
            for stop in stops:
                stop.terminal, stop.direction = True, -1.0  # type: ignore[attr-defined]
            solution = solve_ivp(
                lambda t, y, V=V: machine.compute_rates(t, y, V),
                (t, period),
                x.ravel(),
                method=method,
                rtol=max(rtol, 1e-13),  # SciPy allows 2.2e-14
                atol=1e-2 * rtol,
                # A joint that sets out and rests again within the first step would not be seen.
                first_step=min(1e-3 * longest, period - t),
                max_step=longest,
                events=stops,
            )
            t, x = float(solution.t[-1]), solution.y[:, -1].reshape(x.shape)
            if solution.status == 0:
                break
            events += 1
            freed = None
            for (event, j, _), times in zip(margins, solution.t_events, strict=True):
                if not len(times):
                    continue
                if event == "rest":
                    x[4, j] = 0.0
                elif event == "away":
                    freed = j
                elif event == "limit":
                    machine.hold_limit(j, x, V)
                else:
                    machine.side[j] = 0.0
            machine.choose_locks(x, V, freed)
        else:
            raise RuntimeError(f"reference: more than {MAX_PIECES} events in row {k}")
        out[k] = x[3]
    return out, events
