"""Derivatives of motions are those of the machine: by every number of every part, events included.

The truth is the ordinary machine, one of its numbers changed, and central differences of fourth
order. All machines locate their events, so that motions are smooth in their
numbers between two orders of events.
"""

import itertools
from pathlib import Path

import numpy as np
import pytest
from draws import FULL, some
from machines import GANTRY, GRAVITY, gantry_urdf

from arm_emulator import Plant, Refusal, Scene, load_scene, sensitivities
from arm_emulator.analysis.sensitivities import (
    QUANTITIES,
    SensitiveMachine,
    list_varied_numbers,
    make_differentiable,
)
from arm_emulator.base.arrays import Array
from arm_emulator.machine.parts.part import Part
from arm_emulator.machine.scene.known_parts import PARTS
from arm_emulator.machine.varied import Varied
from oracles.mixtures import PERIOD, draw_alone, draw_commands, write_mixture, write_scene

Parts = tuple[type[Part], ...]

BESIDE = [(PARTS + PARTS)[k : k + 3] for k in range(0, len(PARTS), 3)]
SHARES = (3e-3, 1e-3, 1e-4, 1e-5, 1e-6)  # of a number: an event in its order spoils the longer
# steps (of mixture 10 down to 1e-5), rounding the shorter ones
POINTS, WEIGHTS = (-2, -1, 1, 2), np.array([1.0, -8.0, 8.0, -1.0]) / 12.0


def inner(scene: Scene) -> list[str]:
    """The numbers that may become larger and smaller by a hundredth."""
    return [
        name
        for name, number in list_varied_numbers(scene).items()
        if (margin := 0.01 * abs(number.value)) > 0.0
        and number.number.ends[0] < number.value - margin
        and number.value + margin < number.number.ends[1]
    ]


def differences(plant: Plant, rows: Array, varied: tuple[Varied, ...], share: float) -> list[Array]:
    """Derivatives after the last row, (N, n), of the quantities in their order."""
    ends = []
    for number in varied:
        for point in POINTS:
            plant.set_parameter(number.name, number.value * (1.0 + share * point))
            plant.reset()
            plant.run(rows, plant.scene.steps_per_period)
            ends.append([getattr(plant.state, name) for name in QUANTITIES])
        plant.set_parameter(number.name, number.value)
    widths = share * np.array([number.value for number in varied])
    by = np.array(ends).reshape(len(varied), len(POINTS), len(QUANTITIES), -1)
    return [*np.einsum("kpij,p->ijk", by, WEIGHTS) / widths]


def compare(scene: Scene, rows: Array) -> None:
    names = inner(scene)
    of = sensitivities(scene, rows, names)
    assert of.names == tuple(names)
    varied = tuple(list_varied_numbers(scene)[name] for name in names)
    values = np.abs([number.value for number in varied])
    plant = Plant(make_differentiable(scene, varied))
    assert np.abs(plant.run(rows, scene.steps_per_period) - of.q).max() < 1e-11, "the same motion"
    sizes = [np.abs(getattr(plant.state, quantity)).max() for quantity in QUANTITIES]
    tries = [differences(plant, rows, varied, share) for share in SHARES]
    for quantity, size, *by in zip(QUANTITIES, sizes, *tries, strict=True):
        derivative = of.by[quantity][-1]
        off = np.min([np.abs(shifted - derivative) for shifted in by], axis=0)
        # 1e-6 of the number's effect, what rounding leaves of differences, and by how much these
        # disagree: an event that passes the end of a step changes the scheme's error.
        largest = np.abs(derivative).max(axis=0)
        pairs = [np.abs(a - b) for a, b in itertools.combinations(by, 2)]
        disagree = np.sort(pairs, axis=0)[1]  # two may agree by chance
        permitted = 1e-6 * largest + 1e-9 * (size + 1.0) / values
        resolved = disagree <= permitted
        assert resolved.mean() > 0.5, "differences know most of them"
        permitted = np.where(resolved, permitted, permitted + np.ptp(by, axis=0))
        worst = np.unravel_index(int(np.argmax(off / permitted)), off.shape)
        at = f"{quantity} of joint {worst[0]} by {names[worst[1]]}"
        assert (off <= permitted).all(), (
            f"{at}: {derivative[worst]}, differences {[b[worst] for b in by]}"
        )


# In a short run a mixture has some of them.
@pytest.mark.parametrize("parts", some(BESIDE, 0), ids=lambda of: "-".join(p.__name__ for p in of))
def test_derivatives_by_every_number_of_a_part(parts: Parts, tmp_path: Path) -> None:
    joints = {name: draw_alone(part, 0) for name, part in zip(GANTRY, parts, strict=True)}
    file = write_scene(tmp_path, gantry_urdf(), joints, gravity=GRAVITY)
    scene = load_scene(file, {"integrator.dt": PERIOD / 4, "integrator.events": "located"})
    compare(scene, draw_commands(scene, 0))


