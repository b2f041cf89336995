"""Runs without a network, recorded and shown: every tick, with any clock and any end."""

import csv
import inspect
import itertools
import json
import math
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
from draws import some, with_slow

from arm_emulator import Plant, Refusal, Scene, load_gains, load_scene
from arm_emulator.base.io.config_files import find_scene
from arm_emulator.base.io.record_file import open_record
from arm_emulator.base.run_outputs import SUFFIXES, RunOutputs
from arm_emulator.cli.command import command_names, load_command
from arm_emulator.machine.plant.outputs import list_outputs, list_units
from arm_emulator.machine.plant.plant_state import ROWS
from arm_emulator.machine.session.real_time import open_real_time_session
from arm_emulator.machine.session.record_row import RecordRow, list_columns
from arm_emulator.ros.recording.bag import Bag
from arm_emulator.runs.offline import load_offline_run
from arm_emulator.runs.recorder import Recorder
from arm_emulator_fieldbus.commands.canopen import load_segment
from arm_emulator_fieldbus.ethercat import Segment
from test_outputs import everything

PATIENCE = 60.0  # s


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """A machine that has every output."""
    return everything(tmp_path_factory.mktemp("recorded"))


def read(file: Path) -> tuple[dict[str, list[Any]], dict[str, str]]:
    """Return a file's columns and their units, read by others."""
    return READERS[file.suffix](file)


def _csv(file: Path) -> tuple[dict[str, list[Any]], dict[str, str]]:
    with file.open(newline="") as stream:
        head, *rows = csv.reader(stream)
    named = [re.fullmatch(r"(.*?)(?: \[(.*)\])?", heading) for heading in head]
    assert all(named)
    names, units = zip(
        *((heading[1], heading[2] or "") for heading in named if heading), strict=True
    )
    columns = [
        [float(cell) if cell else None for cell in column] for column in zip(*rows, strict=True)
    ]
    return dict(zip(names, columns, strict=True)), dict(zip(names, units, strict=True))


