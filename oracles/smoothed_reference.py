"""An independent solution in which nothing is decided.

The core decides whether a shaft sticks or slides, a current is at its limit, or a tooth touches. It
finds the instants of these changes. The equations here are ordinary differential equations
without decisions. Dry friction rises from 0 to its full torque within a small speed. A large
resistance pushes a current beyond its limit back. Teeth and stops push where they are pressed.
SciPy's LSODA solves these stiff equations with steps of its own. A stuck joint creeps by some 1e-8
rad in 0.1 s, and the effect on a motion falls with `Smoothing`: a tenth of it shows how much is
left.

Shares no line with the core, and decides nothing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from scipy.integrate import solve_ivp

from arm_emulator import Refusal, Scene
from arm_emulator.base.arrays import Array
from arm_emulator.machine.parts.drive_stages.current_loop import CurrentLoop
from arm_emulator.machine.parts.frictions.brake import Brake
from arm_emulator.machine.parts.frictions.friction import Friction, LinkFriction, OfRotor
from arm_emulator.machine.parts.frictions.lugre import LinkLuGre, LuGre, RotorLuGre
from arm_emulator.machine.parts.gears.backlash_gear import BacklashGear
from arm_emulator.machine.parts.gears.elastic_gear import ElasticGear
from arm_emulator.machine.parts.gears.gear import RigidGear
from arm_emulator.machine.parts.gears.progressive_gear import ProgressiveGear
from arm_emulator.machine.parts.joint_effects.end_stops import EndStops
from arm_emulator.machine.parts.motors.current_motor import CurrentMotor
from arm_emulator.machine.parts.motors.dc_motor import DcMotor
from arm_emulator.machine.parts.motors.torque_motor import TorqueMotor
from arm_emulator.machine.scene.joint import Joint
from oracles.reference import make_links_model

SUPPORTED_PARTS = (
    DcMotor, CurrentLoop, TorqueMotor, CurrentMotor, RigidGear, ElasticGear, ProgressiveGear,
    BacklashGear, LinkFriction, OfRotor, LinkLuGre, RotorLuGre, Brake, EndStops,
)  # fmt: skip


@dataclass(frozen=True)
class Smoothing:
    """Widths of smoothed jumps."""

    speed: float = 1e-5  # rad/s or m/s of a link, within which dry friction has its full torque
    resistance: float = 1e5  # of a winding beyond its limit, in its own resistance
    rtol: float = 1e-9


class Dry:
    """A law of dry friction: torque against the motion."""

    def __init__(self, law: Friction, speed: float) -> None:
        self.Dc, self.Ds, self.speed = law.coulomb, law.breakaway, speed
        self.vs = getattr(law, "stribeck", None)
        self.mu = getattr(law, "load", 0.0)

    def compute_torque(self, w: float, T: float, brake: float = 0.0) -> float:
        """Return it at a speed, under the torque of the gear on that shaft and of a brake."""
        s = w / self.speed
        falls = math.exp(-((w / self.vs) ** 2)) if self.vs else 0.0
        dry = self.Dc + (self.Ds - self.Dc) * falls + self.mu * abs(T) + brake
        torque = dry * math.tanh(8.0 * s)
        if not self.vs and self.Ds > self.Dc and abs(s) < 20.0:
            # A breakaway torque is there at rest alone: up to the speed, and gone some of it later.
            torque += (self.Ds - self.Dc) * s * math.exp(0.5 * (1.0 - s * s))
        return torque


class Bristles:
    """LuGre's friction; its one state is the bend."""

    def __init__(self, law: LuGre) -> None:
        self.law = law

    def compute_rate(self, w: float, z: float) -> float:
        """Return how fast bristles bend."""
        law = self.law
        g = law.coulomb + (law.breakaway - law.coulomb) * math.exp(-((w / law.stribeck) ** 2))
        return w - law.bristle_stiffness * abs(w) * z / g

    def compute_torque(self, w: float, z: float) -> float:
        """Return the torque against the motion."""
        return self.law.bristle_stiffness * z + self.law.bristle_damping * self.compute_rate(w, z)


def compute_push(K: float, D: float, u: float, du: float) -> float:
    """Return what a spring and a damper push with that never pull, pressed in by u."""
    return max(0.0, K * u + D * du) if u > 0.0 else 0.0


