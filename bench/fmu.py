"""Cost of a step through FMI 3.0 beside `tick_run`, from C.

    python -m bench.fmu [SCENE ...]

Each servo period commands are set and encoder counts are got, as an importer does it. Nothing
moves: the commands are 0. Published are medians of interleaved repetitions, of the same binary.
"""

from __future__ import annotations

import sys
import tempfile
import time
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from arm_emulator import Plant, load_scene
from arm_emulator.build.c_header import Header, Library, pointer
from arm_emulator.build.flags import C_FLAGS
from arm_emulator.build.unit import Unit, library
from arm_emulator.doors.fmu.export import export
from arm_emulator.doors.fmu.unit import FOLDER
from arm_emulator.machine.core_calls import ARM
from arm_emulator.tick.c import FOLDERS

PERIODS = 20_000  # of a repetition
LOOP = Header(Path(__file__).with_name("fmu_loop.h"), FOLDERS)


def cost(name: str) -> dict[str, float]:
    """Return the median time of a servo period by what was timed [ns]."""
    scene = load_scene(name)
    source = (Path(__file__).parent / "fmu_loop.c").read_text(encoding="utf-8")
    folders = (*FOLDERS, FOLDER, Path(__file__).parent)
    unit = Unit("fmu_loop", source, C_FLAGS, folders, (LOOP,), "bench", "a loop", "fmu_loop.c")
    loop = library(unit)
    with tempfile.TemporaryDirectory() as scratch:
        file = Path(scratch) / "arm.fmu"
        export(scene, file, "native")
        with zipfile.ZipFile(file) as archive:
            archive.extractall(scratch)
        (binary,) = Path(scratch, "binaries", "x86_64-linux").iterdir()
        core = Library(binary, (ARM,))
        root = ET.parse(Path(scratch) / "modelDescription.xml").getroot()
    listed = {one.attrib["name"]: one.attrib for one in root.iterfind("ModelVariables/*")}
    command, encoder = (int(listed[n]["valueReference"]) for n in ("command", "encoder_counts"))
    token = root.attrib["instantiationToken"].encode()
    instance = loop.begin_fmi(core.file.encode(), token)
    assert instance, "the unit begins"
    plant = Plant(scene, core=core)
    plant.exchange(np.zeros(len(scene.joints)))
    values, counts = np.zeros(len(scene.joints)), np.zeros(len(scene.joints), np.int64)
    at = 0.0

    def by_fmi(periods: int) -> None:
        nonlocal at
        at = loop.run_fmi(
            instance, at, scene.servo_period, periods, PERIODS // periods, command,
            pointer(values), encoder, pointer(counts), len(values),
        )  # fmt: skip
        assert at >= 0.0, "every step is taken"

    def by_arm() -> None:
        assert loop.run_arm(plant.ticks, plant.command, PERIODS) == 0, "taken"

    ways: dict[str, Callable[[], object]] = {
        "tick_run": by_arm,
        "set, fmi3DoStep, get": lambda: by_fmi(1),
        "the same, steps of 10 periods": lambda: by_fmi(10),
    }
    times: dict[str, list[float]] = {way: [] for way in ways}
    for _ in range(15):
        for way, work in ways.items():
            started = time.perf_counter()
            work()
            times[way].append((time.perf_counter() - started) / PERIODS * 1e9)
    loop.end_fmi(instance)
    return {way: float(np.median(some[1:])) for way, some in times.items()}


def main() -> None:
    """Print a line per way."""
    for name in sys.argv[1:] or ("three_axis", "ur5"):
        for way, ns in cost(name).items():
            print(f"{name:12} {way:32} {ns:8.0f} ns per servo period")


if __name__ == "__main__":
    main()
