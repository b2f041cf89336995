"""The whole machine as a linear system about a state, or about rest in a pose."""

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from arm_emulator.base.array_equality import ArrayEquality
from arm_emulator.base.arrays import Array
from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.plant.call_arguments import Commands
from arm_emulator.machine.plant.core_machine import Equations
from arm_emulator.machine.plant.plant import Plant
from arm_emulator.machine.scene.scene import Scene, coerce_scene

MAX_ITERATIONS = 30  # of Newton's method
ROUNDING = 1e-10  # of the largest entry in a row of the derivatives: residual permitted at rest


@dataclass(frozen=True, eq=False)
class LinearMachine(ArrayEquality):
    """dx/dt = rate + A (x - x0) + B (u - u0); x are the states of the drives, then q and v.

    The modes of x0 are kept: a link that sticks stays at rest, as does a stuck rotor; a current at
    its limit stays there; a tooth stays in or out of contact. Algebraic quantities, such as a
    current without inductance, are not states.

    Attributes:
        A: (n, n).
        B: (n, N), per unit of each joint's command.
        rate: (n,), dx/dt at x0 under u0; 0 at rest.
        x0: (n,), the state.
        u0: (N,), the commands [V, N m, A].
        theta_m, theta_m_by_u: motor angles by x (N, n) and by u (N, N) [rad].
        current, current_by_u: motor currents likewise [A].
        q, v: places of the links' positions and speeds in x.
        sticks: links that stick (N,).

    N counts the joints that controllers know. The last states are deflections of bearings, then
    their speeds, as `scene.machine_joints` has them.
    """

    A: Array
    B: Array
    rate: Array
    x0: Array
    u0: Array
    theta_m: Array
    theta_m_by_u: Array
    current: Array
    current_by_u: Array
    q: slice
    v: slice
    sticks: NDArray[np.bool_]

    def __repr__(self) -> str:
        n, N = self.B.shape
        return f"<LinearMachine of {n} states and {N} commands>"


def linearise(
    plant: Plant | Scene | str | Path,
    q: ArrayLike | None = None,
    *,
    command: Commands | None = None,
) -> LinearMachine:
    """Return the linearised machine.

    Without a pose it is linearised at its present state, sticking or sliding. With a pose it is
    linearised about rest: commands hold it, gears are wound up by its weight, and no joint sticks.
    A joint without a motor rests where its springs bear the weight, near the pose.

    Args:
        plant: the machine, whose state is unchanged; or its scene, by name or file, at its start.
        q: the pose (N,) [rad or m]; None: where the machine is.
        command: about which (N,), or by names of joints [V, N m, A], without a pose; None: the
            newest that was applied.

    Raises:
        Refusal: the pose or command is invalid, or motors and springs do not hold the pose, as for
            a gear with play.
    """
    if not isinstance(plant, Plant):
        plant = Plant(coerce_scene(plant, "linearise"))
    if q is None:
        voltages = plant.commanded[0] if command is None else command
        return _eliminate_algebraic_states(plant.equations(voltages), plant.scene.joint_places)
    if command is not None:
        raise Refusal("linearise", "command", "be absent in a pose, which decides it", command)
    return _eliminate_algebraic_states(_solve_rest(plant, q), plant.scene.joint_places)


def _solve_rest(plant: Plant, q: ArrayLike) -> Equations:
    """Return the equations at rest near a pose, by Newton's method from unloaded gears.

    It solves for the drives' states, for the command of each motor, and for the position of each
    joint that has none.
    """
    trial = copy.copy(plant)
    trial.reset(q)
    joints, places = trial.scene.machine_joints.values(), trial.scene.joint_places
    N = len(joints)
    driven = np.array([joint.motor is not None for joint in joints])
    at_start = trial.equations(np.zeros(len(places)), slides=True)
    z = np.concatenate([at_start.x, np.zeros(N)])
    for _ in range(MAX_ITERATIONS):
        now = plant.equations(z[-N:][places], z[:-N], slides=True, follows=False)
        m = len(now.D)
        # States without a rate, such as anchors of hysteresis, stay: gears wind up from unloaded.
        states = now.states[now.by[now.states].any(axis=1)]
        rows = np.concatenate([states, m + np.arange(N)])
        columns = np.concatenate([states, m + 2 * N * driven + np.arange(N)])
        J, off = now.by[np.ix_(rows, columns)], now.value[rows]
        # Rows and columns of very different units, each scaled by its largest entry.
        of_row = np.abs(now.by[rows]).max(axis=1)
        of_column = np.abs(J / of_row[:, np.newaxis]).max(axis=0)
        of_column[of_column == 0.0] = 1.0
        scaled = J / of_row[:, np.newaxis] / of_column
        if (np.abs(off) <= ROUNDING * of_row).all():
            return plant.equations(z[-N:][places], z[:-N], slides=True)
        z[columns] += np.linalg.lstsq(scaled, -off / of_row, rcond=1e-12)[0] / of_column
    raise Refusal("linearise", "the pose", "be one that motors and springs hold", np.asarray(q))


