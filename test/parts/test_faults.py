"""Faults: named changes of a machine's numbers, exact to the tick, at every door alike."""

import runpy
from pathlib import Path

import numpy as np
import pytest
from documents import DOCS, page_of
from draws import FULL
from faulty_machine import everything
from made_bags import EmulatorBag

from arm_emulator import Plant, Refusal, Scene, Session
from arm_emulator.bags.comparison import compare_bag
from arm_emulator.machine.faults.known import FAULTS
from arm_emulator.machine.faults.scene_faults import SceneFault
from arm_emulator.machine.parts.measuring.sensors import ANALOG
from arm_emulator.machine.plant.outputs import KNOWN
from arm_emulator.machine.plant.scene_unit import write_scene_unit
from arm_emulator.machine.scene.fault_catalogue import list_variable_numbers
from arm_emulator.ros.recording.bag_writer import BagWriter
from arm_emulator_fleet import Fleet
from arm_emulator_msgs.msg import MachineEvent, MotorCommand, MotorState

BEGIN, END = 12, 72  # of faults and of the motion [servo periods]
Begun = tuple[Plant, bytes, list[bytes]]


def make_scene(folder: Path) -> Scene:
    """The machine with every fault, and every number varied that they change."""
    # The link that carries the payload has its mass's numbers from there.
    plain = everything(folder, faults=[])
    faults = [fault for fault in plain.possible_faults if fault.name != "wrist_link.mass_at_joint"]
    possible = [
        number.name for number in list_variable_numbers(plain.joints, plain.chain, plain.imus)
    ]
    changed = {change.number for fault in faults for change in fault.changes}
    return everything(
        folder,
        faults=[fault.name for fault in faults],
        varied=[*sorted(changed.intersection(possible)), "payload.mass"],
    )


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return make_scene(tmp_path_factory.mktemp("everything"))


# As torques some V or A are a lot for the wrist.
SIZES = {"shoulder": 15.0, "elbow": 10.0, "wrist": 1.0}


def sizes_of(scene: Scene) -> np.ndarray:
    return np.array([SIZES.get(name, 0.0) for name in scene.joint_names])


def commands_at(scene: Scene, tick: int) -> np.ndarray:
    return sizes_of(scene) * np.sin(0.3 * tick + np.arange(len(scene.joints)))


def drive(plant: Plant, ticks: range) -> list[bytes]:
    """Go on under commands that are a function of the tick, the power cut on the way."""
    observed = []
    for tick in ticks:
        plant.powered = tick % 40 < 25
        plant.exchange(commands_at(plant.scene, tick), tick)
        measured = plant.measured
        rows = [getattr(measured, name) for name in KNOWN]
        rows += [plant.state.q, plant.state.v, plant.state.current, plant.winding_temperatures]
        observed.append(b"".join(np.ascontiguousarray(row).tobytes() for row in rows))
    return observed


def magnitude_of(fault: SceneFault) -> float:
    return float(fault.varied.number.default)


@pytest.fixture(scope="module")
def begun(scene: Scene) -> tuple[Plant, bytes, list[bytes]]:
    """A machine, saved on its way, and what is seen from there on without a fault."""
    plant = Plant(scene)
    drive(plant, range(BEGIN))
    saved = plant.save()
    return plant, saved, drive(plant, range(BEGIN, END))


def test_a_scene_without_faults_has_the_same_unit(tmp_path: Path) -> None:
    text = write_scene_unit(everything(tmp_path, faults=[]))
    assert "faults" not in text and "parameters = 0" in text


def test_a_fault_that_a_scene_cannot_have_is_refused(tmp_path: Path) -> None:
    for name in ("elbow.backlash_grows", "nobody.gear_breaks", "gear_breaks", 3, "*.none"):
        with pytest.raises(Refusal, match=r"faults must name faults that this scene can have"):
            everything(tmp_path, faults=[name])
    with pytest.raises(Refusal, match=r"payload_[a-z]+ and wrist_link\.mass_at_joint"):
        everything(tmp_path, faults=["payload_drops", "wrist_link.mass_at_joint"])


