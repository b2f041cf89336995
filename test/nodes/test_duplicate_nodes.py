"""Two nodes of one kind on the same topics are named on both sides; the first emulator rules."""

import os
import random
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from draws import with_slow
from in_process import in_process
from network import JOINTS, PATIENCE, User, assert_same_bits, network, node, offline_states
from rclpy.serialization import serialize_message
from test_network import go, pause_at

from arm_emulator import load_scene
from arm_emulator.base.io.config_files import find_config
from arm_emulator.ros.node import duplicate_nodes
from arm_emulator.ros.process.bringup import Bringup
from arm_emulator.runs.offline import load_offline_run
from arm_emulator.toolchain.compile_unit import compile_once
from arm_emulator.toolchain.flags import C_FLAGS
from arm_emulator.toolchain.unit import Unit
from arm_emulator_msgs.msg import EmulatorStatus, MotorCommand
from emulator_node.c import FOLDERS, MOTOR_COMMANDS
from emulator_node.command_reader import CommandReader

TICKS = 400


@pytest.fixture(scope="module", params=with_slow([True, False], 1))
def forked(request: pytest.FixtureRequest) -> bool:
    """Nodes that can be started again are not forked."""
    return bool(request.param)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory, forked: bool) -> Path:
    return tmp_path_factory.mktemp("forked" if forked else "started")


@pytest.fixture(scope="module")
def three_nodes(log: Path, forked: bool) -> Iterator[tuple[User, Bringup]]:
    """Paused at first; the first test, which compares bits, may leave another emulator."""
    with network(log, forked=forked) as running:
        yield running


def started(user: User, name: str) -> int:
    """Return when a node was started, as it states itself [ns]."""
    return int(user.wait(f"{name} to state it", lambda: user.value(name, "started [ns]")))


SILENT = "silent until it ends: another emulator was started before on /motor_states, "


@pytest.mark.slow
def test_a_second_emulator_is_named_and_silent_until_the_first_has_ended(
    three_nodes: tuple[User, Bringup], log: Path, forked: bool
) -> None:
    """It comes at a random moment of a run, with another scene, and with another start."""
    rng = random.Random(os.environ.get("SEED", "2"))
    start = rng.choice(["free_run", "first_answer"])
    second = ("-p", "scene:=three_axis", "-p", f"start:={start}", "-r", "__node:=emulator_2")
    user, nodes = three_nodes
    go(user)
    start_at = rng.randint(1, 100)
    user.wait("the run", lambda: user.tick >= start_at)
    # On a busy machine the second may speak before it finds the first; the servo knows better.
    user.machine = started(user, "emulator")
    first = nodes.get_process("emulator")
    with node("emulator_node.node", *second) as second_process:
        user.wait("the silence", lambda: user.printed("emulator_2", SILENT))
        words = user.printed("emulator_2", SILENT)[0]
        assert f"node /emulator on host {os.uname().nodename}, process {first.pid}" in words
        assert user.value("emulator_2", "another emulator").endswith(f"process {first.pid}")
        user.wait("the first to know", lambda: user.value("emulator", "another emulator"))
        named = user.value("emulator", "another emulator")
        assert (
            named == f"node /emulator_2 on host {os.uname().nodename}, process {second_process.pid}"
        )
        tick = user.tick
        user.wait("the run to go on", lambda: user.tick >= tick + TICKS)
        assert not user.printed("servo", "the emulator began anew"), user.words["servo"]
        end = pause_at(user, user.tick)
        # Its states and commands do not mix with others': not a bit has changed.
        run = load_offline_run("three_axis")
        assert_same_bits(user.motor_states(), offline_states(run, end), end)
        printed = (log / "emulator.log").read_text()
        # Once; twice if it had to begin again.
        named = printed.count("another emulator is on /motor_states, started after")
        assert named in (1, 2), printed

        if forked:
            return

        # The first ends; the second begins at tick 0 with the partners that are there.
        user.forget()
        user.machine = started(user, "emulator_2")
        first.send_signal(signal.SIGKILL)
        first.wait(PATIENCE)
        user.forget_listeners("emulator")
        user.wait("its run", lambda: user.tick >= TICKS)
        assert user.printed("servo", "the emulator began anew")
        if start == "first_answer":
            run = load_offline_run("three_axis")
            assert_same_bits(user.motor_states(), offline_states(run, TICKS), TICKS)
        assert user.call("emulator_2/pause", True).success
        user.wait("no more words", lambda: not user.value("emulator_2", "another emulator"))
        nodes.start_node("emulator")  # for the ending; now this one is second
        user.wait("the third to be silent", lambda: user.printed("emulator", SILENT))


