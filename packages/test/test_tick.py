"""A servo period of the machine is implemented once: the same fault ends alike at every door."""

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import pytest
from documents import ROOT

from arm_emulator import Breakpoint, Diverged, Plant, Refusal, Session, load_gains, load_scene
from arm_emulator.base.io.config_files import find_scene
from arm_emulator.machine.session.control_code import ControlCode
from arm_emulator.machine.session.firmware_loop import FirmwareLoop
from arm_emulator.machine.session.real_time import RealTimeLoop
from arm_emulator.tick.c import FIRMWARE_CONTROLLER
from arm_emulator.toolchain.c_header import NULL, CData
from arm_emulator_fieldbus.drives import Drives
from arm_emulator_fieldbus.drives_unit import ETHERCAT

ROOMS = (
    "arm_emulator", "bench", "emulator_node", "motion_controller_node", "oracles", "packages",
    "servo_node",
)  # fmt: skip
IN_C = (".c", ".h", ".cpp", ".hpp")
CALL = re.compile(r"\barm_exchange\s*\(|->\s*exchange\s*\(|\bexchange_\s*\(")
FAULTS = {"command_late": 2.0, "command_lost": 0.5}  # of a line; they are off at first
SCENE = load_scene("three_axis", overrides={"faults": [f"elbow.{fault}" for fault in FAULTS]})
N = len(SCENE.joints)


def sources(*ends: str) -> Iterator[tuple[str, str]]:
    """Yield files and their text without comments; core/boundary, which defines it, is left out."""
    for room in ROOMS:
        for file in sorted((ROOT / room).rglob("*")):
            name = file.relative_to(ROOT).as_posix()
            if "/test/" in name or name.startswith("arm_emulator/core/boundary/"):
                continue
            if file.suffix in ends:
                text = file.read_text(encoding="utf-8")
                yield name, re.sub(r"/\*.*?\*/|//[^\n]*|#[^\n]*", "", text, flags=re.S)


def test_only_the_tick_layer_exchanges() -> None:
    callers = {name for name, text in sources(*IN_C) if CALL.search(text)}
    assert callers == {"arm_emulator/tick/c/tick.c"}, "who calls it"
    named = {name for name, text in sources(*IN_C, ".py") if re.search(r"\barm_exchange\b", text)}
    assert named == {
        "packages/arm_emulator_fmu/arm_emulator_fmu/machine.hpp",
        "arm_emulator/machine/plant/plant.py",
        "packages/arm_emulator_hardware/src/driven_machine.cpp",
    }, "who gives it to a tick_machine"


class Constant(ControlCode):
    """Control code that gives the same commands (N,) in every period."""

    name = "constant"

    def __init__(self, command: np.ndarray) -> None:
        def step(with_: CData, reading: CData, out: CData) -> None:
            for joint, value in enumerate(command):
                out.joint[joint].value = value

        kind = "void(void*, firmware_input*, firmware_output*)"
        self.step, self.with_ = FIRMWARE_CONTROLLER.ffi.callback(kind, step), NULL


@dataclass
class Door:
    """A plant, and what takes it through so many periods under commands; it is kept in `owner`."""

    plant: Plant
    go: Callable[[int], None]
    owner: object = None

    @property
    def tick(self) -> int:
        return int(self.plant.ticks.tick)


def by_call(command: np.ndarray) -> Door:
    plant = Plant(SCENE)

    def go(ticks: int) -> None:
        for _ in range(ticks):
            plant.exchange(command, int(plant.ticks.tick))

    return Door(plant, go)


def by_hand(command: np.ndarray) -> Door:
    session = Session(SCENE, "lockstep", "first_answer")

    def go(ticks: int) -> None:
        for _ in range(ticks):
            session.advance_under(command, session.tick)

    return Door(session.plant, go, session)


def by_control_code(command: np.ndarray) -> Door:
    session, code = Session(SCENE, "lockstep", "first_answer"), Constant(command)
    loop = FirmwareLoop(session.plant, code)
    return Door(session.plant, lambda ticks: session.advance_in(loop, ticks), (code, session))


def by_drives(command: np.ndarray) -> Door:
    """A field bus without a master: its drives are not enabled, and their commands are 0."""
    drives = Drives(Plant(SCENE), load_gains(find_scene("three_axis")).servo, ETHERCAT)
    return Door(drives.plant, drives.period, drives)


