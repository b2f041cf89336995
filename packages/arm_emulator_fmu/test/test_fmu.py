"""Units of FMI 3.0 against `Plant`, and under everything that an importer may do wrong.

What needs the standard's own schemas and importers of others is in `peers/test_fmu_fmpy.py`."""

import ctypes
import json
import math
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from draws import FULL, some
from fmu_client import DISCARD, ERROR, OK, Fmu, Instance, abuse
from fuzz.cores import environment
from own_fmu import MASS, NAMES, PERIOD, STIFFNESS, fmu, moved, plant, random_inputs, scene, set_all

from arm_emulator import ExternalWrench, Plant

__all__ = ["fmu", "plant", "scene"]  # fixtures


MEASURED = (
    "current", "brake_closed", "index_counts", "index_pulses", "link_encoder_counts",
    "link_index_counts", "link_index_pulses", "torque",
)  # fmt: skip


def compare(instance: Instance, plant: Plant, start: float = 0.0) -> None:
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
        f"truth.winding_temperature.'{NAMES[0]}'": plant.winding_temperatures[0],
        "faults": measured.faults,
    }
    outputs = {n for n, v in instance.fmu.variables.items() if v.attrib["causality"] == "output"}
    assert outputs == set(reported), "every output is compared"
    for name, value in reported.items():
        actual = instance.get(name)
        assert np.array_equal(actual, np.atleast_1d(value)), (name, plant.t, actual, value)
    # A product here, a sum there.
    assert instance.get("time")[0] == pytest.approx(start + plant.t, abs=1e-9), "time goes along"


def quoted(name: str) -> str:
    """The name of a fault as FMI writes it."""
    owner, _, kind = name.rpartition(".")
    escaped = owner.replace("'", "\\'").replace('"', '\\"')
    return f"{owner if owner.isidentifier() else chr(39) + escaped + chr(39)}.{kind}"


@pytest.mark.parametrize("seed", some(range(20), 3))
def test_a_unit_moves_as_plant_does_to_the_last_bit(fmu: Fmu, plant: Plant, seed: int) -> None:
    """Under random commands, forces, power cuts, parameters, steps and faults of the lines."""
    rng = np.random.default_rng(seed)
    instance, start = Instance(fmu), 5.0 * seed
    faults = {f"faults.{quoted(fault.name)}": fault.varied for fault in plant.scene.faults}
    assert len(faults) == 2 * 12 + 1, "the last joint has no neighbour to swap encoders with"

    def vary() -> None:
        mass, stiffness = float(rng.uniform(0.1, 2.0)), float(10.0 ** rng.uniform(3, 5))
        set_all(instance, {MASS: mass, STIFFNESS: stiffness})
        plant.set_parameter("payload.mass", mass)
        plant.set_parameter(f"joints.{NAMES[0]}.gear.stiffness", stiffness)
        for name in rng.choice([*faults], 3):
            varied = faults[name]
            size = float(rng.choice([0.0, 0.3, 1.0])) * varied.number.default
            set_all(instance, {name: size})
            plant.set_parameter(varied.name, size)

    q, v = rng.normal(0.0, 0.3, (2, len(NAMES)))
    set_all(instance, {"start.q": q, "start.v": v})
    vary()
    plant.reset(q, v)
    compare(instance, plant)
    instance.start(start)
    for _ in range(60):
        inputs = random_inputs(rng)
        set_all(instance, inputs)
        axes = "world" if inputs["external.world_axes"] else "link"
        for j, joint in enumerate(NAMES):
            rows = {
                name: tuple(inputs[f"external.{name}"][j]) for name in ("force", "moment", "point")
            }
            plant.set_external_wrench(f"{joint}_link", ExternalWrench(**rows, axes=axes))
        if rng.random() < 0.2:
            plant.powered = bool(rng.integers(2))
            set_all(instance, {"power": plant.powered})
        if rng.random() < 0.2:
            vary()
        periods = int(rng.integers(1, 6))
        assert instance.step(periods * PERIOD) == OK, instance.printed
        for _ in range(periods):
            plant.exchange(inputs["command"], command_d=inputs["command_d"])
        compare(instance, plant, start)


@pytest.mark.parametrize("seed", some(range(20), 5))
def test_a_saved_state_goes_on_with_equal_bits(fmu: Fmu, seed: int) -> None:
    """Within an instance, in another one, in a new one; kept at any time of its life."""
    rng = np.random.default_rng(seed)
    original = moved(fmu, seed) if seed % 5 else Instance(fmu)
    if seed % 5 == 1:
        original.call("Terminate")
    saved = original.save()
    assert original.save() == saved, "equal states have equal bytes"

    def go_on(instance: Instance) -> dict[str, bytes]:
        if seed % 5 == 0:
            instance.start()
        if seed % 5 != 1:
            set_all(instance, inputs)
            assert instance.step(7 * PERIOD) == OK, instance.printed
        return instance.everything()

    inputs = random_inputs(rng)
    expected = go_on(original)
    others = [original, Instance(fmu), moved(fmu, seed + 100)]
    others[1].call("DoStep", 0.0, 1.0, True, None, None, None, None)  # an error; it is over
    for restored in others:
        assert restored.restore(saved) == OK, restored.printed
        assert restored.save() == saved, "what comes back is what was kept"
        assert go_on(restored) == expected, "it goes on with equal bits"


