"""Stability of schemes and steps on a machine: by the eigenvalues of one step.

Linearised about rest in a pose, every scheme is a matrix that maps the state x = (z, q, v) of one
sample to the next; z are the states of the drives. Its spectral radius is the factor by which a
small motion grows per step.
"""

import math
from collections.abc import Sequence

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.plant.core_machine import LinearDrive
from arm_emulator.machine.plant.diverged import Diverged
from arm_emulator.machine.plant.plant import Plant
from arm_emulator.machine.schemes.known import KNOWN

# 1/s. What grows more slowly than this, e-fold in ten seconds, is drift and no divergence.
HARMLESS = 0.1
SMALLEST_STEP = 1e-8  # s; no step below is looked at
SLOW = 0.01  # rad or m per step; with less, speed is no reason


class _AllDrives:
    """The drives of all joints in one: D z' = F (z, q, v, u), torque = G (z, q, v, u).

    Attributes:
        D: (n,).
        F: (n, n + 3 N).
        G: (N, n + 3 N).
        current, motor_angle: by the same, (N, n + 3 N).
        no_currents: 0 for the currents among the columns, 1 for all others (n + 3 N,).
    """

    def __init__(self, drives: Sequence[LinearDrive]) -> None:
        N, n = len(drives), sum(len(drive.D) for drive in drives)
        self.D, self.F, self.G = np.zeros(n), np.zeros((n, n + 3 * N)), np.zeros((N, n + 3 * N))
        self.current, self.motor_angle = np.zeros((2, N, n + 3 * N))
        self.no_currents = np.ones(n + 3 * N)
        first = 0
        for j, drive in enumerate(drives):
            own = np.arange(first, first + len(drive.D))
            columns = [*own, n + j, n + N + j, n + 2 * N + j]
            self.D[own] = drive.D
            self.F[np.ix_(own, columns)] = drive.F
            self.G[j, columns] = drive.G
            self.current[j, columns] = drive.current
            self.motor_angle[j, columns] = drive.motor_angle
            self.no_currents[own[drive.current[: len(own)] != 0.0]] = 0.0
            first += len(drive.D)


