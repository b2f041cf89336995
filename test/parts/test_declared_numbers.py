"""Every number that a scene, a node or a message gives has the unit, default and range of a table.

The tables are written by hand: here, and of parts in oracles/parts. Tests that ask the declaration
for its own default or range cannot notice that either is wrong.
"""

import re
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import pytest

from arm_emulator.base.validation import bound
from arm_emulator.base.validation.number import REQUIRED, Number, list_numbers
from arm_emulator.machine.parts.measuring.imu import Imu
from arm_emulator.machine.parts.part import Part
from arm_emulator.machine.parts.registry import list_kinds
from arm_emulator.machine.scene.integrator import Integrator
from arm_emulator.machine.scene.joint import Joint
from arm_emulator.machine.scene.payload import COM, INERTIA, MASS
from arm_emulator.machine.scene.scene import Scene
from arm_emulator.motion.model.config import MotionConfig
from arm_emulator.motion.model.drive_parameters import DriveParameters
from arm_emulator.servo.servo_config import JointServo, ServoConfig
from emulator_node.node import EmulatorParameters
from oracles.part_truths import collect_truths, read_tables
from servo_node.node import ServoNodeParameters

# The table has the numbers of all that is no part, in the form of oracles/part_truths.py.
TABLE = """
[joints.NAME]
start                   rad or m    0           -1e4 to 1e4

[scene]
supply_voltage          V           needed      > 0, <= 1e5
servo_period            s           needed      1e-6 to 1
threads                 -           1           whole 1 to 2
seed                    -           0           whole 0 to 9007199254740992

[integrator]
dt                      s           needed      1e-9 to 1
exchange_depth          -           1           whole 1 to 4

[payload]
mass                    kg          needed      >= 0
com                     m           needed      size <= 100
inertia                 kg m2       needed      size <= 1e6

[servo]
period                  s           needed      > 0
motion_period           s           needed      >= 0
hold_after              s           needed      > 0
cut_after               s           needed      > 0
supply_voltage          V           needed      > 0

[servo joints.NAME]
gear_ratio              -           needed      size > 0
counts_per_turn         -           needed      whole >= 1
resistance              ohm         needed      >= 0
torque_constant         N m/A       needed      > 0
back_emf_constant       V s/rad     needed      >= 0
rotor_inertia           kg m2       needed      > 0
velocity_limit          rad/s       needed      > 0
position_gain           1/s         needed      > 0
velocity_gain           N m s/rad   needed      > 0
integral_time           s           needed      > 0
observer_bandwidth      rad/s       needed      > 0
inductance              H           0           >= 0
link_inertia            kg m2       0           >= 0
current_limit           A           inf         > 0
current_bandwidth       Hz          0           >= 0
torque_bandwidth        Hz          0           >= 0
voltage_limit           V           inf         > 0
encoder_bits            -           0           whole 0 to 48

[emulator]
timeout                 s           2           0.1 to 3600
real_time_factor        -           1           0 to 1000
report_period           s           0.01        0 to 10
rerun_port              -           0           whole 0 to 65535
page_port               -           -1          whole -1 to 65535

[servo_node]
joint_states_period     s           0.01        1e-6 to 10

[motion_controller]
period                  s           0.05        1e-4 to 10
weight                  -           0.5         1e-6 to 1
step_limit              rad         0.2         1e-6 to 100
singular_below          -           0.02        1e-9 to 1
velocity_limit          rad/s       3           1e-6 to 1000
acceleration_limit      rad/s2      10          1e-6 to 1e5
jerk_limit              rad/s3      0           0 to 1e8
gravity_x               m/s2        0           -1000 to 1000
gravity_y               m/s2        0           -1000 to 1000
gravity_z               m/s2        -9.81       -1000 to 1000
reached_within          m           1e-3        1e-9 to 1000
reached_within_angle    rad         5e-3        1e-9 to 10
tool_speed              m/s         0.25        1e-6 to 100
tool_turn_speed         rad/s       1           1e-6 to 100
tool_acceleration       m/s2        1           1e-6 to 1e4
tool_jerk               m/s3        10          1e-6 to 1e6
path_blend              m           0           0 to 100
path_tolerance          rad         0           0 to 1000
tool_path_tolerance     m           5e-3        0 to 1000
goal_tolerance          rad         0           0 to 1000
goal_time               s           0           0 to 1e6
jog_scale_linear        m/s         0.4         0 to 100
jog_scale_rotational    rad/s       0.8         0 to 100
jog_scale_joint         rad/s       0.5         0 to 100
jog_incoming_command_timeout  s     0.1         1e-3 to 3600
jog_lower_singularity_threshold  -  17          1 to 1e9
jog_hard_stop_singularity_threshold  -  30      1 to 1e9
jog_joint_limit_margin  rad         0.1         0 to 10
collision_margin        m           0.01        0 to 10

[motion_controller joints.NAME]
stiffness               N m/rad     inf         > 0
cubic_stiffness         N m/rad3    0           >= 0
damping                 N m s/rad   0           >= 0
viscous                 N m s/rad   0           >= 0
coulomb                 N m         0           >= 0
rotor_viscous           N m s/rad   0           >= 0
rotor_coulomb           N m         0           >= 0

[messages and calls]
position                rad         needed      size <= 1e6
velocity                rad/s       needed      size <= 1e6
acceleration            rad/s2      needed      size <= 1e9
effort                  N m         needed      size <= 1e9
command                 V, N m or A  needed     size <= 1e9
current                 A           needed      size <= 1e9
brake_closed            -           needed      size <= 1
force                   N           needed      size <= 1e6
moment                  N m         needed      size <= 1e6
point                   m           needed      size <= 1e3
tool position           m           needed      size <= 1e6
"""


