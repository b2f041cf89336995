"""Coverage of identification's confidence: truth within the published intervals."""

from __future__ import annotations

from typing import Any

import numpy as np

from arm_emulator.machine.scene.scene import Scene, load_scene
from arm_emulator.machine.varied import vary_child
from arm_emulator_identification.filtered import Filtered, filter_run
from arm_emulator_identification.found import list_numbers
from arm_emulator_identification.identified import FitRequest, identify_numbers
from arm_emulator_identification.loop_fit import list_gear_numbers, list_loops
from arm_emulator_identification.read_run import read_run
from arm_emulator_identification.torque_fit import compute_explained, fit_torques
from arm_emulator_identification.torque_model import LOADED, TorqueModel
from arm_emulator_identification.validation.kuka_kr300 import DATA, DELAYS, SHIPPED
from bench.measure import show_progress
from oracles.synthetic_record import make_record

TITLE = "Identification"
SCENE = "three_axis"
SECONDS = 10.0  # of a record
ANGLE_NOISE, TORQUE_NOISE = 2e-6, 0.05  # rad; share of a joint's torque
LOOP_NOISE = 1e-6  # rad, of encoders at both sides of gears with loops
LOOP = "hysteresis"
LOW_PASS = 10.0  # Hz
TRUST = 0.3
SIGMAS = 2.0
EXPECTED = 0.954  # of a normal distribution, within two standard deviations


def load_truth() -> Scene:
    """Return the machine whose numbers are to be found: rotors and links, friction, weight."""
    motor = {
        "kind": "torque",
        "rotor_inertia": 2e-4,
        "friction": {"viscous": 2e-3, "coulomb": 0.05},
    }
    overrides: dict[str, Any] = {"joints.*.motor": motor, "joints.*.friction": None}
    overrides |= {"joints.*.encoder": None, "gravity": [0.0, 0.0, -9.81]}
    overrides |= {"joints.*.gear.stiffness": None, "joints.*.gear.damping": None}
    overrides |= {"integrator": {"scheme": "rosenbrock", "dt": 1e-3}, "servo_period": 4e-3}
    return load_scene(SCENE, overrides)


def draw_loaded(seed: int, *, is_rigid: bool = False) -> Scene:
    """Return a machine with load friction by the direction of power, drawn.

    The inertia of each rotor is drawn, too. Elastic gears are so stiff that links follow their
    rotors. Behind rigid ones friction falls with speed, with an exponent; there the load is the
    motor's torque itself.
    """
    rng = np.random.default_rng([seed, 8 if is_rigid else 7])
    overrides: dict[str, Any] = {"joints.*.friction": None, "joints.*.encoder": None}
    overrides |= {"joints.*.gear.stiffness": None if is_rigid else 1e5}
    overrides |= {"joints.*.gear.damping": None if is_rigid else 50.0}
    for joint in load_scene(SCENE).joint_names:
        friction = {
            "viscous": 2e-3 * rng.uniform(0.5, 2.0),
            "coulomb": 0.05 * rng.uniform(0.5, 2.0),
            "load": rng.uniform(0.05, 0.4),
            "back_load": rng.uniform(0.05, 0.5),
        }
        if is_rigid:
            friction |= {
                "breakaway": friction["coulomb"] * rng.uniform(1.2, 2.0),
                "stribeck": rng.uniform(2.0, 8.0),
                "exponent": rng.uniform(1.0, 3.0),
            }
        else:
            friction["motor_load"] = rng.uniform(0.02, 0.2)
        inertia_m = 2e-4 * rng.uniform(0.5, 2.0)
        motor = {"kind": "torque", "rotor_inertia": inertia_m, "friction": friction}
        overrides[f"joints.{joint}.motor"] = motor
    overrides |= {"gravity": [0.0, 0.0, -9.81], "servo_period": 4e-3}
    overrides |= {"integrator": {"scheme": "rosenbrock", "dt": 1e-3}}
    return load_scene(SCENE, overrides)


