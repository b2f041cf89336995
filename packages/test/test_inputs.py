"""Inputs of motors, declared once: commands and further inputs of mixed motors at every door."""

import shutil
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from by_hand import go_on, session_of
from in_process import in_process
from machines import CONFIG
from rclpy.serialization import serialize_message

from arm_emulator import Plant, Refusal, Scene, Session, load_scene
from arm_emulator.cli.commands.check_bag import check_bag
from arm_emulator.machine.plant.core_calls import ARM
from arm_emulator.machine.plant.inputs import list_further_inputs, list_input_units, list_modes
from arm_emulator.machine.plant.outputs import KNOWN
from arm_emulator.machine.scene.known_parts import DECORATORS, MOTORS
from arm_emulator.machine.session.real_time import open_real_time_session
from arm_emulator.toolchain.c_header import read_text
from arm_emulator_fieldbus.converter import COMMANDED, RegisterConverter, list_blocks
from arm_emulator_fleet import Fleet
from arm_emulator_fmu.variables import list_variables
from arm_emulator_msgs.msg import MotorCommand, MotorState

ROTOR = {"rotor_inertia": 1.0e-4}
MOTORS_OF = {
    "waist": {
        "kind": "pmsm", "resistance": 1.0, "inductance_d": 2e-3, "inductance_q": 3e-3,
        "flux": 0.02, "pole_pairs": 4, **ROTOR,
    },
    "shoulder": {"kind": "current", "torque_constant": 0.1, "current_limit": 30.0, **ROTOR},
    "elbow": {"kind": "torque", "torque_limit": 3.0, **ROTOR},
}  # fmt: skip
AMPLITUDE = 48.0 / np.sqrt(3.0)


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The paper's arm with a motor of another kind at each joint."""
    folder = tmp_path_factory.mktemp("mixed")
    shutil.copytree(CONFIG / "urdf", folder / "urdf")
    scene = yaml.safe_load((CONFIG / "three_axis.yaml").read_text())
    for joint, motor in MOTORS_OF.items():
        scene["joints"][joint]["motor"] = motor
    (folder / "three_axis.yaml").write_text(yaml.safe_dump(scene))
    return folder / "three_axis.yaml"


@pytest.fixture(scope="module")
def scene(file: Path) -> Scene:
    return load_scene(file)


def draw_commands(seed: int, rows: int = 30) -> tuple[np.ndarray, np.ndarray]:
    """Commands and voltages along the flux, (rows, 3) each; motors cannot get some of them."""
    rng = np.random.default_rng(seed)
    commands = rng.normal(0.0, 1.0, (rows, 3)) * [25.0, 10.0, 2.0]
    along = rng.normal(0.0, 15.0, (rows, 3)) * [1.0, 0.0, 0.0]
    return commands, along


def test_every_declared_input_is_complete() -> None:
    """A command first, in a mode of arm.h; of further ones what a motor got is an output."""
    declared = [kind.inputs for kind in MOTORS] + [kind.inputs for kind in DECORATORS]
    for inputs in declared:
        for k, declared_input in enumerate(inputs):
            assert declared_input.about and declared_input.unit in ("V", "N m", "A"), declared_input
            assert (declared_input.name == "command") == (k == 0), declared_input
            if k == 0:
                ARM.get_constant(declared_input.mode)
            else:
                assert declared_input.applied in KNOWN, declared_input


def test_the_core_describes_them(scene: Scene) -> None:
    plant = Plant(scene)
    described = ARM.make_struct("arm_description")
    plant.core.arm_describe(described)
    assert described.inputs == 1 and list_further_inputs(scene) == ("command_d",)
    assert list_input_units(scene, "command_d") == ("V", "V", "V")
    descriptions = []
    for j, mode in enumerate(list_modes(scene)):
        reading, joint = ARM.make_struct("arm_reading"), ARM.make_struct("arm_joint_description")
        assert plant.core.arm_describe_input(0, j, reading) == 0
        plant.core.arm_describe_joint(j, joint)
        assert joint.modes == mode
        descriptions.append((reading.present, read_text(reading.name), read_text(reading.unit)))
    assert descriptions == [(1, "command_d", "V"), (0, "command_d", ""), (0, "command_d", "")]
    assert plant.core.arm_describe_input(1, 0, reading) and plant.core.arm_describe_input(
        0, 3, reading
    )


