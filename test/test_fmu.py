"""Units of FMI 3.0 against `Plant`, and under everything that an importer may do wrong.

What needs the standard's own schemas and importers of others is in test/peers/test_fmu_fmpy.py.
"""

from __future__ import annotations

import ctypes
import json
import math
import subprocess
import sys
import xml.etree.ElementTree as ET
from concurrent.futures import ThreadPoolExecutor
from fractions import Fraction
from pathlib import Path
from time import sleep
from typing import Any

import numpy as np
import pytest
from draws import FULL, some
from fmu_client import DISCARD, ERROR, OK, Fmu, Instance, abuse, rich_machine
from fuzz.cores import environment, random_machine
from random_scenes import NAMES as ODD_NAMES
from random_scenes import draw

from arm_emulator.base.refusal import Refusal
from arm_emulator.build.c_header import Library
from arm_emulator.cli.commands.fmu import fmu as write_fmu
from arm_emulator.doors.fmu.export import export
from arm_emulator.doors.fmu.model_description import model_description
from arm_emulator.doors.fmu.model_description_2 import model_description_2
from arm_emulator.doors.fmu.units import unit_of
from arm_emulator.doors.fmu.variables import scalars, variables
from arm_emulator.machine.core_calls import ARM
from arm_emulator.machine.external_wrench import ExternalWrench
from arm_emulator.machine.parts.known import PARTS
from arm_emulator.machine.plant import Plant
from arm_emulator.machine.scene import Scene, load_scene

TEST = Path(__file__).resolve().parent
NAMES = 'hip\'s "<1>"', "lift"
PERIOD = 1e-3
MASS, STIFFNESS = "payload.mass", "joints.'hip\\'s \\\"<1>\\\"'.gear.stiffness"
MEASURED = (
    "current", "brake_closed", "index_counts", "index_pulses", "link_encoder_counts",
    "link_index_counts", "link_index_pulses", "torque",
)  # fmt: skip


LINES = "command_*", "measurement_*", "controller_*", "encoders_swapped"


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    faults = [f"*.{kind}" for kind in LINES]
    return load_scene(rich_machine(tmp_path_factory.mktemp("rich"), NAMES, faults=faults))


