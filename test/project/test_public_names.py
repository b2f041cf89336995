"""The names that programs may rely on: found late, documented, typed, and what they promise."""

import abc
import copy
import dataclasses
import inspect
import pickle
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import pytest

import arm_emulator
from arm_emulator import (
    JacobianController,
    Kinematics,
    OfflineRun,
    Plant,
    Pose,
    Recording,
    Refusal,
    Servo,
    Session,
    Timeline,
    linearise,
    load_gains,
    load_scene,
    load_servo_config,
    sensitivities,
    testing,
)
from arm_emulator.base.io.config_files import find_config
from arm_emulator.machine.parts.motors.dc_motor import DcMotor
from arm_emulator.machine.scene.known_parts import PARTS
from arm_emulator_fleet import Fleet, FleetWay, ServoFleet

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("name", arm_emulator.__all__)
def test_a_public_name_is_there_and_documented(name: str) -> None:
    thing = getattr(arm_emulator, name)
    assert inspect.getdoc(thing), f"{name} has no docstring"
    assert name in dir(arm_emulator)
    source = (ROOT / "arm_emulator" / "__init__.py").read_text()
    assert re.search(rf"import (?:\(\s+)?{name} as {name},?$", source, re.MULTILINE), (
        "type checkers miss it"
    )
    page = (ROOT / "docs" / "reference" / "python.md").read_text()
    place = thing.__name__ if inspect.ismodule(thing) else f"{thing.__module__}.{name}"
    assert f"::: {place}\n" in page, "the reference misses it"


def test_the_version_is_that_of_the_package() -> None:
    import xml.etree.ElementTree as ET

    assert arm_emulator.__version__ == ET.parse(ROOT / "package.xml").getroot().findtext("version")


def test_the_import_loads_neither_numpy_nor_ros() -> None:
    code = "import sys, arm_emulator; print('numpy' in sys.modules, 'rclpy' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "False"]


def _values(volts: float) -> dict[str, Any]:
    """Return every kind of record that has arrays, of a machine under a constant command."""
    plant = Plant(load_scene("three_axis", {"joints.waist.start": volts}))
    plant.exchange([volts, 0.0, 0.0])
    plant.exchange([volts, 0.0, 0.0])
    fleet = Fleet("three_axis", 2)
    fleet.advance(np.full((2, 3), volts), 10)
    q = plant.state.q
    return {
        "scene": plant.scene,
        "state": plant.state,
        "measured": plant.measured,
        "fleet": fleet.state,
        "fleet measured": fleet.measured,
        "linear": linearise(plant, q),
        "equations": plant.equations([volts, 0.0, 0.0]),
        "pose": Pose([volts, 0.0, 0.0], np.eye(3)),
    }


def test_records_with_arrays_are_equal_if_their_values_are() -> None:
    first, same, different = _values(1.0), _values(1.0), _values(2.0)
    for name, value in first.items():
        assert value == same[name] == copy.deepcopy(value), name
        assert value is not same[name] and value != 1, name
    differing = {name for name in first if first[name] != different[name]}
    assert differing >= {"scene", "state", "measured", "fleet", "fleet measured", "pose"}
    unknown = dataclasses.replace(first["state"], q=np.array([0.0, np.nan, 0.0]))
    assert unknown == copy.deepcopy(unknown), "NaN: not measured"
    assert len({first["scene"], same["scene"], different["scene"]}) == 2


def test_no_object_prints_its_address() -> None:
    gains, plant = load_gains("three_axis"), Plant("three_axis")
    kinematics = Kinematics(plant.scene.urdf, plant.scene.joint_names, plant.scene.tool)
    fleet = Fleet("three_axis", 2)
    for instance in (
        *(plant, fleet, plant.scene, gains, kinematics, Servo("three_axis"), Recording(plant)),
        *(Session("three_axis", "lockstep", "free_run"), JacobianController(kinematics)),
        *(OfflineRun("three_axis", gains.servo, gains.motion), ServoFleet(fleet, "three_axis")),
        *(fleet.step(np.zeros((2, 3))), plant.links, linearise("three_axis")),
    ):
        assert not re.search(r"\bat 0x|\n", repr(instance)), repr(instance)
    assert repr(plant.scene) == "<Scene three_axis: waist, shoulder, elbow>"


