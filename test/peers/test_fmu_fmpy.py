"""Units of FMI in the hands of fmpy: its validation, its importer, and the standard's headers."""

from __future__ import annotations

import ctypes
import html
import io
import re
import subprocess
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("fmpy", reason="fmpy is not installed: make test-peers")

import fmpy
from fmpy.fmi3 import FMU3Slave
from fmpy.validation import validate_fmu
from fmu_client import OK, Fmu, Instance, rich_machine
from lxml import etree
from test_fmu import scenes

from compiled.unit import declare
from emulator_node.compiler import compile_ahead
from emulator_node.core_calls import ARM_CALLS
from emulator_node.plant import Plant
from emulator_node.scene import Scene, load_scene
from fmu.export import export
from fmu.model_description import model_description
from fmu.variables import variables

FMPY = Path(fmpy.__file__).parent
ROOT = Path(__file__).resolve().parents[2]
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
def rich(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("rich")
    names = "a", "b'\"<&>", "c"
    export(load_scene(rich_machine(folder, names)), folder / "rich.fmu", "x86-64-v2")
    return folder / "rich.fmu"


@pytest.fixture(scope="module")
def unpacked(unit: Path) -> Path:
    with zipfile.ZipFile(unit) as archive:
        archive.extractall(unit.parent / "unpacked")
    return unit.parent / "unpacked"


def test_fmpy_finds_no_fault(unit: Path, rich: Path, tmp_path: Path) -> None:
    ur5 = tmp_path / "ur5.fmu"
    export(load_scene("ur5", {"varied": ["joints.*.gear.stiffness"]}), ur5)
    for file in (unit, rich, ur5):
        assert validate_fmu(str(file)) == [], file.name


def test_fmpy_finds_no_fault_in_the_description_of_any_scene(tmp_path: Path) -> None:
    """50 random machines and scenes, whatever names they have."""
    found = scenes(tmp_path, 50)
    assert len(found) == 50, "so many are drawn"
    for scene in found:
        file = io.BytesIO()
        with zipfile.ZipFile(file, "w") as archive:
            text = model_description(scene, variables(scene), "{token}")
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
    told = fmpy.simulate_fmu(
        str(unit), stop_time=count * PERIOD, output_interval=PERIOD, input=signals,
        start_values={"start.q": start}, output=["encoder_counts", "current", "truth.q", "truth.v"],
    )  # fmt: skip
    plant = Plant(three_axis)
    plant.reset(start)
    for row, command in zip(told[1:], signals["command"], strict=False):
        plant.exchange(command)
        state = plant.state
        for name, value in (
            ("encoder_counts", state.encoder_counts), ("current", plant.measured.current),
            ("truth.q", state.q), ("truth.v", state.v),
        ):  # fmt: skip
            assert np.array_equal(row[name], value), (plant.t, name)
    assert len(told) == count + 1, "all of the simulation is compared"


def test_the_portable_binary_equals_the_portable_library(tmp_path: Path) -> None:
    scene = load_scene("three_axis")
    export(scene, tmp_path / "arm.fmu")
    one = Instance(Fmu(tmp_path / "arm.fmu", tmp_path / "unpacked"))
    library = compile_ahead(scene, "x86-64-v2", tmp_path / "lib")[0]
    plant = Plant(scene, core=declare(ctypes.CDLL(str(library)), ARM_CALLS))
    one.start()
    rng = np.random.default_rng(1)
    for _ in range(200):
        command = rng.normal(0.0, 5.0, 3)
        assert one.set("command", command) == OK, one.said
        assert one.step(PERIOD) == OK, one.said
        plant.exchange(command)
    assert np.array_equal(one.get("truth.q"), plant.state.q), "equal bits"
    assert np.array_equal(one.get("truth.current"), plant.state.current), "equal bits"


def slave(unpacked: Path, name: str) -> tuple[Any, dict[str, Any]]:
    description = fmpy.read_model_description(unpacked)
    one = FMU3Slave(
        guid=description.guid, modelIdentifier=description.coSimulation.modelIdentifier,
        unzipDirectory=str(unpacked), instanceName=name,
    )  # fmt: skip
    one.instantiate()
    return one, {v.name: v.valueReference for v in description.modelVariables}


def test_fmpy_saves_restores_and_goes_on_with_equal_bits(unpacked: Path) -> None:
    """Two instances side by side, a state within one, its bytes in the other; then again."""
    (one, at), (other, _) = slave(unpacked, "one"), slave(unpacked, "other")
    rng = np.random.default_rng(2)
    stiffness = at["joints.elbow.gear.stiffness"]

    def go_on(which: Any, first: int, rows: np.ndarray) -> list[float]:
        told = []
        for k, row in enumerate(rows):
            which.setFloat64([at["command"]], row)
            if k == 10:
                which.setFloat64([stiffness], [3e4])
            which.doStep(currentCommunicationPoint=(first + k) * PERIOD,
                         communicationStepSize=PERIOD)  # fmt: skip
            told += which.getFloat64([at["truth.q"], at["truth.v"]], nValues=6)
        return told

    for which in (one, other):
        which.enterInitializationMode(startTime=0.0)
        which.exitInitializationMode()
    go_on(one, 0, rng.normal(0.0, 5.0, (50, 3)))
    state = one.getFMUState()
    saved = one.serializeFMUState(state)
    rows = rng.normal(0.0, 5.0, (50, 3))
    wanted = go_on(one, 50, rows)
    one.setFMUState(state)
    assert go_on(one, 50, rows) == wanted, "from a state in memory"
    one.freeFMUState(state)
    other.setFMUState(other.deserializeFMUState(saved))
    assert go_on(other, 50, rows) == wanted, "in another instance, from bytes"
    for which in (one, other):
        which.terminate()
        which.freeInstance()


def test_units_of_two_scenes_live_in_one_program(unit: Path, rich: Path, tmp_path: Path) -> None:
    """Each calls its own machine, though their functions have the same names for all to see."""
    files = unit, rich
    together = [
        Instance(Fmu(file, tmp_path / file.stem, ctypes.RTLD_GLOBAL | 0x1)) for file in files
    ]
    for one in together:
        one.start()
        assert one.step(10 * PERIOD) == OK, one.said
    alone = Instance(Fmu(files[1], tmp_path / "again"))
    alone.start()
    assert alone.step(10 * PERIOD) == OK, alone.said
    assert together[1].everything() == alone.everything(), "as if it were alone"


def test_one_command_compiles_the_sources(unit: Path, unpacked: Path, tmp_path: Path) -> None:
    """That of its page; what comes out goes on from a state of the binary that came along."""
    page = (unpacked / "documentation" / "index.html").read_text()
    command = html.unescape(re.findall(r"<pre>(.*?)</pre>", page, re.S)[0])
    sources = tmp_path / "sources"
    sources.mkdir()
    for file in (unpacked / "sources").iterdir():
        (sources / file.name).write_bytes(file.read_bytes())
    subprocess.run(command, shell=True, cwd=sources, check=True)
    rebuilt = tmp_path / "rebuilt.fmu"
    with zipfile.ZipFile(unit) as archive, zipfile.ZipFile(rebuilt, "w") as made:
        for name in archive.namelist():
            built = sources / "three_axis.so"
            made.writestr(name, built.read_bytes() if name.endswith(".so") else archive.read(name))
    one = Instance(Fmu(unit, tmp_path / "one"))
    other = Instance(Fmu(rebuilt, tmp_path / "other"))
    one.start()
    assert one.set("command", [5.0, -5.0, 3.0]) == OK, one.said
    assert one.step(20 * PERIOD) == OK, one.said
    assert other.restore(one.save()) == OK, other.said
    for which in (one, other):
        assert which.step(20 * PERIOD) == OK, which.said
    assert one.everything() == other.everything(), "equal bits"


def test_the_description_of_the_build_is_that_of_the_schema(unpacked: Path) -> None:
    schema = etree.XMLSchema(etree.parse(str(FMPY / "schema/fmi3/fmi3BuildDescription.xsd")))
    schema.assertValid(etree.parse(str(unpacked / "sources" / "buildDescription.xml")))


ENUMERATORS = (
    *(f"fmi3{name}" for name in ("OK", "Warning", "Discard", "Error", "Fatal")),
    *(f"fmi3{name}" for name in ("Independent", "Constant", "Fixed", "Tunable", "Discrete",
                                 "Dependent")),
    *(f"fmi3Interval{name}" for name in ("NotYetKnown", "Unchanged", "Changed")),
)  # fmt: skip


def test_our_declarations_are_those_of_the_standard(tmp_path: Path) -> None:
    """Every function of its headers is declared, with the same binary interface."""
    official = (FMPY / "c-code" / "fmi3Functions.h").read_text()
    names = re.findall(r"^FMI3_Export (fmi3\w+)TYPE\s+fmi3\w+;", official, re.M)
    assert len(names) == 75, "the functions are found"
    checks = [f"static_assert(kSame<official::{name}TYPE, decltype({name})>);" for name in names]
    checks += [f"static_assert(int(official::{one}) == int({one}));" for one in ENUMERATORS]
    source = tmp_path / "same.cpp"
    source.write_text(
        """\
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <type_traits>
namespace official {
#include "fmi3FunctionTypes.h"
}
#include "fmi3.h"

// Enumerations of the two headers are different types, of the same binary interface.
template <class A, class B>
constexpr bool kEnums = std::is_enum_v<A> && std::is_enum_v<B> && sizeof(A) == sizeof(B);
template <class A, class B>
struct Same : std::bool_constant<std::is_same_v<A, B> || kEnums<A, B>> {};
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
        + "\n".join(checks)
    )
    folders = [f"-I{FMPY / 'c-code'}", f"-I{ROOT / 'fmu'}"]
    subprocess.run(["c++", "-std=c++20", "-fsyntax-only", *folders, str(source)], check=True)
