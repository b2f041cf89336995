"""Both compilers take everything that we compile, and make the same machine of it."""

import itertools
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from importlib.util import find_spec
from pathlib import Path

import pytest
from draws import FULL, some

import arm_emulator
from arm_emulator.machine.plant.compiler import (
    build_equations_unit,
    build_machine_unit,
    build_real_time_unit,
)
from arm_emulator.machine.plant.formula_rows import build_formula_unit
from arm_emulator.machine.scene.scene import load_scene
from arm_emulator.machine.session.record_ring import build_record_ring_unit
from arm_emulator.ros.c import make_middleware_unit
from arm_emulator.runs.servo_step import make_servo_step_unit
from arm_emulator.servo.servo_law import make_servo_unit
from arm_emulator.tick.c import tick_unit
from arm_emulator.toolchain.compiler_command import identify_compiler
from arm_emulator.toolchain.unit import Unit
from arm_emulator_campaign.judging.program import judges_unit
from arm_emulator_campaign.judging.signals import sampler_unit
from arm_emulator_fieldbus.drives_unit import drives_unit
from arm_emulator_fieldbus.ethercat import ethercat_unit
from arm_emulator_fleet.unit import build_fleet_unit
from arm_emulator_fmu.unit import make_unit
from arm_emulator_fmu.variables import list_scalars, list_variables
from emulator_node.c import make_answered_ticks_unit, make_real_time_ticks_unit
from oracles.mixtures import write_mixture
from oracles.part_truths import collect_truths
from servo_node.c import make_answered_states_unit

KINDS = {"g++": range(11, 16), "clang++": range(14, 22)}


def compilers(kind: str) -> list[str]:
    """Return those of a kind that are installed: the newest, or all of them in full."""
    names = [*(f"{kind}-{version}" for version in reversed(KINDS[kind])), kind]
    command_by_compiler: dict[str, str] = {}
    for name in filter(shutil.which, names):
        command_by_compiler.setdefault(identify_compiler([name]), name)
    return some(command_by_compiler.values(), 1)


# Parts that hold another part as their base, with a number of that base; a winding that opens is
# of every motor.
ON_BASE = [("OpenedMotor<DcMotor>{}", "R"), *collect_truths("ON_BASE").values()]
CLANGS = compilers("clang++") or [
    pytest.param(
        "clang++",
        marks=pytest.mark.skip(
            reason="clang++ is not installed (Debian, Ubuntu: apt install clang)"
        ),
    )
]
CORE = Path(arm_emulator.__file__).with_name("core")
BASED = re.compile(r"^struct (\w+) : \w+ \{", re.MULTILINE)
LEVELS = ("native", "x86-64-v4", "x86-64-v3", "x86-64")
COMPILERS = [*(compilers("g++") if FULL else []), *CLANGS]


def units(folder: Path) -> Iterator[Unit]:
    """Yield all that is compiled for shipped scenes and for random mixtures of parts."""
    for name in ("three_axis", "ur5", "panda"):
        scene = load_scene(name)
        yield build_machine_unit(scene)
        yield build_equations_unit(scene)
        yield build_fleet_unit(scene)
        yield make_unit(scene, list_variables(scene), "3")[0]
        yield make_unit(scene, list_scalars(scene), "2")[0]
    yield build_machine_unit(load_scene("manutec_r3"))
    schemes = itertools.cycle(("rosenbrock", "implicit", "extrapolated", "paper"))
    for seed, scheme in zip(some(range(24), 4), schemes, strict=False):
        (folder / str(seed)).mkdir()
        mixture = write_mixture(folder / str(seed), seed)
        events = "located" if scheme == "rosenbrock" else "step"
        integrator = {"integrator.scheme": scheme, "integrator.events": events}
        scene = load_scene(mixture, overrides=integrator)
        yield build_machine_unit(scene)
        yield build_equations_unit(scene)
        yield build_fleet_unit(scene)
    yield from (make_servo_unit(), make_servo_step_unit(), tick_unit(), build_real_time_unit())
    yield from (
        build_record_ring_unit(),
        build_formula_unit(),
        judges_unit(),
        sampler_unit(),
    )
    yield from (drives_unit(), ethercat_unit())
    yield from (
        make_middleware_unit(),
        make_answered_ticks_unit(),
        make_real_time_ticks_unit(),
        make_answered_states_unit(),
    )
    if find_spec("unicorn"):
        from arm_emulator_firmware.microcontroller import make_runner_unit

        yield make_runner_unit()


@pytest.fixture(scope="module")
def sources(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[Unit, list[Path]]]:
    """All units, with the files that hold their sources."""
    unit_sources = []
    for number, unit in enumerate(units(tmp_path_factory.mktemp("scenes"))):
        folder = tmp_path_factory.mktemp(f"{number}_{unit.name}")
        texts = {"unit.cpp": unit.source, "beside.cpp": unit.beside}
        for name, text in texts.items():
            (folder / name).write_text(text)
        unit_sources.append((unit, [folder / name for name, text in texts.items() if text]))
    return unit_sources


