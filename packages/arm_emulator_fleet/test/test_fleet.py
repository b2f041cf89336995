"""Arms in lanes: each moves as it would alone, for any motion of its neighbours."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from draws import FULL, some, with_slow
from machines import DC, GANTRY, PMSM, gantry_urdf, write_scene
from test_lanes import ELASTIC, WINDING

from arm_emulator import Diverged, Plant, Refusal, Scene, load_scene
from arm_emulator.machine.plant.compiler import compile_ahead
from arm_emulator.toolchain.compile_unit import compile_units
from arm_emulator.toolchain.library_cache import CACHE_VARIABLE
from arm_emulator_fleet import Fleet
from arm_emulator_fleet.unit import build_fleet_unit
from oracles.random_machines import write_machine

STEPS = 7  # of a row: not a whole number of checks, which are 16 steps apart
BACKLASH = {"joints.elbow.gear.backlash": 1e-3}
TWO_THREADS = {"threads": 2, "integrator.scheme": "paper"}  # shared with `test_copies`
NAMES = ("current", "theta_m", "omega_m", "q", "v", "gear_torque")


def mixture(folder: Path, seed: int, scheme: str = "extrapolated", **keys: Any) -> Scene:
    """Return a chain that sticks and meets current limits, all its numbers varied.

    Its events are located where the scheme can, so that most tests share one library.
    """
    file, _ = write_machine(folder, seed)
    overrides = {"integrator.scheme": scheme, "varied": ["joints.*"], "integrator.dt": 2e-4}
    if scheme in ("extrapolated", "rosenbrock"):
        overrides["integrator.events"] = "located"
    return load_scene(file, {**overrides, **keys})


def springy(folder: Path) -> Scene:
    """Return the first mixture with a spring, explicit in its scheme, at a frictionless link."""
    for seed in range(2, 200):
        scene = mixture(folder, seed, "paper")
        if any(j.gear.stiffness and j.motor and not j.friction.coulomb for j in scene.joints):
            return scene
    raise AssertionError("no such machine was drawn")


def sample_numbers(scene: Scene, rng: np.random.Generator, count: int) -> dict[str, np.ndarray]:
    """Values for all that is varied, other ones for each arm."""
    return {number.name: number.value * rng.uniform(0.7, 1.4, count) for number in scene.varied}


def alone(
    scene: Scene, values: dict[str, np.ndarray], arm: int, q: np.ndarray, v: np.ndarray
) -> Plant:
    plant = Plant(scene)
    for name, of_arms in values.items():
        plant.set_parameter(name, float(of_arms[arm]))
    plant.reset(q[arm], v[arm])
    return plant


def assert_state_of(fleet: Fleet, arm: int, plant: Plant) -> None:
    state, expected = fleet.state, plant.state
    for name in NAMES:
        of_arm, of_plant = getattr(state, name)[arm], getattr(expected, name)
        np.testing.assert_array_equal(of_arm, of_plant, err_msg=f"{name} of arm {arm}")
    assert state.t[arm] == expected.t, f"time of arm {arm}"


CASES = [
    (16, "extrapolated", "located"),
    (6, "paper", "step"),
    (21, "rosenbrock", "step"),
    (10, "rosenbrock", "located"),
    (19, "implicit", "step"),
    (5, "extrapolated", "step"),
]


@pytest.mark.parametrize(("seed", "scheme", "events"), with_slow(some(CASES, 2), 1))
def test_each_arm_moves_as_alone(seed: int, scheme: str, events: str, tmp_path: Path) -> None:
    """Random machines that stick and meet limits; numbers, states and voltages of their own."""
    rng = np.random.default_rng(seed)
    scene = mixture(tmp_path, seed, scheme, **{"integrator.events": events})
    count, N = 11, len(scene.joints)  # more than one group, and none that is full
    values = sample_numbers(scene, rng, count)
    q, v = rng.uniform(-1.0, 1.0, (count, N)), rng.uniform(-0.5, 0.5, (count, N))
    v[rng.random((count, N)) < 0.5] = 0.0  # many begin locked
    voltages = rng.uniform(-20.0, 20.0, (60, count, N))
    fleet = Fleet(scene, count, varied=values, q=q, v=v, workers=2)
    moved = fleet.run(voltages, STEPS)
    assert (fleet.faults == -1).all(), f"tame machines: {fleet.diverged}"
    furthest, stuck, limited = 0.0, 0, 0
    limits = [getattr(joint.motor, "current_limit", None) or np.inf for joint in scene.joints]
    for arm in range(count):
        plant = alone(scene, values, arm, q, v)
        expected = plant.run(voltages[:, arm], STEPS)
        # A joint that sticks has the same angle to the last bit in two rows.
        stuck += int((np.diff(expected, axis=0) == 0.0).sum())
        largest = [
            values.get(f"joints.{joint.name}.motor.current_limit", np.full(count, limit))[arm]
            for joint, limit in zip(scene.joints, limits, strict=True)
        ]
        limited += int((np.abs(plant.state.current) >= np.array(largest) * (1.0 - 1e-12)).sum())
        np.testing.assert_array_equal(moved[:, arm], expected, err_msg=f"{arm}")
        assert_state_of(fleet, arm, plant)
        furthest = max(furthest, float(np.abs(expected - q[arm]).max()))
    assert furthest > 0.01, f"the arms hardly moved: {furthest} rad"
    assert stuck > 0 and limited > 0, f"{stuck} rows of joints stick, {limited} end at a limit"


@pytest.mark.parametrize("cause", some(["it turns too far in a step", "its gear is too stiff"], 1))
def test_an_arm_that_diverges_is_reported_and_touches_no_neighbour(
    cause: str, tmp_path: Path
) -> None:
    """It stays at the last sound state, as alone; the bits of all others are as without it."""
    rng = np.random.default_rng(8)
    stiff = "stiff" in cause
    scene = springy(tmp_path) if stiff else mixture(tmp_path, 16)
    count, N, wild = 19, len(scene.joints), [0, 9, 18]
    values = sample_numbers(scene, rng, count)
    q, v = rng.uniform(-1.0, 1.0, (count, N)), np.zeros((count, N))
    voltages = rng.uniform(-20.0, 20.0, (40, count, N))
    tame = Fleet(scene, count, varied=values, q=q, v=v)
    expected = tame.run(voltages, STEPS)
    if stiff:  # for a spring that is explicit where it acts on the link
        for name in values:
            if name.endswith("gear.stiffness"):
                values[name][wild] = 1e9  # N m/rad
    else:
        v[wild, 0] = 1.1 * np.pi / scene.integrator.dt  # rad/s: more than half a turn
    fleet = Fleet(scene, count, varied=values, q=q, v=v)
    moved = fleet.run(voltages, STEPS)
    others = [arm for arm in range(count) if arm not in wild]
    assert moved[:, others].tobytes() == expected[:, others].tobytes(), "a neighbour's bits differ"
    diverged = fleet.diverged
    assert sorted(diverged) == wild, f"diverged: {sorted(diverged)}"
    for arm in wild:
        plant = alone(scene, values, arm, q, v)
        with pytest.raises(Diverged) as result:
            plant.run(voltages[:, arm], STEPS)
        assert diverged[arm].joint == result.value.joint, f"joint of arm {arm}"
        assert diverged[arm].t == result.value.t, f"time of arm {arm}"
        assert np.array_equal(moved[-1, arm], plant.state.q), f"where arm {arm} is"
        # It stays there, and a reset sets it free.
        fleet.advance(voltages[0], STEPS)
        assert fleet.state.q[arm].tobytes() == moved[-1, arm].tobytes(), f"arm {arm} went on"
        for name in values:
            fleet[arm].set_parameter(name, float(values[name][1]))
        fleet[arm].reset()
    fleet.advance(voltages[0], STEPS)
    assert (fleet.faults == -1).all(), "an arm was reset and did not go on"


def test_bits_depend_neither_on_pieces_nor_on_neighbours(tmp_path: Path) -> None:
    rng = np.random.default_rng(9)
    scene = mixture(tmp_path, 16)
    count, N = 13, len(scene.joints)
    values = sample_numbers(scene, rng, count)
    q = rng.uniform(-1.0, 1.0, (count, N))
    voltages = rng.uniform(-20.0, 20.0, (100, count, N))
    full = Fleet(scene, count, varied=values, q=q, workers=1).run(voltages, STEPS)
    pieces = Fleet(scene, count, varied=values, q=q, workers=2)
    moved, at = [], 0
    while at < len(voltages):
        rows = int(rng.integers(1, 20))
        moved.append(pieces.run(voltages[at : at + rows], STEPS))
        at += rows
    assert np.concatenate(moved).tobytes() == full.tobytes(), "pieces change bits"
    order = rng.permutation(count)[:5]
    some = {name: of_arms[order] for name, of_arms in values.items()}
    few = Fleet(scene, 5, varied=some, q=q[order]).run(voltages[:, order], STEPS)
    assert few.tobytes() == full[:, order].tobytes(), "neighbours change bits"


def test_an_arm_of_a_fleet_is_a_plant(tmp_path: Path) -> None:
    """Saving, setting and restoring through it act on its lane."""
    rng = np.random.default_rng(10)
    scene = mixture(tmp_path, 16)
    fleet = Fleet(scene, 9)
    rows = rng.uniform(-20.0, 20.0, (20, len(scene.joints)))
    fleet.run(rows, STEPS)
    saved = fleet[3].save()
    third = fleet.run(rows, STEPS)[:, 3]
    fleet[8].restore(saved)
    assert fleet.run(rows, STEPS)[:, 8].tobytes() == third.tobytes(), (
        "a restored arm goes elsewhere"
    )
    name = scene.varied[0].name
    fleet.reset()
    fleet[4].set_parameter(name, 1.3 * scene.varied[0].value)
    moved = fleet.run(rows, STEPS)
    plant = Plant(scene)
    plant.set_parameter(name, 1.3 * scene.varied[0].value)
    assert np.array_equal(moved[:, 4], plant.run(rows, STEPS))
    assert not np.array_equal(moved[:, 4], moved[:, 5]), "the number has no effect"
    state = plant.state
    fleet[-1].state = state
    assert fleet.state.q[8].tobytes() == state.q.tobytes(), "the state was not set"
    stored = fleet[2]
    del fleet
    stored.advance(rows[0], STEPS)  # the fleet lives as long as one of its arms is held


def one_arm_after_the_other(folder: Path) -> Scene:
    """Return a scene without lanes: a gear has play; motors have temperatures and noise."""
    motors = {**DC, "winding": WINDING}, {**PMSM, "winding": WINDING}, DC
    joints = {
        name: {"motor": motor, "gear": ELASTIC, "current_sensor": {"noise": 0.01}}
        for name, motor in zip(GANTRY, motors, strict=True)
    }
    joints["z"]["gear"] = {**ELASTIC, "backlash": 1e-3}
    varied = ["joints.*.gear.stiffness", "joints.y.motor.winding.thermal_resistance", "seed"]
    file = write_scene(
        folder, gantry_urdf(), joints, varied=varied, gravity=[0.5, -0.5, 1.0], seed=3,
        servo_period=2e-3, integrator={"scheme": "rosenbrock", "dt": 2e-4},
    )  # fmt: skip
    return load_scene(file)


def one_arm_of_two_threads(folder: Path) -> Scene:
    return load_scene("three_axis", overrides=TWO_THREADS)


@pytest.mark.parametrize(
    "make_scene", with_slow([one_arm_after_the_other, one_arm_of_two_threads], 1)
)
def test_scenes_that_have_no_lanes_move_as_well(
    make_scene: Callable[[Path], Scene], tmp_path: Path
) -> None:
    """Drives without a usual mode, and two threads: one arm after the other, to the last bit."""
    rng = np.random.default_rng(11)
    scene = make_scene(tmp_path)
    rows = rng.uniform(-20.0, 20.0, (10, 3, len(scene.joints)))
    fleet = Fleet(scene, 3)
    assert fleet.lanes == 1, "lanes"
    moved = fleet.run(rows, STEPS)
    for arm in range(3):
        expected = Plant(scene).run(rows[:, arm], STEPS)
        assert moved[:, arm].tobytes() == expected.tobytes(), f"arm {arm}"


@pytest.mark.skipif(not FULL, reason="fleets are compiled once more for it: make test-in-full")
@pytest.mark.parametrize(("target", "lanes"), [("x86-64-v3", 4), ("x86-64", 2)])
def test_processors_with_narrower_registers_have_fewer_lanes(
    target: str, lanes: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A joint that sticks and meets its limit, alone and in lanes, both compiled for the target."""
    rng = np.random.default_rng(12)
    scene = mixture(tmp_path, 34)
    values, rows = (
        sample_numbers(scene, rng, 5),
        rng.uniform(-20.0, 20.0, (20, 5, len(scene.joints))),
    )
    q, v = rng.uniform(-1.0, 1.0, (5, len(scene.joints))), np.zeros((5, len(scene.joints)))
    cache = tmp_path / "cache"
    monkeypatch.setenv(CACHE_VARIABLE, str(cache))
    libraries = compile_ahead(scene, target, None)
    libraries += compile_units([build_fleet_unit(scene)], target, None)
    assert len(libraries) == 4, "machine, equations, real time, fleet"
    narrow = Fleet(scene, 5, varied=values, q=q, v=v)
    assert narrow.lanes == lanes, "lanes"
    moved = narrow.run(rows, STEPS)
    for arm in range(5):
        plant = alone(scene, values, arm, q, v)
        assert np.array_equal(moved[:, arm], plant.run(rows[:, arm], STEPS)), f"arm {arm}"
    assert len(list(cache.glob("*.so"))) == 3, "libraries that were used, of that target alone"


