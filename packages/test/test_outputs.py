"""Outputs of parts, declared once: every door and display has all of them."""

import dataclasses
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from documents import DOCS
from machines import GRAVITY, LINK, write_scene
from rclpy.serialization import deserialize_message

from arm_emulator import Plant, Refusal, Scene, Session, load_gains, load_scene
from arm_emulator.base.io.config_files import find_scene
from arm_emulator.core import BOUNDARY
from arm_emulator.design.tuned import make_data_sheet
from arm_emulator.machine.parts.measuring.sensors import ANALOG, SENSOR_PARTS
from arm_emulator.machine.parts.measuring.torque_sensor import TorqueSensor
from arm_emulator.machine.parts.output import Output
from arm_emulator.machine.plant import outputs
from arm_emulator.machine.plant.core_calls import ARM
from arm_emulator.machine.plant.measured_fields import MeasuredFields
from arm_emulator.machine.plant.outputs import (
    ALWAYS,
    KNOWN,
    SYMBOLS,
    list_outputs,
    list_readings,
    list_reported_by_parts,
)
from arm_emulator.machine.plant.scene_unit import write_scene_unit
from arm_emulator.machine.scene.known_parts import MOTORS, PARTS
from arm_emulator.machine.session.real_time import open_real_time_session
from arm_emulator.ros.messages.fixed_layout import FixedLayout
from arm_emulator.ros.messages.middleware import Outgoing, get_middleware
from arm_emulator.toolchain.c_header import NULL, read_text
from arm_emulator_fieldbus.converter import RegisterConverter, list_blocks
from arm_emulator_fieldbus.declared import find_index, find_places
from arm_emulator_fieldbus.drives import Drives
from arm_emulator_fieldbus.drives_unit import CANOPEN
from arm_emulator_fieldbus.modbus_rtu import ModbusException
from arm_emulator_fieldbus.object_dictionary import Aborted
from arm_emulator_fmu.variables import list_variables
from arm_emulator_msgs.msg import MotorState
from docs import tables
from oracles.part_truths import collect_truths, get_truth

PMSM = {
    "kind": "pmsm", "resistance": 0.4, "inductance_d": 2e-3, "inductance_q": 3e-3, "flux": 0.05,
    "pole_pairs": 4, "rotor_inertia": 2e-4,
    "winding": {"heat_capacity": 50.0, "thermal_resistance": 2.0, "limit": 120.0},
}  # fmt: skip

SPRINGS = {f"shift_{axis}": {"stiffness": 1e5, "damping": 50.0} for axis in "xyz"} | {
    f"tilt_{axis}": {"stiffness": 1e3, "damping": 0.5} for axis in "xyz"
}
# The direction in which each joint itself moves, so that its bearing does not give way.
ALONG = {"turn": "tilt_z", "slide": "shift_z"}

# A joint has one motor: outputs of other kinds stand where this machine has one, too.
OTHERS = {output for kind in MOTORS if kind.kind != PMSM["kind"] for output in kind.outputs}
HERE = {name: output for name, output in KNOWN.items() if output not in OTHERS}


def everything(folder: Path, **more: Any) -> Scene:
    """A machine that has every output: a turn, a slide."""
    text = '<robot name="all"><link name="base"/>'
    for name, kind, parent in (("turn", "continuous", "base"), ("slide", "prismatic", "turn_link")):
        text += LINK.format(
            name=name, kind=kind, parent=parent, xyz="0.1 0.2 0.3", rpy="0.3 -0.5 1.2",
            axis="0 0 1", com="0.05 0.1 0.02", com_rpy="0 0 0", mass=1.5,
            ixx=0.03, iyy=0.04, izz=0.05, ixy=0.0, ixz=0.0, iyz=0.01,
        )  # fmt: skip
    analog = {kind.section: {"noise": 0.01, "offset": 0.5} for kind in ANALOG}
    joint = {
        "motor": PMSM,
        "gear": {"ratio": 0.02, "stiffness": 3e3, "damping": 5.0},
        "brake": {"torque": 1.0},
        "encoder": {"counts_per_turn": 1000, "index": "latch"},
        "link_encoder": {"counts_per_turn": 4096, "index": "latch"},
        **analog,
    }
    imus = {name: {"link": "slide_link"} for name in ("hand", "other")}
    joints = {
        name: {**joint, "bearing": {key: value for key, value in SPRINGS.items() if key != along}}
        for name, along in ALONG.items()
    }
    file = write_scene(
        folder, text + "</robot>", joints, imus=imus, seed=3, gravity=GRAVITY, **more
    )
    return load_scene(file)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return everything(tmp_path_factory.mktemp("everything"))