class Row(NamedTuple):
    """A number: its unit, its default as text, its range."""

    unit: str
    default: str
    above: float | None = None
    at_least: float | str | None = None  # or the key of another number
    at_most: float | None = None
    in_size: bool = False
    whole: bool = False


def numbers_in(tables: Iterable[str]) -> dict[str, dict[str, Row]]:
    result: dict[str, dict[str, Row]] = {}
    for owner, _, rows in (block for table in tables for block in read_tables(table)):
        assert owner not in result, f"{owner} has one heading"
        result[owner] = dict(map(row_of, rows))
        assert len(result[owner]) == len(rows), f"{owner} has each number once"
    return result


def row_of(columns: list[str]) -> tuple[str, Row]:
    name, unit, default, words, *_ = columns
    if default not in ("needed", "none") and not default.isalpha():
        default = str(float(default))
    ends = dict(re.findall(r"(>=|<=|>) (\S+?)(?:,|$)", words))
    if between := re.search(r"(\S+) to (\S+)$", words):
        ends[">="], ends["<="] = between.groups()
    smallest = ends.get(">=")
    return name, Row(
        "" if unit == "-" else unit,
        default,
        float(ends[">"]) if ">" in ends else None,
        smallest if smallest is None or smallest.isalpha() else float(smallest),
        float(ends["<="]) if "<=" in ends else None,
        words.startswith("size"),
        words.startswith("whole"),
    )


def declared(number: Number) -> Row:
    followed = getattr(number, "follows", None)
    default = "needed" if number.default is REQUIRED else "none" if number.default is None else None
    return Row(
        number.unit,
        followed or default or str(float(number.default)),
        number.above,
        followed or number.at_least,
        None if number.at_most is None else float(number.at_most),
        number.in_size,
        number.whole,
    )


def rows_of(numbers: Iterable[Number]) -> dict[str, Row]:
    return {number.name: declared(number) for number in numbers}


def of_class(kind: type[Any]) -> dict[str, Row]:
    return rows_of(list_numbers(kind).values())


def declarations() -> Iterator[tuple[str, dict[str, Row]]]:
    """Yield what parts, scenes, nodes and messages declare, by the headings of the table."""
    for part in list_kinds(Part):
        beside = (key for key in part.keys if isinstance(key, Number))
        yield part.name_place(), rows_of((*part.list_numbers().values(), *beside))
    yield "imus.NAME", rows_of(key for key in Imu.keys if isinstance(key, Number))
    yield "joints.NAME", of_class(Joint)
    yield "scene", of_class(Scene)
    yield "integrator", of_class(Integrator)
    yield "payload", rows_of((MASS, COM, INERTIA))
    yield "emulator", of_class(EmulatorParameters)
    yield "servo_node", of_class(ServoNodeParameters)
    yield "servo", of_class(ServoConfig)
    yield "servo joints.NAME", of_class(JointServo)
    yield "motion_controller", of_class(MotionConfig)
    yield "motion_controller joints.NAME", of_class(DriveParameters)
    b = bound
    messages = (b.POSITION, b.VELOCITY, b.ACCELERATION, b.EFFORT, b.COMMAND, b.CURRENT,
                b.BRAKE_CLOSED, b.FORCE, b.MOMENT, b.POINT)  # fmt: skip
    yield "messages and calls", rows_of((*messages, b.TOOL_POSITION.rename("tool position")))


WRITTEN = numbers_in([TABLE, *collect_truths("NUMBERS").values()])
DECLARED = dict(declarations())


def test_the_table_has_all_that_declares_numbers() -> None:
    assert WRITTEN.keys() == DECLARED.keys()


@pytest.mark.parametrize("owner", DECLARED)
def test_numbers_have_the_units_defaults_and_ranges_of_the_table(owner: str) -> None:
    assert DECLARED[owner] == WRITTEN[owner]