def test_true_values_are_not_set_in_a_copy_of_them() -> None:
    plant, fleet = Plant("three_axis"), Fleet("three_axis", 2)
    for rows in (plant.state.q, plant.state.current, fleet.state.q, fleet.state.t, fleet.powered):
        with pytest.raises(ValueError, match="read-only"):
            rows[0] = 0
    plant.state = dataclasses.replace(plant.state, v=[0.1, 0.0, 0.0], omega_m=[10.0, 0.0, 0.0])
    assert plant.state.v[0] == 0.1


def test_a_name_that_is_nearly_public_is_named_in_the_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'Plnat'") as error:
        arm_emulator.Plnat  # noqa: B018
    assert (error.value.name, error.value.obj) == ("Plnat", arm_emulator), "Python looks there"


def test_arguments_are_taken_or_refused(tmp_path: Path) -> None:
    """By every public name; nothing else is raised, and nothing passes in silence."""
    assert load_servo_config("three_axis") == load_gains("three_axis").servo
    gains, plant = load_gains("three_axis"), Plant("three_axis")
    urdf, names, tool = plant.scene.urdf, plant.scene.joint_names, plant.scene.tool
    fleet = Fleet("three_axis", 2)
    for wrong in (
        None,
        5.5,
        b"three_axis",
        "no_such_thing",
        object(),
        np.zeros(3),
        ["no_such_thing"],
    ):
        calls: tuple[Callable[[Any], object], ...] = (
            *(Plant, load_scene, load_gains, Servo, load_servo_config, linearise, Recording),
            *(JacobianController, lambda it: Fleet(it, 2), lambda it: Fleet("three_axis", it)),
            lambda it: Session(it, "lockstep", "free_run"),
            lambda it: Session("three_axis", it, "free_run"),
            lambda it: Session("three_axis", "lockstep", it),
            lambda it: setattr(Session("three_axis", "lockstep", "free_run"), "paused", it),
            lambda it: OfflineRun(it, gains.servo, gains.motion),
            lambda it: OfflineRun("three_axis", it, gains.motion),
            lambda it: OfflineRun("three_axis", gains.servo, it),
            *(
                Timeline,
                lambda it: Timeline(OfflineRun("three_axis", gains.servo, gains.motion), it),
            ),
            lambda it: ServoFleet(it, gains.servo),
            lambda it: ServoFleet(fleet, it),
            lambda it: Kinematics(it, names, tool),
            lambda it: Kinematics(urdf, it, tool),
            lambda it: Kinematics(urdf, names, it),
            lambda it: Pose(it, np.ones((3, 3))),
            lambda it: setattr(fleet, "powered", it),
        )
        for k, call in enumerate(calls):
            with pytest.raises(Refusal):
                call(wrong)
                pytest.fail(f"call {k} takes {wrong!r}")
    with pytest.raises(Refusal, match="folder that exists"):
        Recording(plant, tmp_path / "missing" / "run.csv")


def test_a_session_is_closed_as_a_context_ends() -> None:
    with Session("three_axis", "realtime", "free_run") as session:
        assert session.phase != "closed"
    assert "Session of three_axis" in repr(session)


def test_a_recording_is_a_table(tmp_path: Path) -> None:
    plant = Plant("three_axis")
    with Recording(plant, tmp_path / "run.csv", names=("q", "energy", "measured.current")) as run:
        for _ in range(20):
            plant.exchange({"waist": 5.0, "shoulder": 0.0, "elbow": 1.0})
            run.take()
    rows = np.genfromtxt(tmp_path / "run.csv", delimiter=",", names=True, deletechars="")
    # Headings have units; NumPy makes names of them.
    assert np.array_equal(rows["q.elbow_[rad]"], run["q"][:, 2])
    assert rows["t_[s]"][-1] == plant.t and rows["energy_[J]"][-1] == plant.energy
    assert np.array_equal(rows["measured.current.waist_[A]"], run["measured.current"][:, 0])
    for wrong in ({"names": ("speed",)}, {"file": "run.txt"}):
        with pytest.raises(Refusal):
            Recording(plant, **wrong)  # type: ignore[arg-type]
    pa = pytest.importorskip("pyarrow")
    table = run.table()
    assert (
        isinstance(table, pa.Table)
        and table["q.elbow"].to_pylist() == rows["q.elbow_[rad]"].tolist()
    )
    assert table.schema.field("q.elbow").metadata == {b"unit": b"rad"}


