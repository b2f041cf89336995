"""A unit of a scene, and the same machine as `Plant`."""

from typing import Any

import numpy as np
import pytest
from fmu_client import OK, Fmu, Instance, rich_machine

from arm_emulator import Plant, Scene, load_scene
from arm_emulator.machine.plant.core_calls import ARM
from arm_emulator.toolchain.c_header import Library
from arm_emulator_fmu.export import export

NAMES = "hip [1]: left", "lift"

PERIOD = 1e-3

MASS, STIFFNESS = "payload.mass", "joints.'hip [1]: left'.gear.stiffness"

LINES = "command_*", "measurement_*", "controller_*", "encoders_swapped"


def set_all(instance: Instance, values: dict[str, Any]) -> None:
    """Set variables; all are taken."""
    for name, value in values.items():
        assert instance.set(name, value) == OK, instance.printed


def random_inputs(rng: np.random.Generator) -> dict[str, Any]:
    """Commands and forces."""
    N = len(NAMES)
    return {
        "command": rng.normal(0.0, 20.0, N),
        "command_d": rng.normal(0.0, 20.0, N) * [1.0, 0.0],
        "external.force": rng.normal(0.0, 5.0, (N, 3)),
        "external.moment": rng.normal(0.0, 5.0, (N, 3)),
        "external.point": rng.normal(0.0, 0.3, (N, 3)),
        "external.world_axes": bool(rng.integers(2)),
    }


def moved(fmu: Fmu, seed: int, periods: int = 20) -> Instance:
    """An instance that is on its way."""
    rng = np.random.default_rng(seed)
    instance = Instance(fmu)
    set_all(instance, {"start.q": rng.normal(0.0, 0.3, len(NAMES)), **random_inputs(rng)})
    instance.start()
    assert instance.step(periods * PERIOD) == OK, instance.printed
    return instance


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """A machine with all kinds of parts and all faults of lines."""
    faults = [f"*.{kind}" for kind in LINES]
    return load_scene(rich_machine(tmp_path_factory.mktemp("rich"), NAMES, faults=faults))


@pytest.fixture(scope="module")
def fmu(scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Fmu:
    """Its unit."""
    folder = tmp_path_factory.mktemp("unit")
    export(scene, folder / "rich.fmu", "native")
    return Fmu(folder / "rich.fmu", folder / "unpacked")


@pytest.fixture
def plant(scene: Scene, fmu: Fmu) -> Plant:
    """The same machine at another door: arm.h of the unit's binary."""
    return Plant(scene, core=Library(fmu.binary._name, (ARM,)))