def clamp_value(x: float, limit: float | None) -> float:
    """Return x clamped to a limit; None: unlimited."""
    return x if limit is None else min(max(x, -limit), limit)


class SmoothJoint:
    """One joint: states of its motor, rotor and bristles, in this order, and its torques."""

    def __init__(self, joint: Joint, smoothing: Smoothing, supply: float) -> None:
        for part in joint.parts:
            if not isinstance(part, SUPPORTED_PARTS):
                where = f"joints.{joint.name}.{part.section}"
                raise Refusal("reference", where, "be a part that it knows", type(part).__name__)
        self.joint, self.motor, self.gear = joint, joint.motor, joint.gear
        self.supply, self.smoothing = supply, smoothing
        self.Ng = joint.gear.ratio
        self.link = Dry(joint.friction, smoothing.speed)
        self.rotor = Dry(joint.rotor_friction or LinkFriction(), smoothing.speed / abs(self.Ng))
        self.rotor_viscous = joint.rotor_friction.viscous if joint.rotor_friction else 0.0
        self.brake = joint.brake.torque if joint.brake else 0.0
        own = [part for part in joint.extras if isinstance(part, LuGre)]
        self.bristles = [(Bristles(bristles), isinstance(bristles, RotorLuGre)) for bristles in own]
        self.stops = [part for part in joint.extras if isinstance(part, EndStops)]
        self.elastic = self.motor is not None and not isinstance(self.gear, RigidGear)
        lags = (
            self.motor.inductance > 0.0
            if isinstance(self.motor, DcMotor)
            else getattr(self.motor, "bandwidth", None) is not None
        )
        self.of_motor = lags + (joint.find_part(CurrentLoop) is not None)
        self.states = self.of_motor + 2 * self.elastic + len(self.bristles)
        self.armature = (
            getattr(self.motor, "rotor_inertia", 0.0) / self.Ng**2 if not self.elastic else 0.0
        )

    def make_rest_state(self, q: float) -> list[float]:
        """Return the states without current, the gear unloaded."""
        rotor = [q / self.Ng, 0.0] if self.elastic else []
        return [0.0] * self.of_motor + rotor + [0.0] * len(self.bristles)

    def _compute_motor(self, u: float, wm: float, z: list[float]) -> tuple[float, list[float]]:
        """Return the torque on the rotor, and the rates of the motor's states."""
        motor = self.motor
        if isinstance(motor, DcMotor):
            return self._compute_winding(motor, u, wm, z)
        if isinstance(motor, TorqueMotor):
            limit, per_state = motor.torque_limit, 1.0
        else:
            assert isinstance(motor, CurrentMotor)
            limit, per_state = motor.current_limit, motor.torque_constant
        u = clamp_value(u, limit)
        if motor.bandwidth is None:
            return per_state * u, []
        return per_state * z[0], [2.0 * math.pi * motor.bandwidth * (u - z[0])]

    def _compute_winding(
        self, motor: DcMotor, u: float, wm: float, z: list[float]
    ) -> tuple[float, list[float]]:
        R, L, emf = motor.resistance, motor.inductance, motor.back_emf_constant * wm
        if (loop := self.joint.find_part(CurrentLoop)) is not None:
            rate = 2.0 * math.pi * (loop.bandwidth or 0.0)
            P = loop.proportional_gain or rate * L
            I = loop.integral_gain if loop.integral_gain is not None else rate * R  # noqa: E741
            i, x = z
            error = clamp_value(u, motor.current_limit) - i
            requested = P * error + x + loop.emf_feedforward * emf
            V = clamp_value(requested, self.supply)
            return motor.torque_constant * i, [
                (V - R * i - emf) / L, I * error + I / P * (V - requested)
            ]  # fmt: skip
        V = clamp_value(u, self.supply)
        if L == 0.0:
            return motor.torque_constant * clamp_value((V - emf) / R, motor.current_limit), []
        beyond = z[0] - clamp_value(z[0], motor.current_limit)
        drop = V - emf - R * (z[0] + self.smoothing.resistance * beyond)
        return motor.torque_constant * z[0], [drop / L]

    def _compute_gear_torque(self, tm: float, wm: float, q: float, v: float) -> float:
        """Return the torque of an elastic gear on the link."""
        gear, w, rate = self.gear, self.Ng * tm - q, self.Ng * wm - v
        K, D = gear.stiffness or 0.0, gear.damping
        if isinstance(gear, BacklashGear):
            side = -1.0 if w < 0.0 else 1.0
            return side * compute_push(K, D, side * w - 0.5 * gear.backlash, side * rate)
        cubic = gear.cubic_stiffness if isinstance(gear, ProgressiveGear) else 0.0
        return K * w + cubic * w**3 + D * rate

    def compute_rates(
        self, z: list[float], q: float, v: float, u: float, closed: bool
    ) -> tuple[list[float], float]:
        """Return the rates of the states, and the torque on the link."""
        m = self.of_motor
        tm, wm = z[m : m + 2] if self.elastic else (0.0, v / self.Ng)
        tau, out = 0.0, list[float]()
        if self.motor is not None:
            tau, out = self._compute_motor(u, wm, z[:m])
        T = self._compute_gear_torque(tm, wm, q, v) if self.elastic else tau / self.Ng
        on_rotor, on_link = tau, -self.joint.friction.viscous * v
        bends = []
        for (bristles, at_rotor), bend in zip(
            self.bristles, z[-len(self.bristles) :], strict=False
        ):
            w = wm if at_rotor else v
            bends.append(bristles.compute_rate(w, bend))
            if at_rotor:
                on_rotor -= bristles.compute_torque(w, bend)
            else:
                on_link -= bristles.compute_torque(w, bend)
        if self.motor is not None:
            on_rotor -= self.rotor_viscous * wm
            on_rotor -= self.rotor.compute_torque(wm, self.Ng * T, self.brake * closed)
        if self.elastic:
            out += [wm, (on_rotor - self.Ng * T) / self.motor.rotor_inertia]  # type: ignore[union-attr]
            on_link += T
        else:
            on_link += on_rotor / self.Ng
        on_link -= self.link.compute_torque(v, T)
        for stop in self.stops:
            on_link -= compute_push(stop.stiffness, stop.damping, q - stop.upper, v)
            on_link += compute_push(stop.stiffness, stop.damping, stop.lower - q, -v)
        return out + bends, on_link


