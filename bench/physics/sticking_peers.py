"""A bar on a hinge and a block on a slope, held by dry friction: the emulator's and its peers'."""

from __future__ import annotations

import importlib
import math
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import yaml
from scipy.integrate import solve_ivp

from arm_emulator import Plant, load_scene
from arm_emulator.base.arrays import Array
from bench.speed.mujoco_peer import import_mujoco

G = 9.81
SAMPLE = 1e-2  # s
RATIO, HEAVY = 0.01, 1e6  # the rotor that pulls: link turns per turn, inertia [kg m2]


@dataclass(frozen=True)
class Bar:
    """A slender bar on a hinge with dry friction; angle 0 is horizontal, and weight raises it."""

    mass: float = 4.0  # kg
    reach: float = 0.5  # m, from the hinge to its centre
    friction: float = 39.24  # N m, sliding: twice the weight's torque
    breakaway: float = 1.0  # by `friction`
    # None: gravity acts. Else it has none, and this spring [N m/rad] pulls at this speed [rad/s].
    pull: tuple[float, float] | None = None

    @property
    def weight(self) -> float:
        """Largest torque of the weight [N m]."""
        return 0.0 if self.pull else self.mass * G * self.reach

    @property
    def own_inertia(self) -> float:
        """About the bar's centre [kg m2]."""
        return self.mass * self.reach**2 / 3.0

    @property
    def inertia(self) -> float:
        """About the hinge [kg m2]."""
        return self.own_inertia + self.mass * self.reach**2


@dataclass(frozen=True)
class PeerRun:
    """Places (K,) every SAMPLE [rad or m], and the time of a step [ns], None if not measured."""

    q: Array
    step: float | None = None


# From a bar, a time [s] and the angle at which it begins.
Peer = Callable[[Bar, float, float], PeerRun]


def measure_samples(advance: Callable[[], float], duration: float, dt: float) -> PeerRun:
    """Return a run of which `advance` gives the place after each sample."""
    q = np.empty(round(duration / SAMPLE))
    began = time.perf_counter()
    for k in range(len(q)):
        q[k] = advance()
    return PeerRun(q, 1e9 * (time.perf_counter() - began) / (duration / dt))


def write_urdf(bar: Bar) -> str:
    """Return the bar's description."""
    inertia = f'iyy="{bar.own_inertia!r}" izz="{bar.own_inertia!r}" ixy="0" ixz="0" iyz="0"'
    return f"""<robot name="bar"><link name="base"/><link name="bar"><inertial>
<origin xyz="{bar.reach!r} 0 0"/><mass value="{bar.mass!r}"/><inertia ixx="1e-6" {inertia}/>
</inertial></link><joint name="hinge" type="revolute"><parent link="base"/><child link="bar"/>
<limit lower="-1e3" upper="1e3" effort="1e9" velocity="1e9"/><axis xyz="0 1 0"/></joint></robot>"""


def make_emulator(dt: float, events: str) -> Peer:
    """Return the emulator with a step and a way to treat events."""

    def run_bar(bar: Bar, duration: float, start: float) -> PeerRun:
        joint: dict[str, Any] = {
            "friction": {"coulomb": bar.friction, "breakaway": bar.breakaway * bar.friction}
        }
        if bar.pull:
            joint["gear"] = {"ratio": RATIO, "stiffness": bar.pull[0]}
            joint["motor"] = {"resistance": 1.0, "torque_constant": 1e-9, "back_emf_constant": 0.0,
                              "rotor_inertia": HEAVY}  # fmt: skip
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "bar.yaml"
            (Path(folder) / "bar.urdf").write_text(write_urdf(bar))
            scene = {
                "name": "bar", "urdf": "bar.urdf", "tool": "bar", "supply_voltage": 48.0,
                "joints": {"hinge": joint}, "gravity": [0.0, 0.0, 0.0 if bar.pull else -G],
                "integrator": {"scheme": "rosenbrock", "dt": dt, "events": events},
                "servo_period": SAMPLE, "varied": ["joints.hinge.friction.coulomb", "links.*"],
            }  # fmt: skip
            file.write_text(yaml.safe_dump(scene))
            plant = Plant(load_scene(file))
        put: dict[str, Any] = {"q": [start], "theta_m": [start / RATIO]}
        if bar.pull:
            put["omega_m"] = [bar.pull[1] / RATIO]
        plant.put("the bench", put if bar.pull else {"q": [start]})
        rows = np.zeros((round(duration / SAMPLE), 1))
        began = time.perf_counter()
        q = plant.run(rows, round(SAMPLE / dt))[:, 0]
        return PeerRun(q, 1e9 * (time.perf_counter() - began) / (duration / dt))

    return run_bar