@pytest.fixture(scope="module")
def fmu(scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Fmu:
    folder = tmp_path_factory.mktemp("unit")
    export(scene, folder / "rich.fmu", "native")
    return Fmu(folder / "rich.fmu", folder / "unpacked")


@pytest.fixture
def plant(scene: Scene, fmu: Fmu) -> Plant:
    """The same machine at another door: arm.h of the unit's binary."""
    return Plant(scene, core=Library(fmu.binary._name, (ARM,)))


def compare(one: Instance, plant: Plant, start: float = 0.0) -> None:
    """Compare all that the unit reports, bit by bit."""
    state, measured = plant.state, plant.measured
    reported: dict[str, Any] = {name: getattr(measured, name) for name in MEASURED}
    reported |= {
        "encoder_counts": measured.encoder_counts,
        "current_d": plant.measured.current_d,
        "applied_d": plant.measured.applied_d,
        "applied": plant.measured.applied,
        "powered": plant.powered,
        "specific_force.'unit 1'": measured.specific_force[0],
        "angular_rate.'unit 1'": measured.angular_rate[0],
        "truth.q": state.q,
        "truth.v": state.v,
        "truth.gear_torque": state.gear_torque,
        "truth.motor_angle": state.theta_m,
        "truth.motor_speed": state.omega_m,
        "truth.current": state.current,
        "truth.energy": plant.energy,
        "truth.winding_temperature.'hip\\'s \\\"<1>\\\"'": plant.winding_temperatures[0],
        "faults": measured.faults,
    }
    outputs = {n for n, v in one.fmu.variables.items() if v.attrib["causality"] == "output"}
    assert outputs == set(reported), "every output is compared"
    for name, value in reported.items():
        got = one.get(name)
        assert np.array_equal(got, np.atleast_1d(value)), (name, plant.t, got, value)
    # A product here, a sum there.
    assert one.get("time")[0] == pytest.approx(start + plant.t, abs=1e-9), "time goes along"


def quoted(name: str) -> str:
    """The name of a fault as FMI writes it."""
    owner, _, kind = name.rpartition(".")
    escaped = owner.replace("'", "\\'").replace('"', '\\"')
    return f"{owner if owner.isidentifier() else chr(39) + escaped + chr(39)}.{kind}"


def set_all(one: Instance, values: dict[str, Any]) -> None:
    """Set variables; all are taken."""
    for name, value in values.items():
        assert one.set(name, value) == OK, one.printed


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
    one = Instance(fmu)
    set_all(one, {"start.q": rng.normal(0.0, 0.3, len(NAMES)), **random_inputs(rng)})
    one.start()
    assert one.step(periods * PERIOD) == OK, one.printed
    return one


@pytest.mark.parametrize("seed", some(range(20), 3))
def test_a_unit_moves_as_plant_does_to_the_last_bit(fmu: Fmu, plant: Plant, seed: int) -> None:
    """Under random commands, forces, power cuts, parameters, steps and faults of the lines."""
    rng = np.random.default_rng(seed)
    one, start = Instance(fmu), 5.0 * seed
    faults = {f"faults.{quoted(fault.name)}": fault.varied for fault in plant.scene.faults}
    assert len(faults) == 2 * 12 + 1, "the last joint has no neighbour to swap encoders with"

    def vary() -> None:
        mass, stiffness = float(rng.uniform(0.1, 2.0)), float(10.0 ** rng.uniform(3, 5))
        set_all(one, {MASS: mass, STIFFNESS: stiffness})
        plant.set_parameter("payload.mass", mass)
        plant.set_parameter(f"joints.{NAMES[0]}.gear.stiffness", stiffness)
        for name in rng.choice([*faults], 3):
            varied = faults[name]
            size = float(rng.choice([0.0, 0.3, 1.0])) * varied.number.default
            set_all(one, {name: size})
            plant.set_parameter(varied.name, size)

    q, v = rng.normal(0.0, 0.3, (2, len(NAMES)))
    set_all(one, {"start.q": q, "start.v": v})
    vary()
    plant.reset(q, v)
    compare(one, plant)
    one.start(start)
    for _ in range(60):
        inputs = random_inputs(rng)
        set_all(one, inputs)
        axes = "world" if inputs["external.world_axes"] else "link"
        for j, joint in enumerate(NAMES):
            rows = {
                name: tuple(inputs[f"external.{name}"][j]) for name in ("force", "moment", "point")
            }
            plant.set_external_wrench(f"{joint}_link", ExternalWrench(**rows, axes=axes))
        if rng.random() < 0.2:
            plant.powered = bool(rng.integers(2))
            set_all(one, {"power": plant.powered})
        if rng.random() < 0.2:
            vary()
        periods = int(rng.integers(1, 6))
        assert one.step(periods * PERIOD) == OK, one.printed
        for _ in range(periods):
            plant.exchange(inputs["command"], command_d=inputs["command_d"])
        compare(one, plant, start)


@pytest.mark.parametrize("seed", some(range(20), 5))
def test_a_state_that_was_kept_goes_on_with_equal_bits(fmu: Fmu, seed: int) -> None:
    """Within an instance, in another one, in a new one; kept at any time of its life."""
    rng = np.random.default_rng(seed)
    one = moved(fmu, seed) if seed % 5 else Instance(fmu)
    if seed % 5 == 1:
        one.call("Terminate")
    saved = one.save()
    assert one.save() == saved, "equal states have equal bytes"

    def go_on(instance: Instance) -> dict[str, bytes]:
        if seed % 5 == 0:
            instance.start()
        if seed % 5 != 1:
            set_all(instance, inputs)
            assert instance.step(7 * PERIOD) == OK, instance.printed
        return instance.everything()

    inputs = random_inputs(rng)
    wanted = go_on(one)
    others = [one, Instance(fmu), moved(fmu, seed + 100)]
    others[1].call("DoStep", 0.0, 1.0, True, None, None, None, None)  # an error; it is over
    for other in others:
        assert other.restore(saved) == OK, other.printed
        assert other.save() == saved, "what comes back is what was kept"
        assert go_on(other) == wanted, "it goes on with equal bits"


def test_a_spoiled_state_is_refused(fmu: Fmu) -> None:
    one = moved(fmu, 1)
    saved, rng = one.save(), np.random.default_rng(0)
    for _ in range(200):
        spoiled = bytearray(saved)
        spoiled[int(rng.integers(len(saved)))] ^= 1 << int(rng.integers(8))
        other = Instance(fmu)
        assert other.restore(bytes(spoiled)) == ERROR, "one bit is spoiled"
    assert Instance(fmu).restore(saved[:-8]) == ERROR, "it is cut short"


def test_a_reset_makes_it_new(fmu: Fmu) -> None:
    rng = np.random.default_rng(3)
    one, new = moved(fmu, 3), Instance(fmu)
    set_all(one, {"power": False, MASS: 3.0})
    assert one.step(PERIOD) == OK, one.printed
    assert one.call("Reset") == OK, one.printed
    assert one.everything() == new.everything(), "all start values are there again"
    inputs = random_inputs(rng)
    for instance in (one, new):
        instance.start()
        set_all(instance, inputs)
        assert instance.step(20 * PERIOD) == OK, instance.printed
    assert one.everything() == new.everything(), "it moves as a new one"


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_inputs_not_finite_are_discarded_and_change_nothing(fmu: Fmu, bad: float) -> None:
    """At any place of any variable, while others in the same row are sound."""
    rng = np.random.default_rng(4)
    for one in (Instance(fmu), moved(fmu, 4)):
        before = one.save()
        for name, variable in fmu.variables.items():
            kind = variable.attrib["causality"], variable.attrib["variability"]
            now = kind in (("input", "continuous"), ("parameter", "tunable")) or (
                kind == ("parameter", "fixed") and one.time == 0.0
            )
            if not now:
                continue
            values = rng.normal(0.0, 1.0, fmu.size(name))
            values[int(rng.integers(len(values)))] = bad
            assert one.set(name, values) == DISCARD, name
            assert "be finite" in one.printed[-1][2], "the reason is reported"
            assert one.save() == before, f"{name} changed something"


def test_inputs_out_of_bounds_are_discarded(fmu: Fmu) -> None:
    one = moved(fmu, 5)
    before = one.save()
    for name, value, rule in (
        (MASS, -1.0, "within its bounds"),
        (STIFFNESS, -1.0, "within its bounds"),
        ("command_d", [0.0, 1.0], "no such input"),
        ("external.force", [1e10] + [0.0] * 5, "at most 1e9"),
    ):
        assert one.set(name, value) == DISCARD, name
        assert rule in one.printed[-1][2], one.printed[-1]
    assert one.save() == before, "nothing changed"
    assert one.set("start.q", [0.0, 0.0]) == ERROR, "it has begun"
    early = Instance(fmu)
    assert early.set("start.q", [1e9, 0.0]) == DISCARD, early.printed
    assert early.set("start.v", [0.0, -1e7]) == DISCARD, early.printed


def random_lengths(seed: int) -> list[float]:
    """Lengths of steps, mostly of some periods, some far shorter."""
    rng = np.random.default_rng(seed)
    return (PERIOD * 10.0 ** rng.uniform(-3.0, 1.0, 120)).tolist()


@pytest.mark.parametrize(
    "lengths",
    [
        [1 / 60] * 30,
        [1e-5] * 2000,
        [PERIOD / 3] * 100,
        [math.pi * 1e-3] * 60,
        [1e-9] * 50 + [0.7 * PERIOD] * 20,
        *map(random_lengths, some(range(20), 3)),
    ],
    ids=lambda lengths: f"{len(lengths)}x{lengths[0]:.3g}",
)
def test_steps_of_any_length_move_as_plant_with_the_inputs_held(
    fmu: Fmu, plant: Plant, lengths: list[float]
) -> None:
    """A servo period has the inputs of the step in which it begins; outputs are those of ticks."""
    rng = np.random.default_rng(len(lengths))
    one, start, rounding = Instance(fmu), 12.5, Fraction(PERIOD) / 10**6
    one.start(start)
    plant.reset(plant.scene.start)
    period, time, ticks = Fraction(PERIOD), Fraction(0), 0
    held: dict[str, Any] | None = None  # none: the next period begins with the next step

    def let_go_on(inputs: dict[str, Any]) -> None:
        plant.set_parameter("payload.mass", inputs[MASS])
        plant.exchange(inputs["command"], command_d=inputs["command_d"])

    mass = 0.5
    for k, length in enumerate(lengths):
        if rng.random() < 0.1:
            mass = float(rng.uniform(0.1, 2.0))
        drawn = random_inputs(rng)
        inputs = {"command": drawn["command"], "command_d": drawn["command_d"], MASS: mass}
        set_all(one, inputs)
        held = held or inputs
        assert one.step(length) == OK, one.printed
        time += Fraction(length)
        while held and time >= (ticks + 1) * period - rounding:
            let_go_on(held)
            ticks += 1
            held = inputs if time > ticks * period + rounding else None
        if k % 7 and k < len(lengths) - 1:
            continue
        now = {"encoder_counts": plant.measured.encoder_counts, "truth.q": plant.state.q,
               "truth.v": plant.state.v, "applied": plant.measured.applied}  # fmt: skip
        for name, value in now.items():
            assert np.array_equal(one.get(name), value), (name, k, float(time))
        assert one.get("time")[0] == pytest.approx(start + float(time), abs=1e-9), "time"
        assert one.restore(one.save()) == OK, "a state in the midst of a period"
    assert ticks > 10, "it has moved"


def test_a_step_beyond_all_bounds_is_discarded(fmu: Fmu) -> None:
    one = moved(fmu, 6)
    before = one.save()
    assert one.step(1e300) == DISCARD, one.printed
    assert "must be at most" in one.printed[-1][2], one.printed[-1]
    assert one.save() == before, "nothing changed"
    assert one.step(PERIOD) == OK, "it goes on"


@pytest.mark.parametrize("until", [0.0, 3.0, 7.4, 400.0])
def test_a_step_can_return_early(fmu: Fmu, plant: Plant, until: float) -> None:
    """At the tick at which it is asked to, or later; the importer looks at the machine then."""
    seen: list[tuple[float, float]] = []

    def watch(time: float) -> float | None:
        seen.append((time, one.get("truth.q")[0]))
        return None if len(seen) < 5 else time + until * PERIOD

    one = Instance(fmu, watch=watch)
    one.start()
    set_all(one, {"command": [3.0, 4.0]})
    end = (5.0 + until) * PERIOD
    assert one.step(100.6 * PERIOD) == OK, one.printed
    assert one.early == (until < 95.0), "it reports that it came back early"
    ended = one.get("time")[0]
    assert ended == pytest.approx(min(end, 100.6 * PERIOD), abs=1e-12), "where it ended"
    plant.reset(plant.scene.start)
    for time, q in seen:
        plant.exchange([3.0, 4.0])
        assert (time, q) == (pytest.approx(plant.t), plant.state.q[0]), "what was seen at a tick"
    one.time = ended
    assert one.step(20.0 * PERIOD) == OK, one.printed
    patient = Instance(fmu)
    patient.start()
    set_all(patient, {"command": [3.0, 4.0]})
    assert patient.step(one.get("time")[0]) == OK, patient.printed
    assert np.array_equal(one.get("truth.q"), patient.get("truth.q")), "it goes on"


def test_a_step_can_be_ended_from_another_thread(fmu: Fmu) -> None:
    one = Instance(fmu)
    one.start()
    with ThreadPoolExecutor(1) as threads:
        step = threads.submit(one.step, 1e9)  # some weeks
        sleep(0.2)
        assert one.call("Terminate") == OK, one.printed
        assert step.result(timeout=30.0) == DISCARD, one.printed
    assert 0.0 < one.get("time")[0] < 1e9, "where it ended"
    assert one.step(PERIOD) == ERROR, "it is over"
    assert one.call("Reset") == OK, one.printed


def test_steps_are_taken_as_importers_compute_them(fmu: Fmu) -> None:
    """As a constant, as a difference of times, as times that are summed up."""
    wanted, start = Instance(fmu), 1e4 + 0.1
    wanted.start(start)
    assert wanted.step(3000 * PERIOD) == OK, wanted.printed
    differences, summed = Instance(fmu), Instance(fmu)
    for one in (differences, summed):
        one.start(start)
    for k in range(3000):
        now, then = start + k * PERIOD, start + (k + 1) * PERIOD
        differences.time = now
        assert differences.step(then - now) == OK, differences.printed
    time = start
    for _ in range(3000):
        summed.time = time
        assert summed.step(PERIOD) == OK, summed.printed
        time += PERIOD
    assert differences.everything() == wanted.everything() == summed.everything(), "equal bits"


@pytest.mark.parametrize(("at", "step"), [
    (0.0, 0.0), (0.0, -PERIOD), (0.0, math.nan), (0.0, math.inf), (math.nan, PERIOD),
    (PERIOD, PERIOD), (-PERIOD, PERIOD), (0.0, 0.02),
])  # fmt: skip
def test_a_step_that_cannot_be_is_an_error(fmu: Fmu, at: float, step: float) -> None:
    one = Instance(fmu)
    one.start(stop=0.01)
    one.time = at
    assert one.step(step) == ERROR, one.printed
    assert one.call("DoStep", 0.0, PERIOD, True, *[None] * 4) == ERROR, "it is over"
    assert one.call("Reset") == OK, "a reset helps"


def test_a_divergence_is_reported_and_hurts_nobody_else(fmu: Fmu) -> None:
    other, wanted = moved(fmu, 7), moved(fmu, 7)
    one = Instance(fmu, logging=False)
    set_all(one, {"start.v": [9e5, 9e5], MASS: 1e15})
    one.start()
    set_all(one, {"external.force": [1e9] * 6, "external.moment": [1e9] * 6})
    status = OK
    for _ in range(1000):
        status = status or one.step(PERIOD)
    assert status == ERROR, "it diverges"
    last, category, text = one.printed[-1]
    assert (last, category) == (ERROR, "logStatusError"), "reported, though logging is off"
    assert "diverged" in text, text
    for values in map(one.get, ("truth.q", "truth.v", "truth.energy")):
        assert np.isfinite(values).all(), "the last sound state is reported"
    assert one.step(PERIOD) == ERROR, "it is over"
    assert other.step(5 * PERIOD) == OK, other.printed
    assert wanted.step(5 * PERIOD) == OK, wanted.printed
    assert other.everything() == wanted.everything(), "the others do not notice"
    assert one.call("Reset") == OK, one.printed
    new = Instance(fmu)
    for instance in (one, new):
        instance.start()
        assert instance.step(5 * PERIOD) == OK, instance.printed
    assert one.everything() == new.everything(), "a reset makes it sound again"


def test_instances_in_threads_do_not_notice_each_other(fmu: Fmu) -> None:
    """ctypes lets go of Python's lock during a call."""

    def drive(seed: int) -> dict[str, bytes]:
        one = moved(fmu, seed)
        rng = np.random.default_rng(seed)
        for _ in range(20):
            set_all(one, random_inputs(rng))
            assert one.step(50 * PERIOD) == OK, one.printed
        return one.everything()

    alone = [drive(seed) for seed in range(4)]
    with ThreadPoolExecutor(4) as threads:
        together = list(threads.map(drive, range(4)))
    assert together == alone, "equal bits"


def test_brakes_and_drives_obey(fmu: Fmu) -> None:
    one = Instance(fmu)
    one.start()
    set_all(one, {"command": [5.0, 5.0]})
    assert one.step(10 * PERIOD) == OK, one.printed
    assert one.get("applied").tolist() == [5.0, 5.0], "enabled"
    assert not one.get("brake_closed").any(), "a brake opens with its drive"
    set_all(one, {"close_brake": [True, False], "enable": [True, False]})
    assert one.step(10 * PERIOD) == OK, one.printed
    assert one.get("brake_closed").tolist() == [True, False], "a brake closes"
    assert one.get("applied").tolist() == [5.0, 0.0], "a drive is off"
    set_all(one, {"power": False})
    assert one.step(PERIOD) == OK, one.printed
    assert not one.get("powered")[0] and not one.get("applied").any(), "no power"


CALLS = {
    "EnterInitializationMode": (False, 0.0, 0.0, False, 0.0),
    "ExitInitializationMode": (),
    "DoStep": (0.0, PERIOD, True, None, None, None, None),
    "Terminate": (),
}
ALLOWED = {
    "instantiation": {"EnterInitializationMode"},
    "initialization": {"ExitInitializationMode"},
    "step": {"DoStep", "Terminate"},
    "termination": set(),
}


@pytest.mark.parametrize("mode", ALLOWED)
def test_calls_in_the_wrong_mode_are_errors(fmu: Fmu, mode: str) -> None:
    way = ["EnterInitializationMode", "ExitInitializationMode", "Terminate"]
    for name, arguments in CALLS.items():
        one = Instance(fmu)
        for before in way[: list(ALLOWED).index(mode)]:
            assert one.call(before, *CALLS[before]) == OK, one.printed
        wanted = OK if name in ALLOWED[mode] else ERROR
        assert one.call(name, *arguments) == wanted, (mode, name)
        if wanted == ERROR:
            assert mode[:4] in one.printed[-1][2], "the message reports the mode"
            assert one.set("command", [0.0, 0.0]) == ERROR, "after an error nothing can be set"
            assert len(one.get("truth.q")) == 2, "but looked at"


def test_null_instances_and_wrong_tokens_are_refused(fmu: Fmu) -> None:
    assert not Instance(fmu, token="{0}").handle, "a token of another unit"
    assert fmu.binary.fmi3Reset(None) == ERROR, "no instance"
    fmu.binary.fmi3FreeInstance(None)
    version = fmu.binary.fmi3GetVersion
    version.restype = ctypes.c_char_p
    assert version() == b"3.0", "of FMI"


def test_messages_go_to_their_categories(fmu: Fmu) -> None:
    one = moved(fmu, 8)
    assert {category for _, category, _ in one.printed} == {"logEvents"}, one.printed
    chosen = (ctypes.c_char_p * 1)(b"logStatusDiscard")
    assert one.call("SetDebugLogging", False, 1, chosen) == OK, one.printed
    count = len(one.printed)
    assert one.step(1e300) == DISCARD, one.printed
    assert len(one.printed) == count, "switched off"
    assert one.call("SetDebugLogging", True, 0, None) == OK, one.printed
    assert one.step(1e300) == DISCARD, one.printed
    assert one.printed[-1][1] == "logStatusDiscard", one.printed
    unknown = (ctypes.c_char_p * 1)(b"logAnything")
    assert one.call("SetDebugLogging", True, 1, unknown) == ERROR, one.printed


def test_any_calls_in_any_order_hurt_nobody(fmu: Fmu) -> None:
    """The same under sanitizers: `test_sanitizers_find_nothing`."""
    statuses = abuse(np.random.default_rng(0), fmu, 30_000 if FULL else 2500)
    assert min(statuses[status] for status in (OK, DISCARD, ERROR)) > 20, statuses


@pytest.mark.skipif(not FULL, reason="compiles with sanitizers: make test-in-full")
def test_sanitizers_find_nothing(tmp_path: Path) -> None:
    """Units of both versions, called in any order: `python -m fuzz.units`."""
    command = [sys.executable, "-m", "fuzz.units", "0", "30000", str(tmp_path)]
    known = environment(tmp_path / "cache")
    known["PYTHONPATH"] = f"{TEST}:{TEST.parent}:{known.get('PYTHONPATH', '')}"
    done = subprocess.run(command, env=known, capture_output=True, check=False)
    assert done.returncode == 0, done.stderr.decode()[-3000:]
    for statuses in json.loads(done.stdout.splitlines()[-1])["statuses"]:
        assert min(statuses[str(status)] for status in (OK, DISCARD, ERROR)) > 200, statuses


# Of joints: in URDFs, whose XML has no other control characters than those.
ODD = [one for one in ODD_NAMES if one and not set(one) & set("\0\x1b\r\n\t")]

ODDER = [one for one in ODD if not one.isascii() or set(one) & set("'\"\\<>&")]


def scenes(folder: Path, count: int) -> list[Scene]:
    """Scenes that are taken, of any names and numbers."""
    found: list[Scene] = []
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
                known = ODD if rng.random() < 0.5 else ODDER
                names = rng.choice(known, int(rng.integers(1, 4)), replace=False)
                path = rich_machine(at, tuple(map(str, names)))
            found.append(load_scene(path, {} if number % 5 else {"varied": ["*"]}))
        except Refusal:
            continue
        if len(found) == count:
            break
    return found


def test_the_description_of_any_scene_is_sound(tmp_path: Path) -> None:
    """Its names differ, its references lead somewhere, its start values fit."""
    conventions = set()
    for scene in scenes(tmp_path, 50 if FULL else 16):
        listed = variables(scene)
        root = ET.fromstring(model_description(scene, listed, "{token}"))
        elements = root.find("ModelVariables")
        assert elements is not None and len(elements) == len(listed), "all are listed"
        names = [one.attrib["name"] for one in elements]
        assert len(set(names)) == len(names), "names differ"
        assert not any(set(name) & set("\r\n\t") for name in names), "names are of one line"
        units = {one.attrib["name"] for one in root.iter("Unit")}
        for one in elements:
            assert one.attrib.get("unit") in (None, *units), "its unit is defined"
            size = math.prod(int(part.attrib["start"]) for part in one)
            start = one.attrib.get("start")
            assert start is None or len(start.split()) == size, "start values fit"
        single = scalars(scene)
        root = ET.fromstring(model_description_2(scene, single, "{token}"))
        conventions.add(root.attrib["variableNamingConvention"])
        names = [one.attrib["name"] for one in root.iter("ScalarVariable")]
        assert len(set(names)) == len(names), "names differ"
        assert len(names) == sum(one.count for one in listed[1:]), "one per number, but for time"
    assert conventions == {"structured", "flat"}, "names of both kinds are drawn"


def test_units_are_powers_of_base_units() -> None:
    for part in PARTS:
        for key, one in part.numbers().items():
            if one.varied and not one.whole:
                assert unit_of(one.unit).powers is not None, (part.__name__, key, one.unit)
    assert unit_of("V s/rad").powers == {"kg": 1, "m": 2, "s": -2, "A": -1, "rad": -1}
    assert unit_of("N m/rad3").powers == {"kg": 1, "m": 2, "s": -2, "rad": -3}


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
    given = {"scene": "three_axis", "out": tmp_path / "arm.fmu", "target": "native", **change}
    with pytest.raises(Refusal, match=words):
        write_fmu(given.pop("scene"), **given)
    assert not (tmp_path / "arm.fmu").exists(), "nothing is written"