@pytest.mark.slow
def test_off_is_as_without_it(tmp_path: Path, scene: Scene, begun: Begun) -> None:
    """Against numbers that are constants: rounding alone differs."""
    plant, second = Plant(everything(tmp_path, faults=[])), Plant(scene)
    for ticks in (range(BEGIN), range(BEGIN, END)):
        drive(plant, ticks), drive(second, ticks)
        np.testing.assert_allclose(plant.state.q, second.state.q, rtol=0.0, atol=1e-12)
        np.testing.assert_allclose(plant.state.v, second.state.v, rtol=0.0, atol=1e-9)
        np.testing.assert_array_equal(plant.measured.encoder_counts, second.measured.encoder_counts)


def test_every_fault_acts_from_its_tick_on_and_is_saved(begun: Begun, scene: Scene) -> None:
    plant, saved, without = begun
    second, acting = Plant(scene), set()
    for fault in scene.faults:
        if fault.kind.name in acting and not FULL:
            continue  # at another joint
        plant.restore(saved)
        plant.set_parameter(fault.varied.name, magnitude_of(fault))
        middle = (BEGIN + END) // 2
        observed = drive(plant, range(BEGIN, middle))
        second.restore(plant.save())
        assert second.parameters[fault.varied.name] == magnitude_of(fault), fault.name
        rest = drive(plant, range(middle, END))
        assert drive(second, range(middle, END)) == rest, f"{fault.name}: restored in the middle"
        if observed + rest != without:
            acting.add(fault.kind.name)
        plant.restore(saved)
        plant.set_parameter(fault.varied.name, magnitude_of(fault))
        plant.set_parameter(fault.varied.name, 0.0)
        assert drive(plant, range(BEGIN, END)) == without, f"{fault.name}: on and off at one tick"
    assert {fault.name for fault in FAULTS} == acting, "kinds that change nothing of this motion"


def test_a_fault_is_the_numbers_that_its_kind_states(begun: Begun, scene: Scene) -> None:
    plant, saved, _ = begun
    numbers, compared = {number.name: number.number for number in scene.varied}, set()
    for fault in scene.faults:
        m, by_hand = magnitude_of(fault), {}
        for change in fault.changes:
            value = eval(change.expression.format(x=repr(change.value), m=repr(m)))
            if change.number in numbers and numbers[change.number].is_in_range(value):
                by_hand[change.number] = value
        if fault.kind.name in compared and not FULL:
            continue  # at another joint
        if len(by_hand) < len(fault.changes):
            continue  # a number that the scene leaves out, or nothing is left of it
        compared.add(fault.kind.name)
        plant.restore(saved)
        plant.set_parameter(fault.varied.name, m)
        expected = drive(plant, range(BEGIN, END))
        plant.restore(saved)
        for name, value in by_hand.items():
            plant.set_parameter(name, value)
        assert drive(plant, range(BEGIN, END)) == expected, fault.name
    assert len(compared) > 30, compared


def test_a_stuck_output_keeps_its_value(begun: Begun, scene: Scene) -> None:
    """Readings are those of the tick before, truth goes on, and off lets them catch up."""
    plant, saved, _ = begun
    plant.restore(saved)
    before, stuck = plant.measured, [fault for fault in scene.faults if "_stuck" in fault.name]
    assert len(stuck) >= 3 * 4 + 2, "encoders and sensors of three joints, a unit"
    for part in stuck:
        plant.set_parameter(part.varied.name, 1.0)
    fields = [
        "encoder_counts", "link_encoder_counts", "current", "specific_force", "angular_rate",
        *(part.outputs[0].name for part in ANALOG if part.outputs),
    ]  # fmt: skip
    for tick in range(BEGIN, BEGIN + 20):
        drive(plant, range(tick, tick + 1))
        for name in fields:
            holding = getattr(plant.measured, name)
            np.testing.assert_array_equal(holding, getattr(before, name), err_msg=name)
    for part in stuck:
        plant.set_parameter(part.varied.name, 0.0)
    second = Plant(scene)
    second.restore(saved)
    drive(second, range(BEGIN, BEGIN + 21)), drive(plant, range(BEGIN + 20, BEGIN + 21))
    for name in fields:
        caught_up, expected = getattr(plant.measured, name), getattr(second.measured, name)
        np.testing.assert_array_equal(caught_up, expected, err_msg=name)
    assert (plant.measured.encoder_counts != before.encoder_counts).all(), "it was moving"


