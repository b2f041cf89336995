"""Random numbers of parts, as sections of a scene state them, for random machines.

A part whose numbers are independent has a row in `TYPICAL`; a part whose numbers depend on each
other has a function in `SAMPLERS`. A class without either takes that of the class it inherits.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from arm_emulator.base.validation.number import REQUIRED
from arm_emulator.machine.parts.bearing import Shift, Tilt
from arm_emulator.machine.parts.drive_stages.current_loop import CurrentLoop
from arm_emulator.machine.parts.drive_stages.inverter import Inverter
from arm_emulator.machine.parts.drive_stages.torque_ripple import TorqueRipple
from arm_emulator.machine.parts.drive_stages.winding import Winding
from arm_emulator.machine.parts.frictions.brake import Brake
from arm_emulator.machine.parts.frictions.friction import Friction, OfRotor
from arm_emulator.machine.parts.frictions.load_friction import OF_MOTOR_TORQUE, LoadFriction
from arm_emulator.machine.parts.frictions.lugre import LinkLuGre, LuGre
from arm_emulator.machine.parts.frictions.stribeck import Stribeck
from arm_emulator.machine.parts.gears.backlash_gear import BacklashGear
from arm_emulator.machine.parts.gears.elastic_gear import ElasticGear
from arm_emulator.machine.parts.gears.gear import Gear
from arm_emulator.machine.parts.gears.hysteresis import Hysteresis
from arm_emulator.machine.parts.gears.kinematic_error_gear import KinematicErrorGear
from arm_emulator.machine.parts.gears.progressive_gear import ProgressiveGear
from arm_emulator.machine.parts.joint_effects.cogging import Cogging
from arm_emulator.machine.parts.joint_effects.counterbalance import Counterbalance
from arm_emulator.machine.parts.joint_effects.drag import Drag
from arm_emulator.machine.parts.joint_effects.end_stops import EndStops
from arm_emulator.machine.parts.joint_effects.gear_temperature import GearTemperature
from arm_emulator.machine.parts.joint_effects.torque_table import MIN_POINTS, TorqueTable
from arm_emulator.machine.parts.motors.current_motor import CurrentMotor
from arm_emulator.machine.parts.motors.dc_motor import DcMotor
from arm_emulator.machine.parts.motors.motor import Motor, Rating
from arm_emulator.machine.parts.motors.pmsm import POLE_PAIRS, Pmsm
from arm_emulator.machine.parts.motors.stepper import Stepper
from arm_emulator.machine.parts.motors.torque_motor import TorqueMotor
from arm_emulator.machine.parts.part import Part

Rng = np.random.Generator
Numbers = dict[str, Any]

# Ends of usual values, by the keys of a part.
TYPICAL: dict[type[Part], dict[str, tuple[float, float]]] = {
    Inverter: {"voltage_error": (0.3, 3.0), "knee": (0.2, 1.0)},
    Winding: {
        "heat_capacity": (0.2, 5.0),
        "thermal_resistance": (0.1, 2.0),
        "magnet_coefficient": (-0.001, 0.0),
    },
    Counterbalance: {
        "base_distance": (0.3, 0.5),
        "link_distance": (0.05, 0.2),
        "angle": (-3.0, 3.0),
        "force": (20.0, 200.0),
        "length": (0.4, 0.6),
        "stiffness": (20.0, 200.0),
    },
    Hysteresis: {"torque": (1.0, 20.0), "twist": (3e-4, 3e-3)},
    Drag: {"coefficient": (0.1, 10.0)},
    Tilt: {"stiffness": (1e3, 1e5), "damping": (0.0, 10.0)},
    Shift: {"stiffness": (1e5, 1e7), "damping": (0.0, 1e3)},
}


def draw_scaled(rng: Rng, low: float, high: float) -> float:
    """Draw a number of any scale between two: its logarithm is uniform."""
    return float(10 ** rng.uniform(np.log10(low), np.log10(high)))


def draw_part(part: type[Part], rng: Rng) -> Numbers:
    """Return the section of a random part."""
    for base in part.__mro__:
        if base in SAMPLERS:
            return SAMPLERS[base](part, rng)
        if base in TYPICAL:
            return _draw_typical(part, TYPICAL[base], rng)
    raise AssertionError(f"oracles/part_samples.py: {part.__name__} has no usual numbers")


def _draw_typical(part: type[Part], typical: dict[str, tuple[float, float]], rng: Rng) -> Numbers:
    """Return the section of a part, with half of what may be absent."""
    numbers: Numbers = {}
    for key, number in part.list_numbers().items():
        needed = number.default is REQUIRED
        if not needed and key not in typical:
            continue
        low, high = typical[key]
        if needed or rng.random() < 0.5:
            numbers[key] = (
                draw_scaled(rng, low, high) if low > 0.0 else float(rng.uniform(low, high))
            )
    return numbers


def _draw_current_loop(_: type[Part], rng: Rng) -> Numbers:
    """By its bandwidth, or by its gains."""
    if rng.random() < 0.5:
        return {"bandwidth": draw_scaled(rng, 100.0, 1000.0)}
    share = float(rng.uniform(0.0, 1.0))
    return {
        "proportional_gain": draw_scaled(rng, 1.0, 10.0),
        "integral_gain": draw_scaled(rng, 100.0, 5e3),
        "emf_feedforward": share,
    }


def _draw_gear_temperature(_: type[Part], rng: Rng) -> Numbers:
    """A small body, which friction heats by some K in the seconds of a test."""
    return {
        "heat_capacity": draw_scaled(rng, 0.05, 0.5),
        "thermal_resistance": draw_scaled(rng, 0.5, 5.0),
        "viscous_floor": float(rng.uniform(0.0, 0.5)),
        "viscous_decay": draw_scaled(rng, 10.0, 50.0),
        "dry_coefficient": float(rng.uniform(-0.01, 0.01)),
    }


def _draw_torque_ripple(_: type[Part], rng: Rng) -> Numbers:
    return {"waves": [[6.0, float(rng.uniform(0.01, 0.1)), 1.0]]}


def _draw_brake(_: type[Part], rng: Rng) -> Numbers:
    """With delays of whole steps of 0.5 ms."""
    close, release = (5e-4 * int(n) for n in rng.integers(0, 30, 2))
    return {"torque": draw_scaled(rng, 0.02, 0.5), "close_delay": close, "release_delay": release}


def _draw_friction(part: type[Part], rng: Rng) -> Numbers:
    dry_scale, viscous = (0.01, 1e-5) if issubclass(part, OfRotor) else (0.6, 0.1)
    dry = dry_scale * draw_scaled(rng, 0.3, 3.0)
    return {"coulomb": dry, "breakaway": 1.3 * dry, "viscous": viscous}


def _find_typical_speed(part: type[Part]) -> float:
    """Return a slow speed of the shaft [rad/s]."""
    return 6.0 if issubclass(part, OfRotor) else 0.2


def _draw_stribeck(part: type[Part], rng: Rng) -> Numbers:
    return _draw_friction(part, rng) | {"stribeck": _find_typical_speed(part)}


def _draw_load_friction(part: type[Part], rng: Rng) -> Numbers:
    """With and without a fall of the dry torque, half of them with keys of the direction."""
    falls = {"stribeck": _find_typical_speed(part)} if rng.random() < 0.5 else {}
    directed = _draw_directions(part, rng.spawn(1)[0], falls=bool(falls))
    return _draw_friction(part, rng) | {"load": 0.2, **falls, **directed}


def _draw_directions(part: type[Part], rng: Rng, *, falls: bool) -> Numbers:
    """Draw half of the keys of the direction of power; some gears lock themselves."""
    if rng.random() < 0.5:
        return {}
    per_torque = 5.0 if issubclass(part, OfRotor) else 0.05
    numbers: Numbers = {
        "back_load": draw_scaled(rng, 0.05, 1.5),
        "rest_load": draw_scaled(rng, 0.02, 0.2),
        "rest_back_load": draw_scaled(rng, 0.02, 0.4),
        "motor_load": draw_scaled(rng, 0.02, 0.2),
        "rest_motor_load": draw_scaled(rng, 0.02, 0.2),
        "rest_load_square": per_torque * draw_scaled(rng, 0.1, 1.0),
        "rest_motor_square": per_torque * draw_scaled(rng, 0.1, 1.0),
        **({"exponent": draw_scaled(rng, 1.0, 4.0)} if falls else {}),
    }
    return {key: value for key, value in numbers.items() if rng.random() < 0.5}


def fit_friction_to_gear(joint: Numbers) -> None:
    """Leave out friction by a rotor's torque behind a rigid gear, which has no other torque."""
    if "stiffness" not in joint["gear"]:
        for key in OF_MOTOR_TORQUE:
            joint["motor"].get("friction", {}).pop(key, None)


