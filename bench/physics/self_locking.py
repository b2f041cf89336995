"""A worm that holds a load without power: beside MuJoCo, Drake and Pinocchio, and a closed form."""

from __future__ import annotations

import importlib
import math
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import yaml
from scipy.optimize import brentq

from arm_emulator import Plant, load_scene
from arm_emulator.base.arrays import Array
from bench.measure import show_progress
from bench.physics.sticking import HARD_AND_SHORT
from bench.physics.sticking_peers import SAMPLE, G
from bench.speed.mujoco_peer import import_mujoco
from bench.tables import format_table

TITLE = "A gear that locks itself"

LEAD, RUB = math.radians(3.0), math.radians(5.0)  # of the worm: angle of lead, angle of friction
LIFTING = math.tan(LEAD + RUB) / math.tan(LEAD) - 1.0  # mu where the motor drives
LOWERING = 1.0 - math.tan(LEAD - RUB) / math.tan(LEAD)  # mu where the load drives
RATIO, ROTOR = 1e-3, 2e-4  # m/rad, kg m2
CARRIED = ROTOR / RATIO**2  # the rotor's inertia at the load [kg]
TUNED = 50.0  # kg, the load for which a constant friction is chosen
LOADS = (0.5, 1.0, 2.0)  # by TUNED
STOPPED, LOADED_TIME = 0.2, 10.0  # m/s, s
NO_SLIP = 'noslip_iterations="10"'


@dataclass(frozen=True)
class Hoist:
    """A load [kg] on a worm, under a force of the motor at the load [N], at a speed [m/s]."""

    mass: float
    force: float = 0.0
    speed: float = 0.0

    @property
    def weight(self) -> float:
        """Weight of the load [N]."""
        return self.mass * G


# From a hoist and a time [s]: heights [m] and speeds [m/s] after each sample, (K,) each.
Peer = Callable[[Hoist, float], tuple[Array, Array]]


def compute_lossy_torque(speed: float, T: float) -> float:
    """Return the worm's friction under the force T that it carries [N], without its sign."""
    return (LIFTING if T * speed > 0.0 else LOWERING) * abs(T)


def predict_force(hoist: Hoist) -> float:
    """Return the force of the motor that keeps the hoist's speed [N], in closed form."""
    return hoist.weight * (1.0 + LIFTING if hoist.speed > 0.0 else 1.0 - LOWERING)


def predict_stop(hoist: Hoist) -> float:
    """Return the way to rest [m] of a hoist without power, in closed form.

    The rotor's equation is CARRIED a = -share T, the load's T = m (g + a); both are rigid.
    """
    share = 1.0 + LIFTING if hoist.speed > 0.0 else 1.0 - LOWERING
    a = share * hoist.weight / (CARRIED + share * hoist.mass)
    return math.copysign(hoist.speed**2 / (2.0 * abs(a)), hoist.speed)


def write_urdf(hoist: Hoist) -> str:
    """Return the description of the load on its guide."""
    return f"""<robot name="hoist"><link name="base"/><link name="load"><inertial>
<mass value="{hoist.mass!r}"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
</link><joint name="guide" type="prismatic"><parent link="base"/><child link="load"/>
<limit lower="-1e3" upper="1e3" effort="1e9" velocity="1e9"/><axis xyz="0 0 1"/></joint></robot>"""


