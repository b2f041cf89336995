"""Stability of schemes and steps on a machine: by the eigenvalues of one step, and by trial.

Linearised about rest in a pose, every scheme is a matrix that maps the state x = (z, q, v) of one
sample to the next; z are the states of the drives. Its spectral radius is the factor by which a
small motion grows per step.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.chain import Array
from arm_emulator.machine.core_machine import LinearDrive
from arm_emulator.machine.diverged import Diverged
from arm_emulator.machine.integrator import Integrator
from arm_emulator.machine.plant import Plant
from arm_emulator.machine.scene import Scene
from arm_emulator.machine.schemes.known import KNOWN, LOCATING_SCHEMES, SCHEMES

# 1/s. What grows more slowly than this, e-fold in ten seconds, is drift and no divergence.
HARMLESS = 0.1
SMALLEST_STEP = 1e-8  # s; no step below is looked at
SLOW = 0.01  # rad or m per step; with less, speed is no reason
LONGEST_TRIAL = 3e6  # steps; about a second of computing for an arm of six joints


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
        N = len(scene.joints)
        zero, unit = np.zeros((N, N)), np.eye(N)
        at = np.tile(q, (N, 1))
        M_inverse, torques = at_rest(plant, q)
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
        kept = np.concatenate([~follows, np.ones(3 * N, dtype=bool)])

        def from_kept(F: Array) -> Array:
            whole = np.eye(n + 3 * N)[:, kept]
            whole[:n][follows] = -np.linalg.solve(
                F[follows][:, :n][:, follows], F[follows][:, kept]
            )
            return whole

        # M + carried rotors: (M + C)^-1 = (1 + M^-1 C)^-1 M^-1.
        carried = np.array([drive.carried for drive in drives])
        by_torque = np.linalg.solve(unit + M_inverse * carried, M_inverse)
        by_q = np.linalg.solve(unit + M_inverse * carried, sag)

        self.links = int(np.count_nonzero(~follows))  # where q begins
        own_places = slice(self.links, self.links + N)

        def rates(F: Array, G: Array) -> Array:
            of_kept = from_kept(F)
            return np.vstack(
                [
                    (F[~follows] / D[~follows, None]) @ of_kept,
                    np.eye(N, self.links + 3 * N, self.links + N),  # dq/dt = v
                    by_torque @ G @ of_kept,
                ]
            )

        all_from_kept, whole = from_kept(F), rates(F, G)
        whole, self.B = whole[:, :-N], whole[:, -N:]
        self.theta_m = (of_drives.motor_angle @ all_from_kept)[:, :-N]
        measured = of_drives.current @ all_from_kept
        self.current, self.current_by_command = measured[:, :-N], np.diag(measured[:, -N:])
        self.A = whole.copy()  # what the schemes treat implicitly
        whole[-N:, own_places] += by_q
        self.J = whole  # all
        # Without torques of motors: a current acts on nothing but itself.
        no_currents = of_drives.no_currents
        alone = np.where(np.eye(n, n + 3 * N) > 0.0, F, F * no_currents)
        free = rates(alone, G * no_currents)[:, :-N]
        free[-N:, own_places] += by_q
        self.falls = max(0.0, float(np.linalg.eigvals(free).real.max()))  # 1/s
        self.fastest = max(0.0, float(np.linalg.eigvals(self.J).real.max()))  # 1/s
        self._by_torque = by_torque

    def braked(self, joint: int) -> tuple[Array, Array]:
        """Return J and B while a brake holds the rotor of a joint, with its link if that is stiff.

        Held joints stay: their states are rows of zeros.
        """
        J, B = self.J.copy(), self.B.copy()
        (own,) = np.nonzero(self.theta_m[joint])
        m, N = self.links, len(self.theta_m)
        if own[0] < m:
            held = [own[0], int(np.argmax(J[own[0]]))]  # its angle, and what that grows by
        else:
            by = self._by_torque[:, joint] / self._by_torque[joint, joint]
            for rows in (J, B):  # the torque that keeps the link acts on the others
                rows[m + N :] -= np.outer(by, rows[m + N + joint])
            held = [m + joint, m + N + joint]
        J[held], B[held] = 0.0, 0.0
        return J, B

    def step(self, scheme: str, dt: float) -> Array:
        """Return the matrix of one step of a scheme: of x, and x one step ago if it takes that."""
        return KNOWN[scheme].matrix(self.J, self.A, self.links, dt)

    def growth(self, scheme: str, dt: float) -> float:
        """Return the factor by which the fastest growing small motion grows per step."""
        return float(np.abs(np.linalg.eigvals(self.step(scheme, dt))).max())

    def holds(self, scheme: str, dt: float) -> bool:
        """Whether a scheme makes no motion grow that the machine itself does not make grow."""
        # Rounding splits the double eigenvalue 1 of a free turn by the root of the last place.
        rate = (math.log(self.growth(scheme, dt)) - 1e-7) / dt
        return rate < 1.1 * self.fastest + HARMLESS

    def largest_step(self, scheme: str) -> float | None:
        """Return the largest step that holds, at most the scene's, and divides the servo period.

        None: no step above `SMALLEST_STEP` does.
        """
        period, dt = self.scene.servo_period, self.scene.integrator.dt
        low = self.scene.steps_per_period  # too few, as far as is known
        if self.holds(scheme, dt):
            return dt
        high = 2 * low
        while not self.holds(scheme, period / high):
            low, high = high, 2 * high
            if period / high < SMALLEST_STEP:
                return None
        while high - low > max(1, high // 50):
            middle = (low + high) // 2
            low, high = (low, middle) if self.holds(scheme, period / middle) else (middle, high)
        return period / high


def contacts(plant: Plant) -> tuple[bool, ...]:
    """Return the ways in which gears can stand, as `SmallMotions` takes them, loaded first."""
    pairs = zip(plant.linear_drives(True), plant.linear_drives(False), strict=True)
    play = any(not np.array_equal(one.G, other.G) for one, other in pairs)
    return (True, False) if play else (True,)


def at_rest(plant: Plant, q: Array) -> tuple[Array, Array]:
    """Return the inverse of the links' mass matrix at q (N, N), and what holds them there (N,)."""
    N = len(plant.scene.joints)
    zero, unit = np.zeros((N, N)), np.eye(N)
    fall = plant.links.accelerations(q, zero[0], zero[0])
    M_inverse: Array = (plant.links.accelerations(np.tile(q, (N, 1)), zero, unit) - fall).T
    return M_inverse, np.linalg.solve(M_inverse, -fall).astype(np.float64)