def _draw_lugre(part: type[Part], rng: Rng) -> Numbers:
    if issubclass(part, LinkLuGre):
        torque = draw_scaled(rng, 0.2, 2.0)
        bend, damping, speed = (2e-3, 2e-2), (0.3, 3.0), {}
    else:
        torque = draw_scaled(rng, 0.003, 0.03)
        bend, damping, speed = (0.2, 1.0), (3e-4, 3e-3), {"stribeck": 5.0}
    return {
        "coulomb": torque,
        "breakaway": torque * float(rng.uniform(1.0, 1.5)),
        **speed,
        "bristle_stiffness": torque / draw_scaled(rng, *bend),
        "bristle_damping": draw_scaled(rng, *damping),
    }


def _draw_gear(_: type[Part], rng: Rng) -> Numbers:
    return {"ratio": draw_scaled(rng, 0.01, 0.04) * float(rng.choice([-1.0, 1.0]))}


def _draw_elastic_gear(part: type[Part], rng: Rng) -> Numbers:
    gear = _draw_gear(part, rng)
    stiffness, damping = draw_scaled(rng, 1e3, 1e4), draw_scaled(rng, 0.5, 10.0)
    return gear | {"stiffness": stiffness, "damping": damping}


def _draw_backlash_gear(part: type[Part], rng: Rng) -> Numbers:
    return _draw_elastic_gear(part, rng) | {"backlash": draw_scaled(rng, 1e-3, 2e-2)}


