"""Frequency responses against two masses on a spring, and against a machine that swings."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from machines import GANTRY, MOVED, ROTOR, gantry_urdf, write_scene
from test_command_line import run

from arm_emulator import Plant, linearise, load_gains, load_scene
from arm_emulator.analysis.vibration_modes import find_vibration_modes
from arm_emulator.base.io.table_file import read_table
from arm_emulator.motion.model.config import load_motion_config
from bench.physics.published_responses import ABB, Masses

RATIO, STIFFNESS, DAMPING = 0.01, 4e4, np.array([5.0, 8.0, 3.0])


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    joints = {
        name: {
            "motor": {"kind": "torque", "rotor_inertia": ROTOR},
            "gear": {"ratio": RATIO, "stiffness": STIFFNESS, "damping": float(damping)},
        }
        for name, damping in zip(GANTRY, DAMPING, strict=True)
    }
    integrator = {"scheme": "rosenbrock", "dt": 1e-5}
    return write_scene(
        tmp_path_factory.mktemp("gantry"), gantry_urdf(), joints, integrator=integrator
    )


def two_masses(s: np.ndarray, j: int) -> tuple[np.ndarray, np.ndarray]:
    """Speeds of motor and link per N m: rotor, spring and damper, link."""
    spring = DAMPING[j] * s + STIFFNESS
    link = MOVED[j] * s**2 + spring
    carried = ROTOR / RATIO**2 * s**2 + spring * MOVED[j] * s**2 / link
    angle = 1.0 / RATIO / carried  # at the link's side
    return s * angle / RATIO, s * angle * spring / link


def test_the_response_is_that_of_two_masses(file: Path, tmp_path: Path) -> None:
    table = tmp_path / "bode.csv"
    code, out, errors = run("bode", str(file), "--json", "--table", str(table), "--high", "400")
    assert code == 0, errors
    facts, rows = json.loads(out), read_table(table, {})
    s = 2j * np.pi * np.array(facts["frequency"])
    for j, name in enumerate(GANTRY):
        response = facts["joints"][name]
        for of, expected in zip(("motor", "link"), two_masses(s, j), strict=True):
            actual = np.array(response[of]["gain"]) * np.exp(1j * np.array(response[of]["phase"]))
            np.testing.assert_allclose(actual, expected, rtol=1e-8)
            # The table has nine digits.
            np.testing.assert_allclose(
                rows.get_column(f"{name}.{of}.gain"), np.abs(actual), rtol=1e-8
            )
        stiffness = STIFFNESS / (2.0 * np.pi) ** 2
        locked = np.sqrt(stiffness / MOVED[j])
        free = np.sqrt(stiffness * (1.0 / MOVED[j] + RATIO**2 / ROTOR))
        # Damping moves peaks by some 1e-3 of their frequency, the grid's step is as large.
        assert response["antiresonances"] == pytest.approx([locked], rel=3e-3)
        assert response["resonances"] == pytest.approx([free], rel=3e-3)


def test_a_machine_that_is_shaken_swings_as_far(file: Path) -> None:
    """After a second, in which what it began with has died away; steps of 1e-5 s hold commands."""
    plant, hz, rows = Plant(load_scene(file)), 20.0, 100_000
    t = 1e-5 * (np.arange(2 * rows) + 0.5)
    command = 0.01 * np.cos(2.0 * np.pi * hz * t)[:, np.newaxis] * np.ones(3)
    plant.run(command[:rows], 1)
    before = plant.state.q
    q = plant.run(command[rows:], 1)
    v = np.diff(np.vstack([before, q]), axis=0) / 1e-5
    wave = np.exp(-2j * np.pi * hz * t[rows:])
    result = 2.0 * (v - v.mean(axis=0)).T @ wave / rows / 0.01
    expected = [two_masses(np.array([2j * np.pi * hz]), j)[1][0] for j in range(3)]
    np.testing.assert_allclose(result, expected, rtol=1e-3)


def test_wrong_ranges_and_places_are_refused(file: Path, tmp_path: Path) -> None:
    for words, line in (
        (["--low", "900"], "--low must be below the highest frequency"),
        (["--high", "0"], "--low and --high must be"),
        (["--pose", "0", "1"], "bode: --pose must have"),
        (["--pose", "nan", "0", "0"], "bode: --pose must be numbers within"),
        (["--picture", str(tmp_path / "no" / "a.png")], "must be writable"),
        (["--table", str(tmp_path / "no" / "a.csv")], "must be writable"),
    ):
        code, _, errors = run("bode", str(file), *words)
        assert code == 2 and line in errors and errors.count("\n") == 1, errors


def test_the_modes_under_the_servos_are_lines_of_a_motion_controllers_file(tmp_path: Path) -> None:
    code, out, errors = run("bode", "three_axis", "--closed")
    assert code == 0, errors
    lines = out.partition("for the motion controller's file:\n")[2]
    file = tmp_path / "motion.yaml"
    file.write_text(f"/**/motion_controller:\n  ros__parameters:\n    tool: tool\n{lines}")
    config = load_motion_config(file)
    scene = load_scene("three_axis")
    modes = find_vibration_modes(Plant(scene), load_gains("three_axis").servo, scene.start)
    assert config.shaper == "zvd" and len(config.modes) == 2
    for file_mode, mode in zip(config.modes, modes, strict=False):
        assert file_mode.frequency == pytest.approx(mode.frequency, rel=1e-3)
        assert file_mode.damping == pytest.approx(mode.damping, rel=1e-2)
    facts = json.loads(run("bode", "three_axis", "--closed", "--json")[1])
    assert [fact["swing"] for fact in facts["modes"]] == [
        computed_mode.swing for computed_mode in modes
    ]
    assert facts["range"][0] <= modes[0].frequency <= facts["range"][1]


def test_modes_need_a_servo(file: Path) -> None:
    code, out, errors = run("bode", str(file), "--closed")
    assert code == 2 and "servo parameters must be in" in errors, out


@pytest.mark.slow
@pytest.mark.parametrize("axis", ABB)
def test_a_published_axis_responds_as_its_masses(axis: Masses) -> None:
    """The arm's structure is joints without a motor, on springs."""
    scene = load_scene(axis.scene)
    linear = linearise(scene, scene.start)
    frequencies = np.geomspace(0.5, 200.0, 50)
    s = 2j * np.pi * frequencies
    x = np.linalg.solve(s[:, None, None] * np.eye(len(linear.A)) - linear.A, linear.B[:, [0]])
    speed = s * (x[..., 0] @ linear.theta_m[0])
    # A joint's friction acts between its links, that of the outer masses on the ground is left out.
    outer = dataclasses.replace(
        axis, friction=(*axis.friction[:2], *(0.0 for _ in axis.springs[1:]))
    )
    assert speed == pytest.approx(outer.compute_response(frequencies), rel=1e-9)
    code, out, errors = run("bode", axis.scene, "--json", "--high", "100")
    assert code == 0, errors
    axis_facts = json.loads(out)["joints"]["axis"]
    grid = np.geomspace(1.0, 100.0, 20001)
    gain = np.abs(outer.compute_response(grid))
    dips = grid[1:-1][(gain[1:-1] < gain[:-2]) & (gain[1:-1] < gain[2:])]
    assert axis_facts["antiresonances"] == pytest.approx(dips.tolist(), rel=1e-3)  # 2000 per decade
