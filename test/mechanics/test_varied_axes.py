"""Varied numbers on axes as they are measured: tilted against each other by anything but nothing.

A varied number must give the machine in which it is built in. Tilts are drawn from 1e-9 to 0.1 rad,
so that every threshold by which terms could be left out stands between some of them.
"""

import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from draws import FULL, some
from machines import Oracle, write_scene

from arm_emulator import Diverged, Measured, Plant, Scene, load_scene
from arm_emulator.base.urdf.frames import Frame, make_frame
from arm_emulator.machine.chain import Body, ChainJoint
from arm_emulator.machine.parts.drive_stages.current_loop import CurrentLoop
from arm_emulator.machine.plant.outputs import KNOWN
from arm_emulator.machine.varied import (
    AXES,
    NAMES,
    TENSOR,
    read_body_numbers,
    vary_child,
    write_expressions,
)
from oracles.mixtures import STEPS, draw_commands, push_link, write_mixture
from oracles.random_chain import list_moving_joints, write_random_chain

SENSORS: dict[str, Any] = {
    "link_encoder": {"counts_per_turn": 8192, "noise": 1e-3, "eccentricity": 1e-3},
}
MOTOR_SENSORS: dict[str, Any] = {
    "torque_sensor": {"noise": 0.1, "offset": 0.02, "gain_error": 0.02},
    "current_sensor": {"noise": 0.05, "offset": 0.01, "gain_error": 0.02},
}


def tilt(rng: np.random.Generator) -> float:
    return float(rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(-9.0, -1.0))


def skew(rng: np.random.Generator, urdf: str) -> str:
    """The same chain with axes near x, y or z, and quarter turns, all tilted a little."""
    robot = ET.fromstring(urdf)
    for joint in robot.iter("joint"):
        axis = np.roll([1.0, tilt(rng), tilt(rng)], int(rng.integers(3))) * rng.choice([-1.0, 1.0])
        rpy = 0.5 * np.pi * rng.integers(-2, 3, 3) + [tilt(rng) for _ in range(3)]
        joint.find("axis").set("xyz", words(axis))
        joint.find("origin").set("rpy", words(rpy))
    return ET.tostring(robot, encoding="unicode")


def change_links(rng: np.random.Generator, urdf: str) -> str:
    """The same chain with links of other masses, elsewhere, turned about."""
    robot = ET.fromstring(urdf)
    for inertial in robot.iter("inertial"):
        inertial.find("mass").set("value", repr(float(rng.uniform(0.5, 3.0))))
        origin = inertial.find("origin")
        origin.set("xyz", words(rng.uniform(-0.2, 0.2, 3)))
        origin.set("rpy", words(rng.uniform(-1.0, 1.0, 3)))
    return ET.tostring(robot, encoding="unicode")


def words(values: Any) -> str:
    return " ".join(map(repr, np.asarray(values, dtype=float).tolist()))


# Generated code


def skewed_joint(rng: np.random.Generator) -> ChainJoint:
    """A joint whose axes are near to those of its link, and what it moves."""
    R = make_frame(
        (0.0, 0.0, 0.0), 0.5 * np.pi * rng.integers(-2, 3, 3) + [tilt(rng) for _ in "xyz"]
    )
    A = rng.normal(size=(3, 3))
    body = Body(float(rng.uniform(0.5, 3.0)), rng.normal(size=3), A @ A.T + np.eye(3))
    nowhere = np.zeros(3)
    return ChainJoint(
        "joint", "revolute", -1, 1.0, 0.0, 1.0, 0.0, 0.0, nowhere, body, R.R, {"link": Frame()}
    )  # fmt: skip