def test_a_spoiled_state_is_refused(fmu: Fmu) -> None:
    instance = moved(fmu, 1)
    saved, rng = instance.save(), np.random.default_rng(0)
    for _ in range(200):
        spoiled = bytearray(saved)
        spoiled[int(rng.integers(len(saved)))] ^= 1 << int(rng.integers(8))
        fresh = Instance(fmu)
        assert fresh.restore(bytes(spoiled)) == ERROR, "one bit is spoiled"
    assert Instance(fmu).restore(saved[:-8]) == ERROR, "it is cut short"


def test_a_reset_makes_it_new(fmu: Fmu) -> None:
    rng = np.random.default_rng(3)
    original, new = moved(fmu, 3), Instance(fmu)
    set_all(original, {"power": False, MASS: 3.0})
    assert original.step(PERIOD) == OK, original.printed
    assert original.call("Reset") == OK, original.printed
    assert original.everything() == new.everything(), "all start values are there again"
    inputs = random_inputs(rng)
    for instance in (original, new):
        instance.start()
        set_all(instance, inputs)
        assert instance.step(20 * PERIOD) == OK, instance.printed
    assert original.everything() == new.everything(), "it moves as a new one"


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_inputs_not_finite_are_discarded_and_change_nothing(fmu: Fmu, bad: float) -> None:
    """At any place of any variable, while others in the same row are sound."""
    rng = np.random.default_rng(4)
    for instance in (Instance(fmu), moved(fmu, 4)):
        before = instance.save()
        for name, variable in fmu.variables.items():
            kind = variable.attrib["causality"], variable.attrib["variability"]
            now = kind in (("input", "continuous"), ("parameter", "tunable")) or (
                kind == ("parameter", "fixed") and instance.time == 0.0
            )
            if not now:
                continue
            values = rng.normal(0.0, 1.0, fmu.size(name))
            values[int(rng.integers(len(values)))] = bad
            assert instance.set(name, values) == DISCARD, name
            assert "be finite" in instance.printed[-1][2], "the reason is reported"
            assert instance.save() == before, f"{name} changed something"


def test_inputs_out_of_bounds_are_discarded(fmu: Fmu) -> None:
    instance = moved(fmu, 5)
    before = instance.save()
    for name, value, rule in (
        (MASS, -1.0, "within its bounds"),
        (STIFFNESS, -1.0, "within its bounds"),
        ("command_d", [0.0, 1.0], "no such input"),
        ("external.force", [1e10] + [0.0] * 5, "at most 1e9"),
    ):
        assert instance.set(name, value) == DISCARD, name
        assert rule in instance.printed[-1][2], instance.printed[-1]
    assert instance.save() == before, "nothing changed"
    assert instance.set("start.q", [0.0, 0.0]) == ERROR, "it has begun"
    early = Instance(fmu)
    assert early.set("start.q", [1e9, 0.0]) == DISCARD, early.printed
    assert early.set("start.v", [0.0, -1e7]) == DISCARD, early.printed


def test_a_divergence_is_reported_and_leaves_the_rest_unharmed(fmu: Fmu) -> None:
    unaffected, expected = moved(fmu, 7), moved(fmu, 7)
    diverging = Instance(fmu, logging=False)
    set_all(diverging, {"start.v": [9e5, 9e5], MASS: 1e15})
    diverging.start()
    set_all(diverging, {"external.force": [1e9] * 6, "external.moment": [1e9] * 6})
    status = OK
    for _ in range(1000):
        status = status or diverging.step(PERIOD)
    assert status == ERROR, "it diverges"
    last, category, text = diverging.printed[-1]
    assert (last, category) == (ERROR, "logStatusError"), "reported, though logging is off"
    assert "diverged" in text, text
    for values in map(diverging.get, ("truth.q", "truth.v", "truth.energy")):
        assert np.isfinite(values).all(), "the last sound state is reported"
    assert diverging.step(PERIOD) == ERROR, "it is over"
    assert unaffected.step(5 * PERIOD) == OK, unaffected.printed
    assert expected.step(5 * PERIOD) == OK, expected.printed
    assert unaffected.everything() == expected.everything(), "the others do not notice"
    assert diverging.call("Reset") == OK, diverging.printed
    new = Instance(fmu)
    for instance in (diverging, new):
        instance.start()
        assert instance.step(5 * PERIOD) == OK, instance.printed
    assert diverging.everything() == new.everything(), "a reset makes it sound again"


