"""Steps of a unit: of any length, ended early, discarded, in threads."""

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
def test_steps_of_any_length_move_as_plant_with_zoh_inputs(
    fmu: Fmu, plant: Plant, lengths: list[float]
) -> None:
    """A servo period has the inputs of the step in which it begins; outputs are those of ticks."""
    rng = np.random.default_rng(len(lengths))
    instance, start, rounding = Instance(fmu), 12.5, Fraction(PERIOD) / 10**6
    instance.start(start)
    plant.reset(plant.scene.start)
    period, time, ticks = Fraction(PERIOD), Fraction(0), 0
    zoh_inputs: dict[str, Any] | None = None  # none: the next period begins with the next step

    def let_go_on(inputs: dict[str, Any]) -> None:
        plant.set_parameter("payload.mass", inputs[MASS])
        plant.exchange(inputs["command"], command_d=inputs["command_d"])

    mass = 0.5
    for k, length in enumerate(lengths):
        if rng.random() < 0.1:
            mass = float(rng.uniform(0.1, 2.0))
        random_values = random_inputs(rng)
        inputs = {
            "command": random_values["command"],
            "command_d": random_values["command_d"],
            MASS: mass,
        }
        set_all(instance, inputs)
        zoh_inputs = zoh_inputs or inputs
        assert instance.step(length) == OK, instance.printed
        time += Fraction(length)
        while zoh_inputs and time >= (ticks + 1) * period - rounding:
            let_go_on(zoh_inputs)
            ticks += 1
            zoh_inputs = inputs if time > ticks * period + rounding else None
        if k % 7 and k < len(lengths) - 1:
            continue
        now = {"encoder_counts": plant.measured.encoder_counts, "truth.q": plant.state.q,
               "truth.v": plant.state.v, "applied": plant.measured.applied}  # fmt: skip
        for name, value in now.items():
            assert np.array_equal(instance.get(name), value), (name, k, float(time))
        assert instance.get("time")[0] == pytest.approx(start + float(time), abs=1e-9), "time"
        assert instance.restore(instance.save()) == OK, "a state in the midst of a period"
    assert ticks > 10, "it has moved"


def test_a_step_beyond_all_bounds_is_discarded(fmu: Fmu) -> None:
    instance = moved(fmu, 6)
    before = instance.save()
    assert instance.step(1e300) == DISCARD, instance.printed
    assert "must be at most" in instance.printed[-1][2], instance.printed[-1]
    assert instance.save() == before, "nothing changed"
    assert instance.step(PERIOD) == OK, "it goes on"


@pytest.mark.parametrize("until", [0.0, 3.0, 7.4, 400.0])
def test_a_step_can_return_early(fmu: Fmu, plant: Plant, until: float) -> None:
    """At the tick at which it is asked to, or later; the importer looks at the machine then."""
    observed: list[tuple[float, float]] = []

    def watch(time: float) -> float | None:
        observed.append((time, instance.get("truth.q")[0]))
        return None if len(observed) < 5 else time + until * PERIOD

    instance = Instance(fmu, watch=watch)
    instance.start()
    set_all(instance, {"command": [3.0, 4.0]})
    end = (5.0 + until) * PERIOD
    assert instance.step(100.6 * PERIOD) == OK, instance.printed
    assert instance.early == (until < 95.0), "it reports that it came back early"
    ended = instance.get("time")[0]
    assert ended == pytest.approx(min(end, 100.6 * PERIOD), abs=1e-12), "where it ended"
    plant.reset(plant.scene.start)
    for time, q in observed:
        plant.exchange([3.0, 4.0])
        assert (time, q) == (pytest.approx(plant.t), plant.state.q[0]), "what was seen at a tick"
    instance.time = ended
    assert instance.step(20.0 * PERIOD) == OK, instance.printed
    patient = Instance(fmu)
    patient.start()
    set_all(patient, {"command": [3.0, 4.0]})
    assert patient.step(instance.get("time")[0]) == OK, patient.printed
    assert np.array_equal(instance.get("truth.q"), patient.get("truth.q")), "it goes on"


def test_a_step_can_be_ended_from_another_thread(fmu: Fmu) -> None:
    instance = Instance(fmu)
    instance.start()
    with ThreadPoolExecutor(1) as threads:
        used, until = process_time(), monotonic() + PATIENCE
        step = threads.submit(instance.step, 1e9)  # some weeks
        while (
            process_time() < used + 0.1 and monotonic() < until
        ):  # s of computing: it is under way
            sleep(0.01)
        assert instance.call("Terminate") == OK, instance.printed
        assert step.result(timeout=30.0) == DISCARD, instance.printed
    assert 0.0 < instance.get("time")[0] < 1e9, "where it ended"
    assert instance.step(PERIOD) == ERROR, "it is over"
    assert instance.call("Reset") == OK, instance.printed


def test_steps_are_taken_as_importers_compute_them(fmu: Fmu) -> None:
    """As a constant, as a difference of times, as times that are summed up."""
    expected, start = Instance(fmu), 1e4 + 0.1
    expected.start(start)
    assert expected.step(3000 * PERIOD) == OK, expected.printed
    differences, summed = Instance(fmu), Instance(fmu)
    for instance in (differences, summed):
        instance.start(start)
    for k in range(3000):
        now, then = start + k * PERIOD, start + (k + 1) * PERIOD
        differences.time = now
        assert differences.step(then - now) == OK, differences.printed
    time = start
    for _ in range(3000):
        summed.time = time
        assert summed.step(PERIOD) == OK, summed.printed
        time += PERIOD
    assert differences.everything() == expected.everything() == summed.everything(), "equal bits"


@pytest.mark.parametrize(("at", "step"), [
    (0.0, 0.0), (0.0, -PERIOD), (0.0, math.nan), (0.0, math.inf), (math.nan, PERIOD),
    (PERIOD, PERIOD), (-PERIOD, PERIOD), (0.0, 0.02),
])  # fmt: skip
def test_a_step_that_cannot_be_is_an_error(fmu: Fmu, at: float, step: float) -> None:
    instance = Instance(fmu)
    instance.start(stop=0.01)
    instance.time = at
    assert instance.step(step) == ERROR, instance.printed
    assert instance.call("DoStep", 0.0, PERIOD, True, *[None] * 4) == ERROR, "it is over"
    assert instance.call("Reset") == OK, "a reset helps"