def level_of(compiler: str) -> list[str]:
    """Return the flag of the first level that it takes without a word of its own."""
    for level in LEVELS:
        command = [compiler, f"-march={level}", "-fsyntax-only", "-Werror", "-xc++", os.devnull]
        if subprocess.run(command, capture_output=True, check=False).returncode == 0:
            return [f"-march={level}"]
    return []


@pytest.mark.parametrize("compiler", COMPILERS)
def test_a_compiler_takes_everything_without_a_warning(
    compiler: str, sources: list[tuple[Unit, list[Path]]]
) -> None:
    level = level_of(compiler)
    strict = ["-fsyntax-only", "-Wall", "-Wextra", "-Werror", "-DARM_FINGERPRINT=1u"]

    def words_about(unit: Unit, files: list[Path]) -> str:
        flags = [flag for flag in unit.flags if not flag.startswith(("-shared", "-Wl"))]
        folders = [f"-I{folder}" for folder in unit.folders]
        command = [compiler, *flags, *level, *strict, *folders, *map(str, files)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        return f"{done.returncode} {done.stderr}"

    with ThreadPoolExecutor(2) as pool:
        words = list(pool.map(words_about, *zip(*sources, strict=True)))
    for (unit, _), printed in zip(sources, words, strict=True):
        assert printed == "0 ", f"exit code and words about {unit.name}: {printed[:2000]}"


# A run of the arm, its servo's voltages and what is noticed, reported as bits.
RUN = """
import json
import numpy as np
from arm_emulator.machine.plant.diverged import Diverged
from arm_emulator.machine.plant.plant import Plant
from arm_emulator.machine.scene.scene import load_scene
from arm_emulator.servo.servo import Servo, load_servo_config
from arm_emulator.base.refusal import Refusal

scene = load_scene("three_axis", {"joints.waist.encoder.noise": 1e-3})
plant = Plant(scene)
servo = Servo(load_servo_config("config/servo/three_axis.yaml"))
seen, given = [], []
for tick in range(400):
    aim = np.array(scene.start) + 0.1 * np.sin([0.02 * tick, 0.03 * tick, 0.05 * tick])
    counts = np.round(1e4 * np.sin(0.01 * tick * np.arange(1.0, 4.0))).astype(int)
    servo.observe(counts, 0.1 * np.cos(0.1 * tick * np.arange(1.0, 4.0)))
    given.append([float(v).hex() for v in servo.control(aim)])
    plant.advance(10.0 * np.sin(0.03 * tick * np.arange(1.0, 4.0)), scene.steps_per_period)
    seen.append([int(count) for count in plant.measured.encoder_counts])
noticed = []
coarse = {"integrator.scheme": "paper", "integrator.dt": 0.01, "servo_period": 0.01}
rough = Plant(load_scene("three_axis", coarse))
try:
    for _ in range(1000):
        rough.advance(np.full(3, 20.0), 1)
except Diverged as reason:
    noticed.append(str(reason).split(" after")[0])
try:
    plant.put("test", {"q": [np.nan, 0.0, 0.0]})
except Refusal as reason:
    noticed.append(str(reason))
print(json.dumps({"q": [float(q).hex() for q in plant.state.q], "given": given,
                  "counts": seen, "noticed": noticed}))
"""


def machine_of(compiler: str, cache: Path) -> dict[str, list[str]]:
    done = subprocess.run(
        [sys.executable, "-c", RUN],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "CXX": compiler, "ARM_EMULATOR_CACHE": str(cache)},
    )
    assert done.returncode == 0, done.stderr
    values: dict[str, list[str]] = json.loads(done.stdout)
    return values


@pytest.mark.parametrize("compiler", COMPILERS)
def test_compilers_make_the_same_machine(compiler: str, tmp_path: Path) -> None:
    of_g = machine_of("g++", tmp_path / "cache")
    values = machine_of(compiler, tmp_path / "cache")
    assert values == of_g, "bits of angles and of the servo's voltages, and what is noticed"
    assert len(values["noticed"]) == 2, "that it diverges, and that NaN is no angle"


@pytest.mark.parametrize(
    "compiler",
    [f"{kind}-{version}" for kind in KINDS for version in KINDS[kind]],
)
def test_parts_that_differ_in_their_base_are_different(compiler: str, tmp_path: Path) -> None:
    """g++ 11 leaves the base out of a defaulted comparison: a fault of the base had no effect."""
    if not shutil.which(compiler):
        pytest.skip(f"{compiler} is not installed")
    parts = CORE / "parts"
    based = {base for file in parts.rglob("*.hpp") for base in BASED.findall(file.read_text())}
    assert based == {made.partition("<")[0] for made, _ in ON_BASE}
    lines = [f'#include "{file.relative_to(CORE)}"' for file in sorted(parts.rglob("*.hpp"))]
    lines.append("using namespace arm;")
    for k, (made, number) in enumerate(ON_BASE):
        lines += [
            f"constexpr auto part_{k} = {made};",
            f"constexpr auto other_{k} = [] {{",
            f"  auto other = part_{k};",
            f"  other.{number} = 1.0;",
            "  return other;",
            "}();",
            f"static_assert(!(part_{k} == other_{k}));",
        ]
    (tmp_path / "parts.cpp").write_text("\n".join(lines))
    command = [compiler, "-std=c++20", "-fsyntax-only", f"-I{CORE}", "parts.cpp"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