@pytest.fixture(scope="module")
def plant(scene: Scene) -> Plant:
    """One that has moved, so that outputs are no zeros."""
    plant = Plant(scene)
    for tick in range(40):
        plant.exchange(np.array([30.0, -30.0]) * (1 if tick < 20 else -1), command_d=[2.0, -3.0])
    return plant


def test_this_machine_has_every_output_that_a_part_declares(scene: Scene) -> None:
    assert {output.name for output in list_outputs(scene)} == set(HERE)
    assert {output.symbol for output in OTHERS} <= {value.symbol for value in HERE.values()}


# Units at joints that turn and that slide, written down apart from the declarations. "" of counts,
# flags, bits, and of what is in the unit of an input.
UNITS = {
    "encoder_counts": ("", ""),
    "current": ("A", "A"),
    "applied": ("command", "command"),
    "faults": ("", ""),
}
for of_part in collect_truths("OUTPUTS").values():
    UNITS |= of_part


def test_outputs_and_inputs_have_the_units_of_the_table() -> None:
    kinds = ("revolute", "prismatic")
    assert {name: tuple(map(output.choose_unit, kinds)) for name, output in KNOWN.items()} == UNITS
    for kind in MOTORS:
        assert {input.name: input.unit for input in kind.inputs} == get_truth(kind).INPUTS


def test_symbols_are_those_of_the_header() -> None:
    header = (BOUNDARY / "arm.h").read_text()
    for symbol in SYMBOLS:
        field = symbol.partition(".")[2] or symbol
        assert f" {field};" in header or f"*{field};" in header or f" {field}[" in header, symbol


