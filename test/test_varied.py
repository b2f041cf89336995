"""Numbers that a scene lists as varied: one library serves every value, as exactly as constants."""

from __future__ import annotations

import dataclasses
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from draws import some
from machines import MOTOR, Oracle, moving_joints, random_chain_urdf, write_scene

from arm_emulator import Diverged, Plant, Refusal, Scene, load_scene
from arm_emulator.base.validation.number import Number
from arm_emulator.machine.plant.compiler import library_of
from arm_emulator.machine.schemes.known import SCHEMES

ALL = ["payload.mass", "joints.*.motor.*", "joints.*.gear.*", "joints.*.friction.*"]


def random_arm(folder: Path, rng: np.random.Generator, scheme: str, threads: int) -> Path:
    """Three random joints: progressive, rigid with a limit, free; all with friction; a payload."""
    urdf = random_chain_urdf(rng, 3)
    names = moving_joints(urdf)
    friction = {"viscous": 0.1, "coulomb": 0.3, "breakaway": 0.6}
    gear = {"ratio": 0.02, "stiffness": 2e3, "damping": 4.0, "cubic_stiffness": 5e6}
    joints = {
        names[0]: {"motor": MOTOR, "gear": gear, "friction": friction},
        names[1]: {
            "motor": {**MOTOR, "current_limit": 2.0},
            "gear": {"ratio": 0.03},
            "friction": {"coulomb": 0.0},
        },
        names[2]: {"friction": friction},
    }
    tool = urdf.rsplit('<link name="', 1)[1].split('"')[0]
    return write_scene(
        folder, urdf, joints, tool=tool, gravity=[0.0, 0.0, -9.81], threads=threads,
        payload={"mass": 1.5, "com": [0.1, 0.0, 0.05], "inertia": [0.01, 0.02, 0.02, 0, 0, 0.001]},
        integrator={"scheme": scheme, "dt": 2e-4},
    )  # fmt: skip


def drawn(scene: Scene, rng: np.random.Generator) -> dict[str, float]:
    """Other values for all that is varied."""
    return {one.name: float(max(one.value, 0.1) * rng.uniform(0.5, 2.0)) for one in scene.varied}


def motion(plant: Plant, rows: np.ndarray, steps: int = 10) -> np.ndarray:
    try:
        plant.run(rows, steps)
    except Diverged as fault:
        pytest.fail(f"a tame machine: {fault}")
    x = plant.state
    return np.concatenate(
        [x.q, x.v, x.current, x.theta_m, x.omega_m, x.gear_torque, [plant.energy]]
    )


@pytest.mark.parametrize(
    ("scheme", "threads"),
    some([("extrapolated", 2), ("rosenbrock", 1), ("implicit", 1), ("paper", 1)], 1),
)
def test_varied_numbers_give_the_motion_of_constants(
    scheme: str, threads: int, tmp_path: Path
) -> None:
    """Set to other values, a machine moves as one that was compiled with these values."""
    rng = np.random.default_rng([SCHEMES.index(scheme), threads])
    file = random_arm(tmp_path, rng, scheme, threads)
    scene = load_scene(str(file), overrides={"varied": ALL})
    assert len(scene.varied) == 21, [one.name for one in scene.varied]
    plant = Plant(scene)
    rows = rng.normal(0.0, 10.0, (200, 3))
    values = drawn(scene, rng)
    for name, value in values.items():
        plant.set_parameter(name, value)
    assert plant.parameters == values, "numbers that were set"
    plant.reset()
    # The breakaway torque keeps its ratio to the coulomb torque.
    ratio = {j.name: j.friction.breakaway / (j.friction.coulomb or 1.0) for j in scene.joints}
    constants = dict(values)
    for joint in scene.joints:
        coulomb = values[f"joints.{joint.name}.friction.coulomb"]
        constants[f"joints.{joint.name}.friction.breakaway"] = coulomb * (ratio[joint.name] or 1.0)
    fixed = Plant(load_scene(str(file), overrides=constants))
    moved, expected = motion(plant, rows), motion(fixed, rows)
    # Rounding alone differs, in the sums of the base parameters: some 1e-16, grown in 0.4 s.
    np.testing.assert_allclose(moved, expected, rtol=1e-9, atol=1e-9)


def test_one_library_serves_every_value(tmp_path: Path) -> None:
    # The arm of the test above, whose library is there.
    rng, mass = np.random.default_rng([SCHEMES.index("extrapolated"), 2]), "payload.mass"
    file = random_arm(tmp_path, rng, "extrapolated", 2)
    scene = load_scene(str(file), overrides={"varied": ALL})
    one, other = Plant(scene), Plant(scene)
    other.set_parameter(mass, 3.0)
    heavy = dataclasses.replace(
        scene,
        varied=tuple(
            dataclasses.replace(v, value=2.5) if v.name == mass else v for v in scene.varied
        ),
    )
    assert library_of(heavy).file == one.core.file == other.core.file, "libraries"
    assert Plant(heavy).parameters[mass] == 2.5, "as the scene has it"
    assert one.parameters[mass] == 1.5, "as another scene has it"
    assert other.parameters[mass] == 3.0, "as it was set"
    rows = rng.normal(0.0, 10.0, (20, 3))
    assert not np.allclose(motion(one, rows), motion(other, rows)), "the mass has no effect"