def make_emulator(dt: float, events: str) -> Peer:
    """Return the emulator: the worm is `load` and `back_load` of a rotor behind a stiff gear."""
    stiffness = 1e8  # N/m; yields by less than 0.02 mm under the loads

    def run_hoist(hoist: Hoist, duration: float) -> tuple[Array, Array]:
        worm = {"coulomb": 0.0, "load": LIFTING, "back_load": LOWERING}
        motor = {"kind": "torque", "rotor_inertia": ROTOR, "friction": worm}
        gear = {"ratio": RATIO, "stiffness": stiffness, "damping": 3e4}
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "hoist.yaml"
            (Path(folder) / "hoist.urdf").write_text(write_urdf(hoist))
            scene = {
                "name": "hoist", "urdf": "hoist.urdf", "tool": "load", "gravity": [0.0, 0.0, -G],
                "joints": {"guide": {"motor": motor, "gear": gear}}, "servo_period": SAMPLE,
                "supply_voltage": 48.0,
                "integrator": {"scheme": "rosenbrock", "dt": dt, "events": events},
                "varied": ["links.*"],
            }  # fmt: skip
            file.write_text(yaml.safe_dump(scene))
            plant = Plant(load_scene(file))
        plant.put("the bench", {"q": [1.0], "v": [hoist.speed], "omega_m": [hoist.speed / RATIO],
                                "theta_m": [(1.0 + hoist.weight / stiffness) / RATIO]})  # fmt: skip
        torque, reached = np.array([hoist.force * RATIO]), []
        for _ in range(round(duration / SAMPLE)):
            plant.advance(torque, round(SAMPLE / dt))
            reached.append([plant.state.q[0] - 1.0, plant.state.v[0]])
        return np.array(reached)[:, 0], np.array(reached)[:, 1]

    return run_hoist


def make_mujoco_hoist(
    dt: float, joint: str = "", option: str = "", *, is_loaded: bool = False
) -> Peer:
    """Return MuJoCo: `frictionloss` that holds TUNED as the worm does.

    Args:
        dt: step [s].
        joint: further attributes of the joint.
        option: further attributes of the options.
        is_loaded: sets the friction before each step to that under the force of the last one.
    """

    def run_hoist(hoist: Hoist, duration: float) -> tuple[Array, Array]:
        model = import_mujoco().MjModel.from_xml_string(f"""<mujoco>
<option timestep="{dt!r}" gravity="0 0 {-G}" {option}/><worldbody><body>
<inertial pos="0 0 0" mass="{hoist.mass!r}" diaginertia="1 1 1"/>
<joint type="slide" axis="0 0 1" armature="{CARRIED!r}" frictionloss="{LOWERING * TUNED * G!r}"
 {joint}/></body></worldbody></mujoco>""")
        data, reached = import_mujoco().MjData(model), []
        data.qvel[0], data.qfrc_applied[0] = hoist.speed, hoist.force
        for _ in range(round(duration / SAMPLE)):
            for _ in range(round(SAMPLE / dt)):
                if is_loaded:
                    T = hoist.mass * (G + float(data.qacc[0]))
                    model.dof_frictionloss[0] = compute_lossy_torque(float(data.qvel[0]), T)
                import_mujoco().mj_step(model, data)
            reached.append([data.qpos[0], data.qvel[0]])
        return np.array(reached)[:, 0], np.array(reached)[:, 1]

    return run_hoist


def compute_smoothed_force(hoist: Hoist, v: float, slow: float) -> float:
    """Return the worm's friction on a load at a speed, tanh(v / slow) of the law's [N].

    The acceleration, which the law's force depends on, follows from the rigid hoist's equation.
    """
    mu = (LIFTING if v > 0.0 else LOWERING) * math.tanh(v / slow)
    a = (hoist.force - (1.0 + mu) * hoist.weight) / (CARRIED + (1.0 + mu) * hoist.mass)
    return -mu * hoist.mass * (G + a)


def make_pinocchio_hoist(dt: float, slow: float) -> Peer:
    """Return Pinocchio's ABA under the smoothed law, in semi-implicit Euler steps."""

    def run_hoist(hoist: Hoist, duration: float) -> tuple[Array, Array]:
        model = pin.buildModelFromXML(write_urdf(hoist))
        model.gravity.linear = np.array([0.0, 0.0, -G])
        model.armature = np.array([CARRIED])
        data, q, v, reached = model.createData(), np.zeros(1), np.array([hoist.speed]), []
        for _ in range(round(duration / SAMPLE)):
            for _ in range(round(SAMPLE / dt)):
                tau = hoist.force + compute_smoothed_force(hoist, float(v[0]), slow)
                v = v + dt * pin.aba(model, data, q, v, np.array([tau]))
                q = q + dt * v
            reached.append([q[0], v[0]])
        return np.array(reached)[:, 0], np.array(reached)[:, 1]

    return run_hoist


