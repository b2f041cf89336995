"""A machine and its servos as one sampled linear system: stability and margins."""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from arm_emulator.analysis.linear_servo import INPUTS, STATES, LinearServo
from arm_emulator.base.arrays import Array

ComplexArray = npt.NDArray[np.complex128]

_THETA, _CURRENT, _APPLIED = (INPUTS.index(name) for name in ("theta", "current", "applied"))
_TARGETS = [INPUTS.index(name) for name in ("target", "v_target")]
_FREQUENCIES = 240  # from 1e-4 of the sampling frequency to its half


@dataclass(frozen=True)
class SampledPlant:
    """A machine of N joints with n states over one servo period, commands held.

    x' = F x + G V. At a tick the drives measure motor angles theta x, and currents current x +
    current_by_command V. V are the commands of the period that ends there.
    """

    F: Array  # (n, n)
    G: Array  # (n, N)
    theta: Array  # (N, n)
    current: Array  # (N, n)
    current_by_command: Array  # (N,)
    q: Array  # (N, n), link positions
    period: float  # s


@dataclass(frozen=True)
class Margins:
    """Margins of a joint's loop, opened at its command with all other loops closed."""

    gain_up: float
    """Factor by which the command may grow; inf: any."""
    gain_down: float
    """Factor by which it may shrink; 0: it may fail."""
    phase: float
    """Phase margin [rad]; pi where the gain never crosses 1."""
    delay: float
    """Additional dead time that the loop tolerates [servo periods]."""
    sensitivity: float
    """Largest |1 / (1 + L)|: largest amplification of disturbances."""


