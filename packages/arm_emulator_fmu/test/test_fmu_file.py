"""The file of a unit: its description, its units, its bytes, its arguments."""

import math
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from draws import FULL
from fmu_client import Fmu, Instance, rich_machine
from fuzz.cores import random_machine
from machines import write_scene
from own_fmu import fmu, scene
from random_scenes import NAMES as ODD_NAMES
from random_scenes import draw

from arm_emulator import Refusal, Scene, load_scene
from arm_emulator.machine.scene.known_parts import PARTS
from arm_emulator_fmu.commands.fmu import write_unit as write_fmu
from arm_emulator_fmu.export import export
from arm_emulator_fmu.model_description import describe_model, describe_model_2
from arm_emulator_fmu.units import find_powers
from arm_emulator_fmu.variables import list_scalars, list_variables
from oracles.random_chain import write_slides

__all__ = ["fmu", "scene"]  # fixtures


# Of joints: in URDFs, whose XML has no other control characters than those.
ODD = [name for name in ODD_NAMES if name and not set(name) & set("\0\x1b\r\n\t")]


ODDER = [name for name in ODD if not name.isascii() or set(name) & set("'\"\\<>&")]


def scenes(folder: Path, count: int) -> list[Scene]:
    """Scenes that are taken, of any names and numbers."""
    loaded: list[Scene] = []
    for number in range(10 * count):
        rng = np.random.default_rng([11, number])
        at = folder / str(number)
        try:
            if number % 3 == 0:
                path = random_machine(rng, at, int(rng.integers(1, 7)))
            elif number % 3 == 1:
                path = draw(rng, at)
            else:
                at.mkdir()
                names_to_use = ODD if rng.random() < 0.5 else ODDER
                names = rng.choice(names_to_use, int(rng.integers(1, 4)), replace=False)
                path = rich_machine(at, tuple(map(str, names)))
            loaded.append(load_scene(path, {} if number % 5 else {"varied": ["*"]}))
        except Refusal:
            continue
        if len(loaded) == count:
            break
    return loaded


def test_the_description_of_any_scene_is_sound(tmp_path: Path) -> None:
    """Its names differ, its references lead somewhere, its start values fit."""
    conventions = set()
    for random_scene in scenes(tmp_path, 50 if FULL else 16):
        listed = list_variables(random_scene)
        root = ET.fromstring(describe_model(random_scene, listed, "{token}"))
        elements = root.find("ModelVariables")
        assert elements is not None and len(elements) == len(listed), "all are listed"
        names = [element.attrib["name"] for element in elements]
        assert len(set(names)) == len(names), "names differ"
        assert not any(set(name) & set("\r\n\t") for name in names), "names are of one line"
        units = {element.attrib["name"] for element in root.iter("Unit")}
        for element in elements:
            assert element.attrib.get("unit") in (None, *units), "its unit is defined"
            size = math.prod(int(part.attrib["start"]) for part in element)
            start = element.attrib.get("start")
            assert start is None or len(start.split()) == size, "start values fit"
        single = list_scalars(random_scene)
        root = ET.fromstring(describe_model_2(random_scene, single, "{token}"))
        conventions.add(root.attrib["variableNamingConvention"])
        names = [element.attrib["name"] for element in root.iter("ScalarVariable")]
        assert len(set(names)) == len(names), "names differ"
        assert len(names) == sum(variable.count for variable in listed[1:]), (
            "one per number, but for time"
        )
    assert conventions == {"structured", "flat"}, "names of both kinds are drawn"


def test_units_are_powers_of_base_units() -> None:
    for part in PARTS:
        for key, number in part.list_numbers().items():
            if number.varied and not number.whole:
                assert find_powers(number.unit) is not None, (part.__name__, key, number.unit)
    assert find_powers("V s/rad") == {"kg": 1, "m": 2, "s": -2, "A": -1, "rad": -1}
    assert find_powers("N m/rad3") == {"kg": 1, "m": 2, "s": -2, "rad": -3}


@pytest.mark.slow
def test_equal_scenes_make_equal_files(scene: Scene, fmu: Fmu, tmp_path: Path) -> None:
    files = tmp_path / "a.fmu", tmp_path / "b.fmu"
    for file in files:
        export(scene, file, "native")
    assert files[0].read_bytes() == files[1].read_bytes(), "byte by byte"


@pytest.mark.parametrize(("change", "words"), [
    ({"scene": "no_such"}, "file no_such must exist"),
    ({"varied": "joints.*.color"}, "varied must name numbers"),
    ({"target": "z80"}, "target must be known"),
    ({"out": Path("arm.zip")}, "--out must end in .fmu"),
])  # fmt: skip
def test_unknown_arguments_are_refused(change: dict[str, Any], words: str, tmp_path: Path) -> None:
    arguments = {"scene": "three_axis", "out": tmp_path / "arm.fmu", "target": "native", **change}
    with pytest.raises(Refusal, match=words):
        write_fmu(arguments.pop("scene"), **arguments)
    assert not (tmp_path / "arm.fmu").exists(), "nothing is written"


@pytest.mark.slow
def test_equal_start_values_before_zeros_are_those_of_the_scene(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """GCC 12.1 and 12.2 copied such constant arrays wrongly for processors with AVX-512."""
    monkeypatch.delenv("CXX", raising=False)  # at full optimisation
    names, friction = ("a", "b"), {"viscous": 0.1, "coulomb": 0.2}
    joints = {name: {"friction": friction, "drag": {"coefficient": 1.0}} for name in names}
    varied = {"varied": ["joints.*.friction.viscous"], "faults": ["*"], "integrator": {"dt": 5e-4}}
    scene = load_scene(write_scene(tmp_path, write_slides(names), joints, **varied))
    export(scene, tmp_path / "slides.fmu", "native")
    instance = Instance(Fmu(tmp_path / "slides.fmu", tmp_path / "unpacked"))
    shown = {number.name: float(instance.get(number.name)[0]) for number in scene.varied}
    assert shown == {number.name: number.value for number in scene.varied}
    assert [*shown.values()][:2] == [0.1, 0.1] and len(shown) > 8
