"""Arms stay in their lanes between calls, without visible effect; `step` is exchange and looks."""

import contextlib
import copy
import gc
from typing import Any

import numpy as np
import pytest
from draws import some
from machines import SENSED
from test_fleet_calls import COUNT, NUMBER

from arm_emulator import Diverged, Plant, Refusal, Scene, load_scene
from arm_emulator.machine.plant.outputs import KNOWN
from arm_emulator_fleet import Fleet

BRAKED: dict[str, Any] = {
    "varied": ["joints.*.friction.viscous"],
    "joints.waist.brake": {"torque": 50.0, "close_delay": 0.004, "release_delay": 0.006},
    "external_wrench": True,
}
# Shared by `test_fleet_follow` and `test_external_wrench`: its lanes take seconds to compile.
LOCATED: dict[str, Any] = {
    "integrator.events": "located",
    "integrator.scheme": "extrapolated",
    "integrator.dt": 5e-4,  # two steps in a period, of which the first may have no event
    "varied": ["joints.*.friction.coulomb", "joints.*.friction.viscous"],
    "joints.*.friction.coulomb": 0.05,
    "joints.*.motor.current_limit": 6.0,
    "joints.elbow.brake": {"torque": 0.5, "close_delay": 0.004, "release_delay": 0.006},
    "external_wrench": True,
}
SCENES = {"located": LOCATED, "sensed": SENSED, "braked": BRAKED}


@pytest.fixture(scope="module", params=some(list(SCENES), 2))
def scene(request: pytest.FixtureRequest) -> Scene:
    return load_scene("three_axis", overrides=SCENES[request.param])


def walk(fleet: Fleet, seed: int, calls: int) -> list[bytes]:
    """Call every function of a fleet; return its state and what it measures after some."""
    rng = np.random.default_rng(seed)
    observed = []
    saved = fleet.save()
    for _ in range(calls):
        which = rng.random(COUNT) < 0.3
        arm = int(rng.integers(COUNT))
        rows = rng.uniform(-20.0, 20.0, (COUNT, 3))
        action = int(rng.integers(12))
        if action <= 2:
            fleet.exchange(rows, tick=action)
        elif action == 3:
            fleet.step(rows, int(rng.integers(1, 40)))
        elif action == 4:
            fleet.advance(rows, int(rng.integers(40)))
        elif action == 5:
            fleet.run(rng.uniform(-20.0, 20.0, (3, COUNT, 3)), int(rng.integers(1, 20)))
        elif action == 6:
            fleet.reset(which, q=rng.uniform(-0.5, 0.5, (int(which.sum()), 3)))
        elif action == 7:
            fleet.set_parameter(NUMBER, rng.uniform(1.0, 5.0, int(which.sum())), arms=which)
        elif action == 8:
            fleet.powered = ~which
        elif action == 9:
            fleet.restore(saved, arms=which)
        elif action == 10:
            saved = fleet.save()
        else:
            plant = fleet[arm]
            plant.state = plant.state
            plant.advance(rows[0], 3)
        if rng.random() < 0.3:
            observed.append(everything(fleet))
    return [*observed, everything(fleet)]


def everything(fleet: Fleet) -> bytes:
    state, measured = fleet.state, fleet.measured
    rows = [getattr(state, name) for name in state.__dataclass_fields__]
    rows += [getattr(measured, name) for name in KNOWN]
    return b"".join(np.ascontiguousarray(row).tobytes() for row in (*rows, fleet.faults))


@pytest.mark.parametrize("seed", some(range(40), 4))
def test_a_fleet_with_references_to_its_arms_moves_as_a_fleet_without(
    seed: int, scene: Scene
) -> None:
    alone, monitored = Fleet(scene, COUNT, workers=1), Fleet(scene, COUNT, workers=2)
    arms = list(monitored)  # as long as these are there, no arm stays in its lane
    assert walk(alone, seed, 120) == walk(monitored, seed, 120)
    assert len(arms) == COUNT


