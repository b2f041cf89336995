"""Records with effects that the scene lacks, and spoiled ones: what identification makes of them.

Of a record with an effect: whether the numbers lie within two of the published deviations, and
whether the effect is named. Of a spoiled one: whether it is refused or warned of, with the right
cause.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection, Mapping
from functools import cache
from typing import Any

import numpy as np

from arm_emulator import Refusal, Scene, load_scene
from arm_emulator.base.arrays import Array
from arm_emulator.machine.parts.drive_stages.torque_ripple import TorqueRipple
from arm_emulator.machine.parts.frictions.brake import Brake
from arm_emulator.machine.parts.frictions.friction import RotorFriction
from arm_emulator.machine.parts.frictions.lugre import RotorLuGre
from arm_emulator.machine.parts.frictions.stribeck import RotorStribeck
from arm_emulator.machine.parts.input import TORQUE
from arm_emulator.machine.scene.fault_catalogue import list_variable_numbers
from arm_emulator.machine.scene.joint import Joint
from arm_emulator.machine.scene.known_parts import EXTRAS, MOTORS, remove_kind
from arm_emulator.machine.varied import vary_child
from arm_emulator_identification import inertia
from arm_emulator_identification.found import list_numbers
from arm_emulator_identification.measured_run import MeasuredRun, check_samples
from arm_emulator_identification.plausibility import check_fit, filter_record
from arm_emulator_identification.read_run import read_run
from arm_emulator_identification.residual_effects import FALLS, RIPPLE, RISES, TRAVEL, WARMS
from arm_emulator_identification.torque_fit import TorqueFit, fit_torques
from arm_emulator_identification.validation.kuka_kr300 import DATA, DELAYS, SHIPPED
from bench.identification import ANGLE_NOISE, LOW_PASS, SECONDS, SIGMAS, make_model
from bench.identification import load_truth as three_axis
from bench.measure import show_progress
from bench.tables import format_table
from oracles.synthetic_record import make_record

TITLE = "Doubtful records"
PERIOD = 4e-3  # s
TORQUE_NOISE = 0.03  # share of a joint's torque
OFF = 0.15  # share by which the machine that is recorded differs from the scene
SEED = 0  # of the spoiled records


def load_ur5() -> Scene:
    """Return the arm with friction at its rotors that sticks, and rigid gears."""
    friction = {"viscous": 3e-4, "coulomb": 0.03}
    overrides: dict[str, Any] = {"joints.*.friction": None, "joints.*.encoder": None}
    overrides |= {f"joints.{j}.motor.friction": friction for j in load_scene("ur5").joint_names}
    rigid = ("stiffness", "cubic_stiffness", "damping")
    overrides |= {f"joints.*.gear.{number}": None for number in rigid}
    overrides |= remove_kind((Brake, *EXTRAS))
    return load_scene("ur5", overrides)


def load_kuka() -> Scene:
    """Return the machine whose real records are at hand, as published."""
    return load_scene(DATA / "given.yaml")


MACHINES: dict[str, Callable[[], Scene]] = {
    "three_axis": cache(three_axis), "ur5": cache(load_ur5), "kuka": cache(load_kuka),
}  # fmt: skip


def make_torque_driven(scene: Scene, period: float, fitted: Collection[str]) -> Scene:
    """Return a scene with ideal torque motors, otherwise unchanged.

    Parts between a voltage or a current and the torque of the windings are left out.

    Args:
        scene: the machine.
        period: of the commands [s].
        fitted: names of numbers to vary.
    """
    ideal: Any = next(
        motor for motor in MOTORS if motor.inputs == (TORQUE,)
    )  # which has an inertia

    def replace_motor(joint: Joint) -> Joint:
        if joint.motor is None or joint.inputs == (TORQUE,):
            return joint
        mechanical = tuple(decorator for decorator in joint.decorators if not decorator.electrical)
        motor = ideal(rotor_inertia=joint.motor.inertia)
        return dataclasses.replace(joint, motor=motor, decorators=mechanical)

    joints = tuple(replace_motor(joint) for joint in scene.joints)
    steps = max(1, round(period / scene.integrator.dt))
    varied = tuple(
        number for number in list_variable_numbers(joints, scene.chain, ()) if number.name in fitted
    )
    return dataclasses.replace(
        scene, joints=joints, servo_period=period, varied=varied, load=None,
        integrator=dataclasses.replace(scene.integrator, dt=period / steps),
    )  # fmt: skip


def draw_changes(scene: Scene, rng: np.random.Generator) -> tuple[Scene, dict[str, float]]:
    """Return a scene with varied numbers, and values of a machine that differs from it."""
    links = [
        f"links.{joint.link}.{name}" for joint in scene.chain.joints for name in vary_child(joint)
    ]
    inertias = [f"joints.{joint.name}.motor.rotor_inertia" for joint in scene.joints]
    of_friction = [f"joints.{joint.name}.motor.friction.{key}" for joint in scene.joints
                   for key in ("viscous", "coulomb")]  # fmt: skip
    driven = make_torque_driven(scene, PERIOD, [*links, *inertias, *of_friction])
    values = {number.name: number.value for number in driven.varied}
    for joint in scene.chain.joints:
        numbers = inertia.map_logarithm(joint.body)
        moved = numbers + OFF * inertia.estimate_widths(joint.body, 1.0) * rng.standard_normal(10)
        body = inertia.make_body(inertia.map_exponential(moved))
        of = vary_child(joint, body).items()
        values |= {f"links.{joint.link}.{name}": value for name, value in of}
    for name in inertias:
        values[name] *= np.exp(0.5 * OFF * rng.standard_normal())
    return driven, values


# Effects: what a scene has more, and under which names it may go.


def _change_joints(scene: Scene, of: Callable[[Joint], Joint]) -> Scene:
    return dataclasses.replace(scene, joints=tuple(of(joint) for joint in scene.joints))


def add_stribeck(scene: Scene, rng: np.random.Generator) -> Scene:
    """Friction that falls with speed."""

    def change_joint(joint: Joint) -> Joint:
        own = joint.rotor_friction
        assert own is not None
        slow = rng.uniform(0.03, 0.12) / abs(joint.gear.ratio)
        breakaway = rng.uniform(1.5, 2.5) * own.coulomb
        law = RotorStribeck(
            viscous=own.viscous, coulomb=own.coulomb, breakaway=breakaway, stribeck=slow
        )
        return dataclasses.replace(joint, rotor_friction=law)

    return _change_joints(scene, change_joint)


def add_bristles(scene: Scene, rng: np.random.Generator) -> Scene:
    """Friction that builds up over a way after each reversal."""

    def change_joint(joint: Joint) -> Joint:
        own = joint.rotor_friction
        assert own is not None
        travel = rng.uniform(0.01, 0.04) / abs(joint.gear.ratio)
        law = RotorLuGre(coulomb=own.coulomb, breakaway=own.coulomb, stribeck=10.0,
                         bristle_stiffness=own.coulomb / travel,
                         bristle_damping=0.02 * own.coulomb / travel)  # fmt: skip
        viscous = RotorFriction(viscous=own.viscous)
        return dataclasses.replace(joint, rotor_friction=viscous, extras=(*joint.extras, law))

    return _change_joints(scene, change_joint)


def add_ripple(scene: Scene, rng: np.random.Generator) -> Scene:
    """Torque that goes with the angle of the motor."""

    def change_joint(joint: Joint) -> Joint:
        order = rng.uniform(10.0, 25.0) * abs(joint.gear.ratio)
        wave = (order, rng.uniform(0.06, 0.12), rng.uniform(-3.0, 3.0))
        return dataclasses.replace(
            joint, decorators=(*joint.decorators, TorqueRipple(waves=(wave,)))
        )

    return _change_joints(scene, change_joint)


def keep_scene(scene: Scene, rng: np.random.Generator) -> Scene:
    """Nothing more."""
    return scene


# Change of a scene that adds an effect, and the accepted names of the effect.
EFFECTS: dict[str, tuple[Callable[[Scene, np.random.Generator], Scene], tuple[str, ...]]] = {
    "stribeck": (add_stribeck, (FALLS,)),
    "hysteresis": (add_bristles, (TRAVEL, RISES)),
    "ripple": (add_ripple, (RIPPLE,)),
    "temperature": (keep_scene, (WARMS,)),
}
RECORDS = [("three_axis", 0), ("three_axis", 1), ("ur5", 0), ("ur5", 1), ("kuka", 0)]


def scale_friction(values: Mapping[str, float], share: float) -> dict[str, float]:
    """Return what friction is at a time of the record, from 0 to 1, its mean that of `values`."""
    lost = 0.5 * np.exp(-2.0 * share)
    lost -= 0.25 * (1.0 - np.exp(-2.0))
    return {
        name: value * (1.0 + lost) for name, value in values.items() if ".friction." in name
    }  # fmt: skip


def identify_with_effect(
    machine: str, effect: str, seed: int
) -> tuple[float, list[str], TorqueFit]:
    """Identify a record with an effect.

    Returns:
        the share of the numbers within two deviations, effects named, and the fit. Without an
        effect, "", the machine has what the scene has.
    """
    rng = np.random.default_rng([seed, 7])
    scene = MACHINES[machine]()
    driven, values = draw_changes(scene, rng)
    real = EFFECTS[effect][0](driven, rng) if effect else driven
    has = {number.name for number in real.varied} & _list_names(real)
    real = dataclasses.replace(
        real, varied=tuple(number for number in real.varied if number.name in has)
    )
    numbers = {name: value for name, value in values.items() if name in has}

    def scale_drift(share: float) -> Mapping[str, float]:
        return scale_friction(numbers, share) if effect == "temperature" else {}

    run = make_record(real, seed, SECONDS, ANGLE_NOISE, TORQUE_NOISE, numbers, scale_drift)
    run, motion, _ = filter_record(scene, run, LOW_PASS, as_is=True)
    model = make_model(scene, motion)
    fit = fit_torques(model, motion, model.choose_unknowns(["*"], "bench"))
    inside = [
        abs(number.value - values[number.name]) < SIGMAS * number.deviation
        for number in list_numbers(scene, fit) if number.name in values and number.deviation > 0.0
    ]  # fmt: skip
    return float(np.mean(inside)), [fitted_effect.name for fitted_effect in fit.effects], fit


def _list_names(scene: Scene) -> set[str]:
    return {number.name for number in list_variable_numbers(scene.joints, scene.chain, ())}


# Spoiled records: what is done to them, and which words must be in the answer.

Spoiled = tuple[MeasuredRun, tuple[str, ...]]


def spoil_record(run: MeasuredRun, scene: Scene, rng: np.random.Generator) -> dict[str, Spoiled]:
    """Return a record spoiled in each way, and what must be reported: one of the words."""
    N, K = len(run.joints), len(run.t)
    every = np.arange(N)
    j = int(rng.integers(N))
    i = int((j + rng.integers(1, N)) % N)
    k = int(rng.integers(1, N - 1))
    name, second, middle = run.joints[j], run.joints[i], run.joints[k]
    chosen = np.where(every == j, 1.0, 0.0)
    swing, ratio = run.tau.std(axis=0), np.abs(scene.gear_ratios)

    def change_run(**changes: Any) -> MeasuredRun:
        return dataclasses.replace(run, **{"v_motor": None, "q_link": None, **changes})

    def shift_torques(seconds: float, joints: Array) -> Array:
        columns = [np.interp(run.t - seconds * s, run.t, column)
                   for s, column in zip(joints, run.tau.T, strict=True)]  # fmt: skip
        return np.column_stack(columns)

    def swap_columns(rows: Array) -> Array:
        order = every.copy()
        order[[i, j]] = j, i
        return rows[:, order]

    def add_spikes(rows: Array, size: float) -> Array:
        rows = rows.copy()
        at = rng.choice(np.arange(5, K - 5), 20, replace=False)
        rows[at, j] += size * rng.choice([-1.0, 1.0], 20) * rng.uniform(1.0, 3.0, 20)
        return rows

    def draw_size(low: float, high: float) -> float:
        return float(rng.uniform(low, high))

    up = rng.choice([draw_size(1.9, 3.2), 1.0 / draw_size(2.0, 3.0)])
    tau, q = run.tau, run.q_motor
    zero = draw_size(0.3, 1.0) * rng.choice([-1.0, 1.0])
    return {
        "torques scaled up": (change_run(tau=draw_size(1.9, 3.2) * tau),
                              ("got torques ", "with torques ")),
        "torques scaled down": (change_run(tau=tau / draw_size(2.0, 3.2)),
                                ("got torques ", "with torques ")),
        "one torque scaled up": (change_run(tau=tau * (1.0 + chosen * draw_size(1.0, 2.5))),
                                 (f"scale of the torques of {name}",)),
        "one torque scaled": (change_run(tau=tau * np.where(every == j, up, 1.0)),
                              (f"scale of the torques of {name}",)),
        "one angle scaled": (change_run(q_motor=q * (1.0 + chosen)),
                             (f"scale of the angles of {name}",)),
        "time halved": (change_run(t=0.5 * run.t), ("time base",)),
        "time doubled": (change_run(t=2.0 * run.t), ("time base",)),
        "time in ms": (change_run(t=1e3 * run.t), ("t must be in s",)),
        "torques late": (change_run(tau=shift_torques(draw_size(0.015, 0.05), np.ones(N))),
                         (" late",)),
        "one torque late": (change_run(tau=shift_torques(draw_size(0.03, 0.06), chosen)),
                            (" late",)),
        "torque outliers": (change_run(tau=add_spikes(tau, 3.0 * swing[j])),
                            (f"{name}: 2", "outliers")),
        "angle outliers": (change_run(q_motor=add_spikes(q, 0.02)), (f"{name}: 2", "outliers")),
        "angle zero": (change_run(q_motor=q + np.where(every == k, zero, 0.0)),
                       (f"zero of {middle}'s angle",)),
        "torque zero": (change_run(tau=tau + chosen * draw_size(0.6, 1.5) * swing),
                        (f"zero of {name}'s torque", "offset")),
        "degrees": (change_run(q_motor=np.degrees(q)), ("deg, given as rad",)),
        "N mm": (change_run(tau=1e3 * tau), ("N mm", "1e+03 times")),
        "at the links": (change_run(tau=tau / ratio), ("at the links",)),
        "torques swapped": (change_run(tau=swap_columns(tau)),
                            (f"torques of {name} and {second}", f"torques of {second} and {name}")),
        "torque's sign": (change_run(tau=tau * (1.0 - 2.0 * chosen)), (f"{name}'s torque",)),
        "angle's sign": (change_run(q_motor=q * (1.0 - 2.0 * chosen)), (f"{name}'s angle",)),
    }  # fmt: skip


def answer_to(scene: Scene, run: MeasuredRun) -> tuple[str, bool]:
    """Return what identification reports of a record, in words, and whether it refuses it."""
    try:
        check_samples(run)
        run, motion, warnings = filter_record(scene, run, LOW_PASS)
        model = make_model(scene, motion)
        fit = fit_torques(model, motion, model.choose_unknowns(["*"], "bench"))
        check_fit(run.where, run.joints, fit.explained)
    except Refusal as refusal:
        return str(refusal), True
    effects = [
        f"{', '.join(run.joints[j] for j in effect.joints)}: {effect.name}"
        for effect in fit.effects
    ]
    return "; ".join([*warnings, *effects]), False


def make_clean_record(machine: str, seed: int) -> tuple[Scene, MeasuredRun]:
    """Return a scene and a record of a machine like it: of the KUKA a measured one."""
    scene = MACHINES[machine]()
    if machine == "kuka":
        path = SHIPPED[seed % len(SHIPPED)]
        return scene, read_run(path, scene, angles="deg").shift_back(DELAYS)
    driven, values = draw_changes(scene, np.random.default_rng([seed, 3]))
    return scene, make_record(driven, seed, SECONDS, ANGLE_NOISE, TORQUE_NOISE, values)


def run_bench(quick: bool) -> dict[str, Any]:
    """Measure both."""
    effects = [
        (*record, effect) for effect in EFFECTS for record in RECORDS[: 1 if quick else None]
    ]
    machines = list(MACHINES)[: 1 if quick else None]
    rows, spoiled = list[dict[str, Any]](), list[dict[str, Any]]()
    with show_progress("records", len(effects) + 20 * len(machines)) as done:
        for machine, seed, effect in effects:
            share, names, _ = identify_with_effect(machine, effect, seed)
            named = any(text in name for text in EFFECTS[effect][1] for name in names)
            rows.append({"machine": machine, "effect": effect, "seed": seed, "inside": share,
                         "named": named, "names": sorted(set(names))})  # fmt: skip
            done(f"{machine}, {effect}")
        for machine in machines:
            scene, record = make_clean_record(machine, SEED)
            of = spoil_record(record, scene, np.random.default_rng([SEED, len(machine), 5]))
            for kind, (bad, words) in of.items():
                answer, refused = answer_to(scene, bad)
                right = any(word in answer for word in words)
                spoiled.append({"machine": machine, "kind": kind, "refused": refused,
                                "right": right, "answer": answer})  # fmt: skip
                done(f"{machine}, {kind}")
    return {"effects": rows, "spoiled": spoiled}


def write_report(figures: dict[str, Any]) -> str:
    """Return the section."""
    rows, spoiled = figures["effects"], figures["spoiled"]
    well = sum(row["inside"] >= 0.9 for row in rows)
    named = sum(row["named"] for row in rows)
    good = sum(row["inside"] >= 0.9 or row["named"] for row in rows)
    cells = (
        (row["machine"], row["effect"], f"{100 * row['inside']:.0f}",
         "yes" if row["named"] else "; ".join(row["names"]) or "no") for row in rows
    )  # fmt: skip
    text = (
        f"Of {len(rows)} records with an effect that the scene lacks, two deviations hold for at "
        f"least 90 % of the numbers in {well}, the effect is named in {named}, one or the other in "
        f"{good}.\n\n"
        + format_table(("machine", "effect", "within two deviations, %", "named"), cells)
    )
    right = sum(record["right"] for record in spoiled)
    silent = sum(not record["answer"] for record in spoiled)
    text += (
        f"\n\nOf {len(spoiled)} spoiled records the right cause is named in {right}; of {silent} "
        "nothing is reported.\n"
    )
    for record in spoiled:
        if not record["right"]:
            text += f"\n- {record['machine']}, {record['kind']}: {record['answer'] or 'nothing'}"
    return text + "\n"
