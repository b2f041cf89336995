"""The same machine in MuJoCo: dcmotor actuators, a fixed tendon as gear.

MuJoCo gets what its documentation offers for such a machine, and nothing that slows it down: no
geometry, and contacts and constraints are switched off. Its links come from Pinocchio's reading of
the URDF, so that a slip in the emulator's own reading would show as a difference.

The rotor is a separate body beside the chain, as in the paper's equations: its inertia turns about
its own axis only. An arrangement with rotor and gear as two coaxial hinges of
each link gave the same accuracy or less at the same cost.
"""

from __future__ import annotations

import importlib
from functools import cache
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from arm_emulator import Diverged, Plant, Refusal, Scene
from arm_emulator.base.arrays import Array
from arm_emulator.machine.parts.motors.dc_motor import DcMotor
from arm_emulator.machine.scene.joint import Joint
from bench.speed.bare import list_odd_parts
from oracles.reference import make_links_model

INTEGRATORS = ("Euler", "implicit", "implicitfast", "discrete", "RK4")

UNUSED = ("contact", "constraint", "equality", "limit", "frictionloss", "warmstart")


@cache
def import_mujoco() -> Any:
    """Return MuJoCo, of requirements-bench.txt: tests, which read reports, do without it."""
    module = importlib.import_module("mujoco")
    # Else it writes a file into the working directory; `PeerDiverged` reports the same.
    module.set_mju_user_warning(lambda message: None)
    return module


class PeerDiverged(RuntimeError):
    """MuJoCo has warned of a bad state, and reset itself."""


class MujocoArm:
    """A scene's machine, stepped by MuJoCo.

    Args:
        scene: the machine, with the parts of a bare scene; no current limit, no payload.
        integrator: one of `INTEGRATORS`.
        dt: step [s].
    """

    def __init__(self, scene: Scene, integrator: str, dt: float) -> None:
        self.model = import_mujoco().MjModel.from_xml_string(write_mjcf(scene, integrator, dt))
        self.data = import_mujoco().MjData(self.model)
        self._start = scene.start
        self._elastic = [
            k for k, j in enumerate(scene.joints) if j.motor and j.gear.stiffness is not None
        ]
        self._ratio = scene.gear_ratios
        self._q = self._find_addresses([joint.name for joint in scene.joints])
        self._motors = self._find_addresses(
            [f"{scene.joints[k].name}_rotor" for k in self._elastic]
        )
        self._driven = [k for k, joint in enumerate(scene.joints) if joint.motor is not None]
        self.reset()

    def _find_addresses(self, names: list[str]) -> NDArray[np.int64]:
        return np.array([self.model.joint(name).qposadr[0] for name in names], dtype=np.int64)

    def reset(self) -> None:
        """Put the machine at its start: at rest, gears unloaded, no current."""
        import_mujoco().mj_resetData(self.model, self.data)
        self.data.qpos[self._q] = self._start
        if self._elastic:
            self.data.qpos[self._motors] = (self._start / self._ratio)[self._elastic]

    def run(self, voltages: ArrayLike, steps: int) -> None:
        """Hold each row of voltages (K, N) [V] for `steps` steps.

        Raises:
            PeerDiverged: see there.
        """
        control, model, data, step = self.data.ctrl, self.model, self.data, import_mujoco().mj_step
        for row in np.asarray(voltages)[:, self._driven]:
            control[:] = row
            step(model, data, nstep=steps)
        self._check_state()

    def trace_rows(self, voltages: ArrayLike, steps: int) -> Array:
        """Do as `run`, and return link positions after each row, (K, N) [rad or m]."""
        rows, step = np.asarray(voltages), import_mujoco().mj_step
        q = np.empty((len(rows), len(self._q)))
        for k, row in enumerate(rows):
            self.data.ctrl[:] = row[self._driven]
            step(self.model, self.data, nstep=steps)
            q[k] = self.data.qpos[self._q]
        self._check_state()
        return q

    def _check_state(self) -> None:
        kinds = import_mujoco().mjtWarning
        bad = kinds.mjWARN_BADQPOS, kinds.mjWARN_BADQVEL, kinds.mjWARN_BADQACC
        if any(self.data.warning[kind].number > 0 for kind in bad):
            raise PeerDiverged

    def choose_driven(self, voltages: Array) -> Array:
        """Return the voltages of the joints with motors, of (N,) [V]."""
        return voltages[self._driven]

    def choose_links(self, positions: Array) -> Array:
        """Return the positions of links, of all of MuJoCo's positions."""
        return np.array(positions[self._q], np.float64)

    @property
    def q(self) -> Array:
        """Link positions now (N,) [rad or m]."""
        return self.choose_links(self.data.qpos)


