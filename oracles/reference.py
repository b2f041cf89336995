"""An independent solution of the equations of motion, to far more digits than the emulator needs.

Equations (1), (2) and (4) in plain NumPy, the links by Pinocchio's articulated-body algorithm, time
by SciPy's variable-step integrators. Shares no line with the compiled core: neither the chain's
frames, nor the elimination of the motors, nor a fixed step.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from typing import Any, TypedDict, Unpack

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike
from scipy.integrate import solve_ivp

from arm_emulator.base.arrays import Array
from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.parts.drive_stages.current_loop import CurrentLoop
from arm_emulator.machine.parts.frictions.brake import Brake
from arm_emulator.machine.parts.frictions.friction import LinkFriction
from arm_emulator.machine.parts.gears.elastic_gear import ElasticGear
from arm_emulator.machine.parts.gears.gear import RigidGear
from arm_emulator.machine.parts.gears.progressive_gear import ProgressiveGear
from arm_emulator.machine.parts.joint_effects.end_stops import EndStops
from arm_emulator.machine.parts.motors.dc_motor import DcMotor
from arm_emulator.machine.scene.joint import Joint
from arm_emulator.machine.scene.scene import Scene

ROWS = 6  # of a state: i, tm, wm, q, v, integral of the current controller [V]

# 1/s; above this an explicit method spends its steps on stability, not on accuracy.
STIFF = 3e4


class Beginning(TypedDict, total=False):
    """Initial state and solver of a motion.

    Keys:
        method: of `scipy.integrate.solve_ivp`: "LSODA" for stiff machines, "DOP853" the most
            accurate for non-stiff ones, "Radau" a check of both at ten times their cost. Chosen by
            the machine's fastest time constant if not given.
        q: link positions (N,) [rad or m], the scene's start if not given; motors along.
        v: link speeds (N,) [rad/s or m/s], zero if not given.
        payload: the scene file's section `payload`, which a loaded scene has merged into its links.
    """

    method: str | None
    q: ArrayLike | None
    v: ArrayLike | None
    payload: Mapping[str, Any] | None


def solve_positions(
    scene: Scene,
    commands: ArrayLike,
    period: float,
    rtol: float = 1e-11,
    **beginning: Unpack[Beginning],
) -> Array:
    """Return link positions after each row, (K, N) [rad or m]; else as `solve_states`."""
    return solve_states(scene, commands, period, rtol, **beginning)[:, 3]


def solve_states(
    scene: Scene,
    commands: ArrayLike,
    period: float,
    rtol: float = 1e-11,
    **beginning: Unpack[Beginning],
) -> Array:
    """Solve the machine's equations from rest at the scene's start.

    Args:
        scene: the machine. Its integrator is ignored.
        commands: (K, N) [V, N m, A], row k held from k periods to
            k + 1.
        period: time of each row [s]. The integration starts anew with each row, since
            there the right-hand side jumps.
        rtol: relative error per step of the variable-step method; absolute: a hundredth of it.
            DOP853 takes a hundredth of both: at the edge of its stability its estimate is poor.
        beginning: see `Beginning`.

    Returns:
        i, tm, wm, q, v after each row, (K, 5, N). What a joint lacks (current of a joint without
        inductance, motor behind a rigid gear) is zero.

    Raises:
        Refusal: Coulomb friction or a limit of an inductive current (the right-hand side jumps), or
            a payload that is not given.
    """
    machine = ReferenceMachine(scene, beginning.get("payload"))
    q, method = beginning.get("q"), beginning.get("method")
    x = machine.make_rest_state(scene.start if q is None else q, beginning.get("v"))
    if method is None:
        method = "LSODA" if machine.compute_fastest_rate(x) > STIFF else "DOP853"
    if method == "DOP853":
        rtol = max(1e-2 * rtol, 1e-13)  # SciPy allows 2.2e-14
    rows = np.clip(np.atleast_2d(commands), -machine.largest, machine.largest)
    out = np.empty((len(rows), 5, machine.N))
    step = None
    for k, V in enumerate(rows):
        solution = solve_ivp(
            machine.compute_rates,
            (0.0, period),
            x.ravel(),
            method=method,
            rtol=rtol,
            atol=1e-2 * rtol,
            first_step=step,
            t_eval=[period],
            args=(V,),
        )
        if not solution.success:
            raise RuntimeError(f"reference: {method} failed in row {k}: {solution.message}")
        x = solution.y[:, -1].reshape(x.shape)
        out[k] = x[:5]
    return out


# The parts whose equations stand here. Brakes are open: there is power.
SUPPORTED_PARTS = (
    DcMotor, CurrentLoop, RigidGear, ElasticGear, ProgressiveGear, LinkFriction, Brake, EndStops,
)  # fmt: skip


def _get_motor(joint: Joint) -> DcMotor | None:
    """Return a joint's motor; refuse parts whose equations are not here."""
    for part in joint.parts:
        if type(part) not in SUPPORTED_PARTS:
            where, kinds = (
                f"joints.{joint.name}.{part.section}",
                (part_kind.__name__ for part_kind in SUPPORTED_PARTS),
            )
            rule = "be a part that the reference knows"
            raise Refusal("reference", where, rule, type(part).__name__, ", ".join(kinds))
    assert joint.motor is None or isinstance(joint.motor, DcMotor)
    return joint.motor