def test_a_recording_is_readable_by_rerun(tmp_path: Path) -> None:
    """Every row, however quickly they come."""
    from rerun.chunk import RrdReader

    plant, rows = Plant("three_axis"), np.tile([5.0, 0.0, 1.0], (700, 1))
    with Recording(plant, tmp_path / "run.rrd") as run:
        run.run(rows, 1)
    assert [file.name for file in tmp_path.iterdir()] == ["run.rrd"]
    chunks = RrdReader(tmp_path / "run.rrd").stream().filter(content="/signals/q/waist")
    count = sum(chunk.to_record_batch().num_rows for chunk in chunks if not chunk.is_static)
    assert count == 700
    with pytest.raises(Refusal, match="end in"):
        Recording(plant, "run.txt")


def test_a_run_is_recorded_every_so_often() -> None:
    rows = np.random.default_rng(4).uniform(-9.0, 9.0, (10, 3))
    run, alone = Recording(Plant("three_axis")), Plant("three_axis")
    run.run(rows, 7, every=4)
    q = alone.run(rows, 7)
    assert np.array_equal(run["q"], q[[3, 7, 9]])
    assert np.array_equal(run["measured.encoder_counts"][-1], alone.measured.encoder_counts)
    with pytest.raises(Refusal, match="every must be a whole number >= 1"):
        run.run(rows, 7, every=0)


def test_helpers_for_users_tests() -> None:
    plant = testing.plant_of("three_axis")
    servo, target = Servo(load_gains(find_config("three_axis", ".yaml")).servo), plant.scene.start
    q = testing.drive(
        plant,
        lambda _, measured: servo.update(measured.encoder_counts, measured.current, target),
        500,
    )
    testing.assert_settles(q, target, within=1e-3, last=100)
    with pytest.raises(AssertionError, match=r"joint 1 is .* off"):
        testing.assert_settles(q, target + np.array([0.0, 0.5, 0.0]), within=1e-3, last=100)
    with pytest.raises(AssertionError, match="nan off"):
        testing.assert_settles(np.full((5, 3), np.nan), np.zeros(3), 1e-3, last=2)


# Tried in the first hour, and ended in a traceback of ours, in a page of text or in silence.
ROWS = np.zeros((5, 3))


def load_run() -> OfflineRun:
    """Return a run of the shipped arm."""
    gains = load_gains("three_axis")
    return OfflineRun("three_axis", gains.servo, gains.motion)


FIRST_HOUR: list[tuple[Callable[[], object], str]] = [
    (lambda: Recording("three_axis"), "plant must be a Plant"),  # type: ignore[arg-type]
    (lambda: Recording(Plant("three_axis"), names=("q",))["v"], "be recorded, got v; valid: q"),
    (lambda: load_gains(load_scene("three_axis")), "scene must be a name or a file"),  # type: ignore[arg-type]
    (lambda: load_scene(load_scene("three_axis")), "scene must be a name or a file"),  # type: ignore[arg-type]
    (lambda: Plant("three_axis").exchange(np.zeros(3), enable=1), "got enable; valid: none"),
    (lambda: Fleet("three_axis", 2).exchange(np.zeros(3), enable=1), "got enable"),
    (lambda: Fleet("three_axis", 2).reset([1, 1]), "a mask of 2, or indices, each once"),
    (lambda: sensitivities("three_axis", ROWS, "start.q.elbo"), "valid: start.q.elbow"),
    (lambda: copy.copy(load_run()), "must stay one, got a copy; valid: a new one, or `fork`"),
    (lambda: pickle.dumps(Timeline(load_run())), "must stay one"),
    (lambda: copy.deepcopy(ServoFleet(Fleet("three_axis", 2), "three_axis")), "must stay one"),
    (lambda: copy.copy(Recording(Plant("three_axis"))), "must stay one"),
    (lambda: copy.copy(FleetWay(load_scene("three_axis"), 2)), "must stay one"),
    (lambda: testing.assert_settles(ROWS, np.zeros(3), 1e-3, last=10), "last must be"),
    (lambda: testing.assert_settles(ROWS, 0.0, 1e-3, last=2), r"must have shapes \(K, N\) and"),
]  # fmt: skip


