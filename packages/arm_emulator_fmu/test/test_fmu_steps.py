"""Steps of a unit: of any length, ended early, discarded, in threads."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from fractions import Fraction
from time import monotonic, process_time, sleep
from typing import Any

import numpy as np
import pytest
from draws import some
from fmu_client import DISCARD, ERROR, OK, Fmu, Instance
from own_fmu import MASS, PERIOD, fmu, moved, plant, random_inputs, scene, set_all

from arm_emulator.machine.plant.plant import Plant

PATIENCE = 60.0  # s

__all__ = ["fmu", "plant", "scene"]  # fixtures


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
        used, until = process_time(), monotonic() + PATIENCE
        step = threads.submit(one.step, 1e9)  # some weeks
        while (
            process_time() < used + 0.1 and monotonic() < until
        ):  # s of computing: it is under way
            sleep(0.01)
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