def test_every_term_of_a_turned_body_is_written(seeds: int = 4000 if FULL else 300) -> None:
    """Mass, first moment and tensor, some of them varied, against R h and R I R' in NumPy."""
    for seed in range(seeds):
        rng = np.random.default_rng([seed, 11])
        joint = skewed_joint(rng)
        own = vary_child(joint)
        chosen = [name for name in NAMES if rng.random() < 0.5] or ["mass"]
        places = {f"links.link.{name}": f"p[{k}]" for k, name in enumerate(chosen)}
        p = rng.normal(size=len(chosen)).tolist()
        numbers = own | dict(zip(chosen, p, strict=True))
        h = np.array([numbers[f"moment_{x}"] for x in AXES])
        I = np.zeros((3, 3))  # noqa: E741
        for xx in TENSOR:
            k, m = AXES.index(xx[0]), AXES.index(xx[1])
            I[k, m] = I[m, k] = numbers[f"inertia_{xx}"]
        R = joint.axes
        expected = read_body_numbers(Body(numbers["mass"], R @ h, R @ I @ R.T))
        written = write_expressions(joint, places)
        assert written is not None, "numbers that are varied"
        for name, text in written.items():
            result = eval(text, {"p": p})  # a sum of products, as C++ and Python write them
            # A sum of nine terms, each rounded.
            rounding = 2e-15 * (1.0 + np.abs(h).sum() + np.abs(I).sum())
            assert abs(result - expected[name]) < rounding, f"{seed}: {name} = {text}"


# The machines


