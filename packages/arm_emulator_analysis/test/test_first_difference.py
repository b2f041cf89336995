"""Differences planted into one of two runs are found: tick, quantity, and joint."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from draws import FULL, some
from made_bags import EmulatorBag
from sensor_msgs.msg import JointState

from arm_emulator import PlantState, Session
from arm_emulator.bags.comparison import compare_bag
from arm_emulator.bags.recorded_machine import RecordedMachine
from arm_emulator.cli.command_line import main
from arm_emulator.machine.plant import compiler
from arm_emulator.machine.plant.build_facts import build_facts
from arm_emulator.ros.recording.bag_writer import BagWriter
from arm_emulator_analysis.first_difference import FirstDifference, find_first_difference
from arm_emulator_msgs.msg import MachineEvent, MotorState

ROOT = Path(__file__).resolve().parents[3]
TICKS = 60
KINDS = {
    "/motor_states": MotorState,
    "/emulator/joint_states": JointState,
    "/emulator/events": MachineEvent,
    "/diagnostics": DiagnosticArray,
}
VARIED = "joints.elbow.friction.viscous"
Plant = Callable[[Session, int], None]
States = list[PlantState]


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The shipped arm, with a number that varies."""
    folder = tmp_path_factory.mktemp("scene")
    shutil.copytree(ROOT / "config" / "urdf", folder / "urdf")
    data = yaml.safe_load((ROOT / "config" / "three_axis.yaml").read_text())
    file = folder / "three_axis.yaml"
    file.write_text(yaml.safe_dump(data | {"varied": [VARIED]}, sort_keys=False))
    return file


def record(
    folder: Path,
    scene: Path,
    *,
    unseen: Plant = lambda session, tick: None,
    command: Callable[[int, np.ndarray], np.ndarray] = lambda tick, row: row,
    number: Callable[[int], float | None] = lambda tick: None,
    power: Callable[[int], bool] = lambda tick: True,
    truths: bool = True,
) -> States:
    """Write a run as the emulator does; return the true states.

    Args:
        folder: the bag.
        scene: the machine.
        unseen: changes the machine without a record, after a tick was reported.
        command: changes the commands that answer a tick.
        number: new value of the varied number after a tick, with a record; None: none.
        power: whether the drives have power after a tick, with a record of changes.
        truths: whether the true joint states are recorded.
    """
    session = Session(str(scene), "lockstep", "first_answer")
    names = list(session.scene.joint_names)
    rng, events, states = np.random.default_rng(4), 0, []
    with BagWriter(folder) as writer:
        bag = EmulatorBag(writer, session, KINDS)

        def report() -> None:
            now = session.state
            states.append(now)
            bag.report(machine=1)
            if truths:
                bag.send("/emulator/joint_states", name=names, position=now.q.tolist(),
                         velocity=now.v.tolist(), effort=now.gear_torque.tolist())  # fmt: skip

        def event(kind: int) -> None:
            nonlocal events
            events += 1
            bag.event(1, events, kind)

        build = [KeyValue(key=key, value=fact) for key, fact in build_facts(session.plant).items()]
        bag.send("/diagnostics", status=[DiagnosticStatus(name="emulator", values=build)])
        report()
        for tick in range(TICKS):
            unseen(session, tick)
            if (value := number(tick)) is not None:
                session.set_varied(VARIED, value)
                event(MachineEvent.KIND_SET_VARIED)
            if power(tick) != session.powered:
                session.powered = power(tick)
                event(MachineEvent.KIND_POWER)
            session.offer(tick, names, command(tick, rng.uniform(-5.0, 5.0, 3)).tolist())
            session.advance()
            report()
    return states


def difference_between(first: Path, second: Path, scene: Path) -> FirstDifference:
    difference, _ = find_first_difference(
        *(RecordedMachine.open_run(bag, str(scene)) for bag in (first, second))
    )
    assert difference is not None
    return difference


@pytest.fixture(scope="module")
def plain(scene: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, States]:
    folder = tmp_path_factory.mktemp("plain") / "bag"
    return folder, record(folder, scene)