def test_instances_in_threads_are_independent(fmu: Fmu) -> None:
    """ctypes lets go of Python's lock during a call."""

    def drive(seed: int) -> dict[str, bytes]:
        instance = moved(fmu, seed)
        rng = np.random.default_rng(seed)
        for _ in range(20):
            set_all(instance, random_inputs(rng))
            assert instance.step(50 * PERIOD) == OK, instance.printed
        return instance.everything()

    alone = [drive(seed) for seed in range(4)]
    with ThreadPoolExecutor(4) as threads:
        together = list(threads.map(drive, range(4)))
    assert together == alone, "equal bits"


def test_brakes_and_drives_obey(fmu: Fmu) -> None:
    instance = Instance(fmu)
    instance.start()
    set_all(instance, {"command": [5.0, 5.0]})
    assert instance.step(10 * PERIOD) == OK, instance.printed
    assert instance.get("applied").tolist() == [5.0, 5.0], "enabled"
    assert not instance.get("brake_closed").any(), "a brake opens with its drive"
    set_all(instance, {"close_brake": [True, False], "enable": [True, False]})
    assert instance.step(10 * PERIOD) == OK, instance.printed
    assert instance.get("brake_closed").tolist() == [True, False], "a brake closes"
    assert instance.get("applied").tolist() == [5.0, 0.0], "a drive is off"
    set_all(instance, {"power": False})
    assert instance.step(PERIOD) == OK, instance.printed
    assert not instance.get("powered")[0] and not instance.get("applied").any(), "no power"


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
    transitions = ["EnterInitializationMode", "ExitInitializationMode", "Terminate"]
    for name, arguments in CALLS.items():
        instance = Instance(fmu)
        for before in transitions[: list(ALLOWED).index(mode)]:
            assert instance.call(before, *CALLS[before]) == OK, instance.printed
        expected = OK if name in ALLOWED[mode] else ERROR
        assert instance.call(name, *arguments) == expected, (mode, name)
        if expected == ERROR:
            assert mode[:4] in instance.printed[-1][2], "the message reports the mode"
            assert instance.set("command", [0.0, 0.0]) == ERROR, "after an error nothing can be set"
            assert len(instance.get("truth.q")) == 2, "but looked at"


def test_null_instances_and_wrong_tokens_are_refused(fmu: Fmu) -> None:
    assert not Instance(fmu, token="{0}").handle, "a token of another unit"
    assert fmu.binary.fmi3Reset(None) == ERROR, "no instance"
    fmu.binary.fmi3FreeInstance(None)
    version = fmu.binary.fmi3GetVersion
    version.restype = ctypes.c_char_p
    assert version() == b"3.0", "of FMI"


def test_messages_go_to_their_categories(fmu: Fmu) -> None:
    instance = moved(fmu, 8)
    assert {category for _, category, _ in instance.printed} == {"logEvents"}, instance.printed
    chosen = (ctypes.c_char_p * 1)(b"logStatusDiscard")
    assert instance.call("SetDebugLogging", False, 1, chosen) == OK, instance.printed
    count = len(instance.printed)
    assert instance.step(1e300) == DISCARD, instance.printed
    assert len(instance.printed) == count, "switched off"
    assert instance.call("SetDebugLogging", True, 0, None) == OK, instance.printed
    assert instance.step(1e300) == DISCARD, instance.printed
    assert instance.printed[-1][1] == "logStatusDiscard", instance.printed
    unknown = (ctypes.c_char_p * 1)(b"logAnything")
    assert instance.call("SetDebugLogging", True, 1, unknown) == ERROR, instance.printed


def test_any_calls_in_any_order_do_no_harm(fmu: Fmu) -> None:
    """The same under sanitizers: `test_sanitizers_find_nothing`."""
    statuses = abuse(np.random.default_rng(0), fmu, 30_000 if FULL else 2500)
    assert min(statuses[status] for status in (OK, DISCARD, ERROR)) > 20, statuses


@pytest.mark.skipif(not FULL, reason="compiles with sanitizers: make test-in-full")
def test_sanitizers_find_nothing(tmp_path: Path) -> None:
    """Units of both versions, called in any order: `python -m fuzz.units`."""
    command = [sys.executable, "-m", "fuzz.units", "0", "30000", str(tmp_path)]
    sanitizer_environment = environment(tmp_path / "cache")
    sanitizer_environment["PYTHONPATH"] = ":".join(sys.path)
    done = subprocess.run(command, env=sanitizer_environment, capture_output=True, check=False)
    assert done.returncode == 0, done.stderr.decode()[-3000:]
    for statuses in json.loads(done.stdout.splitlines()[-1])["statuses"]:
        assert min(statuses[str(status)] for status in (OK, DISCARD, ERROR)) > 200, statuses