@pytest.mark.slow
def test_derivatives_by_every_number_of_friction_that_knows_the_direction_of_power(
    tmp_path: Path,
) -> None:
    directed = {"viscous": 1e-5, "load": 0.1, "back_load": 0.3, "rest_load": 0.2,
                "rest_back_load": 0.1, "motor_load": 0.1, "rest_motor_load": 0.05,
                "rest_load_square": 0.5, "rest_motor_square": 0.2, "exponent": 1.6}  # fmt: skip
    of_rotor = {**directed, "coulomb": 5e-3, "breakaway": 8e-3, "stribeck": 6.0}
    motor = {"kind": "torque", "rotor_inertia": 1e-4, "torque_limit": 0.3, "bandwidth": 100.0}
    elastic = {"ratio": 0.02, "stiffness": 2e4, "damping": 20.0}
    rigid = {key: value for key, value in of_rotor.items() if "motor_load" not in key}
    sections = (
        {"motor": {**motor, "friction": of_rotor}, "gear": elastic},
        {"motor": motor, "gear": {**elastic, "ratio": -0.02},
         "friction": {**directed, "coulomb": 0.5, "breakaway": 0.7, "stribeck": 0.2}},
        {"motor": {**motor, "friction": rigid}, "gear": {"ratio": -0.02}},
    )  # fmt: skip
    joints = dict(zip(GANTRY, sections, strict=True))
    file = write_scene(tmp_path, gantry_urdf(), joints, gravity=GRAVITY)
    scene = load_scene(file, {"integrator.dt": PERIOD / 4, "integrator.events": "located"})
    compare(scene, draw_commands(scene, 0))


def mixture(folder: Path, seed: int) -> Scene:
    scheme = ("extrapolated", "rosenbrock")[seed % 2]
    return load_scene(write_mixture(folder, seed), {"integrator.scheme": scheme})


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(20) if FULL else [8])
def test_derivatives_by_every_number_of_a_mixture(seed: int, tmp_path: Path) -> None:
    scene = mixture(tmp_path, seed)
    compare(scene, draw_commands(scene, seed))


@pytest.mark.slow
def test_derivatives_do_not_depend_on_how_many_there_are(tmp_path: Path) -> None:
    """As many as fill a vector, one more and one less: what is shared by several does not change.

    In the library of the test above, by some of its numbers and starts, drawn with repetition.
    """
    scene = mixture(tmp_path, 8)
    machine = SensitiveMachine(scene, [*inner(scene), "start.*"])
    rows, rng = draw_commands(scene, 8), np.random.default_rng(0)
    every, places = machine.run_motion(rows).by, np.array(machine._places)
    for count in (1, 7, 8, 9, 16, 17, 64, 65):
        which = rng.integers(len(places), size=count)
        machine._places = places[which].tolist()
        for quantity, by in machine.run_motion(rows).by.items():
            expected = every[quantity][..., which]
            off = np.abs(by - expected).max(axis=(0, 1))
            # Rounding of sums in another order.
            assert (off <= 1e-9 * np.abs(expected).max(axis=(0, 1))).all(), (count, quantity)


@pytest.mark.parametrize("name", some(["three_axis", "ur5", "panda"], 1))
def test_derivatives_by_every_number_of_a_shipped_scene(name: str) -> None:
    scene = load_scene(name)
    rows = 0.3 * scene.largest_commands * np.sin(np.arange(200)[:, np.newaxis] / 30.0)
    compare(scene, rows)


def test_derivatives_by_the_start() -> None:
    """Each link moved at the start, with the motors that follow it."""
    scene = load_scene("three_axis")
    rows = np.tile([3.0, -2.0, 1.0], (50, 1))
    q, v = scene.start + 0.1, np.array([0.3, -0.2, 0.4])
    # With the numbers of the test above, whose libraries it shares.
    names = inner(scene)
    of = sensitivities(scene, rows, [*names, "start.*"], q=q, v=v)
    assert of.names[-6:] == tuple(
        f"start.{which}.{name}" for which in "qv" for name in scene.joint_names
    )
    h, plant = (
        1e-3,
        Plant(
            make_differentiable(scene, tuple(list_varied_numbers(scene)[name] for name in names))
        ),
    )
    for k in range(6):
        ends = []
        for point in POINTS:
            moved = np.concatenate([q, v])
            moved[k] += point * h
            plant.reset(moved[:3], moved[3:])
            ends.append(plant.run(rows, scene.steps_per_period))
        by = np.einsum("pkj,p->kj", np.array(ends), WEIGHTS) / h
        # h^4 of the differences.
        assert np.abs(by - of.by["q"][..., len(names) + k]).max() < 1e-9 * np.abs(by).max() + 1e-9


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({"by": ["joints.wrist.gear.stiffness"]}, "by must name numbers of the scene"),
        ({"steps": 0}, "steps must"),
        ({"commands": np.zeros((3, 2))}, "commands must have shape"),
        ({"commands": np.full((3, 3), np.nan)}, "commands must be"),
        ({"q": [0.0, 0.0]}, "position must"),
        ({"v": [np.inf, 0.0, 0.0]}, "velocity must be"),
    ],
)
def test_bad_arguments_are_refused(changed: dict[str, object], reason: str) -> None:
    scene = load_scene("three_axis")
    # By the numbers of the tests above, whose library it shares.
    arguments = {"commands": np.zeros((3, 3)), "by": inner(scene), **changed}
    with pytest.raises(Refusal, match=reason):
        sensitivities(scene, **arguments)  # type: ignore[arg-type]