def test_a_step_is_an_exchange_and_a_look(scene: Scene) -> None:
    rng = np.random.default_rng(3)
    fleet = Fleet(scene, COUNT, q=rng.uniform(-1.0, 1.0, (COUNT, 3)))
    second = copy.copy(fleet)
    frame = fleet.frame()
    for tick in range(40):
        if tick == 20:
            fleet.powered = second.powered = np.arange(COUNT) % 2 == 0
        rows = rng.uniform(-20.0, 20.0, (COUNT, 3))
        periods = tick % 4
        if periods == 0:  # what it commands is no answer, and measured as applied by neither
            fleet.advance(-rows, 5)
            second.advance(-rows, 5)
        assert fleet.step(rows, periods, out=frame) is frame
        for _ in range(periods):
            second.exchange(rows)
        state, measured = second.state, second.measured
        for name in ("t", "q", "v", "current", "theta_m", "omega_m"):
            assert np.array_equal(getattr(frame, name), getattr(state, name)), name
        for name in KNOWN:
            mine, its = getattr(frame.measured, name), getattr(measured, name)
            assert np.array_equal(mine, its), name
        assert np.array_equal(frame.powered, second.powered)
        assert np.array_equal(frame.faults, second.faults)


@pytest.mark.parametrize("device", [None, "processor"])
def test_an_arm_that_has_diverged_measures_what_a_plant_does(device: str | None) -> None:
    """Its drives bound their commands on, and its brake receives them."""
    rng = np.random.default_rng(5)
    scene = load_scene("three_axis", overrides=LOCATED)
    wild, v = [1, COUNT - 1], np.zeros((COUNT, 3))
    v[wild, 0] = 1.1 * np.pi / scene.integrator.dt  # more than half a turn in a step
    fleet = Fleet(scene, COUNT, v=v, device=device, workers=1)
    plants = [Plant(scene) for _ in range(COUNT)]
    for plant, speeds in zip(plants, v, strict=True):
        plant.reset(v=speeds)
    for period in range(12):
        rows = rng.uniform(-200.0, 200.0, (COUNT, 3))  # far beyond the bounds
        count = period % 3  # 0: by `exchange`
        if count:
            fleet.step(rows, count)
        else:
            fleet.exchange(rows)
        for plant, row in zip(plants, rows, strict=True):
            for _ in range(max(count, 1)):
                with contextlib.suppress(Diverged):
                    plant.exchange(row)
        for name in KNOWN:
            expected = np.array([getattr(plant.measured, name) for plant in plants])
            assert np.array_equal(getattr(fleet.measured, name), expected), f"{name}, {period}"
    assert sorted(fleet.diverged) == wild


def test_an_arm_continues_in_its_lane_when_its_reference_ends(scene: Scene) -> None:
    fleet = Fleet(scene, COUNT)
    rows = np.full((COUNT, 3), 5.0)
    for _ in range(3):
        fleet.step(rows)
        arm = fleet[2]
        before = arm.state
        arm.reset(q=[0.1, 0.2, 0.3])
        assert not np.array_equal(before.q, arm.state.q)
        del arm
        gc.collect()
        frame = fleet.step(rows, 0)
        np.testing.assert_array_equal(frame.q[2], [0.1, 0.2, 0.3])
        assert frame.t[2] == 0.0 < frame.t[3]


@pytest.mark.parametrize(
    ("attempt", "words"),
    [
        (lambda f: f.step(np.zeros(4)), r"command must have shape"),
        (lambda f: f.step(np.full(3, np.nan)), r"command must be finite"),
        (lambda f: f.step(np.zeros(3), -1), r"periods must"),
        (lambda f: f.step(np.zeros(3), 1.5), r"periods must"),
        (lambda f: f.step(np.zeros(3), True), r"periods must"),
        (lambda f: f.step(np.zeros(3), out={}), r"out must be a frame of this fleet"),
        (lambda f: f.step(np.zeros(3), out=Fleet(f.scene, 3).frame()), r"out must be a frame"),
    ],
)
def test_steps_that_make_no_sense_change_nothing(attempt: Any, words: str, scene: Scene) -> None:
    fleet = Fleet(scene, COUNT)
    fleet.step(np.full(3, 5.0))
    before = fleet.save()
    with pytest.raises(Refusal, match=words):
        attempt(fleet)
    assert fleet.save() == before