def _draw_progressive_gear(part: type[Part], rng: Rng) -> Numbers:
    gear = _draw_elastic_gear(part, rng)
    return gear | {"cubic_stiffness": gear["stiffness"] * draw_scaled(rng, 1e2, 1e4)}


def _draw_kinematic_error_gear(part: type[Part], rng: Rng) -> Numbers:
    gear = _draw_elastic_gear(part, rng)
    of_motor = [2.0, 0.1 * gear["ratio"], float(rng.uniform(0.0, 6.0))]
    of_link = [3.0, draw_scaled(rng, 1e-4, 1e-2)]
    return gear | {"kinematic_error": {"motor": [of_motor], "link": [of_link]}}


def _draw_cogging(_: type[Part], rng: Rng) -> Numbers:
    return {"waves": [[4.0, draw_scaled(rng, 1e-3, 1e-2), float(rng.uniform(0.0, 6.0))]]}


def _draw_end_stops(_: type[Part], rng: Rng) -> Numbers:
    scaled = draw_scaled(rng, 0.02, 0.2)
    return {
        "lower": -scaled,
        "upper": scaled,
        "stiffness": draw_scaled(rng, 1e3, 2e4),
        "damping": 10.0,
    }


def _draw_torque_table(_: type[Part], rng: Rng) -> Numbers:
    angles = np.cumsum(rng.uniform(0.05, 0.4, int(rng.integers(MIN_POINTS, 12)))) - 1.5
    torques = rng.uniform(-5.0, 5.0, len(angles))
    periodic = bool(rng.random() < 0.5)
    if periodic:
        torques[-1] = torques[0]
    return {"angles": angles.tolist(), "torques": torques.tolist(), "periodic": periodic}