class SmallMotions:
    """The machine linearised about rest in a pose, all commands 0, held by constant torques.

    Those torques hold the links, so that no gear is wound up. Coulomb friction and current limits
    are left out: both only take energy.

    With the state x = (z, q, v) and the commands u, dx/dt = J x + B u.

    Attributes:
        J: (n, n).
        q: places of the joints' positions in x (N,).
        B: (n, N), per volt (A, N m); 0 for a joint without a motor.
        theta_m: motor angles by x, (N, n); those of the links for joints without a motor.
        current: motor currents by x, (N, n).
        fastest: how fast its fastest motion grows [1/s].
        falls: the same with motors that give no torque: what an arm does by its weight.
        current_by_command: the same by u, (N,) [1/ohm, 1]; 0 where it does not follow at once.

    Args:
        plant: whose links are asked for accelerations; its state is not touched.
        q: the pose (N,) [rad or m].
        loaded: whether a tooth is in contact in gears with play; else links and rotors are apart.
    """

    def __init__(self, plant: Plant, q: Array, loaded: bool = False) -> None:
        scene = plant.scene
        self.scene = scene
        N, places = len(scene.chain.shafts), scene.joint_places
        zero, unit = np.zeros((N, N)), np.eye(N)
        at = np.zeros((N, N))
        at[:, places] = q
        M_inverse, torques = compute_rest(plant, q)
        holding = np.tile(torques, (N, 1))
        step = 1e-5  # rad: the difference is good to 1e-10 of the second derivative
        sag = (
            plant.links.accelerations(at + step * unit, zero, holding)
            - plant.links.accelerations(at - step * unit, zero, holding)
        ).T / (2.0 * step)

        drives = plant.linear_drives(loaded)
        of_drives = _AllDrives(drives)
        n, D, F, G = len(of_drives.D), of_drives.D, of_drives.F, of_drives.G
        # States that follow at once, such as a current without inductance, are no states.
        follows = D == 0.0
        remaining = np.concatenate([~follows, np.ones(3 * N, dtype=bool)])

        def expand_states(F: Array) -> Array:
            expansion = np.eye(n + 3 * N)[:, remaining]
            expansion[:n][follows] = -np.linalg.solve(
                F[follows][:, :n][:, follows], F[follows][:, remaining]
            )
            return expansion

        # M + carried rotors: (M + C)^-1 = (1 + M^-1 C)^-1 M^-1.
        carried = np.array([drive.carried for drive in drives])
        by_torque = np.linalg.solve(unit + M_inverse * carried, M_inverse)
        by_q = np.linalg.solve(unit + M_inverse * carried, sag)

        self.links = int(np.count_nonzero(~follows))  # where q begins
        own_places = slice(self.links, self.links + N)

        def stack_rates(F: Array, G: Array) -> Array:
            expanded = expand_states(F)
            return np.vstack(
                [
                    (F[~follows] / D[~follows, None]) @ expanded,
                    np.eye(N, self.links + 3 * N, self.links + N),  # dq/dt = v
                    by_torque @ G @ expanded,
                ]
            )

        all_states, jacobian = expand_states(F), stack_rates(F, G)
        jacobian, B = jacobian[:, :-N], jacobian[:, -N:]
        angles, measured = of_drives.motor_angle @ all_states, of_drives.current @ all_states
        by_command = np.diag(measured[:, -N:])
        self.B, self.theta_m = B, angles[:, :-N]
        self.current, self.current_by_command = measured[:, :-N], by_command
        if scene.chain.deflections:
            self.B, self.theta_m = B[:, places], angles[places, :-N]
            self.current, self.current_by_command = measured[places, :-N], by_command[places]
        self.q = self.links + np.array(places)
        self.A = jacobian.copy()  # what the schemes treat implicitly
        jacobian[-N:, own_places] += by_q
        self.J = jacobian  # all
        # Without torques of motors: a current acts on nothing but itself.
        no_currents = of_drives.no_currents
        alone = np.where(np.eye(n, n + 3 * N) > 0.0, F, F * no_currents)
        free = stack_rates(alone, G * no_currents)[:, :-N]
        free[-N:, own_places] += by_q
        self.falls = max(0.0, float(np.linalg.eigvals(free).real.max()))  # 1/s
        self.fastest = max(0.0, float(np.linalg.eigvals(self.J).real.max()))  # 1/s
        self._by_torque = by_torque

    def apply_brake(self, joint: int) -> tuple[Array, Array]:
        """Return J and B while a brake holds the rotor of a joint, with its link if that is stiff.

        Held joints stay: their states are rows of zeros.
        """
        J, B = self.J.copy(), self.B.copy()
        (own,) = np.nonzero(self.theta_m[joint])
        m, N, place = self.links, len(self._by_torque), int(self.q[joint])
        if own[0] < m:
            braked_states = [own[0], int(np.argmax(J[own[0]]))]  # its angle, and what that grows by
        else:
            by = self._by_torque[:, place - m] / self._by_torque[place - m, place - m]
            for rows in (J, B):  # the torque that keeps the link acts on the others
                rows[m + N :] -= np.outer(by, rows[N + place])
            braked_states = [place, N + place]
        J[braked_states], B[braked_states] = 0.0, 0.0
        return J, B

    def compute_step_matrix(self, scheme: str, dt: float) -> Array:
        """Return the matrix of one step of a scheme: of x, and x one step ago if it takes that."""
        return KNOWN[scheme].build_step_matrix(self.J, self.A, self.links, dt)

    def compute_growth(self, scheme: str, dt: float) -> float:
        """Return the factor by which the fastest growing small motion grows per step."""
        return float(np.abs(np.linalg.eigvals(self.compute_step_matrix(scheme, dt))).max())

    def is_stable(self, scheme: str, dt: float) -> bool:
        """Whether a scheme makes no motion grow that the machine itself does not make grow."""
        # Rounding splits the double eigenvalue 1 of a free turn by the root of the last place.
        rate = (math.log(self.compute_growth(scheme, dt)) - 1e-7) / dt
        return rate < 1.1 * self.fastest + HARMLESS

    def find_largest_step(self, scheme: str) -> float | None:
        """Return the largest step that holds, at most the scene's, and divides the servo period.

        None: no step above `SMALLEST_STEP` does.
        """
        period, dt = self.scene.servo_period, self.scene.integrator.dt
        low = self.scene.steps_per_period  # too few, as far as is known
        if self.is_stable(scheme, dt):
            return dt
        high = 2 * low
        while not self.is_stable(scheme, period / high):
            low, high = high, 2 * high
            if period / high < SMALLEST_STEP:
                return None
        while high - low > max(1, high // 50):
            middle = (low + high) // 2
            low, high = (low, middle) if self.is_stable(scheme, period / middle) else (middle, high)
        return period / high


def list_contacts(plant: Plant) -> tuple[bool, ...]:
    """Return the ways in which gears can stand, as `SmallMotions` takes them, loaded first."""
    pairs = zip(plant.linear_drives(True), plant.linear_drives(False), strict=True)
    play = any(not np.array_equal(first.G, second.G) for first, second in pairs)
    return (True, False) if play else (True,)


def compute_rest(plant: Plant, q: Array) -> tuple[Array, Array]:
    """Return the inverse of the links' mass matrix (N, N), and what holds them at rest (N,).

    N counts the joints of the machine; no bearing is deflected.
    """
    N = len(plant.scene.chain.shafts)
    zero, unit, at = np.zeros((N, N)), np.eye(N), np.zeros(N)
    at[plant.scene.joint_places] = q
    fall = plant.links.accelerations(at, zero[0], zero[0])
    M_inverse: Array = (plant.links.accelerations(np.tile(at, (N, 1)), zero, unit) - fall).T
    return M_inverse, np.linalg.solve(M_inverse, -fall).astype(np.float64)


def explain_divergence(fault: Exception) -> Exception:
    """Add to a divergence why it came, before it is reported; return it."""
    if isinstance(fault, Diverged) and not fault.hint:
        fault.hint = describe_divergence(fault)
    return fault


def describe_divergence(fault: Diverged) -> str:
    """Return in words why a machine diverged, by its small motions about rest in that pose."""
    scene, now = fault.scene, fault.scene.integrator
    try:
        motions = SmallMotions(Plant(scene), fault.q)
        if not motions.is_stable(now.scheme, now.dt):
            growth, dt = (
                motions.compute_growth(now.scheme, now.dt),
                motions.find_largest_step(now.scheme),
            )
            words = f"each step multiplies a small motion about rest in this pose by {growth:.3g}"
            return words if dt is None else f"{words}, with dt = {dt:.3g} s none grows"
    except (np.linalg.LinAlgError, Refusal):  # numbers so far apart that something overflows
        return "small motions in this pose could not be examined"
    turn = float(np.abs(fault.v).max()) * now.dt
    words = "small motions about rest in this pose hold"
    if turn < SLOW:
        return f"{words}, and the motion was slow, {turn:.2g} rad or m per step"
    stiffens = any(joint.gear.stiffens for joint in scene.joints)
    more = ", or a gear is wound up beyond what is linear in it" if stiffens else ""
    return f"{words}: the motion is too fast for the step, {turn:.2g} rad or m per step{more}"