def _eliminate_algebraic_states(of: Equations, places: Sequence[int]) -> LinearMachine:
    """Return the linear system without the algebraic states.

    Args:
        of: the equations.
        places: of the joints that controllers know among the machine's.
    """
    N, m = len(of.u), len(of.D)
    follows = of.states[of.D[of.states] == 0.0]
    differential = of.states[of.D[of.states] != 0.0]
    links = m + np.arange(2 * N)
    columns = np.concatenate([differential, links, m + 2 * N + np.arange(N)])
    # d(algebraic) = W d(all others) + w, so that its rows stay 0.
    inner, outer = of.by[np.ix_(follows, follows)], of.by[np.ix_(follows, columns)]
    W, w = -np.linalg.solve(inner, outer), -np.linalg.solve(inner, of.value[follows])

    def substitute_states(places: NDArray[np.int64]) -> tuple[Array, Array]:
        by = of.by[np.ix_(places, follows)]
        return of.by[np.ix_(places, columns)] + by @ W, of.value[places] + by @ w

    n = len(differential) + 2 * N
    of_drives, of_links, of_currents, of_angles = (
        substitute_states(places)
        for places in (differential, *(m + k * N + np.arange(N) for k in range(3)))
    )
    D = of.D[differential]
    of_q = np.eye(N, n + N, len(differential) + N), of.x[m + N :]
    table = np.vstack([of_drives[0] / D[:, np.newaxis], of_q[0], of_links[0]])
    rate = np.concatenate([of_drives[1] / D, of_q[1], of_links[1]])
    (resting,) = np.nonzero(of.sticks)
    for first in (len(differential), len(differential) + N):
        table[first + resting], rate[first + resting] = 0.0, 0.0
    machine = LinearMachine(
        A=table[:, :n],
        B=table[:, n:],
        rate=rate,
        x0=of.x[columns[:n]],
        u0=of.u,
        theta_m=of_angles[0][:, :n],
        theta_m_by_u=of_angles[0][:, n:],
        current=of_currents[0][:, :n],
        current_by_u=of_currents[0][:, n:],
        q=slice(len(differential), len(differential) + N),
        v=slice(len(differential) + N, n),
        sticks=of.sticks,
    )
    return machine if len(places) == N else _put_joints_first(machine, places)


def _put_joints_first(of: LinearMachine, joints: Sequence[int]) -> LinearMachine:
    """Return a linear machine of the joints that controllers know, deflections as its last states.

    Args:
        of: the machine with all of its joints.
        joints: places of those that controllers know.
    """
    own, N, m = np.array(joints), len(of.u0), of.q.start
    others = np.setdiff1d(np.arange(N), own)
    at = np.concatenate(
        [np.arange(m), *(m + k * N + some for some in (own, others) for k in (0, 1))]
    )
    return LinearMachine(
        A=of.A[np.ix_(at, at)],
        B=of.B[np.ix_(at, own)],
        rate=of.rate[at],
        x0=of.x0[at],
        u0=of.u0[own],
        theta_m=of.theta_m[np.ix_(own, at)],
        theta_m_by_u=of.theta_m_by_u[np.ix_(own, own)],
        current=of.current[np.ix_(own, at)],
        current_by_u=of.current_by_u[np.ix_(own, own)],
        q=slice(m, m + len(own)),
        v=slice(m + len(own), m + 2 * len(own)),
        sticks=of.sticks[own],
    )