def test_equal_runs_are_equal(plain: tuple[Path, States], scene: Path, tmp_path: Path) -> None:
    record(tmp_path / "again", scene)
    sides = (RecordedMachine.open_run(bag, str(scene), 1) for bag in (plain[0], tmp_path / "again"))
    assert find_first_difference(*sides) == (None, TICKS + 1)


@pytest.mark.parametrize("seed", some(range(20), 5))
def test_a_bit_of_the_state(
    seed: int, plain: tuple[Path, States], scene: Path, tmp_path: Path
) -> None:
    rng = np.random.default_rng(seed)
    quantity = ("q", "v", "theta_m", "omega_m", "current")[seed % 5]
    when, joint = int(rng.integers(1, TICKS - 1)), int(rng.integers(3))
    bit = np.int64(1) << np.int64(rng.integers(10, 45))  # a lower one may be lost in rounding

    def flip(session: Session, tick: int) -> None:
        if tick == when:
            row = getattr(session.state, quantity).copy()
            row.view(np.int64)[joint] ^= bit
            session.set_state(session.scene.joint_names, {quantity: row.tolist()})

    states = record(tmp_path / "bag", scene, unseen=flip)
    difference = difference_between(plain[0], tmp_path / "bag", scene)
    shows = [k for k in range(TICKS + 1) if any(
        getattr(states[k], name).tobytes() != getattr(plain[1][k], name).tobytes()
        for name in ("q", "v", "gear_torque", "current"))]  # fmt: skip
    assert shows[0] == when + 1, "the planted bit shows at once"
    assert (difference.kind, difference.tick) == ("state", when + 1)
    name = {"true position": "q", "true velocity": "v", "true effort": "gear_torque"}.get(
        difference.quantity, difference.quantity
    )
    place = list(("waist", "shoulder", "elbow")).index(difference.owner)
    pair = getattr(plain[1][when + 1], name)[place], getattr(states[when + 1], name)[place]
    assert difference.values == pair and pair[0] != pair[1]


@pytest.mark.parametrize("seed", some(range(18), 3))
def test_a_bit_of_a_command(
    seed: int, plain: tuple[Path, States], scene: Path, tmp_path: Path
) -> None:
    rng = np.random.default_rng(100 + seed)
    when, joint = int(rng.integers(0, TICKS)), int(rng.integers(3))

    def nudge(tick: int, row: np.ndarray) -> np.ndarray:
        if tick == when:
            row[joint] = np.nextafter(row[joint], 10.0)
        return row

    record(tmp_path / "bag", scene, command=nudge)
    difference = difference_between(plain[0], tmp_path / "bag", scene)
    assert (difference.kind, difference.tick, difference.ulps) == ("command", when, 1)
    assert difference.owner == ("waist", "shoulder", "elbow")[joint]


@pytest.mark.parametrize("seed", some(range(8), 3))
def test_a_bit_of_a_number(seed: int, scene: Path, tmp_path: Path) -> None:
    rng = np.random.default_rng(200 + seed)
    when, value = int(rng.integers(0, TICKS)), float(rng.uniform(0.4, 0.6))
    for name, number in (("one", value), ("other", np.nextafter(value, 1.0))):
        inputs = {when: float(number)}
        record(tmp_path / name, scene, number=inputs.get)
    difference = difference_between(tmp_path / "one", tmp_path / "other", scene)
    assert (difference.kind, difference.tick) == ("change by hand", when)
    assert (difference.quantity, difference.ulps) == (VARIED, 1)


def test_power_and_a_change_in_a_single_bag(
    plain: tuple[Path, States], scene: Path, tmp_path: Path
) -> None:
    record(tmp_path / "dark", scene, power=lambda tick: tick < 30)
    dark = difference_between(plain[0], tmp_path / "dark", scene)
    assert (dark.kind, dark.tick, dark.values) == ("change by hand", 30, ("none", "power"))
    record(tmp_path / "number", scene, number={17: 0.5}.get)
    number = difference_between(plain[0], tmp_path / "number", scene)
    assert (number.tick, number.values) == (17, ("none", "set_varied"))


