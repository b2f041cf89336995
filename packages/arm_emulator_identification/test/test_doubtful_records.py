"""Records with effects that a scene lacks, and spoiled ones; bench/doubtful_records.py has all."""

from functools import cache

import numpy as np
import pytest
from draws import some, with_slow

from arm_emulator.machine.scene.scene import Scene
from arm_emulator_identification.measured_run import MeasuredRun
from arm_emulator_identification.plausibility import replace_outliers
from bench.doubtful_records import (
    EFFECTS,
    MACHINES,
    RECORDS,
    answer_to,
    draw_changes,
    identify_with_effect,
    make_clean_record,
    spoil_record,
)
from oracles.synthetic_record import make_record

KINDS = [  # one of each cause that is named, then the others
    "torques scaled up", "time halved", "one torque scaled up", "torques late", "one angle scaled",
    "time in ms", "torque outliers", "degrees", "N mm", "at the links", "torques swapped",
    "torque's sign", "angle's sign",
    "time doubled", "torques scaled down", "one torque scaled", "one torque late", "angle outliers",
]  # fmt: skip


@cache
def record(seed: int) -> tuple[Scene, MeasuredRun]:
    return make_clean_record("three_axis", seed)


@pytest.mark.parametrize("seed", some(range(3), 1))
@pytest.mark.parametrize("kind", with_slow(KINDS, 6))
def test_a_spoiled_record_is_refused_or_doubted_with_the_cause(kind: str, seed: int) -> None:
    scene, run = record(seed)
    bad, words = spoil_record(run, scene, np.random.default_rng([seed, 10, 5]))[kind]
    answer, _ = answer_to(scene, bad)
    assert any(word in answer for word in words), f"not {words[0]!r}: {answer}"


@pytest.mark.parametrize("seed", some(range(3), 1))
def test_a_sound_record_gives_no_warning(seed: int) -> None:
    scene, run = record(seed)
    assert answer_to(scene, run) == ("", False)


CASES = [("three_axis", 0, effect) for effect in EFFECTS] + [
    (*machine, effect) for effect in EFFECTS for machine in RECORDS if machine != ("three_axis", 0)
]


@pytest.mark.slow
@pytest.mark.parametrize(("machine", "seed", "effect"), some(CASES, 1))
def test_effects_that_a_scene_lacks_are_named_and_widen_the_deviations(
    machine: str, seed: int, effect: str
) -> None:
    inside, names, _ = identify_with_effect(machine, effect, seed)
    assert any(text in name for text in EFFECTS[effect][1] for name in names), names
    # Of normal errors 95 % are; those of one record go together.
    assert inside >= 0.85, f"{inside} of the numbers within two deviations"


def test_a_few_spikes_are_detected_singly() -> None:
    rng = np.random.default_rng(4)
    driven, values = draw_changes(MACHINES["three_axis"](), rng)
    run = make_record(driven, 5, 4.0, 2e-6, 0.03, values)
    clean, reported = replace_outliers(run)
    assert not reported
    np.testing.assert_array_equal(clean.tau, run.tau)
    at = rng.choice(np.arange(10, len(run.t) - 10), 12, replace=False)
    run.tau[at, 1] += 4.0 * run.tau[:, 1].std() * rng.choice([-1.0, 1.0], 12)
    cleaned, reported = replace_outliers(run)
    assert len(reported) == 1
    assert reported[0].startswith(f"torque of {run.joints[1]}: 12 outliers"), reported
    left = np.abs(cleaned.tau - clean.tau)[:, 1]
    assert left.max() < 0.5 * run.tau[:, 1].std(), "neighbours stand in their place"