def make_drake_hoist(slow: float) -> Peer:
    """Return Drake's continuous plant with its own integrator, under the smoothed law."""

    def run_hoist(hoist: Hoist, duration: float) -> tuple[Array, Array]:
        framework = importlib.import_module("pydrake.systems.framework")
        plants = importlib.import_module("pydrake.multibody.plant")
        parsing = importlib.import_module("pydrake.multibody.parsing")
        analysis = importlib.import_module("pydrake.systems.analysis")

        class Worm(framework.LeafSystem):  # type: ignore[misc, name-defined]
            """Force of motor and worm on the load, of its height and speed."""

            def __init__(self) -> None:
                super().__init__()
                self.DeclareVectorInputPort("state", 2)
                self.DeclareVectorOutputPort("force", 1, self.compute_force)

            def compute_force(self, context: Any, output: Any) -> None:
                v = float(self.get_input_port().Eval(context)[1])
                output.SetFromVector([hoist.force + compute_smoothed_force(hoist, v, slow)])

        builder = framework.DiagramBuilder()
        plant = builder.AddSystem(plants.MultibodyPlant(0.0))
        parsing.Parser(plant).AddModelsFromString(write_urdf(hoist), "urdf")
        plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base"))
        guide = plant.GetJointByName("guide")
        actuator = plant.AddJointActuator("motor", guide)
        actuator.set_default_rotor_inertia(CARRIED)
        actuator.set_default_gear_ratio(1.0)
        plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, -G])
        plant.Finalize()
        worm = builder.AddSystem(Worm())
        builder.Connect(plant.get_state_output_port(), worm.get_input_port())
        builder.Connect(worm.get_output_port(), plant.get_applied_generalized_force_input_port())
        simulator = analysis.Simulator(builder.Build())
        context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
        plant.get_actuation_input_port().FixValue(context, [0.0])
        guide.set_translation_rate(context, hoist.speed)
        reached = []
        for k in range(round(duration / SAMPLE)):
            simulator.AdvanceTo((k + 1) * SAMPLE)
            reached.append([guide.get_translation(context), guide.get_translation_rate(context)])
        return np.array(reached)[:, 0], np.array(reached)[:, 1]

    return run_hoist


PEERS: dict[str, Peer] = {
    "emulator, `located`, 1 ms": make_emulator(1e-3, "located"),
    "emulator, `located`, 0.1 ms": make_emulator(1e-4, "located"),
    "emulator, `step`, 1 ms": make_emulator(1e-3, "step"),
    "MuJoCo, `frictionloss` that holds 50 kg, 2 ms": make_mujoco_hoist(2e-3),
    "the same, noslip_iterations 10, 2 ms": make_mujoco_hoist(2e-3, option=NO_SLIP),
    "the same, tuned, 0.1 ms": make_mujoco_hoist(1e-4, HARD_AND_SHORT, NO_SLIP),
    "MuJoCo, tuned, the caller sets `frictionloss` before each step, 0.1 ms": make_mujoco_hoist(
        1e-4, HARD_AND_SHORT, NO_SLIP, is_loaded=True
    ),
    "Drake, tanh(v / 1 mm/s) of the law, its own steps": make_drake_hoist(1e-3),
    "Pinocchio, tanh(v / 1 mm/s) of the law, 0.1 ms": make_pinocchio_hoist(1e-4, 1e-3),
}


def run_bench(quick: bool) -> dict[str, Any]:
    """Let every hoist hold, lift, lower and stop."""
    rows = []
    with show_progress("hoists", len(PEERS)) as done:
        for name, peer in PEERS.items():
            rows.append(
                {"name": name, **_measure_peer(peer, 0.2 * LOADED_TIME if quick else LOADED_TIME)}
            )
            done(name)
    return {"peers": rows}