def test_two_servos_and_two_motion_controllers_are_named(
    three_nodes: tuple[User, Bringup],
) -> None:
    kinds = {"servo": "servo", "motion_controller": "motion controller"}
    servo, motion = (str(find_config("three_axis", ".yaml", kind)) for kind in ("servo", "motion"))
    user, nodes = three_nodes
    observed: dict[str, set[str]] = {name: set() for name in kinds}

    def named() -> dict[str, set[str]]:
        """Collect the processes that the two nodes of each name have named so far."""
        for name, kind in kinds.items():
            if words := user.value(name, f"another {kind}"):
                observed[name].add(words.rsplit(" ", 1)[1])
        return observed

    with (
        node("servo_node.node", "--params-file", servo) as second_servo,
        node("motion_controller_node.node", "--params-file", motion) as second_motion,
    ):
        expected = {
            "servo": {str(second_servo.pid), str(nodes.get_process("servo").pid)},
            "motion_controller": {
                str(second_motion.pid),
                str(nodes.get_process("motion_controller").pid),
            },
        }
        user.wait("both sides to name the other", lambda: named() == expected)
    for name, kind in kinds.items():
        travelled = f"another {kind}"
        user.wait("it to be gone", lambda n=name, g=travelled: not user.value(n, g))


def test_c_reads_commands_for_this_emulator_alone() -> None:
    """Or for any, with the identity 0; others are left to Python, as -1."""
    parts = ("messages", "message_reader", "motor_commands")
    source = "".join(f'#include "{part}.c"\n' for part in parts)
    unit = Unit("commands_alone", source, C_FLAGS, FOLDERS, (MOTOR_COMMANDS,), "test", "", "m.c")
    code, struct = compile_once(lambda: unit)(), MOTOR_COMMANDS.make_struct("motor_commands")
    reader = CommandReader(load_scene("three_axis"), struct, 0)
    own = duplicate_nodes.get_start_time()
    for machine, read in ((own, 7), (0, 7), (own + 1, -1), (1, -1)):
        command = MotorCommand(tick=7, joint_names=JOINTS, command=[0.0] * 3, machine=machine)
        data = serialize_message(command)
        assert len(data) <= reader.largest
        assert code.motor_commands_read(struct, data, len(data)) == read, machine


def test_a_command_for_another_emulator_is_not_taken() -> None:
    """Seeded identities; 0, of a servo that knows of one emulator only, is taken."""
    rng = random.Random(3)
    with in_process() as nodes:
        emulator = nodes.nodes["emulator"]
        for count in range(1, 9):
            foreign = MotorCommand(
                tick=0, joint_names=JOINTS, command=[0.0] * 3, machine=rng.getrandbits(64) or 1
            )
            nodes.send("motor_commands", foreign)
            counted = emulator._diagnostics.values["motor_commands for another emulator"]
            assert counted == count, "commands that are counted as others'"
        emulator._status.publish_status()
        status = nodes.newest("emulator/status")
        assert status.tick == nodes.newest("motor_states").tick == 0, "the machine has moved"
        assert status.phase == EmulatorStatus.PHASE_WAITING, "for its own command"
        assert status.commands_refused == nodes.refused("emulator") == 0, "they are no fault"
        nodes.send("motor_commands", MotorCommand(tick=0, joint_names=JOINTS, command=[0.0] * 3))
        assert nodes.newest("motor_states").tick == 1, "a command for any emulator is taken"