def end_of(machine: Plant | MujocoArm, voltages: Array, steps: int) -> Array | None:
    """Hold each row for `steps` steps; return link positions (N,) at the end, None: it diverged."""
    try:
        if isinstance(machine, MujocoArm):
            machine.run(voltages, steps)
            return machine.q
        end: Array = machine.run(voltages, steps)[-1]
    except (Diverged, PeerDiverged):
        return None
    return end


def write_mjcf(scene: Scene, integrator: str, dt: float) -> str:
    """Return the scene's machine as MJCF text.

    Raises:
        Refusal: it has a part that is not written here.
    """
    if odd := list_odd_parts(scene):
        raise Refusal("MuJoCo", "parts", "be those of a bare scene", ", ".join(odd))
    model = make_links_model(scene)
    flags = " ".join(f'{name}="disable"' for name in UNUSED)
    links, rotors, gears, motors = "", "", "", ""
    for index, joint in enumerate(scene.joints, start=1):
        links += _write_link(model, index, joint)
        if not isinstance(joint.motor, DcMotor):  # it has none
            continue
        motors += _write_motor(joint, joint.motor)
        if joint.gear.stiffness is not None:
            rotors += _write_rotor(joint, joint.motor)
            gears += _write_gear(joint)
    links += "</body>" * len(scene.joints)
    return f"""<mujoco>
<compiler angle="radian"/>
<option timestep="{dt!r}" integrator="{integrator}"
 gravity="{_join_values(scene.gravity or (0, 0, 0))}">
<flag {flags}/></option>
<worldbody>{rotors}{links}</worldbody>
<tendon>{gears}</tendon>
<actuator>{motors}</actuator>
</mujoco>"""


def _write_link(model: pin.Model, index: int, joint: Joint) -> str:
    placement, inertia = model.jointPlacements[index], model.inertias[index]
    turn = pin.Quaternion(placement.rotation)
    I = inertia.inertia  # noqa: E741
    tensor = (I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2])
    linear, angular = find_joint_axis(model, index)
    kind, axis = ("hinge", angular) if angular.any() else ("slide", linear)
    rigid = joint.motor is not None and joint.gear.stiffness is None
    carried = joint.motor.inertia / joint.gear.ratio**2 if rigid and joint.motor else 0.0
    return f"""
<body pos="{_join_values(placement.translation)}"
 quat="{_join_values((turn.w, turn.x, turn.y, turn.z))}">
<inertial mass="{inertia.mass!r}" pos="{_join_values(inertia.lever)}"
 fullinertia="{_join_values(tensor)}"/>
<joint name="{joint.name}" type="{kind}" axis="{_join_values(axis)}"
 damping="{joint.friction.viscous!r}" armature="{carried!r}"/>"""


def find_joint_axis(model: pin.Model, index: int) -> tuple[Array, Array]:
    """Return the linear and the angular part of a joint's motion, in its own frame, (3,) each."""
    joint = model.joints[index]
    data = joint.createData()
    joint.calc(data, np.zeros(model.nq), np.zeros(model.nv))
    S = np.ravel(data.S)
    return S[:3], S[3:]


def _write_rotor(joint: Joint, motor: DcMotor) -> str:
    inertia = _join_values([motor.rotor_inertia] * 3)
    return f"""
<body><inertial mass="1" pos="0 0 0" diaginertia="{inertia}"/>
<joint name="{joint.name}_rotor" type="hinge" axis="0 0 1"/></body>"""


def _write_gear(joint: Joint) -> str:
    gear = joint.gear
    return f"""
<fixed springlength="0" stiffness="{gear.stiffness!r}" damping="{gear.damping!r}">
<joint joint="{joint.name}_rotor" coef="{gear.ratio!r}"/><joint joint="{joint.name}" coef="-1"/>
</fixed>"""


def _write_motor(joint: Joint, motor: DcMotor) -> str:
    rigid = joint.gear.stiffness is None
    at, gear = (joint.name, 1.0 / joint.gear.ratio) if rigid else (f"{joint.name}_rotor", 1.0)
    return f"""
<dcmotor joint="{at}" gear="{gear!r}" resistance="{motor.resistance!r}"
 motorconst="{motor.torque_constant!r} {motor.back_emf_constant!r}"
 inductance="{motor.inductance!r} 0"/>"""


def _join_values(values: ArrayLike) -> str:
    return " ".join(repr(float(value)) for value in np.ravel(values))