def draw_hysteretic(seed: int) -> tuple[Scene, Scene]:
    """Return a machine whose gears have drawn loops, and as it is known: gears off by some 30 %."""
    rng = np.random.default_rng([seed, 17])
    names = load_scene(SCENE).joint_names
    motor = {"kind": "torque", "rotor_inertia": 2e-4,
             "friction": {"viscous": 2e-3, "coulomb": 0.03}}  # fmt: skip
    overrides: dict[str, Any] = {"joints.*.encoder": None, "joints.*.motor": motor}
    overrides |= {"gravity": [0.0, 0.0, -9.81], "servo_period": 4e-3}
    overrides |= {"integrator": {"scheme": "rosenbrock", "dt": 5e-4, "events": "located"}}
    overrides["payload"] = {"mass": float(rng.uniform(3.0, 12.0))}
    changes = dict[str, Any]()
    for joint in names:
        stiffness, torque = 10 ** rng.uniform(3.7, 4.5), 10 ** rng.uniform(0.0, 0.8)
        twist = 2.0 * torque / stiffness / rng.uniform(0.5, 3.0)
        loop = {"torque": torque, "twist": twist, "elements": int(rng.integers(1, 9))}
        gear = {"ratio": 0.01, "stiffness": stiffness, "damping": 5.0}
        overrides[f"joints.{joint}.gear"] = gear | {LOOP: loop}
        overrides[f"joints.{joint}.friction"] = {"viscous": 0.5, "coulomb": rng.uniform(0.0, 0.5)}
        off = np.exp(0.3 * rng.standard_normal(3)).tolist()
        changes[f"joints.{joint}.gear"] = gear | {
            "stiffness": stiffness * off[0],
            LOOP: loop | {"torque": torque * off[1], "twist": twist * off[2]},
        }
    return load_scene(SCENE, overrides), load_scene(SCENE, overrides | changes)


def judge_loops(seed: int) -> np.ndarray:
    """Return by how many of the published deviations each number of a gear found is off."""
    scene, nominal = draw_hysteretic(seed)
    record = make_record(scene, seed, 2.0 * SECONDS, LOOP_NOISE, 0.02, link_noise=LOOP_NOISE)
    request = FitRequest(["*"], [], LOW_PASS, 0.5, as_is=True)
    identified = identify_numbers(nominal, record, request, lambda _: None)
    loops = list_loops(
        nominal, identified.run, identified.motion, identified.loads, lambda _: True, request.trust
    )
    true = {
        name: float(getattr(part, key))
        for joint in scene.joints
        for name, (part, key) in list_gear_numbers(joint).items()
    }
    return np.array([(loop.value - true[loop.name]) / loop.deviation for loop in loops])


def make_model(scene: Scene, data: Filtered) -> TorqueModel:
    """Return the model of a scene for what was measured."""
    return TorqueModel(scene, (data.tau.std(axis=0), np.abs(data.v).max(axis=0)), TRUST)


def judge_numbers(scene: Scene, seed: int) -> np.ndarray:
    """Return by how many of the published deviations each number found is off.

    What is known before is off by as much as it is trusted to be, drawn anew for each seed.
    """
    record = make_record(scene, seed, SECONDS, ANGLE_NOISE, TORQUE_NOISE)
    ratio = scene.gear_ratios
    data = filter_run(record, ratio, LOW_PASS)
    model = make_model(scene, data)
    fitted = model.choose_unknowns(["*"], "bench")
    true = {unknown.name: unknown.value for unknown in model.unknowns}
    for joint in scene.chain.joints:
        true |= {f"links.{joint.link}.{name}": value for name, value in vary_child(joint).items()}
    rng = np.random.default_rng([seed, 1])
    start = model.start + model.widths * rng.standard_normal(len(model.start))
    low = np.array([unknown.least for unknown in model.unknowns])
    model.start = np.where(fitted & (start > low), start, model.start)
    numbers = list_numbers(scene, fit_torques(model, data, fitted))
    return np.array(
        [
            (number.value - true[number.name]) / number.deviation
            for number in numbers
            if not number.left
        ]
    )


FRICTIONS: dict[str, dict[str, float]] = {  # friction of rotors beside viscous and Coulomb's
    "none": {},
    "load": {"load": 0.05},
    "directed": {"load": 0.05, "back_load": 0.05},  # of rigid gears: motors carry the same load
}
WIDE_PRIOR = 0.2  # width of their priors


