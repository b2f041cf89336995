"""Units of FMI in the hands of fmpy: its validation, its importer, and the standard's headers."""

import ctypes
import html
import io
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("fmpy", reason="fmpy is not installed: make test-peers")

import fmpy
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import (
    FMU2Slave,
    fmi2CallbackFunctions,
    fmi2CallbackLoggerTYPE,
    fmi2Discard,
    fmi2Error,
    fmi2LastSuccessfulTime,
)
from fmpy.fmi3 import FMU3Slave
from fmpy.validation import validate_fmu
from fmu_client import OK, Fmu, Instance, plant_for, rich_machine
from lxml import etree
from machines import DC, GANTRY, gantry_urdf, write_scene
from test_fmu_file import scenes

from arm_emulator.machine.scene.scene import Scene, load_scene
from arm_emulator_fmu.export import export
from arm_emulator_fmu.model_description import describe_model, describe_model_2
from arm_emulator_fmu.variables import list_scalars, list_variables

FMPY = Path(fmpy.__file__).parent
ROOT = Path(__file__).resolve().parents[4]
PERIOD = 1e-3


@pytest.fixture(scope="module")
def three_axis() -> Scene:
    return load_scene("three_axis", {"varied": ["joints.*.gear.stiffness", "joints.*.friction.*"]})