def _measure_peer(peer: Peer, zoh_torque: float) -> dict[str, Any]:
    masses = [share * TUNED for share in LOADS]
    directions = {"up": STOPPED, "down": -STOPPED}
    return {
        "sunk": [_measure_creep(peer, Hoist(mass), zoh_torque) for mass in masses],
        "force": {
            direction: [_keep_speed(peer, Hoist(mass, speed=0.5 * speed)) for mass in masses]
            for direction, speed in directions.items()
        },
        "stop": {
            direction: [_measure_stop(peer, Hoist(mass, speed=speed)) for mass in masses]
            for direction, speed in directions.items()
        },
    }


def _measure_creep(peer: Peer, hoist: Hoist, zoh_torque: float) -> float:
    """Return how fast a load sinks that was at rest [m/min], over the second half of the time."""
    q, _ = peer(hoist, zoh_torque)
    half = len(q) // 2
    return float(q[half - 1] - q[-1]) / (SAMPLE * (len(q) - half)) * 60.0


def _keep_speed(peer: Peer, hoist: Hoist) -> float:
    """Return the force that keeps the speed for a tenth of a second, by that of the closed form."""

    def compute_rise(force: float) -> float:
        return float(peer(Hoist(hoist.mass, force, hoist.speed), 0.1)[1][-1]) - hoist.speed

    needed, beyond = predict_force(hoist), 4.0 * TUNED * G
    torque = brentq(compute_rise, needed - beyond, needed + beyond, xtol=1e-4 * hoist.weight)
    return float(torque) / needed


def _measure_stop(peer: Peer, hoist: Hoist) -> float | None:
    """Return the way to rest without power, by that of the closed form; None: it does not stop.

    What it creeps after the instant of rest in closed form is no part of the way.
    """
    q, v = peer(hoist, 1.0)
    if abs(v[-1]) > 0.1 * STOPPED:
        return None
    distance = predict_stop(hoist)
    return float(q[-1] - v[-1] * (1.0 - 2.0 * distance / hoist.speed)) / distance


def write_report(figures: dict[str, Any]) -> str:
    """Return the section of the report."""
    loads = [f"{share * TUNED:g} kg" for share in LOADS]

    def format_value(value: float | None) -> str:
        return "does not stop" if value is None else f"{value:.4f}"

    holding = [
        (row["name"], *("0" if value == 0.0 else f"{value:.1e}" for value in row["sunk"]))
        for row in figures["peers"]
    ]
    driving, stopping = (
        [
            (
                row["name"],
                *(
                    format_value(row[key][direction][k])
                    for direction in ("up", "down")
                    for k in range(len(loads))
                ),
            )
            for row in figures["peers"]
        ]
        for key in ("force", "stop")
    )
    heads = [f"{direction}, {load}" for direction in ("up", "down") for load in loads]
    return f"""\
A worm with a lead of {math.degrees(LEAD):g}° and a friction of {math.degrees(RUB):g}° lifts a load
with eta1 = {1.0 / (1.0 + LIFTING):.3f} and is not driven back by it (eta2 = {1.0 - LOWERING:.3f}):
friction is {LIFTING:.3f} times the force in the mesh where the motor drives and {LOWERING:.3f}
times where the load does. In closed form the motor lifts with {1.0 + LIFTING:.3f} times the
weight, and has to push the load down with {LOWERING - 1.0:.3f} times. The rotor counts as
{CARRIED:g} kg.

MuJoCo's friction of joints knows no load: it is chosen to hold {TUNED:g} kg as the worm does. In
one row the caller computes the law and sets the friction before each step. Drake's and Pinocchio's
joints have no dry friction: the caller applies the law, which knows mass and acceleration of the
load, smoothed over 1 mm/s. The emulator's gear is elastic (1e8 N/m), the others' are rigid as the
closed form's.

How fast a load sinks without power [m/min]:

{format_table(("held without power", *loads), holding)}

Force of the motor that keeps {0.5 * STOPPED:g} m/s, by that of the closed form:

{format_table(("kept moving", *heads), driving)}

Way to rest from {STOPPED:g} m/s after an emergency stop (no power, no brake), by that of the closed
form:

{format_table(("stopped", *heads), stopping)}"""
