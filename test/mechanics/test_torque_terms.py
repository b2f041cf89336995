"""Torques term by term: they sum up, and each equals what others compute for it."""

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from draws import FULL
from faulty_machine import NAMES, chain_urdf, everything
from machines import MOTOR, write_scene

from arm_emulator import ExternalWrench, Plant, Scene, load_scene
from arm_emulator.analysis.torque_terms import TermsNow, TorqueTerms

MOMENTS = 1000 if FULL else 200
# Shares of the largest term of a joint. A link's acceleration solves M a = ..., whose condition
# loses two digits or three; a rotor's balance is a sum alone.
ROUNDING = 1e-12


def many_parts(folder: Path) -> Scene:
    """Elastic and rigid gears, every kind of friction, play, stops, a spring and a load."""
    shoulder = {
        "motor": {**MOTOR, "friction": {"viscous": 1e-4, "coulomb": 0.01, "load": 0.01}},
        "gear": {"ratio": 0.02, "stiffness": 3e3, "damping": 5.0, "backlash": 1e-3},
        "friction": {"viscous": 0.1, "coulomb": 0.3, "breakaway": 0.5, "load": 0.02},
        "end_stops": {"lower": -0.5, "upper": 6e-3, "stiffness": 1e4, "damping": 10.0},
        "counterbalance": {"base_distance": 0.3, "link_distance": 0.1, "force": 50.0,
                           "length": 0.2, "stiffness": 100.0},
    }  # fmt: skip
    elbow = {
        "start": 0.7,
        "motor": MOTOR,
        "gear": {"ratio": 0.05, "stiffness": 2e3, "damping": 2.0, "cubic_stiffness": 1e5},
        "lugre": {"coulomb": 0.2, "bristle_stiffness": 1e3, "bristle_damping": 10.0},
    }
    wrist = {"start": -0.7, "motor": MOTOR, "gear": {"ratio": 0.1},
             "friction": {"viscous": 0.05, "coulomb": 1.5}}  # fmt: skip
    joints = dict(zip(NAMES, (shoulder, elbow, wrist), strict=True))
    return load_scene(write_scene(
        folder, chain_urdf(), joints, tool="wrist_link", gravity=[0.0, 0.0, -9.81],
        external_wrench=True,
        integrator={"scheme": "rosenbrock", "dt": 2e-4}, supply_voltage=24.0,
    ))  # fmt: skip


def scenes(folder: Path) -> list[Scene]:
    (folder / "many").mkdir()
    many = many_parts(folder / "many")
    if not FULL:
        return [many]
    return [many, *map(load_scene, ("three_axis", "ur5", "panda")), everything(folder, faults=[])]


def moments(scene: Scene, seed: int) -> tuple[Plant, list[tuple[bytes, np.ndarray, TermsNow]]]:
    """A machine under random commands, at rest between them, with its terms."""
    rng, plant, terms = np.random.default_rng(seed), Plant(scene), TorqueTerms(scene)
    if scene.external_wrench:
        plant.set_external_wrench(
            scene.chain.joints[-1].link, ExternalWrench((3.0, -2.0, 5.0), (0.1, 0.2, -0.3))
        )
    limits = np.where(np.isfinite(scene.largest_commands), scene.largest_commands, 1.0)
    records = []
    while len(records) < MOMENTS:
        if len(records) % 50 == 0:
            plant.reset()
        command = limits * rng.uniform(-0.3, 0.3, len(limits)) * rng.integers(0, 2, len(limits))
        for _ in range(int(rng.integers(1, 8))):
            plant.exchange(command)
        saved = plant.save()
        records.append((saved, command, terms.evaluate_torques(saved, command)))
    return plant, records


def test_terms_sum_up_to_zero(tmp_path: Path) -> None:
    for scene in scenes(tmp_path):
        _, records = moments(scene, 1)
        for _, _, now in records:
            for side in (now.link, now.rotor):
                if "inertia" in side:
                    rows = np.array(list(side.values()))
                    sums, largest = np.nansum(rows, axis=0), np.nanmax(np.abs(rows), axis=0)
                    elastic = ~np.isnan(side["inertia"])
                    assert (np.abs(sums) <= ROUNDING * largest)[elastic].all(), scene.name