def by_plant(scene: Scene, seed: int) -> Plant:
    """A plant after commands, against what motors could get."""
    plant = Plant(scene)
    for command, along in zip(*draw_commands(seed), strict=True):
        plant.exchange(command, command_d=along)
        measured = plant.measured
        d = float(np.clip(along[0], -AMPLITUDE, AMPLITUDE))
        left = np.sqrt(max(AMPLITUDE**2 - d**2, 0.0))
        limits = np.array([left, 30.0, 3.0])
        assert measured.applied == pytest.approx(np.clip(command, -limits, limits), abs=1e-4)
        assert measured.applied_d == pytest.approx([d, 0.0, 0.0], abs=1e-12)
    return plant


def by_fleet(scene: Scene, seed: int) -> Plant:
    fleet = Fleet(scene, 3)
    for command, along in zip(*draw_commands(seed), strict=True):
        fleet.exchange(command, command_d=np.array([along, 0.5 * along, along]))
    assert fleet.measured.applied_d[:, 0].tolist() == [
        fleet[k].measured.applied_d[0] for k in range(3)
    ]
    assert fleet[1].save() != fleet[0].save()
    return fleet[0]


def by_session(scene: Scene, seed: int) -> Plant:
    """In another order of joints, named."""
    session = Session(scene, "lockstep", "first_answer")
    names = list(scene.joint_names)[::-1]
    for tick, (command, along) in enumerate(zip(*draw_commands(seed), strict=True)):
        session.offer(tick, names, command[::-1].tolist(), {"command_d": along[::-1].tolist()})
        session.advance()
    return session.plant


def by_real_time(scene: Scene, seed: int) -> Plant:
    """In the loop of the core; each command is given while it stands."""
    session = open_real_time_session(scene, "paused")
    plant, names = session.plant, scene.joint_names
    for tick, (command, along) in enumerate(zip(*draw_commands(seed), strict=True)):
        session.offer(tick, names, command.tolist(), {"command_d": along.tolist()})
        session.advance()
    del plant
    session.close()
    return session.plant


DOORS = [by_fleet, by_session, by_real_time]


@pytest.mark.parametrize("door", DOORS)
def test_a_machine_moves_alike_at_each_door(
    door: Callable[[Scene, int], Plant], scene: Scene
) -> None:
    expected, plant = by_plant(scene, 1), door(scene, 1)
    ticks = len(draw_commands(1)[0])
    assert plant.t == pytest.approx(ticks * scene.servo_period)
    for name in ("q", "current", "omega_m"):
        np.testing.assert_array_equal(getattr(plant.state, name), getattr(expected.state, name))
    assert plant.measured.applied_d.tolist() == expected.measured.applied_d.tolist()


def test_the_real_time_loop_holds_them(scene: Scene) -> None:
    """It reports what the motors got in each of its periods."""
    session = open_real_time_session(scene, "first_answer")
    session.offer(0, scene.joint_names, [3.0, 1.0, 0.1], {"command_d": [2.0, 0.0, 0.0]})
    applied = []
    while len(applied) < 5:
        session.wait(1.0)
        while session.take():
            applied.append(session.measured.applied_d.tolist())
    session.close()
    assert applied == [[2.0, 0.0, 0.0]] * len(applied)