@pytest.mark.parametrize("seed", some(range(12), 1))
def test_varied_links_on_skewed_axes_are_those_of_pinocchio(seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng([seed, 12])
    urdf = skew(rng, write_random_chain(rng, 3))
    changed_urdf = change_links(rng, urdf)
    files = []
    for name, text in (("one", urdf), ("other", changed_urdf)):
        (tmp_path / name).mkdir()
        joints: dict[str, Any] = {joint: {} for joint in list_moving_joints(text)}
        common: dict[str, Any] = {"gravity": [0.0, 0.0, -9.81], "varied": ["links.*"]}
        files.append(write_scene(tmp_path / name, text, joints, **common))
    scene, changed = map(load_scene, files)
    plant, oracle = Plant(scene), Oracle(changed)
    for number in changed.varied:
        plant.set_parameter(number.name, number.value)
    q, v, tau = rng.normal(size=(3, 50, len(scene.joints)))
    expected = np.array([oracle.aba(*row) for row in zip(q, v, tau, strict=True)])
    accelerations = plant.links.accelerations(q, v, tau)
    # As in test_dynamics.py.
    np.testing.assert_allclose(
        accelerations, expected, rtol=1e-9, atol=1e-10, err_msg="accelerations"
    )
    plant.reset(q[0], v[0])
    energies = plant.energy, oracle.energy(q[0], v[0])
    assert energies[0] == pytest.approx(energies[1], rel=1e-12), "energy [J]"


def write_skewed_mixture(folder: Path, seed: int) -> tuple[Path, Path]:
    """Write a mixture on skewed axes with noisy sensors; and the same with other links."""
    rng = np.random.default_rng([seed, 13])
    file = write_mixture(folder, seed)
    scene = yaml.safe_load(file.read_text())
    for joint in scene["joints"].values():
        sensors = SENSORS | (MOTOR_SENSORS if "motor" in joint else {})
        joint |= {key: section for key, section in sensors.items() if rng.random() < 0.5}
    first = list_moving_joints((folder / "mixture.urdf").read_text())[0]
    gyroscope = {"noise": 1e-3, "bias_x": 0.01}
    scene["imus"] = {"hand": {"link": f"{first}_link", "gyroscope": gyroscope}}
    scene["seed"] = 3
    urdf = skew(rng, (folder / "mixture.urdf").read_text())
    files = []
    for name, text in (("mixture", urdf), ("other", change_links(rng, urdf))):
        (folder / f"{name}.urdf").write_text(text)
        files.append(folder / f"{name}.yaml")
        files[-1].write_text(yaml.safe_dump({**scene, "urdf": f"{name}.urdf"}))
    return files[0], files[1]


# Numbers of a winding that drives are set up for.
OF_DC = "resistance", "inductance", "back_emf_constant"
OF_PMSM = "inductance_d", "inductance_q", "flux"


def change_values(scene: Scene, of_links: Scene, rng: np.random.Generator) -> dict[str, float]:
    """Other values of all that is varied; of the links those of another scene.

    A current loop is set up for the winding that is built in, so that none could be built in with
    another one.
    """
    links = {number.name: number.value for number in of_links.varied}
    fixed = {
        f"joints.{joint.name}.motor.{key}"
        for joint in scene.joints
        if any(isinstance(part, CurrentLoop) for part in joint.parts)
        for key in (*OF_DC, *OF_PMSM)
    }
    return {
        number.name: links[number.name]
        if number.name.startswith("links.")
        else number.value
        if number.name in fixed
        else number.value + 1.0
        if number.name == "seed"
        else float(
            np.clip(number.value * rng.uniform(1.0, 1.2), number.number.least, number.number.most)
        )
        for number in scene.varied
    }


def constants(scene: Scene, values: dict[str, float]) -> dict[str, float]:
    """Return overrides with these values: numbers that follow another one keep their ratio."""
    built = {name: value for name, value in values.items() if not name.startswith("links.")}
    for joint in scene.joints:
        for part in joint.parts:
            for key, number in part.list_numbers().items():
                place = f"joints.{joint.name}.{part.section}."
                followed = None if number.follows is None else getattr(part, number.follows)
                if followed:
                    ratio = getattr(part, key) / followed
                    built[place + key] = ratio * values[f"{place}{number.follows}"]
    return built


def moved(scene: Scene, values: dict[str, float], seed: int) -> tuple[np.ndarray, list[Measured]]:
    """States and measurements after each servo period."""
    plant, rows, measured = Plant(scene), [], []
    for name, value in values.items():
        plant.set_parameter(name, value)
    plant.reset()
    push_link(plant, seed)
    for command in draw_commands(scene, seed):
        plant.exchange(command)
        x = plant.state
        rows.append([x.q, x.v, x.current, x.theta_m, x.omega_m, x.gear_torque])
        measured.append(plant.measured)
    return np.array(rows), measured


@pytest.mark.slow
@pytest.mark.parametrize("seed", some(range(30), 1))
def test_every_kind_of_varied_number_is_as_if_built_in(seed: int, tmp_path: Path) -> None:
    """All parts' numbers, links' and sensors' at once, on a mixture with skewed axes."""
    mixture, with_links = write_skewed_mixture(tmp_path, seed)
    # Where events fall does not depend on whence the numbers come, and costs half of the compiler.
    fine: dict[str, Any] = {"integrator.dt": 0.01 / STEPS[-1], "integrator.events": "step"}
    all_of_them = {**fine, "varied": ["joints.*", "links.*", "imus.*", "seed"]}
    rng = np.random.default_rng([seed, 14])
    scene = load_scene(mixture, all_of_them)
    values = change_values(scene, load_scene(with_links, all_of_them), rng)
    try:
        built = load_scene(with_links, {**fine, **constants(scene, values)})
        expected, measured = moved(built, {}, seed)
    except Diverged:
        with pytest.raises(Diverged):
            moved(scene, values, seed)
        return
    states, reported = moved(scene, values, seed)
    size = np.abs(expected).max(axis=(0, 2), keepdims=True)
    # Rounding, which stick-slip and hard stops let grow in 0.2 s.
    assert (np.abs(states - expected) / (1.0 + size)).max() < 1e-8, "states"
    for reading, with_links in zip(reported, measured, strict=True):
        for field in KNOWN:
            mine, its = (np.asarray(getattr(m, field), dtype=float) for m in (reading, with_links))
            # A motion that is off by 1e-8 may be at the edge of a count.
            atol = 1.0 if getattr(reading, field).dtype == np.int64 else 1e-6
            np.testing.assert_allclose(mine, its, rtol=1e-6, atol=atol, err_msg=field)
