"""Flags that the environment adds, and that those of the tests change no bit of any number."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from conftest import QUICK
from draws import some

from arm_emulator import Plant, Refusal, Scene, load_scene
from arm_emulator.build.compiler_command import FLAGS_VARIABLE
from arm_emulator.build.unit import compiled_bytes, flags_of
from arm_emulator.machine.compiler import machine_unit
from oracles.mixtures import write_mixture

# Shipped scenes, the others in full runs, and mixtures of all parts.
CASES = [*some(["three_axis", "manutec_r3", "ur5", "panda", "kuka_kr300"], 1), *some(range(20), 1)]


def drawn(scene: Scene, periods: int) -> np.ndarray:
    """Commands (periods, N), held for six periods each."""
    largest = np.where(np.isfinite(scene.largest_commands), scene.largest_commands, 5.0)
    rows = np.random.default_rng(5).uniform(-0.4, 0.4, (periods // 6 + 1, len(largest))) * largest
    return np.repeat(rows, 6, axis=0)[:periods]


def numbers_of(scene: Scene) -> list[bytes]:
    """All that a machine reports of a run that meets limits and cuts of power, as bytes."""
    plant, seen = Plant(scene), []
    for tick, row in enumerate(drawn(scene, 60)):
        plant.powered = tick % 20 < 15
        plant.exchange(row)
        state = plant.state
        seen += [one.tobytes() for one in (state.q, state.v, state.gear_torque, state.current)]
        seen += [np.float64(plant.energy).tobytes(), plant.measured.encoder_counts.tobytes()]
    return seen


@pytest.mark.parametrize("case", CASES)
def test_flags_of_the_tests_change_no_bit(
    case: str | int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = load_scene(case if isinstance(case, str) else write_mixture(tmp_path, case))
    monkeypatch.setenv(FLAGS_VARIABLE, QUICK)
    quick, code = numbers_of(scene), compiled_bytes(machine_unit(scene), "native")
    monkeypatch.delenv(FLAGS_VARIABLE)
    assert compiled_bytes(machine_unit(scene), "native") != code, "it is compiled otherwise"
    assert numbers_of(scene) == quick


def test_they_are_added_behind_ours(monkeypatch: pytest.MonkeyPatch) -> None:
    unit = machine_unit(load_scene("three_axis"))
    monkeypatch.setenv(FLAGS_VARIABLE, "-g '-DA=two words'")
    assert flags_of(unit) == (*unit.flags, "-g", "-DA=two words")
    monkeypatch.setenv(FLAGS_VARIABLE, "")
    assert flags_of(unit) == unit.flags
    monkeypatch.setenv(FLAGS_VARIABLE, "'unclosed")
    with pytest.raises(Refusal, match=f"{FLAGS_VARIABLE} must be the words of a command, got 'un"):
        flags_of(unit)
