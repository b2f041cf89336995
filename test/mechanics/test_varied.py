"""Numbers that a scene lists as varied; that they act as constants do: test_varied_axes.py."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import yaml
from draws import some
from machines import own_three_axis
from test_manners import NAME as MASS
from test_manners import VARIED

from arm_emulator import Diverged, Plant, Refusal, Scene, load_scene
from arm_emulator.machine.plant.compiler import load_machine


def motion(plant: Plant, rows: np.ndarray, steps: int = 10) -> np.ndarray:
    try:
        plant.run(rows, steps)
    except Diverged as fault:
        pytest.fail(f"a tame machine: {fault}")
    x = plant.state
    return np.concatenate(
        [x.q, x.v, x.current, x.theta_m, x.omega_m, x.gear_torque, [plant.energy]]
    )


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("three_axis", VARIED)


def test_the_same_library_serves_every_value(scene: Scene) -> None:
    unchanged, changed = Plant(scene), Plant(scene)
    changed.set_parameter(MASS, 3.0)
    heavy = dataclasses.replace(
        scene, varied=tuple(dataclasses.replace(number, value=2.5) for number in scene.varied)
    )
    assert load_machine(heavy).file == unchanged.core.file == changed.core.file, "libraries"
    assert Plant(heavy).parameters[MASS] == 2.5, "as the scene has it"
    assert unchanged.parameters[MASS] == 1.0, "as another scene has it"
    assert changed.parameters[MASS] == 3.0, "as it was set"
    rows = np.random.default_rng(0).normal(0.0, 10.0, (20, 3))
    assert not np.allclose(motion(unchanged, rows), motion(changed, rows)), "the mass has no effect"


def test_a_number_that_is_set_is_saved_and_the_motion_goes_on(scene: Scene) -> None:
    rows, machine, restored = (
        np.random.default_rng(1).normal(0.0, 10.0, (30, 3)),
        Plant(scene),
        Plant(scene),
    )
    motion(machine, rows)
    before = machine.state
    machine.set_parameter(MASS, 5.0)
    assert machine.state == before, "a state is no matter of numbers"
    restored.restore(machine.save())
    assert restored.parameters == machine.parameters == {MASS: 5.0}, "of the restored machine"
    np.testing.assert_array_equal(
        motion(machine, rows), motion(restored, rows), err_msg="last states"
    )
    assert machine.save() == restored.save(), "all that the machines are"


@pytest.mark.parametrize(
    ("varied", "rule"),
    [
        (["joints.*.gear.ratio"], "varied must name numbers of this scene that can be varied"),
        (["payload.mas"], "varied must name numbers"),
        ([3], "varied must name numbers"),
        ([["payload.mass"]], "varied must name numbers"),
        ("payload.mass", "varied must be a list"),
        (None, "varied must be a list"),
    ],
)
def test_numbers_that_cannot_vary_are_refused(varied: object, rule: str, tmp_path: Path) -> None:
    file = own_three_axis(tmp_path, yaml.safe_dump({"payload": {"mass": 1.0}, "varied": varied}))
    with pytest.raises(Refusal, match=rule):
        load_scene(file)


@pytest.mark.parametrize("scheme", some(["rosenbrock", "paper"], 1))
def test_dry_friction_that_is_set_on_a_resting_arm_is_no_divergence(scheme: str) -> None:
    """Joints that creep stop within a step, which gives the others more than there was before."""
    overrides = {"varied": ["joints.*"], "integrator.scheme": scheme}  # a library of many tests
    overrides["integrator.dt"] = 5e-4  # at which `paper` is stable, too
    plant, rng = Plant(load_scene("three_axis", overrides=overrides)), np.random.default_rng(1)
    names = [name for name in plant.parameters if name.endswith("friction.coulomb")]
    for trial in range(50):
        for name in names:
            plant.set_parameter(name, 0.0)
        plant.reset()
        for _ in range(5):
            plant.exchange(np.zeros(3))
        for name in names:
            if trial == 0:
                plant.set_parameter(name, 0.10153298494504581 if "elbow" in name else 0.0)
            elif rng.random() < 0.6:
                plant.set_parameter(name, float(10.0 ** rng.uniform(-2.0, 2.0)))
        for _ in range(100):
            plant.exchange(np.zeros(3))
        # It creeps by rounding alone; friction of 100 N m stops it within 1 ms at 1 kg m2.
        assert np.abs(plant.state.v).max() < 1e-2, plant.parameters