@pytest.mark.parametrize("clock", ["lockstep", "realtime"])
def test_over_ros_and_repeated_from_its_bag(
    clock: str, file: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """A controller of one's own answers each state, with joints and inputs by name."""
    with in_process(clock, file=file) as inside:
        rows = draw_commands(2, 300)

        def answer(state: MotorState) -> None:
            command, along = (row[state.tick % 300] for row in rows)
            names = list(state.joint_names)[::-1]
            inputs = {"input_names": ["command_d"], "inputs": along[::-1].tolist()}
            message = MotorCommand(tick=state.tick, joint_names=names, **inputs)
            message.command = command[::-1].tolist()
            inside.send("motor_commands", message)
            assert inside._wires.record is not None
            inside._wires.record.append(
                ("motor_commands", MotorCommand, serialize_message(message))
            )

        heard = inside._heard
        inside.listen_alone("motor_states", MotorState, answer)
        inside._wires.listeners["motor_states"].append(heard)
        inside.begin_record()
        assert inside.call("emulator/reset").success
        go_on(inside, 100, inside.nodes["emulator"]._status.publish_status)
        state = inside.newest("motor_states")
        assert inside.refused("emulator") == 0
        assert list(state.reading_names) == ["current_d", "applied_d"]
        assert 0.0 < abs(state.readings[3]) <= AMPLITUDE + 1e-9
        along = session_of(inside).measured.applied_d
        if clock == "lockstep":
            expected = rows[1][(state.tick - 1) % 300]
            assert along == pytest.approx(np.clip(expected, -AMPLITUDE, AMPLITUDE))
        inside.write(tmp_path / "bag")
    code, words = check_bag(tmp_path / "bag", scene=str(file)), capfd.readouterr().out
    assert code == 0 and "equal to the last bit" in words, words
    assert "applied_d" in words and "motor_commands (command, command_d)" in words, words


@pytest.mark.parametrize(
    ("names", "values", "words"),
    [
        (["command_d"], [1.0], "inputs must have 3 values, one per joint name for each of"),
        (["command_d"] * 2, [0.0] * 6, "input_names must name each input once"),
        (["ud"], [0.0] * 3, "inputs must be a further input of three_axis, got ud; valid: comm"),
        (["command_d"], [1.0, 2.0, 0.0], "command_d of shoulder must be 0, its motor has no such"),
        (["command_d"], [np.nan, 0.0, 0.0], "command_d of waist must be finite, got nan"),
        (["command_d"], [1e10, 0.0, 0.0], "command_d of waist must be a number within"),
    ],
)
def test_an_input_that_no_motor_has_is_refused(
    names: list[str], values: list[float], words: str, file: Path, capfd: Any
) -> None:
    with in_process(file=file) as inside:
        session = session_of(inside)
        tick, before = session.tick, session.plant.save()
        message = MotorCommand(tick=tick, joint_names=list(session.scene.joint_names))
        message.command, message.input_names, message.inputs = [0.0] * 3, names, values
        inside.send("motor_commands", message)
        assert inside.refused("emulator") == 1 and session.plant.save() == before
        inside.timers()
        assert words in str(inside.newest("diagnostics")), inside.newest("diagnostics")


def test_a_plant_refuses_alike(scene: Scene) -> None:
    plant = Plant(scene)
    before = plant.save()
    for arguments, words in (
        ({"ud": [0.0] * 3}, "must be a further input of three_axis, got ud; valid: command_d"),
        ({"command_d": [0.0, 0.0, 1.0]}, "command_d of elbow must be 0"),
        ({"command_d": [0.0, 0.0]}, "must have"),
    ):
        with pytest.raises(Refusal, match=words):
            plant.exchange(np.zeros(3), **arguments)
        with pytest.raises(Refusal, match=words):
            Fleet(scene, 2).exchange(np.zeros(3), **arguments)
    entries = ARM.make_rows("arm_joint_command", 3)
    entries["mode"], entries["enable"] = list_modes(scene), 1
    rows = np.array([[0.0, 5.0, 0.0]])
    command = ARM.make_struct("arm_command", tick=-1, joint=entries, further=rows)
    assert plant.core.arm_exchange(plant.machine, command, plant.measurement) == 1
    why = ARM.make_struct("arm_refusal")
    plant.core.arm_why(plant.machine, why)
    assert (why.joint, read_text(why.quantity), why.got) == (1, "command_d", 5.0)
    assert plant.save() == before


def test_registers_have_them_behind_the_commands(scene: Scene) -> None:
    session = Session(scene, "lockstep", "first_answer")
    converter, N = RegisterConverter(session, 0), len(scene.joints)
    rows = {block.name: block for block in list_blocks(scene) if block.writable}
    assert (rows["command_d"].address, rows["command_d"].count) == (COMMANDED + 1 + N, N)
    words = [8192, -4096, 16384, -8192, 0, 0]
    raw = [struct.unpack(">H", struct.pack(">h", word))[0] for word in words]
    converter.write(COMMANDED + 1, raw)
    assert list(converter.read(COMMANDED + 1, 2 * N)) == raw
    converter.answer_tick()
    plant = Plant(scene)
    command, along = np.reshape(words, (2, N)) / 32768 * [AMPLITUDE, 30.0, 3.0]
    plant.exchange(command, 0, command_d=along)
    assert session.plant.state.q.tolist() == plant.state.q.tolist()
    assert session.measured.applied_d.tolist() == plant.measured.applied_d.tolist()


def test_units_of_fmus_have_them(scene: Scene) -> None:
    """`test_fmu.py` sets them and compares the motion bit by bit."""
    by_name = {variable.name: variable for variable in list_variables(scene)}
    command, further = by_name[("command",)], by_name[("command_d",)]
    assert command.units == ("V", "A", "N m") and further.units == ("V", "V", "V")
    assert further.role == "input" and "along each rotor's flux" in further.description
    assert by_name[("applied_d",)].role == "output"
