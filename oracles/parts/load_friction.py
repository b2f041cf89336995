"""Friction that grows with the load, apart from its declaration."""

from arm_emulator.machine.parts.frictions.friction import OfRotor
from arm_emulator.machine.parts.part import Part
from oracles.part_truths import Numbers, Rng, draw_scaled
from oracles.parts import friction

NUMBERS = f"""
[joints.NAME.friction with load]
[joints.NAME.motor.friction with load]
{friction.NUMBERS_OF_FRICTIONS}\
stribeck                rad/s       none        > 0
load                    N m/(N m)   0           0 to 10
back_load               N m/(N m)   none        0 to 10
rest_load               N m/(N m)   none        0 to 10
rest_back_load          N m/(N m)   none        0 to 10
motor_load              N m/(N m)   none        0 to 10
rest_motor_load         N m/(N m)   none        0 to 10
rest_load_square        1/(N m)     none        >= 0
rest_motor_square       1/(N m)     none        >= 0
exponent                1           none        0.5 to 20
"""


def draw_section(part: type[Part], rng: Rng) -> Numbers:
    """With and without a fall of the dry torque, half of them with keys of the direction."""
    falls = {"stribeck": friction.find_usual_speed(part)} if rng.random() < 0.5 else {}
    directed = _draw_directions(part, rng.spawn(1)[0], falls=bool(falls))
    return friction.draw_section(part, rng) | {"load": 0.2, **falls, **directed}


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