def _check_smooth(scene: Scene, motors: Sequence[DcMotor | None]) -> None:
    """Refuse parts that make the right-hand side jump."""
    for joint, motor in zip(scene.joints, motors, strict=True):
        limited = motor is not None and motor.current_limit is not None and motor.inductance > 0.0
        for quantity, there in (
            ("friction.coulomb", joint.friction.coulomb > 0.0),
            ("motor.current_limit", limited and joint.find_part(CurrentLoop) is None),
        ):
            if there:
                where = f"joints.{joint.name}.{quantity}"
                raise Refusal("reference", where, "be absent", "there", "a smooth machine")


class ReferenceMachine:
    """The right-hand side of a scene's equations of motion.

    Args:
        scene: the machine.
        payload: the scene file's section `payload`.
        smooth: whether to refuse parts that make the right-hand side jump.
    """

    def __init__(
        self, scene: Scene, payload: Mapping[str, Any] | None = None, smooth: bool = True
    ) -> None:
        self.N = len(scene.joints)
        motors = [_get_motor(joint) for joint in scene.joints]
        gears = [joint.gear for joint in scene.joints]
        if smooth:
            _check_smooth(scene, motors)
        self.motor = np.array([motor is not None for motor in motors])
        self.R, self.L, self.Kt, self.Kb, self.Mm = np.array(
            [
                (
                    m.resistance,
                    m.inductance,
                    m.torque_constant,
                    m.back_emf_constant,
                    m.rotor_inertia,
                )
                if m is not None
                else (1.0, 0.0, 0.0, 0.0, 1.0)
                for m in motors
            ]
        ).T
        limits = np.array([(m and m.current_limit) or np.inf for m in motors])
        loops = [joint.find_part(CurrentLoop) for joint in scene.joints]
        self.looped = np.array([loop is not None for loop in loops])
        self.supply = scene.supply_voltage
        # With a current loop the limit is one of the command.
        self.limit = np.where(self.looped, np.inf, limits)
        self.largest = np.where(self.looped, limits, self.supply)
        self.P, self.I, self.E = np.array(
            [_get_current_loop(*pair) for pair in zip(loops, motors, strict=True)]
        ).T
        self.Ng = np.array([gear.ratio for gear in gears])
        self.Kg = np.array([gear.stiffness or 0.0 for gear in gears])
        self.Kg3 = np.array(
            [g.cubic_stiffness if isinstance(g, ProgressiveGear) else 0.0 for g in gears]
        )
        self.Dg = np.array([gear.damping for gear in gears])
        self.Dl = np.array([joint.friction.viscous for joint in scene.joints])
        stops = [
            next((part for part in joint.extras if isinstance(part, EndStops)), None)
            for joint in scene.joints
        ]
        self.stops = np.array(
            [
                (s.lower, s.upper, s.stiffness, s.damping) if s else (-np.inf, np.inf, 0.0, 0.0)
                for s in stops
            ]
        ).T
        self.rigid = np.array([gear.stiffness is None for gear in gears])
        self.elastic = self.motor & ~self.rigid
        self.inductive = self.L > 0.0
        self.model = make_links_model(scene, payload)
        self.model.armature = np.where(self.motor & self.rigid, self.Mm / self.Ng**2, 0.0)
        self.data = self.model.createData()

    def make_rest_state(self, q: ArrayLike, v: ArrayLike | None) -> Array:
        """Return x, (6, N), without current and with gears unloaded; see `solve_states`."""
        x = np.zeros((ROWS, self.N))
        x[3] = q
        if v is not None:
            x[4] = v
        x[1:3] = np.where(self.elastic, x[3:5] / self.Ng, 0.0)
        return x

    def compute_fastest_rate(self, x: Array) -> float:
        """Return the largest magnitude of the Jacobian's eigenvalues at x, 0 V [1/s]."""
        V, at = np.zeros(self.N), x.ravel()
        J = np.empty((at.size, at.size))
        for k, step in enumerate(1e-6 * np.maximum(1.0, np.abs(at))):
            ahead, back = at.copy(), at.copy()
            ahead[k] += step
            back[k] -= step
            J[:, k] = (self.compute_rates(0.0, ahead, V) - self.compute_rates(0.0, back, V)) / (
                2.0 * step
            )
        return float(np.abs(np.linalg.eigvals(J)).max())

    def compute_gear_torques(self, tm: Array, wm: Array, q: Array, v: Array) -> Array:
        """Return the torques of elastic gears on their links (N,) [N m]."""
        w = self.Ng * tm - q
        return self.Kg * w + self.Kg3 * w**3 + self.Dg * (self.Ng * wm - v)

    def stop_torques(self, q: Array, v: Array) -> Array:
        """Return the torques of end stops on the links (N,) [N m]."""
        lower, upper, K, D = self.stops
        torque = np.zeros(self.N)
        for side, u in ((1.0, q - upper), (-1.0, lower - q)):
            inside = u > 0.0
            push = K[inside] * u[inside] + side * D[inside] * v[inside]
            torque[inside] -= side * np.maximum(push, 0.0)
        return torque

    def compute_applied(
        self, i: Array, wm: Array, integral: Array, u: Array
    ) -> tuple[Array, Array]:
        """Return the voltages at the windings under commands, and the rates of the integrals."""
        requested = self.P * (u - i) + integral + self.E * wm
        voltage = np.clip(requested, -self.supply, self.supply)
        rate = self.I * (u - i) + self.I / self.P * (voltage - requested)
        return np.where(self.looped, voltage, u), np.where(self.looped, rate, 0.0)

    def compute_rates(self, t: float, flat: Array, V: Array) -> Array:
        """Return dx/dt, flat."""
        i, tm, wm, q, v, integral = flat.reshape(ROWS, self.N)
        wm = np.where(self.rigid, v / self.Ng, wm)
        V, of_integral = self.compute_applied(i, wm, integral, V)
        at_once = np.clip((V - self.Kb * wm) / self.R, -self.limit, self.limit)
        i = np.where(self.inductive, i, at_once)
        T = np.where(
            self.rigid,
            self.Kt * i / self.Ng,  # the rotor is part of the links' mass matrix
            self.compute_gear_torques(tm, wm, q, v),
        )
        dx = np.zeros((ROWS, self.N))
        np.divide(V - self.R * i - self.Kb * wm, self.L, out=dx[0], where=self.inductive)
        dx[1] = np.where(self.elastic, wm, 0.0)
        dx[2] = np.where(self.elastic, (self.Kt * i - self.Ng * T) / self.Mm, 0.0)
        dx[3] = v
        dx[5] = of_integral
        dx[4] = pin.aba(self.model, self.data, q, v, T - self.Dl * v + self.stop_torques(q, v))
        return dx.ravel()