def _mcap(file: Path) -> tuple[dict[str, list[Any]], dict[str, str]]:
    from mcap.reader import make_reader

    columns: dict[str, list[Any]] = {}
    units: dict[str, str] = {}

    def leaves(tree: dict[str, Any], path: str) -> Iterator[tuple[str, Any]]:
        for key, value in tree.items():
            if isinstance(value, dict) and not isinstance(value.get("type"), list):
                yield from leaves(value.get("properties", value), f"{path}{key}.")
            else:
                yield path + key, value

    with file.open("rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages():
            assert schema is not None
            group = "measured." if channel.topic == "measured" else ""
            described = leaves(json.loads(schema.data)["properties"], group)
            units |= {name: leaf["description"] for name, leaf in described}
            data = json.loads(message.data)
            assert message.log_time == round(data["t"] * 1e9)
            for name, value in leaves(data, group):
                columns.setdefault(name, []).append(value)
    for clock in ("t", "tick"):
        assert columns.pop(f"measured.{clock}") == columns[clock]
        units.pop(f"measured.{clock}")
    return columns, units


def _parquet(file: Path) -> tuple[dict[str, list[Any]], dict[str, str]]:
    import pyarrow.parquet as pq

    table = pq.read_table(file)
    units = {
        column.name: (column.metadata or {}).get(b"unit", b"").decode() for column in table.schema
    }
    return table.to_pydict(), units


def _npz(file: Path) -> tuple[dict[str, list[Any]], dict[str, str]]:
    with np.load(file) as archive:
        return {name: archive[name].tolist() for name in archive}, {}


READERS: dict[str, Callable[[Path], tuple[dict[str, list[Any]], dict[str, str]]]] = {
    ".csv": _csv, ".mcap": _mcap, ".parquet": _parquet, ".npz": _npz,
}  # fmt: skip


def truth_of(plant: Plant) -> dict[str, Any]:
    """Return all values that a record must contain, from the plant."""
    scene, state, measured = plant.scene, plant.state, plant.measured
    values_by_name: dict[str, Any] = {"t": state.t, "energy": plant.energy}
    values_by_name |= {
        f"{name}.{joint}": float(value)
        for name in ROWS
        for joint, value in zip(scene.joint_names, getattr(state, name), strict=True)
    }
    for output in list_outputs(scene):
        values = getattr(measured, output.name).tolist()
        for owner, value in zip(
            [imu.name for imu in scene.imus] if output.per_unit else scene.joint_names,
            values, strict=True,
        ):  # fmt: skip
            of = zip("xyz", value, strict=True) if output.per_unit else [("", value)]
            values_by_name |= {
                f"measured.{output.name}.{owner}.{k}".rstrip("."): axis_value
                for k, axis_value in of
            }
    return values_by_name


@pytest.mark.slow
def test_a_row_has_the_time_and_the_tick_of_its_measurement(scene: Scene) -> None:
    plant = Plant(scene)
    row = RecordRow(plant)
    for tick in range(3):
        taken = row.take_row()
        assert taken["tick"].tolist() == [tick]
        assert taken["t"] == pytest.approx(tick * scene.servo_period, rel=1e-12)
        plant.exchange(np.zeros(len(scene.joints)))


def test_every_kind_of_file_is_tested() -> None:
    assert set(READERS) == set(SUFFIXES)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_file_has_truth_and_measurement_of_every_tick(
    scene: Scene, tmp_path: Path, suffix: str
) -> None:
    plant, file = Plant(scene), tmp_path / f"run{suffix}"
    draw = np.random.default_rng(3)
    with Recorder(plant, RunOutputs(file), waits=True):
        expected = [truth_of(plant)]
        for tick in range(40):
            plant.exchange(draw.uniform(-20.0, 20.0, len(scene.joints)), tick)
            expected.append(truth_of(plant))
    plant.exchange([0.0, 0.0])  # which is not recorded any more
    columns, units = read(file)
    assert columns.pop("tick") == list(range(41))
    assert set(columns) == set(expected[0])
    for name, values in columns.items():
        assert values == [row[name] for row in expected], f"{name}: to the last bit"
    if units:
        assert units["t"] == "s" and units["q.turn"] == "rad" and units["v.slide"] == "m/s"
        assert units["gear_torque.turn"] == "N m" and units["gear_torque.slide"] == "N"
        for output in list_outputs(scene):
            for joint, unit in zip(scene.joint_names, list_units(scene, output), strict=False):
                if not output.per_unit:
                    assert units[f"measured.{output.name}.{joint}"] == unit


def test_a_missing_number_is_an_empty_cell_and_null(scene: Scene, tmp_path: Path) -> None:
    rows = RecordRow(Plant(scene)).take_row()
    rows["q"][0, 1], rows["v"][0, 0] = np.nan, -np.inf
    for suffix in (".csv", ".mcap"):
        record = open_record("test", tmp_path / f"odd{suffix}", list_columns(scene))
        record.write_rows(rows)
        record.close()
        columns, _ = read(tmp_path / f"odd{suffix}")
        assert columns["q.slide"] == columns["v.turn"] == [None] and columns["q.turn"] != [None]


def in_real_time(file: Path) -> tuple[Plant, Callable[[], None]]:
    session = open_real_time_session(load_scene("three_axis"), "paused")

    def go() -> None:
        session.paused = False
        end = time.monotonic() + PATIENCE
        while session.plant.t < 0.1:
            assert time.monotonic() < end
            time.sleep(0.01)
        session.close()

    return session.plant, go


def in_lock_step(file: Path) -> tuple[Plant, Callable[[], None]]:
    run = load_offline_run("three_axis")
    return run.session.plant, lambda: run.advance(10_000)  # more than the ring has room for


def on_canopen(file: Path) -> tuple[Plant, Callable[[], None]]:
    segment = load_segment("three_axis")
    return segment.drives.plant, lambda: segment.drives.period(500)


def on_ethercat(file: Path) -> tuple[Plant, Callable[[], None]]:
    name = "three_axis"
    servo = load_gains(find_scene(name)).servo
    segment = Segment(load_scene(name), servo, lockstep=False)

    def go() -> None:
        for k in range(1, 201):
            segment.pass_period(k * 1_000_000)

    return segment.drives.plant, go


@pytest.mark.parametrize(
    "door", with_slow([in_real_time, in_lock_step, on_canopen, on_ethercat], 2)
)
def test_loops_in_c_are_recorded_period_by_period(
    tmp_path: Path, door: Callable[[Path], tuple[Plant, Callable[[], None]]]
) -> None:
    file = tmp_path / "run.csv"
    plant, go = door(file)
    with Recorder(plant, RunOutputs(file), waits=door is not in_real_time):
        go()
    columns, _ = read(file)
    last = round(plant.t / plant.scene.servo_period)
    assert columns["tick"] == list(range(last + 1)) and last >= 50
    assert [
        columns[f"q.{joint}"][-1] for joint in plant.scene.joint_names
    ] == plant.state.q.tolist()


def await_rows(process: subprocess.Popen[str], folder: Path) -> None:
    """Wait until the recorder has begun, and then for some thousand rows."""
    end, needed = time.monotonic() + PATIENCE, math.inf

    def used() -> float:
        """CPU time of the run and of the process that writes [s]."""
        process_tree = psutil.Process(process.pid)
        return sum(each.cpu_times().user for each in (process_tree, *process_tree.children()))

    while used() < needed:
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < end, "rows that the test waits for"
        if needed == math.inf and any(folder.iterdir()):
            needed = used() + 0.3  # s, of which a row needs less than 1e-4
        time.sleep(0.02)


def wait_until_complete(file: Path) -> tuple[dict[str, list[Any]], dict[str, str]]:
    """Read a file whose writer ends by itself soon."""
    end = time.monotonic() + PATIENCE
    while True:
        try:
            return read(file)
        except Exception:
            if time.monotonic() > end:
                raise
            time.sleep(0.05)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("how", "suffix"),
    some(
        [
            (signal.SIGKILL, ".csv"),
            (signal.SIGINT, ".mcap"),
            (signal.SIGKILL, ".parquet"),
            *itertools.product([signal.SIGKILL, signal.SIGINT], SUFFIXES),
        ],
        3,
    ),
)
def test_a_run_that_is_ended_leaves_a_complete_file(
    tmp_path: Path, how: signal.Signals, suffix: str
) -> None:
    file = tmp_path / f"run{suffix}"
    words = ["run", "three_axis", "--seconds", "1e6", "--record", str(file)]
    process = subprocess.Popen(
        [sys.executable, "-m", "arm_emulator", *words],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        await_rows(process, tmp_path)
        process.send_signal(how)
        process.wait(PATIENCE)
    finally:
        process.kill()
        process.communicate()
    columns, _ = wait_until_complete(file)
    assert len(columns["t"]) > 100
    np.testing.assert_allclose(np.diff(columns["t"]), 1e-3, rtol=1e-6)
    assert {len(values) for values in columns.values()} == {len(columns["t"])}
    assert not list(tmp_path.glob(".*")), "nothing else is left"


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of its own that is soon full."""
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=300k", "small", str(disk)]
    mounted = subprocess.run(mount, capture_output=True, text=True, check=False)
    if mounted.returncode != 0:
        pytest.skip(f"no disk can be mounted: {mounted.stderr.strip()}")
    try:
        yield disk
    finally:
        subprocess.run(["umount", str(disk)], check=True)


@pytest.mark.slow
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_full_disk_is_reported_and_leaves_a_complete_file_or_none(
    small_disk: Path, suffix: str
) -> None:
    file, run = small_disk / f"run{suffix}", load_offline_run("three_axis")
    recorder = Recorder(run.session.plant, RunOutputs(file), waits=True)
    run.advance(20_000)
    with pytest.raises(Refusal, match="accept every row, got the disk takes no more: No space"):
        recorder.close()
    if suffix in (".csv", ".mcap"):
        columns, _ = read(file)
        assert 100 < len(columns["t"]) < 20_000
        assert columns["tick"] == list(range(len(columns["t"])))
    else:
        assert not list(small_disk.iterdir()), "what cannot be read is not left"


@pytest.mark.slow
def test_rerun_gets_the_run(tmp_path: Path) -> None:
    chunk = pytest.importorskip("rerun.chunk")
    plant, file = Plant("three_axis"), tmp_path / "run.rrd"
    with Recorder(plant, RunOutputs(tmp_path / "run.csv", str(file)), waits=True):
        for _ in range(50):
            plant.exchange([5.0, 0.0, 1.0])
    columns, _ = read(tmp_path / "run.csv")
    values: list[float] = []
    for part in chunk.RrdReader(file).stream().filter(content="/signals/q/elbow"):
        batch = part.to_record_batch()
        if "Scalars:scalars" in batch.schema.names:
            values += [value[0] for value in batch["Scalars:scalars"].to_pylist()]
    assert values == columns["q.elbow"]


def recording_commands() -> list[str]:
    """Commands that take --record and --rerun."""
    names = []
    for name in command_names():
        command = load_command(name)
        assert command is not None
        if "outputs" in inspect.signature(command.function).parameters:
            names.append(name)
    return names


def servers() -> list[str]:
    """Commands that let a machine run until Ctrl-C, without a network."""
    commands = ((name, load_command(name)) for name in command_names())
    network = ("look", "record", "replay", "up")
    return [
        name
        for name, command in commands
        if command and command.until_stopped and name not in network
    ]


def test_every_run_without_a_network_can_be_recorded() -> None:
    assert set(recording_commands()) == {"campaign", "firmware", "run", *servers()}


@pytest.mark.parametrize("name", recording_commands())
def test_wrong_places_are_refused_before_anything_is_begun(name: str) -> None:
    words = ["no_board.yaml", "no.elf"] if name == "firmware" else ["no_scene"]
    for option, value, line in (
        ("--record", "run.txt", "--record must end in a known kind, got run.txt; valid: .mcap, "),
        ("--record", "run", "--record must end in a known kind, got run; valid: .mcap, "),
        ("--rerun", "run.csv", "--rerun must be a port or end in .rrd, got run.csv"),
    ):
        with pytest.raises(Refusal, match=re.escape(f"{name}: {line}")):
            command = load_command(name)
            assert command is not None
            from arm_emulator.cli.arguments import run_with

            run_with(command, [*words, option, value])


def test_files_that_cannot_be_are_refused(tmp_path: Path) -> None:
    plant, there = Plant("three_axis"), tmp_path / "there.csv"
    there.write_text("mine")
    for file, line in (
        (there, "there.csv must be new, got one that exists"),
        (there / "run.mcap", "run.mcap must be writable, got "),
        (there / "run.parquet", "run.parquet must be writable, got "),
    ):
        with pytest.raises(Refusal, match=line):
            Recorder(plant, RunOutputs(file), waits=True)
    assert there.read_text() == "mine"


def test_a_table_of_a_run_is_not_taken_for_a_bag(scene: Scene, tmp_path: Path) -> None:
    """Every reader of bags names what does record one."""
    file = tmp_path / "run.mcap"
    plant = Plant(scene)
    with Recorder(plant, RunOutputs(file), waits=True):
        plant.exchange([0.0, 0.0])
    with pytest.raises(Refusal, match=r"got json in channel truth; valid: bags of `up --record`"):
        Bag(file)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [server for server in servers() if server != "ethercat"]
)  # needs root
def test_servers_record_until_ctrl_c(tmp_path: Path, name: str) -> None:
    file = tmp_path / "run.csv"
    free = [] if name == "modbus" else ["--listen", "0"]
    words = [name, "--clock", "realtime", *free, "--record", str(file)]
    process = subprocess.Popen(
        [sys.executable, "-m", "arm_emulator", *words],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        end = time.monotonic() + PATIENCE
        while not file.exists() or file.read_bytes().count(b"\n") < 2:
            assert process.poll() is None, process.communicate()
            assert time.monotonic() < end
            time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE) == 0
    finally:
        process.kill()
        process.communicate()
    columns, _ = read(file)
    assert columns["tick"] == list(range(len(columns["t"])))