def _draw_motor(part: type[Part], rng: Rng) -> Numbers:
    """Without its rotor, as `new` sizes it."""
    assert issubclass(part, Motor)
    rating = Rating(
        torque=draw_scaled(rng, 0.3, 1.0),
        rotor_inertia=1e-4,
        torque_constant=0.05,
        back_emf_constant=0.05,
        resistance=draw_scaled(rng, 0.5, 2.0),
        inductance=2e-3,
        bandwidth=200.0,
    )
    motor = part.size_part(rating)
    values = {key: getattr(motor, key) for key in part.list_numbers()}
    limit = motor.limit if motor.circuit is not None else ""  # it would need a loop
    return {
        key: value
        for key, value in values.items()
        if value is not None and key not in ("rotor_inertia", limit)
    }


def _draw_current_motor(_: type[Part], rng: Rng) -> Numbers:
    numbers = {"torque_constant": 0.05, "current_limit": 10.0}
    return {**numbers, **({"bandwidth": 200.0} if rng.random() < 0.5 else {})}


def _draw_dc_motor(_: type[Part], rng: Rng) -> Numbers:
    inductive = rng.random() < 0.5
    return {
        "resistance": draw_scaled(rng, 0.5, 2.0),
        "torque_constant": 0.05,
        "back_emf_constant": 0.05,
        **({"inductance": draw_scaled(rng, 1e-3, 5e-3)} if inductive else {}),
        **({"current_limit": draw_scaled(rng, 3.0, 10.0)} if rng.random() < 0.5 else {}),
    }


def _draw_pmsm(_: type[Part], rng: Rng) -> Numbers:
    return {
        "resistance": draw_scaled(rng, 0.3, 1.0),
        "inductance_d": draw_scaled(rng, 1e-3, 3e-3),
        "inductance_q": draw_scaled(rng, 1e-3, 3e-3),
        "flux": draw_scaled(rng, 0.005, 0.02),
        "pole_pairs": POLE_PAIRS,
    }


def _draw_stepper(_: type[Part], rng: Rng) -> Numbers:
    return {
        "torque_per_current": draw_scaled(rng, 0.03, 0.1),
        "teeth": int(rng.integers(1, 5)),
        "bandwidth": draw_scaled(rng, 100.0, 500.0),
    }


def _draw_torque_motor(_: type[Part], rng: Rng) -> Numbers:
    return {"torque_limit": 0.5, **({"bandwidth": 200.0} if rng.random() < 0.5 else {})}


SAMPLERS: dict[type, Callable[[type[Part], Rng], Numbers]] = {
    CurrentLoop: _draw_current_loop,
    TorqueRipple: _draw_torque_ripple,
    Brake: _draw_brake,
    GearTemperature: _draw_gear_temperature,
    Friction: _draw_friction,
    Stribeck: _draw_stribeck,
    LoadFriction: _draw_load_friction,
    LuGre: _draw_lugre,
    Gear: _draw_gear,
    ElasticGear: _draw_elastic_gear,
    BacklashGear: _draw_backlash_gear,
    ProgressiveGear: _draw_progressive_gear,
    KinematicErrorGear: _draw_kinematic_error_gear,
    Cogging: _draw_cogging,
    EndStops: _draw_end_stops,
    TorqueTable: _draw_torque_table,
    Motor: _draw_motor,
    CurrentMotor: _draw_current_motor,
    DcMotor: _draw_dc_motor,
    Pmsm: _draw_pmsm,
    Stepper: _draw_stepper,
    TorqueMotor: _draw_torque_motor,
}