def make_mujoco_bar(dt: float, joint: str = "", option: str = "") -> Peer:
    """Return MuJoCo's `frictionloss`, with further attributes of the joint and of the options."""

    def run_bar(bar: Bar, duration: float, start: float) -> PeerRun:
        model = import_mujoco().MjModel.from_xml_string(f"""<mujoco><compiler angle="radian"/>
<option timestep="{dt!r}" gravity="0 0 {-G}" {option}/><worldbody><body>
<inertial pos="{bar.reach!r} 0 0" mass="{bar.mass!r}"
 diaginertia="1e-6 {bar.own_inertia!r} {bar.own_inertia!r}"/>
<joint type="hinge" axis="0 1 0" frictionloss="{bar.friction!r}" {joint}/>
</body></worldbody></mujoco>""")
        data, every = import_mujoco().MjData(model), round(SAMPLE / dt)
        data.qpos[0] = start

        def advance_sample() -> float:
            import_mujoco().mj_step(model, data, nstep=every)
            return float(data.qpos[0])

        return measure_samples(advance_sample, duration, dt)

    return run_bar


def make_pinocchio_bar(dt: float, smooth: float, fall: float = 0.0) -> Peer:
    """Return Pinocchio's ABA under regularised friction, in semi-implicit Euler steps.

    Friction is tanh(v / smooth); breakaway falls to sliding over the speed `fall`. The loop is
    Python's, so its time is not that of Pinocchio.
    """

    def run_bar(bar: Bar, duration: float, start: float) -> PeerRun:
        model = pin.buildModelFromXML(write_urdf(bar))
        model.gravity.linear = np.array([0.0, 0.0, 0.0 if bar.pull else -G])
        data, every = model.createData(), round(SAMPLE / dt)
        q, v, t = np.array([start]), np.zeros(1), 0.0

        def advance_sample() -> float:
            nonlocal q, v, t
            for _ in range(every):
                dry = 1.0
                if fall:
                    dry += (bar.breakaway - 1.0) * math.exp(-((v[0] / fall) ** 2))
                tau = -bar.friction * dry * np.tanh(v / smooth)
                if bar.pull:
                    tau += bar.pull[0] * (bar.pull[1] * t - (q - start))
                v = v + dt * pin.aba(model, data, q, v, tau)
                q, t = q + dt * v, t + dt
            return float(q[0])

        return PeerRun(measure_samples(advance_sample, duration, dt).q)

    return run_bar