def test_an_output_without_a_place_in_c_is_refused(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of any class; and so is one that an instance reports and its class does not declare."""
    lost = Output("lost", "what nobody has", "sensors.lost", "N m")
    monkeypatch.setattr(TorqueSensor, "outputs", (lost,))
    with pytest.raises(Refusal, match=r"output lost must be declared .* got 'sensors.lost'"):
        write_scene_unit(scene)
    monkeypatch.setitem(outputs.KNOWN, "lost", lost)
    with pytest.raises(Refusal, match=r"output lost must be declared .* place in arm\.h"):
        write_scene_unit(scene)


def test_draws_of_sensors_are_their_own() -> None:
    """No two draw the same noise, at any joints."""
    draws = [range(first, first + stride * 100, stride) for first, stride in
             (kind.list_streams() for kind in ANALOG)]  # fmt: skip
    everyone = [who for draw in draws for who in draw]
    encoders = {4 * j + k for j in range(100) for k in (0, 1)}
    assert len(set(everyone) | encoders) == len(everyone) + len(encoders)
    assert max(everyone) < 2**31, "an int"


def test_measured_has_all_of_it(scene: Scene, plant: Plant) -> None:
    measured = plant.measured
    N = len(scene.joints)
    for name, output in KNOWN.items():
        values = getattr(measured, name)
        assert values.shape == ((len(scene.imus), 3) if output.per_unit else (N,)), name
        assert np.isfinite(values).all(), name
        assert name in dir(measured)
    assert measured.applied.tolist() == plant.measured.applied.tolist()
    with pytest.raises(AttributeError, match="Measured has no colour"):
        _ = measured.colour


def test_c_describes_its_readings(scene: Scene, plant: Plant) -> None:
    rows = list_readings(scene)
    for row in range(len(rows) + 1):
        for joint in range(3):
            reading = ARM.make_struct("arm_reading")
            result = plant.core.arm_describe_reading(row, joint, reading)
            assert result == (row == len(rows) or joint == 2), "refused"
            if result == 0:
                expected = rows[row].choose_unit(scene.chain.joints[joint].kind)
                assert (read_text(reading.name), read_text(reading.unit)) == (
                    rows[row].name,
                    expected,
                )
                is_rigid = rows[row].name == f"bearing_{(*ALONG.values(),)[joint]}"
                assert reading.present == (not is_rigid)


def test_units_of_all_tools_have_all_of_it(scene: Scene) -> None:
    output_names = {
        variable.name[0] for variable in list_variables(scene) if variable.role == "output"
    }
    assert set(HERE) | {"powered", "truth"} == output_names


def test_messages_carry_all_that_parts_report(scene: Scene, plant: Plant) -> None:
    types = MotorState.get_fields_and_field_types()
    fields, measured = MeasuredFields(scene, types), plant.measured
    own = [output.name for output in fields.own]
    assert {*fields.in_all, *own, *fields.listed} >= {
        part.name for part in list_reported_by_parts(scene)
    }
    assert not fields.absent
    empty = MotorState()
    fields.size_message(empty, Plant(scene).measured)
    layout = FixedLayout(empty)
    fields.fill_message(layout.message, measured)
    message = deserialize_message(layout.write_message(), MotorState)
    for name in (*fields.in_all, *own):
        np.testing.assert_array_equal(getattr(message, name), getattr(measured, name).ravel())
    fields.size_message(empty, Plant(scene).measured)
    unpublished: Any = None
    sent = Outgoing(unpublished, empty, further=fields.list_places(plant.measured_place))
    get_middleware().ros_fill(sent.struct, 0, 0, NULL)
    copied = deserialize_message(bytes(sent.layout.bytes), MotorState)
    assert copied == message, "C copies the same"
    rows = np.array(message.readings).reshape(len(message.reading_names), -1)
    for name, row in zip(message.reading_names, rows, strict=True):
        np.testing.assert_array_equal(row, getattr(measured, name), name)


def test_registers_have_all_of_it_behind_those_of_every_machine(scene: Scene) -> None:
    session = Session(scene, "realtime", "first_answer")
    converter = RegisterConverter(session, 0)
    for _ in range(20):
        session.advance_under(np.array([30.0, -20.0]))
    rows = [
        output_block for output_block in list_blocks(scene) if 1003 <= output_block.address < 2000
    ]
    units = len(scene.imus)
    names = [
        (output.name, unit)
        for output in dict.fromkeys((*ALWAYS, *HERE.values()))
        for unit in (range(units) if output.per_unit else (...,))
    ]
    assert len(rows) == len(names), [row.name for row in rows]
    at = 1003
    for (name, unit), block in zip(names, rows, strict=True):
        assert block.address == at, name
        words = np.array(converter.read(block.address, block.count), ">u2")
        kind = {"float32": ">f4", "int32": ">i4", "uint16": ">u2"}[block.kind]
        expected = getattr(session.measured, name)[unit]
        np.testing.assert_allclose(words.view(kind), expected, rtol=1e-7, atol=0, err_msg=name)
        at += block.count
    with pytest.raises(ModbusException):
        converter.read(at, 1)


def test_real_time_passes_the_same_inputs(scene: Scene) -> None:
    session = open_real_time_session(scene, "paused")
    assert session.step() == ""
    fresh = Plant(scene)
    fresh.exchange(np.zeros(2))
    for name in KNOWN:
        mine, its = getattr(session.measured, name), getattr(fresh.measured, name)
        assert mine.tobytes() == its.tobytes(), name
    session.paused = False
    while not session.wait(1.0) or not session.take():
        pass
    session.paused = True
    ticks = session.tick
    for _ in range(ticks - 1):
        fresh.exchange(np.zeros(2))
    for name in KNOWN:
        mine, its = getattr(session.measured, name), getattr(fresh.measured, name)
        assert mine.tobytes() == its.tobytes(), f"{name} by the loop at tick {ticks}"
    session.close()


def test_a_faultless_sensor_has_the_bits_of_the_truth() -> None:
    """However the compiler rounds where it folds the core into what asks."""
    plant = Plant(load_scene("three_axis", {"joints.*.torque_sensor": {}}))
    rng = np.random.default_rng(5)
    for _ in range(100):
        plant.exchange(rng.uniform(-20.0, 20.0, 3))
        assert plant.measured.torque.tobytes() == plant.state.gear_torque.tobytes()
        assert plant.measured.current.tobytes() == plant.state.current.tobytes()


def test_drives_on_a_bus_have_every_output(scene: Scene) -> None:
    """In the unit of the output or a thousandth, at each joint, also after a restart."""
    servo_config = load_gains(find_scene("three_axis")).servo
    servo = dataclasses.replace(
        servo_config,
        period=scene.servo_period,
        supply_voltage=scene.supply_voltage,
        joints=tuple(
            dataclasses.replace(
                servo_config.joints[0],
                name=joint.name,
                **make_data_sheet(joint, scene.supply_voltage),
            )
            for joint in scene.joints
        ),
    )
    plant = Plant(scene)
    plant.reset([2.0 * np.pi - 1e-3, 2.001])  # before a turn of the link, and 2 m
    drives = Drives(plant, servo, CANOPEN)
    entries = {(entry.index, entry.sub): entry for entry in drives.entries}
    assert len({find_index(value) for value in KNOWN.values()}) == len(KNOWN), "an object each"
    changed = dict.fromkeys(HERE, 0)
    further = [joint.inputs[1:] for joint in scene.joints]
    for tick in range(160):
        # Both in torque; the brake of the second one closes.
        for j, sign in enumerate((1, -1)):
            drives.set_entry(j, 0x6502, 1 << 9)  # these gains are not for it
            drives.write(j, 0x6060, 10)
            drives.write(j, 0x6071, sign * 1000)
            for further_input in further[j]:
                drives.write_real(j, find_index(further_input), 0.5 * sign)
            drives.write(j, 0x6040, (6, 7, 15)[min(tick, 2)])
        if tick == 140:
            drives.write(1, 0x60FE, 1, 2)
            drives.write(1, 0x60FE, 1, 1)
        drives.period()
        if tick == 150:
            drives.restart_drive(0)
        elif 3 < tick < 140:
            for further_input in further[0]:
                assert getattr(drives.plant.measured, further_input.applied).tolist() == [0.5, -0.5]
        for name, output in HERE.items():
            measured = np.asarray(getattr(drives.plant.measured, name), float)
            index = find_index(output)
            if output.per_unit:
                readings = [drives.read_number(1, index, sub) for sub in range(1, 7)]
                assert readings == measured.astype(np.float32).ravel().tolist(), name
                assert drives.read_number(0, index, 1) == 0.0, "no unit on its link"
                continue
            entry = entries[index, 0]
            assert entry.access == "ro" and entry.tx, name
            is_integer = entry.type != "REAL32"
            times = 1e3 if is_integer and entry.unit.startswith("m") else 1.0
            for j, value in enumerate(times * measured):
                off = abs(drives.read_number(j, index) - value)
                assert off <= (0.5 if is_integer else 1e-7 * abs(value)), f"{name} of joint {j}"
            changed[name] += len(np.unique(measured)) > 1
    same = {name for name, output in HERE.items() if not output.per_unit and not changed[name]}
    assert same <= {"faults"}


def test_drives_refuse_values_that_no_object_can_carry(scene: Scene) -> None:
    """Units beyond those of a link, numbers that are not finite, inputs that a motor has not."""
    rule = "imus must be at most 1 on the link of slide, for drives on a field bus, got 2"
    with pytest.raises(Refusal, match=rule):
        find_places(scene, 1)
    file = find_scene("three_axis")
    drives = Drives(Plant(load_scene(file)), load_gains(file).servo, CANOPEN)
    for input in scene.joints[0].inputs[1:]:
        drives.write_real(0, find_index(input), 0.0)
        for value in (1.0, np.nan, np.inf):
            with pytest.raises(Aborted, match="06090030"):
                drives.write_real(0, find_index(input), value)


def test_tables_of_the_site_have_all_of_them() -> None:
    """As they are generated from what parts declare; each line leads to a page that is there."""
    rows = tables.list_outputs("")
    assert all(f"| `{name}` |" in rows for name in KNOWN)
    rows = tables.list_inputs("")
    assert all(f"| `{input.name}` |" in rows for kind in MOTORS for input in kind.inputs)
    rows = tables.list_sensors("")
    for part in SENSOR_PARTS:
        assert "| `imus` |" in rows if part.owners == "imus" else part.section in rows, part.section
    rows = tables.list_parts("../reference/scene.md")
    for page in re.findall(r"\]\((\S+)\)", rows):
        assert (DOCS / "concepts" / page).is_file(), page
    assert all(f"`{part.section}`" in rows for part in PARTS if part not in MOTORS)