def test_each_term_is_the_independent_solution(tmp_path: Path) -> None:
    scene = many_parts(tmp_path)
    plant, records = moments(scene, 2)
    model = pin.buildModelFromXML(scene.urdf)
    data = model.createData()
    model.gravity.linear = np.array(scene.gravity)
    still, stuck = np.zeros(3), 0
    for saved, _, now in records:
        plant.restore(saved)
        state, link, rotor = plant.state, now.link, now.rotor
        q, v = state.q, state.v
        # By another program, from the description of the robot; its joints have cosine and sine.
        turned = np.column_stack([np.cos(q), np.sin(q)]).ravel()
        M = pin.crba(model, data, turned)
        M = np.triu(M) + np.triu(M, 1).T
        gravity = pin.rnea(model, data, turned, still, still)
        coriolis = pin.rnea(model, data, turned, v, still) - gravity
        acts = sum(np.nan_to_num(term) for name, term in link.items() if name != "inertia")
        inertia_of_rotor = np.nan_to_num(link["rotor behind a rigid gear"])
        a = np.linalg.solve(M, acts)
        near = {"rtol": 1e-9, "atol": 1e-10 * np.abs(acts).max() + 1e-12}  # condition of M
        np.testing.assert_allclose(-link["gravity"], gravity, **near)
        np.testing.assert_allclose(-link["Coriolis and centrifugal"], coriolis, **near)
        np.testing.assert_allclose(-link["inertia"], M @ a, **near)
        np.testing.assert_allclose(plant.links.mass_matrix(q) @ a, M @ a, **near)
        np.testing.assert_allclose(inertia_of_rotor[2], -a[2] * 1e-4 / 0.1**2, **near)
        # From the data sheet.
        gear = link["gear"] + inertia_of_rotor
        np.testing.assert_allclose(gear, state.gear_torque, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(rotor["motor"], 0.05 * state.current, rtol=1e-13)
        np.testing.assert_allclose(rotor["gear"][0], -0.02 * link["gear"][0], rtol=1e-13)
        damping = np.array([0.1, 0.0, 0.05])
        np.testing.assert_allclose(link["viscous friction"], -damping * v, rtol=1e-13, atol=0.0)
        slides = np.flatnonzero(v * [1.0, 0.0, 1.0])  # the elbow has a law of its own
        dry = np.array([0.3 + 0.02 * abs(link["gear"][0]), 0.0, 1.5]) * -np.sign(v)
        np.testing.assert_allclose(link["dry friction"][slides], dry[slides], rtol=1e-12)
        stuck += int((v == 0.0)[[0, 2]].sum())
    assert 3 < stuck < MOMENTS, "joints that slide and joints that stick"


def test_the_external_wrench_is_a_term_of_its_own(tmp_path: Path) -> None:
    scene = many_parts(tmp_path)
    plant, terms = Plant(scene), TorqueTerms(scene)
    model = pin.buildModelFromXML(scene.urdf)
    data = model.createData()
    force, moment, point = np.array([3.0, -2.0, 5.0]), np.array([0.1, 0.2, -0.3]), np.ones(3) * 0.1
    plant.set_external_wrench("wrist_link", ExternalWrench(force, moment, point, "world"))
    q = plant.state.q
    turned = np.column_stack([np.cos(q), np.sin(q)]).ravel()
    frame = model.getFrameId("wrist_link")
    J = pin.computeFrameJacobian(model, data, turned, frame, pin.LOCAL_WORLD_ALIGNED)
    pin.framesForwardKinematics(model, data, turned)
    lever = data.oMf[frame].rotation @ point
    expected = J[:3].T @ force + J[3:].T @ (moment + np.cross(lever, force))
    now = terms.evaluate_torques(plant.save(), np.zeros(3))
    np.testing.assert_allclose(now.link["external wrench"], expected, atol=1e-11)
    assert "external wrench" not in TorqueTerms(load_scene("three_axis")).evaluate_torques(
        Plant("three_axis").save(), np.zeros(3)
    ).link  # fmt: skip


@pytest.mark.parametrize("wrong", (b"", b"x" * 552))
def test_foreign_bytes_are_refused(wrong: bytes) -> None:
    from arm_emulator.base.refusal import Refusal

    with pytest.raises(Refusal, match=r"Plant.restore"):
        TorqueTerms(load_scene("three_axis")).evaluate_torques(wrong, np.zeros(3))
