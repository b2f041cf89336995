"""Every kind of fault changes the numbers that a table states, and as it states.

The tables are written by hand: here, and of parts in oracles/parts. test_faults.py shows that
machines follow the declarations.
"""

import re
from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np
import pytest

from arm_emulator.machine.faults.known import FAULTS
from oracles.part_truths import collect_truths, read_tables

# The table has the faults of several parts and of what is no part, in the form of part_truths.py.
# Probabilities p and m of causes that do not depend on each other make 1 - (1 - p) (1 - m). Flux
# goes with the number of turns, inductance with its square. An edge that is missed with the
# probability 1/2 shows nothing.
TABLE = """
[of joints]
gear_breaks             1           1       0 to 1      gear.stiffness (1 - m) x
                                                        gear.damping (1 - m) x
                                                        gear.cubic_stiffness (1 - m) x
gear_softens            1           0.5     0 to 0.999  gear.stiffness (1 - m) x
gear_rings              1           1       0 to 1      gear.damping (1 - m) x
gear_runs_dry           N m/(N m)   0.1     0 to 1      friction.load x + m
                                                        motor.friction.load x + m
friction_steps          N m         5       0 to 1e6    friction.coulomb x + m
grease_thickens         N m s/rad   5       0 to 1e6    friction.viscous x + m
bearing_binds           N m         0.1     0 to 1e6    motor.friction.coulomb x + m
bearing_drags           N m s/rad   1e-3    0 to 1e6    motor.friction.viscous x + m
magnets_weaken          1           0.3     0 to 1      motor.torque_constant (1 - m) x
                                                        motor.torque_per_current (1 - m) x
                                                        motor.back_emf_constant (1 - m) x
                                                        motor.flux (1 - m) x
turns_short             1           0.3     0 to 0.9    motor.torque_constant (1 - m) x
                                                        motor.torque_per_current (1 - m) x
                                                        motor.back_emf_constant (1 - m) x
                                                        motor.flux (1 - m) x
                                                        motor.resistance (1 - m) x
                                                        motor.inductance (1 - m) (1 - m) x
                                                        motor.inductance_d (1 - m) (1 - m) x
                                                        motor.inductance_q (1 - m) (1 - m) x
contact_resistance      ohm         1       0 to 1e9    motor.contact x + m
winding_opens           1           1       0 to 1      motor.open x + m
drive_limit_falls       1           0.5     0 to 0.999  motor.current_limit (1 - m) x
                                                        motor.torque_limit (1 - m) x
current_loop_slows      1           0.9     0 to 0.999  motor.bandwidth (1 - m) x
                                                        motor.current_loop.bandwidth (1 - m) x
                                                    motor.current_loop.proportional_gain (1 - m) x
                                                        motor.current_loop.integral_gain (1 - m) x

[of links]
mass_at_joint           kg          1       0 to 1e6    mass x + m

[of the machine]
payload_drops           1           1       0 to 1      payload.mass (1 - m) x
payload_heavier         kg          1       0 to 1e6    payload.mass x + m
supply_sags             1           0.8     0 to 0.999  supply.share (1 - m) x
base_tilts              rad         0.1     -1 to 1     base.tilt x + m
"""
OWNERS = {"joints": "joints", "imus": "imus", "links": "links", "the machine": ""}


class Written(NamedTuple):
    """A line of the table, with those of further numbers."""

    of: str
    unit: str
    default: float
    range: tuple[float, float]
    changes: dict[str, Callable[[float, float], float]]


def formula(text: str) -> Callable[[float, float], float]:
    """Return a function of x and m from a formula as people write it, products without a sign."""
    python = re.sub(r"(?<=[\w)]) (?=[(x])", " * ", text)
    return eval(f"lambda x, m: {python}")


def faults_in(tables: Iterable[str]) -> dict[str, Written]:
    result: dict[str, Written] = {}
    for owner, _, rows in (block for table in tables for block in read_tables(table)):
        name = ""
        for *numbers, change in rows:
            place, _, text = change.partition(" ")
            if numbers[0]:
                name, unit, default, ends = numbers
                assert name not in result, f"{name} has one line"
                low, high = map(float, ends.split(" to "))
                of = OWNERS[owner.removeprefix("of ")]
                result[name] = Written(of, unit, float(default), (low, high), {})
            result[name].changes[place] = formula(text)
    return result


WRITTEN = faults_in([TABLE, *collect_truths("FAULTS").values()])
DECLARED = {fault.name: fault for fault in FAULTS}


def test_the_table_has_every_kind_of_fault() -> None:
    assert WRITTEN.keys() == DECLARED.keys()


@pytest.mark.parametrize("name", DECLARED)
def test_magnitude_and_changes_of_a_fault_are_those_of_the_table(name: str) -> None:
    fault, written = DECLARED[name], WRITTEN[name]
    m = fault.magnitude
    assert (fault.of, m.unit, m.default, m.ends) == written[:4]
    assert fault.sets.keys() == written.changes.keys()
    assert m.is_in_range(0.0) and m.is_in_range(m.default) and m.default
    for place, changed in written.changes.items():
        assert changed(0.7, 0.0) == 0.7 != changed(0.7, m.default), place
        for x, size in np.random.default_rng(5).uniform(0.1, 0.9, (3, 2)).tolist():
            result = eval(fault.sets[place].format(x=x, m=size))
            assert result == pytest.approx(changed(x, size), rel=1e-14), place  # some roundings