def test_another_scene_is_detected_where_the_record_is_still_equal(
    scene: Path, tmp_path: Path
) -> None:
    """Counts hide the first difference, the machines driven again do not."""
    bag, second = tmp_path / "bag", tmp_path / "three_axis.yaml"
    record(bag, scene, truths=False)
    shutil.copytree(scene.parent / "urdf", tmp_path / "urdf")
    data = yaml.safe_load(scene.read_text())
    data["joints"]["elbow"]["friction"] = {"viscous": 0.5 + 1e-10}
    second.write_text(yaml.safe_dump(data, sort_keys=False))
    record(tmp_path / "other_bag", second, truths=False)
    difference, equal = find_first_difference(
        RecordedMachine.open_run(bag, str(scene)),
        RecordedMachine.open_run(tmp_path / "other_bag", str(second)),
    )
    assert difference is not None and equal > 1
    # Nothing moves at tick 0, so that friction acts from the first step on.
    assert (difference.tick, difference.kind) == (1, "state")


PARTS = [  # code of parts, changed by rounding alone
    ("motors/dc_motor.hpp", "Kt * ", "Kt * (1.0 + 0x1p-52) * "),
    ("gears/gear.hpp", "Kg * ", "Kg * (1.0 + 0x1p-52) * "),
]


@pytest.mark.parametrize(("header", "code", "second"), some(PARTS, 1))
def test_code_of_a_part(
    header: str, code: str, second: str, plain: tuple[Path, States], scene: Path, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    shutil.copytree(compiler.CORE, tmp_path / "core")
    file = tmp_path / "core" / "parts" / header
    text = file.read_text()
    assert code in text
    file.write_text(text.replace(code, second))
    monkeypatch.setattr(compiler, "CORE", tmp_path / "core")
    assert_reported(plain, scene, "compiled from ")


@pytest.mark.parametrize("flags", ["-fassociative-math -ffp-contract=fast"])
def test_a_compiler_flag(
    flags: str, plain: tuple[Path, States], scene: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compiler, "FLAGS", (*compiler.FLAGS, *flags.split()))
    second = f"no further flag (record), {flags} (present)"
    assert_reported(plain, scene, f"compiled with {second}")


@pytest.mark.skipif(not FULL or shutil.which("clang++") is None, reason="a second compiler")
def test_another_compiler_makes_no_difference(
    plain: tuple[Path, States], scene: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CXX", "clang++")
    assert compare_bag(plain[0], str(scene)).difference is None


def assert_reported(plain: tuple[Path, States], scene: Path, build: str) -> None:
    """The present machine differs first where its states do; its other build is named."""
    result = compare_bag(plain[0], str(scene))
    (named,) = result.hints[-1:]
    assert named.startswith(f"other builds: {build}")
    first, second = plain[1], again(scene)
    names = ("q", "v", "gear_torque", "current")
    ticks = [k for k in range(TICKS + 1) if any(
        getattr(first[k], name).tobytes() != getattr(second[k], name).tobytes() for name in names
    )]  # fmt: skip
    assert ticks, "the change shows"
    assert result.difference is not None and f"tick {ticks[0]}, " in result.difference


def again(scene: Path) -> States:
    """The states under the same commands, by the compiler and code that are there now."""
    session = Session(str(scene), "lockstep", "first_answer")
    rng, states = np.random.default_rng(4), [session.state]
    for tick in range(TICKS):
        session.offer(tick, session.scene.joint_names, rng.uniform(-5.0, 5.0, 3).tolist())
        session.advance()
        states.append(session.state)
    return states


def test_on_the_command_line(
    plain: tuple[Path, States], scene: Path, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    record(tmp_path / "bag", scene, command=lambda tick, row: row + (tick == 7))
    words = ["explain", str(plain[0]), str(tmp_path / "bag"), "--scene", str(scene)]
    for more, code in (([], 1), (["--run", "1", "--other-run", "1"], 1), (["--run", "2"], 2)):
        monkeypatch.setattr("sys.argv", ["arm_emulator", *words, *more, "--json"])
        with pytest.raises(SystemExit) as end:
            main()
        facts = json.loads(capsys.readouterr().out)
        assert end.value.code == code, facts
        if code == 1:
            assert facts["difference"]["tick"] == 7 and facts["equal_ticks"] == 8
            assert facts["difference"]["owner"] == "waist" and facts["tick"] == 7