def explain(fault: Exception) -> Exception:
    """Add to a divergence what would hold, see `what_holds`, before it is reported; return it."""
    if isinstance(fault, Diverged) and not fault.hint:
        fault.hint = what_holds(fault)
    return fault


def what_holds(fault: Diverged) -> str:
    """Return in words why a machine diverged, and what held where it was tried.

    That is the scene's scheme at a smaller step, and the first of the others. May compile and take
    seconds.
    """
    motions = _small_motions(fault)
    own = fault.scene.integrator.scheme
    last: list[Attempt] = []  # of each scheme that was tried
    for scheme in (own, *(other for other in SCHEMES if other != own)):
        try:
            last += list(_attempts_with(scheme, fault, motions))[-1:]
        except Refusal:  # nothing to compile with
            continue
        if scheme != own and last and last[-1].held:
            break
    tried = ", ".join(map(str, last)) or "nothing could be"
    return f"{_why(fault, motions)}; tried in this pose and from the start, under this: {tried}"


def _small_motions(fault: Diverged) -> SmallMotions | None:
    try:
        motions = SmallMotions(Plant(fault.scene), fault.q)
        motions.holds(fault.scene.integrator.scheme, fault.scene.integrator.dt)
    except (np.linalg.LinAlgError, Refusal):  # numbers so far apart that something overflows
        return None
    return motions


def _why(fault: Diverged, motions: SmallMotions | None) -> str:
    now = fault.scene.integrator
    if motions is None:
        return "small motions in this pose could not be examined"
    if not motions.holds(now.scheme, now.dt):
        growth = motions.growth(now.scheme, now.dt)
        return f"each step multiplies a small motion about rest in this pose by {growth:.3g}"
    turn = float(np.abs(fault.v).max()) * now.dt
    why = "small motions about rest in this pose hold"
    if turn < SLOW:
        return f"{why}, and the motion was slow, {turn:.2g} rad or m per step"
    return (
        f"{why}: the motion is too fast for the step, {turn:.2g} rad or m per step"
        f"{_stiffened(fault.scene)}"
    )


def _stiffened(scene: Scene) -> str:
    progressive = any(joint.gear.stiffens for joint in scene.joints)
    return ", or a gear is wound up beyond what is linear in it" if progressive else ""


@dataclass(frozen=True)
class Attempt:
    """One trial: the scene with another integrator, under constant commands."""

    integrator: Integrator
    reached: float  # s of logical time
    held: bool

    def __str__(self) -> str:
        end = "held" if self.held else "diverged"
        return (
            f"{self.integrator.scheme} at dt = {self.integrator.dt:.3g} s {end} "
            f"({self.reached:.3g} s)"
        )


def attempts(fault: Diverged) -> Iterator[Attempt]:
    """Try what would hold; may compile and take seconds.

    Under the commands that were applied last, the machine starts at rest in the pose where it
    diverged, and from where it was reset before; it moves for twice the time to the divergence
    (half a second at least). Each scheme is tried at the largest step that holds for small motions,
    the scene's at most, and then at a half, a fourth, ... of it until it holds; the scene's own
    scheme last, and below the scene's step, at which it is known to fail.
    """
    own, motions = fault.scene.integrator.scheme, _small_motions(fault)
    for scheme in (*(other for other in SCHEMES if other != own), own):
        yield from _attempts_with(scheme, fault, motions)


def _attempts_with(scheme: str, fault: Diverged, motions: SmallMotions | None) -> Iterator[Attempt]:
    now, duration = fault.scene.integrator, max(0.5, 2.0 * fault.t)
    dt = now.dt if motions is None else motions.largest_step(scheme)
    if dt == now.dt and scheme == now.scheme:
        dt /= 2.0
    while dt is not None and duration / dt < LONGEST_TRIAL:
        attempt = _attempt(scheme, dt, fault, duration)
        yield attempt
        if attempt.held:
            return
        dt /= 2.0


def _attempt(scheme: str, dt: float, fault: Diverged, duration: float) -> Attempt:
    events = fault.scene.integrator.events if scheme in LOCATING_SCHEMES else "step"
    integrator = dataclasses.replace(fault.scene.integrator, scheme=scheme, dt=dt, events=events)
    plant = Plant(dataclasses.replace(fault.scene, integrator=integrator, threads=1))
    reached = math.inf
    for q, v in ((fault.q, np.zeros_like(fault.v)), fault.began):
        plant.reset(q, v)
        try:
            plant.advance(fault.applied, math.ceil(duration / dt))
        except Diverged:
            return Attempt(integrator, plant.t, held=False)
        reached = min(reached, plant.t)
    return Attempt(integrator, reached, held=True)