def test_a_number_that_is_set_is_saved_and_the_motion_goes_on(tmp_path: Path) -> None:
    rng = np.random.default_rng([SCHEMES.index("extrapolated"), 2])  # as above
    file = random_arm(tmp_path, rng, "extrapolated", 2)
    scene = load_scene(str(file), overrides={"varied": ALL})
    rows = rng.normal(0.0, 10.0, (30, 3))
    one = Plant(scene)
    motion(one, rows)
    before = one.state
    name = f"joints.{scene.joints[0].name}.friction.viscous"
    one.set_parameter(name, 5.0)
    after = one.state
    for field in dataclasses.fields(before):
        if field.name != "gear_torque":
            np.testing.assert_array_equal(
                getattr(before, field.name), getattr(after, field.name), err_msg=field.name
            )
    saved = one.save()
    other = Plant(scene)
    other.restore(saved)
    assert other.parameters == one.parameters, "numbers of the saved machine and the restored one"
    assert other.parameters[name] == 5.0, "the number that was set"
    np.testing.assert_array_equal(motion(one, rows), motion(other, rows), err_msg="last states")
    assert one.save() == other.save(), "all that the machines are"


def test_a_number_with_bounds_of_its_size_is_set_below_zero() -> None:
    name = "joints.waist.encoder.offset"
    overrides = {"joints.waist.encoder.offset": 0.0, "varied": [name]}
    scene = load_scene("three_axis", overrides=overrides)
    sized = dataclasses.replace(scene.varied[0], number=Number.within(name, "rad", 1.0))
    scene = dataclasses.replace(scene, varied=(sized,))
    plant = Plant(scene)
    plant.set_parameter(name, -0.5)
    assert plant.parameters == {name: -0.5}, "the number that was set"
    with pytest.raises(Refusal, match="within"):
        plant.set_parameter(name, -1.5)


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
    file = random_arm(tmp_path, np.random.default_rng(7), "rosenbrock", 1)
    file.write_text(yaml.safe_dump({**yaml.safe_load(file.read_text()), "varied": varied}))
    with pytest.raises(Refusal, match=rule):
        load_scene(str(file))


def test_values_out_of_range_are_refused_and_change_nothing(tmp_path: Path) -> None:
    # The arm of the test above, whose library is there.
    rng = np.random.default_rng([SCHEMES.index("extrapolated"), 2])
    file = random_arm(tmp_path, rng, "extrapolated", 2)
    plant = Plant(load_scene(str(file), overrides={"varied": ALL}))
    kept = plant.save()
    names = list(plant.parameters)
    for _ in range(100):
        name = str(rng.choice([*names, "joints.knee.friction.coulomb", "", "payload"]))
        value = rng.choice(np.array([np.nan, np.inf, -1.0, -1e308, 1e308, "one", None], object))
        with pytest.raises(Refusal):
            plant.set_parameter(name, value)
        assert plant.save() == kept, f"{name} = {value} was refused and has changed something"


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


def test_varied_links_move_as_those_of_the_urdf_that_has_them(tmp_path: Path) -> None:
    """Masses, centres and tensors of turned and sliding links, each in its URDF's frame."""
    rng = np.random.default_rng(7)
    urdf = random_chain_urdf(rng, 3)
    other = ET.fromstring(urdf)
    for inertial in other.iter("inertial"):  # larger, elsewhere, and turned about
        inertial.find("mass").set("value", repr(float(rng.uniform(0.5, 3.0))))
        origin = inertial.find("origin")
        origin.set("xyz", " ".join(map(repr, rng.uniform(-0.2, 0.2, 3).tolist())))
        origin.set("rpy", " ".join(map(repr, rng.uniform(-1.0, 1.0, 3).tolist())))
    joints: dict[str, Any] = {name: {} for name in moving_joints(urdf)}
    common = {"gravity": [0.0, 0.0, -9.81], "varied": ["links.*"]}
    for name in ("one", "other"):
        (tmp_path / name).mkdir()
    files = [
        write_scene(tmp_path / name, text, joints, **common)
        for name, text in (("one", urdf), ("other", ET.tostring(other, encoding="unicode")))
    ]
    scene, wanted = map(load_scene, files)
    plant, oracle = Plant(scene), Oracle(wanted)
    for one in wanted.varied:
        plant.set_parameter(one.name, one.value)
    q, v, tau = rng.normal(size=(3, 50, 3))
    expected = np.array([oracle.aba(*row) for row in zip(q, v, tau, strict=True)])
    got = plant.links.accelerations(q, v, tau)
    # As in test_dynamics.py.
    np.testing.assert_allclose(got, expected, rtol=1e-9, atol=1e-10, err_msg="accelerations")
    plant.reset(q[0], v[0])
    energies = plant.energy, oracle.energy(q[0], v[0])
    assert energies[0] == pytest.approx(energies[1], rel=1e-12), "energy [J]"