def _get_current_loop(
    loop: CurrentLoop | None, motor: DcMotor | None
) -> tuple[float, float, float]:
    """Return a current loop's P [V/A], I [V/(A s)] and the EMF fed forward [V s/rad]."""
    if loop is None or motor is None:
        return 1.0, 0.0, 0.0
    emf = loop.emf_feedforward * motor.back_emf_constant
    if loop.bandwidth is None:
        return loop.proportional_gain or 0.0, loop.integral_gain or 0.0, emf
    rate = 2.0 * np.pi * loop.bandwidth
    return rate * motor.inductance, rate * motor.resistance, emf


def make_links_model(scene: Scene, payload: Mapping[str, Any] | None = None) -> pin.Model:
    """Return the scene's links in Pinocchio, with plain joint angles in the scene's order.

    Raises:
        Refusal: the masses are not the scene's: its payload was not given.
    """
    if not scene.chain.coupling.is_identity:
        rule = "have a drive for each joint, to be solved independently"
        raise Refusal("reference", scene.where, rule, "couplings or mimic joints")
    robot = ET.fromstring(scene.true_urdf)
    # Pinocchio need not parse unused elements.
    robot.set("name", "robot")
    for link in robot.findall("link"):
        for element in set(link) - set(link.findall("inertial")):
            link.remove(element)
    for element in set(robot) - {*robot.findall("link"), *robot.findall("joint")}:
        robot.remove(element)
    for joint in robot.iter("joint"):
        # Pinocchio represents a continuous joint by cosine and sine; here every angle is a number.
        if joint.get("type") == "continuous":
            joint.set("type", "revolute")
            for limit in joint.findall("limit"):
                joint.remove(limit)
            ET.SubElement(joint, "limit", lower="-1e9", upper="1e9", effort="1e9", velocity="1e9")
    _name_in_order(robot, list(scene.joint_names))
    model = pin.buildModelFromXML(ET.tostring(robot, encoding="unicode"))
    names = [name.split(" ", 1)[1] for name in list(model.names)[1:]]
    assert names == list(scene.joint_names)
    model.gravity.linear = np.array(scene.gravity or (0.0, 0.0, 0.0))
    if payload is not None:
        xx, yy, zz, xy, xz, yz = payload.get("inertia", (0.0,) * 6)
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        com = np.array(payload.get("com", (0.0, 0.0, 0.0)))
        frame = model.frames[model.getFrameId(scene.tool, pin.FrameType.BODY)]
        body = pin.Inertia(payload["mass"], com, inertia)
        model.appendBodyToJoint(frame.parentJoint, body, frame.placement)
    moved = sum(link.body.mass for link in scene.chain.links)
    model_mass = sum(inertia.mass for inertia in list(model.inertias)[1:])
    if abs(moved - model_mass) > 1e-13 * moved:  # rounding of sums of some hundred masses
        raise Refusal(
            "reference", "payload", "be the scene's", f"{model_mass - moved:g} kg too much"
        )
    return model


def _name_in_order(robot: ET.Element, names: list[str]) -> None:
    """Put a number before each joint's name: Pinocchio takes joints of one link by their names."""
    below: dict[str, list[ET.Element]] = {}
    for joint in robot.iter("joint"):
        below.setdefault(joint.find("parent").get("link"), []).append(joint)  # type: ignore[union-attr, arg-type]

    def find_first(joint: ET.Element) -> int:
        """Return the place of the first moving joint at or behind a joint."""
        if (name := joint.get("name", "")) in places:
            return places[name]
        behind = below.get(joint.find("child").get("link"), [])  # type: ignore[union-attr, arg-type]
        return min(map(find_first, behind), default=len(places))

    places = {name: k for k, name in enumerate(names)}
    for joint in list(robot.iter("joint")):
        joint.set("order", f"{find_first(joint):04}")
    for joint in robot.iter("joint"):
        joint.set("name", f"{joint.get('order')} {joint.get('name')}")