def by_clock(command: np.ndarray) -> Door:
    """Real time, which a breakpoint ends."""
    plant = Plant(SCENE)
    loop = RealTimeLoop(plant, 1_000_000, -1)

    def go(ticks: int) -> None:
        end = Breakpoint(plant, f"tick > {plant.ticks.tick + ticks - 1}")
        own = plant.ticks.stop or end.stop
        plant.ticks.stop = own
        loop.hold_command(-1, command)
        loop.start_time(plant.ticks.tick)
        reached, fault = plant.ticks.tick, -1
        while not own[0] and fault < 0 and loop.wait_for_tick(1.0):
            while (result := loop.take_tick()) is not None:
                reached, fault = result.tick, result.fault
        loop.stop_time()
        while (result := loop.take_tick()) is not None:
            reached = result.tick
        plant.ticks.tick = reached
        end.close()
        if own == end.stop:
            plant.ticks.stop = NULL

    return Door(plant, go, loop)


ALL = (by_call, by_hand, by_control_code, by_drives, by_clock)
LOOPS = (by_control_code, by_drives, by_clock)
UNCHECKED = (by_call, by_hand, by_control_code)  # commands that are not checked before


@pytest.mark.parametrize("door", LOOPS)
def test_a_breakpoint_ends_every_loop_at_its_tick(door: Callable[[np.ndarray], Door]) -> None:
    loop = door(np.zeros(N))
    stop = Breakpoint(loop.plant, "tick > 3")
    loop.plant.ticks.stop = stop.stop
    loop.go(100)
    assert (loop.tick, stop.tick, stop.take_hit()) == (4, 4, True)
    loop.plant.ticks.stop = NULL
    stop.close()


@pytest.mark.parametrize("door", UNCHECKED)
def test_a_refused_command_changes_nothing(door: Callable[[np.ndarray], Door]) -> None:
    command = np.zeros(N)
    loop = door(command)
    loop.go(3)
    before = loop.plant.save()
    command[1] = np.nan
    with pytest.raises(Refusal) as no:
        loop.go(2)
    assert (no.value.quantity, no.value.rule) == ("command of shoulder", "be finite")
    assert loop.tick == 3 and loop.plant.save() == before
    command[1] = 1.0
    loop.go(1)
    assert loop.tick == 4, "the next one is taken"


@pytest.mark.parametrize("door", (by_hand, by_control_code, by_clock))
@pytest.mark.parametrize("fault", FAULTS)
def test_a_line_loses_and_delays_the_same_commands(
    door: Callable[[np.ndarray], Door], fault: str
) -> None:
    first, second, plain = (make(np.full(N, 4.0)) for make in (door, by_call, by_call))
    plain.go(30)
    for each in (first, second):
        each.plant.set_parameter(f"faults.elbow.{fault}", FAULTS[fault])
        each.go(30)
    assert first.tick == second.tick == 30
    np.testing.assert_array_equal(first.plant.state.q, second.plant.state.q)
    assert (first.plant.state.q != plain.plant.state.q).any(), "the fault does nothing"


@pytest.mark.parametrize("door", ALL)
def test_without_power_commands_are_0(door: Callable[[np.ndarray], Door]) -> None:
    first, second = door(np.full(N, 6.0)), by_call(np.zeros(N))
    for each in (first, second):
        each.plant.powered = False
        each.go(20)
    assert first.tick == second.tick == 20
    for name in ("q", "v", "current"):
        np.testing.assert_array_equal(
            getattr(first.plant.state, name), getattr(second.plant.state, name), err_msg=name
        )
    np.testing.assert_array_equal(first.plant.measured.applied, np.zeros(N))


@pytest.mark.parametrize("door", ALL)
def test_a_diverged_machine_stays_at_its_tick(door: Callable[[np.ndarray], Door]) -> None:
    loop = door(np.zeros(N))
    loop.plant.put("test", {"v": np.full(N, 0.9 * loop.plant.bounds["v"].most)})
    try:
        loop.go(50)
    except Diverged:
        pass
    diverged = loop.plant.diverged
    assert diverged is not None
    assert loop.tick == round(loop.plant.state.t / SCENE.servo_period), diverged