def refusals() -> Iterator[tuple[str, Any, str]]:
    three = np.zeros(3)

    def all_joints(s: Scene, value: float) -> list[float]:
        return [value] * len(s.joints)

    yield "count", lambda s: Fleet(s, 0), "count must be a whole number from 1"
    yield "part", lambda s: Fleet(s, 1.5), "count must be a whole number"  # type: ignore[arg-type]
    yield "unknown", lambda s: Fleet(s, 2, varied={"gravity": 1.0}), "must be varied in the scene"
    yield "many", lambda s: Fleet(s, 2, varied={s.varied[0].name: three}), "must have shape (2,)"
    yield "far", lambda s: Fleet(s, 2, q=all_joints(s, 1e300)), "q must be numbers within +-"
    yield "arm", lambda s: Fleet(s, 2)[2], "arm must be a whole number from -2 to 1"
    yield "workers", lambda s: Fleet(s, 2, workers=0), "workers must be a whole number from 1"


@pytest.mark.parametrize(
    ("attempt", "words"),
    [refusal[1:] for refusal in refusals()],
    ids=[refusal[0] for refusal in refusals()],
)
def test_senseless_arguments_are_refused(attempt: Any, words: str, tmp_path: Path) -> None:
    scene = mixture(tmp_path, 16)
    with pytest.raises(Refusal) as refused:
        attempt(scene)
    assert words in str(refused.value), str(refused.value)