def make_drake_block(dt: float, approximation: str, stiction: float | None = None) -> Peer:
    """Return Drake's block on a slope, held by Coulomb contact: joints have no dry friction there.

    The bar's mass and the share of friction in its weight become the block's. The places [m] are
    those down the slope, from the block at rest.
    """

    def run_bar(bar: Bar, duration: float, start: float) -> PeerRun:
        plants = importlib.import_module("pydrake.multibody.plant")
        tree = importlib.import_module("pydrake.multibody.tree")
        shapes = importlib.import_module("pydrake.geometry")
        transform = importlib.import_module("pydrake.math").RigidTransform
        builder = importlib.import_module("pydrake.systems.framework").DiagramBuilder()
        simulators = importlib.import_module("pydrake.systems.analysis")
        plant = plants.AddMultibodyPlantSceneGraph(builder, time_step=dt)[0]
        plant.set_discrete_contact_approximation(
            getattr(plants.DiscreteContactApproximation, f"k{approximation}")
        )
        slope = 0.3
        mu = plants.CoulombFriction(*[bar.friction / bar.weight * math.tan(slope)] * 2)
        size = 0.2, 0.2, 0.1
        unit = tree.UnitInertia.SolidBox(*size)
        block = plant.AddRigidBody("block", tree.SpatialInertia(bar.mass, np.zeros(3), unit))
        box, ground = shapes.Box(*size), shapes.HalfSpace()
        plant.RegisterCollisionGeometry(block, transform(), box, "block", mu)
        plant.RegisterCollisionGeometry(plant.world_body(), transform(), ground, "ground", mu)
        gravity = G * np.array([math.sin(slope), 0.0, -math.cos(slope)])
        plant.mutable_gravity_field().set_gravity_vector(gravity)
        plant.Finalize()
        if stiction is not None:
            plant.set_stiction_tolerance(stiction)
        simulator = simulators.Simulator(builder.Build())
        context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
        plant.SetFreeBodyPose(context, block, transform([0.0, 0.0, size[2] / 2.0]))
        simulator.AdvanceTo(1.0)  # at rest in the ground
        place = plant.EvalBodyPoseInWorld(context, block).translation()[0]
        t = 1.0

        def advance_sample() -> float:
            nonlocal t
            t += SAMPLE
            simulator.AdvanceTo(t)
            return float(plant.EvalBodyPoseInWorld(context, block).translation()[0] - place)

        return measure_samples(advance_sample, duration, dt)

    return run_bar


def solve_swing(bar: Bar, duration: float, start: float) -> Array:
    """Return the angles (K,) of a bar that swings and stops: SciPy at 1e-12, cut at each stop."""
    times = SAMPLE * np.arange(1, round(duration / SAMPLE) + 1)
    q, t, x = np.full(len(times), np.nan), 0.0, np.array([start, 0.0])
    while t < duration and abs(weight := bar.weight * math.cos(x[0])) > bar.friction:
        sign = math.copysign(1.0, weight)

        def compute_rates(_: float, x: Array, sign: float = sign) -> list[float]:
            return [x[1], (bar.weight * math.cos(x[0]) - sign * bar.friction) / bar.inertia]

        def compute_speed(_: float, x: Array, sign: float = sign) -> float:
            return float(sign * x[1])

        compute_speed.terminal, compute_speed.direction = True, -1.0  # type: ignore[attr-defined]
        solved = solve_ivp(
            compute_rates, (t, duration), x, "DOP853", rtol=1e-12, atol=1e-14, events=compute_speed,
            dense_output=True,
        )  # fmt: skip
        inside = (times > t) & (times <= solved.t[-1])
        q[inside] = solved.sol(times[inside])[0]
        t, x = float(solved.t[-1]), np.array([solved.y[0, -1], 0.0])
    return np.where(np.isnan(q), x[0], q)


def predict_stick_slip(bar: Bar) -> tuple[float, float]:
    """Return the period [s] of the limit cycle and by how much the spring swings [rad].

    From breaking away to sticking the bar swings about its sliding torque, in closed form; then the
    spring is wound up again at the speed of the pull.
    """
    assert bar.pull is not None
    K, speed = bar.pull
    omega, A = math.sqrt(K / bar.inertia), (bar.breakaway - 1.0) * bar.friction / K
    slip_time = 2.0 * (math.pi - math.atan(A * omega / speed)) / omega
    return slip_time + 2.0 * A / speed, 2.0 * math.hypot(A, speed / omega)