@dataclass(frozen=True)
class InputRow:
    """A command (N,) and which brakes are closed (N,), for some time [s]."""

    command: Array
    closed: tuple[bool, ...]
    time: float


class SmoothedMachine:
    """A scene's machine; `compute_positions` are those of its links after each row."""

    def __init__(self, scene: Scene, smoothing: Smoothing | None = None) -> None:
        self.smoothing = smoothing or Smoothing()
        self.joints = [SmoothJoint(j, self.smoothing, scene.supply_voltage) for j in scene.joints]
        self.model = make_links_model(scene)
        self.model.armature = np.array([joint.armature for joint in self.joints])
        self.data = self.model.createData()
        self.start = [float(q) for q in scene.start]

    def compute_rates(self, y: Array, row: InputRow) -> list[float]:
        """Return dy/dt; y has all joints' states, then q, then v."""
        values = y.tolist()
        N = len(self.joints)
        q, v = values[-2 * N : -N], values[-N:]
        out: list[float] = []
        torque = np.empty(N)
        at = 0
        for j, joint in enumerate(self.joints):
            own = values[at : at + joint.states]
            at += joint.states
            rates, torque[j] = joint.compute_rates(
                own, q[j], v[j], float(row.command[j]), row.closed[j]
            )
            out += rates
        a = pin.aba(self.model, self.data, y[-2 * N : -N], y[-N:], torque)
        return [*out, *v, *map(float, a)]

    def compute_positions(self, rows: list[InputRow]) -> Array:
        """Return the links' positions from rest at the scene's start, after each row (K, N)."""
        N = len(self.joints)
        y = np.array(
            [
                z
                for joint, q in zip(self.joints, self.start, strict=True)
                for z in joint.make_rest_state(q)
            ]
            + self.start
            + [0.0] * N
        )
        out = np.empty((len(rows), N))
        for k, row in enumerate(rows):
            solution = solve_ivp(
                lambda _, y, row=row: self.compute_rates(y, row), (0.0, row.time), y, "LSODA",
                t_eval=[row.time], rtol=self.smoothing.rtol, atol=1e-3 * self.smoothing.rtol,
                max_step=row.time / 20.0, first_step=1e-9,
            )  # fmt: skip
            if not solution.success:
                raise RuntimeError(f"smoothed reference: row {k}: {solution.message}")
            y = solution.y[:, -1]
            out[k] = y[-2 * N : -N]
        return out