@pytest.fixture(scope="module")
def unit(three_axis: Scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("unit") / "three_axis.fmu"
    export(three_axis, file, "native")
    return file


@pytest.fixture(scope="module")
def unit_2(three_axis: Scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same for FMI 2.0."""
    file = tmp_path_factory.mktemp("unit_2") / "three_axis.fmu"
    export(three_axis, file, "native", "2")
    return file


@pytest.fixture(scope="module")
def rich(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("rich")
    names = "a", "b:/#[].(+)", "c"
    export(load_scene(rich_machine(folder, names)), folder / "rich.fmu", "x86-64-v2")
    return folder / "rich.fmu"


@pytest.fixture(scope="module")
def unpacked(unit: Path) -> Path:
    with zipfile.ZipFile(unit) as archive:
        archive.extractall(unit.parent / "unpacked")
    return unit.parent / "unpacked"


def test_fmpy_finds_no_fault(unit: Path, unit_2: Path, rich: Path, tmp_path: Path) -> None:
    ur5 = tmp_path / "ur5.fmu"
    export(load_scene("ur5", {"varied": ["joints.*.gear.stiffness"]}), ur5)
    for file in (unit, unit_2, rich, ur5):
        assert validate_fmu(str(file)) == [], file.name


def test_fmpy_finds_no_fault_in_the_description_of_any_scene(tmp_path: Path) -> None:
    """50 random machines and scenes, whatever names they have."""
    many_scenes = scenes(tmp_path, 50)
    assert len(many_scenes) == 50, "so many are drawn"
    for number, scene in enumerate(many_scenes):
        texts = [describe_model(scene, list_variables(scene), "{token}")]
        if number % 6 == 0:  # a name per number takes fmpy its time
            texts.append(describe_model_2(scene, list_scalars(scene), "{token}"))
        for text in texts:
            file = io.BytesIO()
            with zipfile.ZipFile(file, "w") as archive:
                archive.writestr("modelDescription.xml", text)
            assert validate_fmu(file) == [], (scene.name, scene.joint_names)


def test_a_simulation_by_fmpy_equals_plant_to_the_last_bit(three_axis: Scene, unit: Path) -> None:
    """The plant is of its own library, of the same compiler, flags and target."""
    count, rng = 2000, np.random.default_rng(0)
    signals = np.zeros(count + 1, [("time", "f8"), ("command", "f8", 3), ("power", "?")])
    signals["time"] = PERIOD * np.arange(count + 1)
    signals["command"] = rng.normal(0.0, 5.0, (count + 1, 3))
    signals["power"] = True
    start = [0.1, 0.4, 0.9]
    reported = fmpy.simulate_fmu(
        str(unit), stop_time=count * PERIOD, output_interval=PERIOD, input=signals,
        start_values={"start.q": start}, output=["encoder_counts", "current", "truth.q", "truth.v"],
    )  # fmt: skip
    plant = plant_for(three_axis, "native")
    plant.reset(start)
    for row, command in zip(reported[1:], signals["command"], strict=False):
        plant.exchange(command)
        state = plant.state
        for name, value in (
            ("encoder_counts", plant.measured.encoder_counts), ("current", plant.measured.current),
            ("truth.q", state.q), ("truth.v", state.v),
        ):  # fmt: skip
            assert np.array_equal(row[name], value), (plant.t, name)
    assert len(reported) == count + 1, "all of the simulation is compared"


def test_a_simulation_of_fmi_2_equals_plant_to_the_last_bit(
    three_axis: Scene, unit_2: Path
) -> None:
    count, rng, names = 1000, np.random.default_rng(3), three_axis.joint_names
    commands = rng.normal(0.0, 5.0, (count + 1, 3))
    fields = [("time", "f8"), *((f"command.{name}", "f8") for name in names)]
    signals = np.zeros(count + 1, fields)
    signals["time"] = PERIOD * np.arange(count + 1)
    for name, row in zip(names, commands.T, strict=True):
        signals[f"command.{name}"] = row
    rows = [f"{group}.{name}" for group in ("encoder_counts", "truth.q") for name in names]
    reported = fmpy.simulate_fmu(
        str(unit_2), stop_time=count * PERIOD, output_interval=PERIOD, input=signals,
        start_values={"start.q.elbow": 0.9, "joints.elbow.gear.stiffness": 2e4}, output=rows,
    )  # fmt: skip
    plant = plant_for(three_axis, "native")
    plant.set_parameter("joints.elbow.gear.stiffness", 2e4)
    plant.reset([0.0, 0.5, 0.9])
    for row, command in zip(reported[1:], commands, strict=False):
        plant.exchange(command)
        actual = [row[name] for name in rows]
        expected = [*plant.measured.encoder_counts.astype(float), *plant.state.q]
        assert np.array_equal(actual, expected), plant.t
    assert len(reported) == count + 1, "all of the simulation is compared"


def test_fmi_2_saves_refuses_and_reports(unit_2: Path, tmp_path: Path) -> None:
    """State in memory and as bytes; what is discarded changes nothing, errors are reported."""
    with zipfile.ZipFile(unit_2) as archive:
        archive.extractall(tmp_path)
    description = fmpy.read_model_description(tmp_path)
    at = {v.name: v.valueReference for v in description.modelVariables}
    printed: list[bytes] = []
    callbacks = fmi2CallbackFunctions()
    callbacks.logger = fmi2CallbackLoggerTYPE(lambda *words: printed.append(words[4]))
    arguments = {
        "guid": description.guid, "unzipDirectory": str(tmp_path), "instanceName": "one",
        "modelIdentifier": description.coSimulation.modelIdentifier,
    }  # fmt: skip
    first, second = FMU2Slave(**arguments), FMU2Slave(**arguments)
    for which in (first, second):
        which.instantiate(callbacks=callbacks)
        which.setupExperiment(startTime=0.0)
        which.enterInitializationMode()
        which.exitInitializationMode()
    first.setReal([at["command.waist"]], [5.0])
    first.doStep(0.0, 20 * PERIOD)
    state = first.getFMUState()
    saved = first.serializeFMUState(state)
    reported = at["truth.q.waist"], at["truth.v.waist"], at["encoder_counts.elbow"]

    def discarded(call: Any, *arguments: Any) -> None:
        before = first.serializeFMUState(first.getFMUState())
        with pytest.raises(FMICallException) as caught:
            call(*arguments)
        assert caught.value.status == fmi2Discard, "it is discarded"
        assert first.serializeFMUState(first.getFMUState()) == before, "nothing has changed"

    discarded(first.setReal, [at["command.elbow"], at["command.waist"]], [1.0, np.nan])
    discarded(first.setReal, [at["joints.elbow.gear.stiffness"]], [-1.0])
    discarded(first.doStep, 20 * PERIOD, 1e300)
    assert first.getRealStatus(fmi2LastSuccessfulTime) == 20 * PERIOD, "where it stands"
    first.doStep(20 * PERIOD, 20 * PERIOD)
    expected = first.getReal(reported)
    first.setFMUState(state)
    first.doStep(20 * PERIOD, 20 * PERIOD)
    assert first.getReal(reported) == expected, "from a state in memory"
    second.setFMUState(second.deserializeFMUState(saved))
    second.doStep(20 * PERIOD, 20 * PERIOD)
    assert second.getReal(reported) == expected, "in another instance, from bytes"
    for call, values in (
        (second.getReal, ([10**6],)), (second.getInteger, ([at["command.waist"]],)),
        (second.setReal, ([at["truth.q.waist"]], [0.0])), (second.setString, ([0], [""])),
        (second.enterInitializationMode, ()),
    ):  # fmt: skip
        first.fmi2SetFMUstate(first.component, state)
        with pytest.raises(FMICallException) as caught:
            call(*values)
        assert caught.value.status == fmi2Error, call.__name__
    assert printed, "errors are reported though logging is off"
    for which in (first, second):
        which.freeInstance()


def test_the_portable_binary_equals_the_portable_library(tmp_path: Path) -> None:
    scene = load_scene("three_axis")
    export(scene, tmp_path / "arm.fmu")
    instance = Instance(Fmu(tmp_path / "arm.fmu", tmp_path / "unpacked"))
    plant = plant_for(scene, "x86-64-v2")
    instance.start()
    rng = np.random.default_rng(1)
    for _ in range(200):
        command = rng.normal(0.0, 5.0, 3)
        assert instance.set("command", command) == OK, instance.printed
        assert instance.step(PERIOD) == OK, instance.printed
        plant.exchange(command)
    assert np.array_equal(instance.get("truth.q"), plant.state.q), "equal bits"
    assert np.array_equal(instance.get("truth.current"), plant.state.current), "equal bits"


def test_motors_take_torque_current_or_voltage_side_by_side(tmp_path: Path) -> None:
    """In a machine of two threads; commands beyond the motors' limits, too."""
    torque = {"kind": "torque", "rotor_inertia": 1e-4, "torque_limit": 3.0}
    current = {"kind": "current", "rotor_inertia": 1e-4, "torque_constant": 0.05}
    joints = {
        name: {"motor": motor, "gear": {"ratio": 0.01}}
        for name, motor in zip(GANTRY, (torque, {**current, "current_limit": 4.0}, DC), strict=True)
    }
    integrator = {"scheme": "extrapolated", "dt": PERIOD}
    file = write_scene(tmp_path, gantry_urdf(), joints, integrator=integrator, threads=2)
    scene = load_scene(file)
    export(scene, tmp_path / "unit.fmu", "native")
    fmu = Fmu(tmp_path / "unit.fmu", tmp_path / "unpacked")
    command = fmu.variables["command"].attrib
    assert "x [N m], y [A], z [V]" in command["description"] and "unit" not in command, command
    instance, rng = Instance(fmu), np.random.default_rng(0)
    plant = plant_for(scene, "native")
    instance.start()
    for _ in range(100):
        row = rng.normal(0.0, 5.0, 3)
        assert instance.set("command", row) == OK, instance.printed
        assert instance.step(PERIOD) == OK, instance.printed
        plant.exchange(row)
        assert np.array_equal(instance.get("truth.q"), plant.state.q), plant.t
        assert np.array_equal(instance.get("applied"), plant.measured.applied), plant.t


def slave(unpacked: Path, name: str) -> tuple[Any, dict[str, Any]]:
    description = fmpy.read_model_description(unpacked)
    slave_ = FMU3Slave(
        guid=description.guid, modelIdentifier=description.coSimulation.modelIdentifier,
        unzipDirectory=str(unpacked), instanceName=name,
    )  # fmt: skip
    slave_.instantiate()
    return slave_, {v.name: v.valueReference for v in description.modelVariables}


def test_fmpy_saves_restores_and_goes_on_with_equal_bits(unpacked: Path) -> None:
    """Two instances side by side, a state within one, its bytes in the other; then again."""
    (slave_, at), (second, _) = slave(unpacked, "one"), slave(unpacked, "other")
    rng = np.random.default_rng(2)
    stiffness = at["joints.elbow.gear.stiffness"]

    def go_on(which: Any, first: int, rows: np.ndarray) -> list[float]:
        reported = []
        for k, row in enumerate(rows):
            which.setFloat64([at["command"]], row)
            if k == 10:
                which.setFloat64([stiffness], [3e4])
            which.doStep(currentCommunicationPoint=(first + k) * PERIOD,
                         communicationStepSize=PERIOD)  # fmt: skip
            reported += which.getFloat64([at["truth.q"], at["truth.v"]], nValues=6)
        return reported

    for which in (slave_, second):
        which.enterInitializationMode(startTime=0.0)
        which.exitInitializationMode()
    go_on(slave_, 0, rng.normal(0.0, 5.0, (50, 3)))
    state = slave_.getFMUState()
    saved = slave_.serializeFMUState(state)
    rows = rng.normal(0.0, 5.0, (50, 3))
    expected = go_on(slave_, 50, rows)
    slave_.setFMUState(state)
    assert go_on(slave_, 50, rows) == expected, "from a state in memory"
    slave_.freeFMUState(state)
    second.setFMUState(second.deserializeFMUState(saved))
    assert go_on(second, 50, rows) == expected, "in another instance, from bytes"
    for which in (slave_, second):
        which.terminate()
        which.freeInstance()


def test_the_servo_of_the_page_moves_the_arm(unit: Path) -> None:
    command = [sys.executable, str(ROOT / "examples" / "simulate_fmu.py"), str(unit)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "q [rad]: [0.2 0.5 0.8]", done.stdout


def test_units_of_two_scenes_live_in_the_same_program(
    unit: Path, rich: Path, tmp_path: Path
) -> None:
    """Each calls its own machine, though their functions have the same names for all to see."""
    files = unit, rich
    together = [
        Instance(Fmu(file, tmp_path / file.stem, ctypes.RTLD_GLOBAL | 0x1)) for file in files
    ]
    for instance in together:
        instance.start()
        assert instance.step(10 * PERIOD) == OK, instance.printed
    alone = Instance(Fmu(files[1], tmp_path / "again"))
    alone.start()
    assert alone.step(10 * PERIOD) == OK, alone.printed
    assert together[1].everything() == alone.everything(), "as if it were alone"


def test_a_single_command_compiles_the_sources(unit: Path, unpacked: Path, tmp_path: Path) -> None:
    """The compilation of its page; the result goes on from a state of the shipped binary."""
    page = (unpacked / "documentation" / "index.html").read_text()
    command = html.unescape(re.findall(r"<pre>(.*?)</pre>", page, re.S)[0])
    sources = tmp_path / "sources"
    shutil.copytree(unpacked / "sources", sources)
    subprocess.run(command, shell=True, cwd=sources, check=True)
    rebuilt = tmp_path / "rebuilt.fmu"
    with zipfile.ZipFile(unit) as archive, zipfile.ZipFile(rebuilt, "w") as rebuilt_archive:
        for name in archive.namelist():
            built = sources / "three_axis.so"
            rebuilt_archive.writestr(
                name, built.read_bytes() if name.endswith(".so") else archive.read(name)
            )
    instance = Instance(Fmu(unit, tmp_path / "one"))
    rebuilt_instance = Instance(Fmu(rebuilt, tmp_path / "other"))
    instance.start()
    assert instance.set("command", [5.0, -5.0, 3.0]) == OK, instance.printed
    assert instance.step(20 * PERIOD) == OK, instance.printed
    assert rebuilt_instance.restore(instance.save()) == OK, rebuilt_instance.printed
    for which in (instance, rebuilt_instance):
        assert which.step(20 * PERIOD) == OK, which.printed
    assert instance.everything() == rebuilt_instance.everything(), "equal bits"


def test_the_description_of_the_build_is_that_of_the_schema(unpacked: Path) -> None:
    schema = etree.XMLSchema(etree.parse(str(FMPY / "schema/fmi3/fmi3BuildDescription.xsd")))
    schema.assertValid(etree.parse(str(unpacked / "sources" / "buildDescription.xml")))


ENUMERATORS = {
    3: (
        *(f"fmi3{name}" for name in ("OK", "Warning", "Discard", "Error", "Fatal")),
        *(f"fmi3{name}" for name in ("Independent", "Constant", "Fixed", "Tunable", "Discrete",
                                     "Dependent")),
        *(f"fmi3Interval{name}" for name in ("NotYetKnown", "Unchanged", "Changed")),
    ),
    2: (
        *(f"fmi2{name}" for name in ("OK", "Warning", "Discard", "Error", "Fatal", "Pending")),
        *(f"fmi2{name}" for name in ("ModelExchange", "CoSimulation")),
        *(f"fmi2{name}" for name in ("DoStepStatus", "PendingStatus", "LastSuccessfulTime",
                                     "Terminated")),
    ),
}  # fmt: skip
# Of FMI 2 for model exchange, which a unit for co-simulation need not have.
MODEL_EXCHANGE = {
    f"fmi2{name}"
    for name in (
        "EnterEventMode", "NewDiscreteStates", "EnterContinuousTimeMode", "CompletedIntegratorStep",
        "SetTime", "SetContinuousStates", "GetDerivatives", "GetEventIndicators",
        "GetContinuousStates", "GetNominalsOfContinuousStates",
    )
}  # fmt: skip


@pytest.mark.parametrize(("version", "count"), [(3, 75), (2, 34)])
def test_our_declarations_are_those_of_the_standard(
    version: int, count: int, tmp_path: Path
) -> None:
    """Every function of its headers is declared, with the same binary interface."""
    official = (FMPY / "c-code" / f"fmi{version}Functions.h").read_text()
    names = re.findall(rf"^\s*FMI{version}_Export (fmi\w+)TYPE\s+fmi\w+;", official, re.M)
    names = [name for name in names if name not in MODEL_EXCHANGE]
    assert len(names) == count, "the functions are found"
    checks = [f"static_assert(kSame<official::{name}TYPE, decltype({name})>);" for name in names]
    checks += [
        f"static_assert(int(official::{enumerator}) == int({enumerator}));"
        for enumerator in ENUMERATORS[version]
    ]
    if version == 2:
        for member in ("logger", "componentEnvironment"):
            official_, ours = (f"offsetof({at}fmi2CallbackFunctions, {member})"
                               for at in ("official::", ""))  # fmt: skip
            checks.append(f"static_assert({official_} == {ours});")
    source = tmp_path / "same.cpp"
    source.write_text(
        f"""\
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <type_traits>
namespace official {{
#include "fmi{version}FunctionTypes.h"
}}
#include "fmi{version}.h"
"""
        + SAME
        + "\n".join(checks)
    )
    folders = [f"-I{FMPY / 'c-code'}", f"-I{ROOT / 'packages/arm_emulator_fmu/arm_emulator_fmu'}"]
    subprocess.run(["c++", "-std=c++20", "-fsyntax-only", *folders, str(source)], check=True)


# Enumerations and structs of the two headers are different types, of the same binary interface.
SAME = """
template <class A, class B>
constexpr bool kAlike = (std::is_enum_v<A> && std::is_enum_v<B> && sizeof(A) == sizeof(B)) ||
                        (std::is_class_v<A> && std::is_class_v<B> && sizeof(A) == sizeof(B));
template <class A, class B>
struct Same : std::bool_constant<std::is_same_v<A, B> || kAlike<A, B>> {};
template <class A, class B>
struct Same<A*, B*>
    : std::bool_constant<std::is_const_v<A> == std::is_const_v<B> &&
                         Same<std::remove_const_t<A>, std::remove_const_t<B>>::value> {};
template <class A, class B, class... As, class... Bs>
  requires(sizeof...(As) == sizeof...(Bs))
struct Same<A(As...), B(Bs...)>
    : std::bool_constant<Same<A, B>::value && (Same<As, Bs>::value && ...)> {};
template <class A, class B>
constexpr bool kSame = Same<A, B>::value;
static_assert(!kSame<void(int*), void(const int*)> && !kSame<void(int), void(int, int)>);
static_assert(!kSame<void(double*), void(float*)>);
"""