def predict_second_run(law: dict[str, float]) -> np.ndarray:
    """Return how much of a second run's torques the numbers of the first explain, by axis [%].

    The runs are those measured of a KUKA KR300 (config/validation/kuka_kr300).
    """
    start_file = DATA / "given.yaml"
    names = load_scene(start_file).joint_names
    scene = load_scene(start_file, {
        f"joints.{joint}.motor.friction.{key}": value
        for joint in names for key, value in law.items()
    })  # fmt: skip
    runs = (read_run(file, scene, angles="deg").shift_back(DELAYS) for file in SHIPPED)
    first, second = (filter_run(part, scene.gear_ratios, LOW_PASS) for part in runs)
    model = make_model(scene, first)
    loads = np.array([unknown.name.endswith("load") for unknown in model.unknowns])
    model.widths = np.where(loads, WIDE_PRIOR, model.widths)
    fit = fit_torques(model, first, model.choose_unknowns(["*"], "bench"))
    motion = model.bind_motion(second)
    for _ in range(LOADED):
        motion = motion.update_loads(fit.values)
    return compute_explained(
        second.tau, motion.compute_torques(fit.values) - second.tau, second.moving
    )


def run_bench(quick: bool) -> dict[str, Any]:
    """Measure over seeds."""
    scene, seeds, machines = load_truth(), 5 if quick else 50, 5 if quick else 20
    every, loaded, rigid, loops = [], [], [], []
    with show_progress("identification", seeds + 3 * machines) as done:
        for seed in range(seeds):
            every.append(judge_numbers(scene, seed))
            done(f"seed {seed}")
        for seed in range(machines):
            loaded.append(judge_numbers(draw_loaded(seed), seed))
            done(f"machine {seed}")
            rigid.append(judge_numbers(draw_loaded(seed, is_rigid=True), seed))
            done(f"machine {seed}, rigid gears")
            loops.append(judge_loops(seed))
            done(f"machine {seed}, loops of gears")
    shares = {name: float(predict_second_run(law).mean()) for name, law in FRICTIONS.items()}
    beside = {
        "machines": machines,
        "loaded": _judge_coverage(loaded),
        "rigid": _judge_coverage(rigid),
    }
    beside |= {"held_out": shares, "loops": _judge_coverage(loops)}
    return {"seeds": seeds} | _judge_coverage(every) | beside


def _judge_coverage(every: list[np.ndarray]) -> dict[str, Any]:
    """Return the coverage of numbers that are off by so many deviations, a row per record."""
    together = np.concatenate(every)
    return {
        "numbers": together.size,
        "within": float(np.mean(np.abs(together) < SIGMAS)),
        "worst_seed": float(min(np.mean(np.abs(scores) < SIGMAS) for scores in every)),
        "root_mean_square": float(np.sqrt(np.mean(together**2))),
    }


def write_report(figures: dict[str, Any]) -> str:
    """Return the section."""
    loaded, rigid, first = figures["loaded"], figures["rigid"], figures["held_out"]
    loops = figures["loops"]
    return (
        f"Of {figures['numbers']} numbers of {figures['seeds']} records of 10 s that the emulator "
        f"made of `{SCENE}` (rotors, links, friction, weight; noise of {100 * TORQUE_NOISE:g} % of "
        f"each torque), {100 * figures['within']:.1f} % lie within two of the standard deviations "
        f"published ({100 * EXPECTED:.1f} % of a normal distribution do); in the worst record "
        f"{100 * figures['worst_seed']:.0f} %. Of {loaded['numbers']} numbers of "
        f"{figures['machines']} drawn machines whose rotors have load friction by the direction of "
        f"power and by the motor's torque, behind elastic gears, {100 * loaded['within']:.1f} % "
        f"lie within; in the worst {100 * loaded['worst_seed']:.0f} %. Of {rigid['numbers']} "
        "numbers of as many behind rigid gears, whose friction also falls with speed, "
        f"{100 * rigid['within']:.1f} % do; in the worst {100 * rigid['worst_seed']:.0f} %. "
        f"Of {loops['numbers']} numbers of gears with hysteresis (stiffness, torque and twist of "
        f"its elements, 20 s, encoders at both sides with noise of {LOOP_NOISE:g} rad) "
        f"{100 * loops['within']:.1f} % do.\n\n"
        "Of the torques of a KUKA KR300's second measured run (MIT licence), the numbers of its "
        f"first explain {first['none']:.1f} % (mean of six axes) without load friction, "
        f"{first['load']:.1f} % with `load`, {first['directed']:.1f} % with `back_load`, too.\n"
    )