@pytest.mark.parametrize(("call", "reason"), FIRST_HOUR, ids=range(len(FIRST_HOUR)))
def test_mistakes_of_newcomers_are_refused_in_a_line(
    call: Callable[[], object], reason: str
) -> None:
    with pytest.raises(Refusal, match=reason) as refused:
        call()
    assert "\n" not in str(refused.value) and len(str(refused.value)) < 200


def test_arms_of_a_fleet_are_the_same_objects_and_come_in_slices() -> None:
    fleet = Fleet("three_axis", 5)
    assert fleet[1] == fleet[np.int64(-4)] and fleet[1] in fleet and fleet[1] != fleet[2]
    assert [*reversed(fleet)] == [*fleet][::-1]
    some = fleet[3:0:-1]
    assert some == [fleet[3], fleet[2], fleet[1]] and fleet[5:] == []
    some[0].advance([5.0, 0.0, 0.0], 10)
    moved = np.flatnonzero((fleet.state.q != fleet.scene.start).any(axis=1))
    assert moved.tolist() == [3], "they share the state"
    fleet.reset(q=[0.1, 0.2, 0.3])
    assert some[0].state.q.tolist() == [0.1, 0.2, 0.3]


def test_a_closed_session_can_be_read_and_not_moved() -> None:
    session = Session("three_axis", "lockstep", "free_run")
    session.advance()
    session.close()
    session.close()
    saved, names = session.plant.save(), session.scene.joint_names
    for change in (
        session.advance, session.reset, lambda: session.offer(1, names, [0.0] * 3),
        lambda: setattr(session, "powered", False),
        lambda: session.set_state(["waist"], {"v": [1.0]}),
    ):  # fmt: skip
        with pytest.raises(Refusal, match="session must be open, got a closed one"):
            change()
    assert session.plant.save() == saved and session.tick == 1 and session.state.t > 0.0


class Logged(abc.ABC):
    """A base of a user, with a constructor of its own."""

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self.lines: list[str] = []

    @abc.abstractmethod
    def log(self) -> None: ...


class HasTime(Protocol):
    @property
    def t(self) -> float: ...


@pytest.mark.parametrize("kind", [Plant, Session, Fleet, Servo, Timeline, OfflineRun, Kinematics])
def test_public_classes_go_with_abstract_bases_and_protocols(kind: type) -> None:
    for bases in ((kind, Logged), (kind, HasTime), (Logged, kind), (HasTime, kind)):
        mine = type("Mine", bases, {"log": lambda self: None})
        if kind is Plant:
            plant = mine("three_axis")
            assert (plant.state.q == Plant("three_axis").state.q).all()


def test_the_keywords_of_a_part_are_its_signature() -> None:
    for kind in PARTS:
        fields = {field.name: field for field in dataclasses.fields(kind)}
        signature = inspect.signature(kind)
        assert signature.parameters.keys() == fields.keys(), kind
        for name, parameter in signature.parameters.items():
            assert parameter.kind is parameter.KEYWORD_ONLY
            required = fields[name].default is fields[name].default_factory is dataclasses.MISSING
            assert (parameter.default is parameter.empty) == required, name
    needed = {value.name for value in inspect.signature(DcMotor).parameters.values()
              if value.default is value.empty}  # fmt: skip
    assert needed == {"resistance", "torque_constant", "back_emf_constant", "rotor_inertia"}