class SampledLoop:
    """Closed loop of machine and servos, for exact commands and encoders without steps.

    Attributes:
        A: one servo period of everything, (n, n).
        B: what it adds per joint target [rad or m] and per speed that comes with it, (n, 2, N).
        radius: growth factor per period of the fastest growing (slowest decaying) motion.

    Args:
        plant: the machine.
        servos: one per joint.
        delay: whole servo periods of dead time between a measurement and the command from it.
    """

    def __init__(self, plant: SampledPlant, servos: list[LinearServo], delay: int = 0) -> None:
        self.plant = plant
        n, N, s = len(plant.F), len(servos), len(STATES)
        # x, the states of the servos, the command applied in the last period, those to come.
        applied = n + s * N
        size = applied + N * (1 + delay)
        measured = np.zeros((len(INPUTS), N, size))
        measured[_THETA, :, :n] = plant.theta
        measured[_CURRENT, :, :n] = plant.current
        for j in range(N):
            measured[_CURRENT, j, applied + j] = plant.current_by_command[j]
            measured[_APPLIED, j, applied + j] = 1.0
        A, B = np.zeros((size, size)), np.zeros((size, 2, N))
        command, by_target = np.zeros((N, size)), np.zeros((N, 2, N))
        for j, servo in enumerate(servos):
            own = slice(n + s * j, n + s * (j + 1))
            A[own] = servo.B @ measured[:, j]
            A[own, own] += servo.A
            B[own, :, j] = servo.B[:, _TARGETS]
            command[j] = servo.D @ measured[:, j]
            command[j, own] += servo.C
            by_target[j, :, j] = servo.D[_TARGETS]
        # The queue of commands: the newest at its end, the one that is applied at its front.
        queue = np.zeros((N * (1 + delay), size))
        queue_by_target = np.zeros((N * (1 + delay), 2, N))
        for d in range(delay):
            queue[N * d : N * (d + 1), applied + N * (d + 1) : applied + N * (d + 2)] = np.eye(N)
        queue[N * delay :] = command
        queue_by_target[N * delay :] = by_target
        A[applied:], B[applied:] = queue, queue_by_target
        A[:n, :n] = plant.F
        A[:n] += plant.G @ queue[:N]
        B[:n] += np.tensordot(plant.G, queue_by_target[:N], 1)
        self.A, self.B = A, B
        self._states, self._command = n, command
        # Inputs added to the commands of the servos.
        added = np.zeros((size, N))
        added[applied + N * delay :] = np.eye(N)
        if delay == 0:
            added[:n] = plant.G
        self._added = added
        self.poles: ComplexArray = np.linalg.eigvals(A).astype(np.complex128)
        self.radius = float(np.abs(self.poles).max())

    @property
    def is_stable(self) -> bool:
        """Whether every small motion decays."""
        return self.radius < 1.0

    def find_loudest(self) -> int:
        """Return the joint whose command is largest in the fastest growing motion."""
        values, vectors = np.linalg.eig(self.A)
        motion = vectors[:, int(np.argmax(np.abs(values)))]
        return int(np.argmax(np.abs(self._command @ motion)))

    def compute_sensitivities(self, count: int = _FREQUENCIES) -> tuple[Array, ComplexArray]:
        """Return frequencies (K,) [rad per period] and 1 / (1 + L) of each joint, (K, N).

        L is the loop opened at the joint's command, all other loops closed: by Schur's complement
        this is the diagonal of the sensitivity matrix.
        """
        from scipy import linalg  # takes long to import

        # Near a pole close to the unit circle, the loop changes within a narrow band.
        resonances = self.poles[(np.abs(self.poles) > 0.7) & (self.poles.imag > 0.0)]
        width = np.abs(1.0 - np.abs(resonances))
        near = np.angle(resonances) + np.array([[-1.0], [-0.3], [0.0], [0.3], [1.0]]) * width
        inside = near[(near > 2e-4 * math.pi) & (near < math.pi)]
        grid = np.geomspace(2e-4 * math.pi, math.pi, count)
        w = np.unique(np.concatenate([grid, inside]))
        # Triangular: a frequency costs the square of the number of states, not its cube.
        T, U = linalg.schur(self.A, output="complex")
        added, command = U.conj().T @ self._added, self._command @ U
        S, pencil = np.empty((len(w), len(command)), complex), -T
        for k, z in enumerate(np.exp(1j * w)):
            np.fill_diagonal(pencil, z - T.diagonal())
            response = linalg.solve_triangular(pencil, added, check_finite=False)
            S[k] = 1.0 + np.einsum("jn,nj->j", command, response)
        return w, S

    def compute_margins(self) -> list[Margins]:
        """Return the margins of each joint's loop."""
        w, S = self.compute_sensitivities()
        return [_compute_margins(w, response) for response in S.T]

    def compute_step_response(self, joint: int, rows: int, every: int = 1) -> Array:
        """Return the response of the link positions to a joint's unit target.

        Args:
            joint: its number.
            rows: number of rows, the first before the arm has moved.
            every: servo periods from row to row.

        Returns:
            (rows, N).
        """
        n = self._states
        size = len(self.A)
        once = np.zeros((size + 1, size + 1))
        once[:size, :size], once[:size, size], once[size, size] = self.A, self.B[:, 0, joint], 1.0
        ahead = np.linalg.matrix_power(once, every)
        x = np.zeros((size + 1, 1))
        x[size] = 1.0
        while x.shape[1] < rows:  # twice as many each time
            x, ahead = np.hstack([x, ahead @ x]), ahead @ ahead
        response: Array = (self.plant.q @ x[:n, :rows]).T
        return response


def _compute_margins(w: Array, S: ComplexArray) -> Margins:
    L = 1.0 / S - 1.0
    # Crossings of L with the negative real axis and the unit circle; linear between two
    # frequencies.
    across = np.flatnonzero(np.signbit(L.imag[1:]) != np.signbit(L.imag[:-1]))
    share = L.imag[across] / (L.imag[across] - L.imag[across + 1])
    real = L.real[across] + share * (L.real[across + 1] - L.real[across])
    factors = -1.0 / np.append(real[real < 0.0], L.real[-1:][L.real[-1:] < 0.0])
    size = np.log(np.abs(L))
    out = np.flatnonzero(np.signbit(size[1:]) != np.signbit(size[:-1]))
    share = size[out] / (size[out] - size[out + 1])
    at = L[out] + share * (L[out + 1] - L[out])
    frequency = w[out] + share * (w[out + 1] - w[out])
    angle = np.angle(-at)
    lag = np.mod(angle, 2.0 * math.pi)  # clockwise turn to -1
    return Margins(
        float(factors[factors > 1.0].min(initial=math.inf)),
        float(factors[factors < 1.0].max(initial=0.0)),
        float(np.abs(angle).min(initial=math.pi)),
        float((lag / frequency).min(initial=math.inf)),
        float(np.abs(S).max()),
    )