@pytest.mark.skipif(not FULL, reason="lanes over all these parts compile for 40 s")
def test_faults_in_a_fleet_are_those_of_machines_alone(scene: Scene) -> None:
    fleet, plant = Fleet(scene, len(scene.faults)), Plant(scene)
    for tick in range(END):
        if tick == BEGIN:
            for arm, fault in enumerate(scene.faults):
                fleet.set_parameter(fault.varied.name, magnitude_of(fault), arms=[arm])
        fleet.powered = tick % 40 < 25
        fleet.exchange(np.tile(commands_at(scene, tick), (len(fleet), 1)), tick)
    for arm, fault in enumerate(scene.faults):
        plant.reset()
        drive(plant, range(BEGIN))
        plant.set_parameter(fault.varied.name, magnitude_of(fault))
        drive(plant, range(BEGIN, END))
        plant.set_parameter(fault.varied.name, 0.0)
        np.testing.assert_array_equal(fleet[arm].state.q, plant.state.q, err_msg=fault.name)


def test_the_table_of_the_page_has_all_kinds() -> None:
    assert "<!-- generated: faults -->\n" in page_of("faults").read_text()
    table = runpy.run_path(str(DOCS / "tables.py"))["list_faults"]("")
    rows = {line.split("`")[1]: line for line in table.splitlines()[2:]}
    assert rows.keys() == {fault.name for fault in FAULTS}
    assert rows["gear_softens"] == (
        "| `gear_softens` | joint | the gear's stiffness falls | 0.5, from 0 to 0.999 | "
        "`gear.stiffness`: `x * (1.0 - m)` |"
    )


# Random faults in recorded runs: `check-bag` drives each again to equal bits.


RUNS, TICKS = (400, 60) if FULL else ((len(FAULTS) + 1) // 2, 40)  # two kinds in a run
KINDS = {
    "/motor_states": MotorState,
    "/motor_commands": MotorCommand,
    "/emulator/events": MachineEvent,
}


def every_kind_first(session: Session, rng: np.random.Generator) -> list[int]:
    """The scene's faults in a random order, but one of each kind before all others."""
    kinds = [fault.kind.name for fault in session.scene.faults]
    order: list[int] = rng.permutation(len(kinds)).tolist()
    first = {kinds[place]: place for place in order}.values()
    return [*first, *(place for place in order if place not in first)]


def record(folder: Path, session: Session, rng: np.random.Generator) -> set[str]:
    """Write runs with two faults each, one of which ends; return the kinds of faults."""
    names, observed = list(session.scene.joint_names), set()
    order = every_kind_first(session, rng)
    fresh = session.plant.save()
    with BagWriter(folder) as writer:
        bag = EmulatorBag(writer, session, KINDS)
        for run in range(RUNS):
            session.reset()
            session.restore(fresh)
            faults = [session.scene.faults[order[(2 * run + k) % len(order)]] for k in range(2)]
            begins, ends = sorted(rng.integers(1, TICKS, 2))
            bag.report(run + 1)
            number = 0
            for tick in range(TICKS):
                for when, (fault, size) in ((begins, (faults[0], 1.0)), (begins, (faults[1], 0.7)),
                                          (ends, (faults[0], 0.0))):  # fmt: skip
                    if tick == when:
                        session.set_varied(fault.varied.name, size * fault.varied.number.default)
                        observed.add(fault.kind.name)
                        number += 1
                        bag.event(run + 1, number, MachineEvent.KIND_SET_VARIED)
                command = (sizes_of(session.scene) * rng.uniform(-1.0, 1.0, len(names))).tolist()
                bag.command(tick, command, input_names=["command_d"], inputs=[0.0] * len(names))
                session.offer(tick, names, command)
                session.advance()
                bag.report(run + 1)
    return observed


@pytest.mark.slow
def test_random_faults_are_repeated_to_equal_bits(tmp_path: Path) -> None:
    file = tmp_path / "scene"
    file.mkdir()
    session = Session(make_scene(file), "lockstep", "first_answer")
    observed = record(tmp_path / "bag", session, np.random.default_rng(5))
    result = compare_bag(tmp_path / "bag", str(file / "scene.yaml"))
    assert result.difference is None, result.difference
    assert result.tally.states == RUNS * (TICKS + 1) and result.tally.changes == 3 * RUNS
    assert observed == {fault.kind.name for fault in session.scene.faults}, "every kind"
