"""A weight behind a gear with losses, solved from event to event by SciPy: truth for load friction.

A motor of inertia Jm has the torque A. Behind it an elastic gear, S = Ng T on the rotor, or a rigid
one moves a weight. The laws of friction are written down from their sources: BAM's budget in
oracles/bam.py, and LossyGear's quadrants here. Neither shares a line with the core.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from arm_emulator.base.arrays import Array

MAX_PIECES = 200  # between two events, in one row
# Torque against a shaft. Arguments: its direction, its speed, the torque that drives it, the torque
# of the gear that it moves. The last: whether the first torque counts as the greater one.
Law = Callable[[float, float, float, float, bool], float]


@dataclass(frozen=True)
class LossyGear:
    """Modelica's, between the rotor (flange a) and what it moves; both bearings' torques at a.

    `loss` states the four quadrants; `__call__` finds the torque of flange a with which flange b
    carries S, as a solver of Modelica does.
    """

    eta_mf1: float
    eta_mf2: float
    tau_bf1: float
    tau_bf2: float

    @property
    def tau_bf_a(self) -> float:
        """Return the bearing's part at flange a."""
        return (self.tau_bf1 - self.tau_bf2) / (self.eta_mf1 - 1.0 / self.eta_mf2)

    def loss(self, sign: float, tau: float) -> float:
        """Return tauLoss for the torque of flange a."""
        if sign > 0.0:
            if tau - self.tau_bf_a >= 0.0:
                return (1.0 - self.eta_mf1) * tau + self.tau_bf1
            return (1.0 - 1.0 / self.eta_mf2) * tau + self.tau_bf2
        if tau + self.tau_bf_a >= 0.0:
            return (1.0 - 1.0 / self.eta_mf2) * tau - self.tau_bf2
        return (1.0 - self.eta_mf1) * tau - self.tau_bf1

    def __call__(self, sign: float, w: float, A: float, S: float, leads: bool) -> float:
        """Return what the rotor feels of it beyond S."""
        far = 10.0 * (abs(S) + self.tau_bf1 + self.tau_bf2 + 1.0) / self.eta_mf1
        tau = brentq(lambda tau: tau - self.loss(sign, tau) - S, -far, far, xtol=1e-16, rtol=1e-14)
        return sign * (tau - S)


@dataclass(frozen=True)
class LossyGearDriven(LossyGear):
    """The same of a shaft that the torque of flange a drives, such as a link behind its spring."""

    def __call__(self, sign: float, w: float, A: float, S: float, leads: bool) -> float:
        """Return what flange b gets less than flange a."""
        return sign * self.loss(sign, A)


@dataclass(frozen=True)
class Rotor:
    """A joint whose rotor rubs, behind it a spring and a weight, `weight` against +q [N].

    Without stiffness the gear is rigid and the rotor turns with the link, where all torques act.
    """

    Jm: float
    Ng: float
    Kg: float
    Dg: float
    mass: float
    weight: float
    viscous: float
    law: Law
    at_link: bool = False

    def gear(self, x: Array, A: float) -> float:
        """Return the gear's torque on the link; of a rigid one the motor's."""
        if self.Kg == 0.0:
            return A / self.Ng
        return float(self.Kg * (self.Ng * x[0] - x[2]) + self.Dg * (self.Ng * x[1] - x[3]))

    def torques(self, x: Array, A: float) -> tuple[float, float, float]:
        """Return what drives the shaft that rubs, what the gear is for the law, and the pull."""
        T = self.gear(x, A)
        if self.at_link:
            return T, T, T - self.weight
        return A, self.Ng * T, A - self.Ng * T

    def leads(self, x: Array, A: float) -> float:
        """Return by how much the torque of the motor is the greater one."""
        drives, of_gear, _ = self.torques(x, A)
        return abs(drives) - abs(of_gear)

    @property
    def place(self) -> int:
        """Place of the speed of the shaft that rubs."""
        return 3 if self.at_link else 1

    def rates(self, x: Array, A: float, sign: float, leads: bool) -> list[float]:
        """Return dx/dt; sign 0: the shaft is stuck."""
        T, w = self.gear(x, A), x[self.place]
        drives, of_gear, _ = self.torques(x, A)
        if self.at_link:  # what drives the link is the gear's torque itself
            leads = sign * T > 0.0
        friction = sign * self.law(sign, w, drives, of_gear, leads) if sign else 0.0
        friction += self.viscous * w
        rotor, link = A - self.Ng * T, T - self.weight
        if self.at_link:
            link = link - friction if sign else 0.0
        else:
            rotor = rotor - friction if sign else 0.0
        if self.Kg == 0.0:
            a = link / (self.mass + self.Jm / self.Ng**2)
            return [x[3] / self.Ng, a / self.Ng, x[3], a]
        return [x[1], rotor / self.Jm, x[3], link / self.mass]

    def excess(self, x: Array, A: float, sign: float) -> float:
        """Return how far the pull that way is beyond what holds the shaft at rest."""
        drives, of_gear, pull = self.torques(x, A)
        leads = sign * of_gear > 0.0 if self.at_link else self.leads(x, A) > 0.0
        return sign * pull - self.law(sign, 0.0, drives, of_gear, leads)

    def run(self, commands: Array, period: float, start: Array) -> tuple[Array, list[float]]:
        """Return the states after each command, and the times at which the shaft stopped."""
        x, states, stops = np.array(start, float), [], list[float]()
        for k, A in enumerate(commands):
            t, end, away = 0.0, period, 0.0
            leads = self.leads(x, A) > 0.0
            for piece in range(MAX_PIECES):
                if t >= end:
                    break
                assert piece < MAX_PIECES - 1, f"no progress at {t} s of row {k}"
                sign = self.direction_at(x, A, away)
                solution = solve_ivp(
                    lambda _, y, A=A, sign=sign, leads=leads: self.rates(y, A, sign, leads),
                    (t, end), x, "DOP853", rtol=1e-11, atol=1e-13,
                    events=self.events(A, sign, leads, t + 1e-9 * period),
                )  # fmt: skip
                x, t = solution.y[:, -1].copy(), float(solution.t[-1])
                away = 0.0
                if solution.status == 1:
                    which = next(n for n, at in enumerate(solution.t_events) if len(at))
                    if not sign:
                        away = 1.0 if which == 0 else -1.0
                    if sign and which == 1:
                        leads = not leads
                    else:
                        leads = self.leads(x, A) > 0.0
                    if sign and which == 0:
                        x[1 if self.Kg == 0.0 else self.place] = x[self.place] = 0.0
                        stops.append(k * period + t)
            states.append(x.copy())
        return np.array(states), stops

    def direction_at(self, x: Array, A: float, away: float) -> float:
        """Return the direction of the shaft, 0 where it sticks; `away`: it just broke away."""
        if away:
            return away
        if x[self.place] != 0.0:
            return float(np.sign(x[self.place]))
        pulled = float(np.sign(self.torques(x, A)[2])) or 1.0
        return pulled if self.excess(x, A, pulled) > 0.0 else 0.0

    def events(self, A: float, sign: float, leads: bool, begin: float) -> list[Any]:
        """Return what ends a smooth piece: a stop, another lead; or breaking away either way.

        None before `begin`: the last event has just been there.
        """

        def stop(t: float, x: Array) -> float:
            return sign * float(x[self.place]) if t > begin else 1.0

        def lead(t: float, x: Array) -> float:
            return (1.0 if leads else -1.0) * self.leads(x, A) if t > begin else 1.0

        def forward(_: float, x: Array) -> float:
            return self.excess(x, A, 1.0)

        def backward(_: float, x: Array) -> float:
            return self.excess(x, A, -1.0)

        ends: list[Any] = [forward, backward]
        if sign:
            ends = [stop] if self.at_link else [stop, lead]
        for end_event in ends:
            end_event.terminal, end_event.direction = True, -1.0 if sign else 1.0
        return ends
