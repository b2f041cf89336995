"""Advice on schemes and steps: for an error, into the scene file, and where a machine diverges."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from draws import some
from machines import CONFIG

from arm_emulator.__main__ import main
from arm_emulator.advise import record
from emulator_node.advice import ORDERS, Motion, advise, round_numbers, write_integrator
from emulator_node.plant import Diverged, Plant
from emulator_node.reference import reference
from emulator_node.scene import SCHEMES, Scene, load_scene
from emulator_node.stability import attempts, what_holds
from words.config_files import BESIDE
from words.refusal import Refusal


@cache
def demo() -> tuple[Motion, np.ndarray]:
    """The first 0.4 s of three_axis' demo (its target holds from 0.2 s on), and the true motion."""
    scene = load_scene("three_axis")
    voltages = record(scene, CONFIG / "three_axis.yaml")[0][:400]
    return Motion(scene, voltages), reference(scene, voltages, scene.servo_period)


def error(scheme: str, steps: int) -> float:
    motion, truth = demo()
    q = motion.q(scheme, steps)
    assert q is not None, f"{scheme} diverges with {steps} steps"
    return float(np.abs(q - truth).max())


def test_the_demo_is_the_paper_s() -> None:
    """Nothing happens for 0.2 s, then the joints move towards a tool 10 mm aside."""
    _, truth = demo()
    still, way = np.abs(truth[:199] - truth[0]).max(), np.abs(truth[-1] - truth[0]).max()
    assert still < 1e-4, "some encoder counts of motion before the target [rad]"
    assert way > 1e-2, "10 mm at 0.6 m [rad]"


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("steps", [2, 5, 20])
def test_estimates_are_errors(scheme: str, steps: int) -> None:
    """Where the differences of doubled steps fall by the scheme's order, their sum is the error."""
    estimate = demo()[0].estimate(scheme, steps)
    # The differences have their maxima at different instants, which makes the sum larger.
    true = error(scheme, steps)
    assert true * 0.98 < estimate < true * 1.3, "the estimate of an error, and the error"


@pytest.mark.parametrize("wanted", some([1e-4, 3e-6, 1e-7, 1e-8], 2))
def test_settings_keep_the_error_and_the_next_coarser_ones_do_not(wanted: float) -> None:
    motion, _ = demo()
    settings = advise(motion, wanted)
    assert settings == sorted(settings, key=lambda s: s.cost), "the cheapest first"
    reached = {setting.scheme for setting in settings}
    assert "rosenbrock" in reached, f"others may need more steps than are tried: {settings}"
    for setting in settings:
        steps = round(1e-3 / setting.dt)
        assert steps in round_numbers(1, steps + 1), f"{steps} is no product of 2s and 5s"
        assert error(setting.scheme, steps) <= wanted, f"true error of {setting}"
        coarser = round_numbers(1, steps)
        if coarser:
            estimate = motion.estimate(setting.scheme, coarser[-1])
            assert estimate > wanted, f"{coarser[-1]} steps would do, in place of {setting}"


def test_divergence_is_no_estimate() -> None:
    """Stiff undamped gears: `paper` diverges down to steps that nobody would choose."""
    gear = {"joints.*.gear.stiffness": 1e7, "joints.*.gear.damping": 0.0}
    # With the libraries of other machines that differ in numbers only.
    scene = load_scene("three_axis", overrides={**gear, "varied": ["joints.*"]})
    motion = Motion(scene, np.full((100, 3), 5.0))
    assert motion.estimate("paper", 1) == np.inf, "an estimate of what diverges"
    # The gears' ringing of 1e-6 rad is not resolved; differences that stay so small are no harm.
    assert motion.estimate("rosenbrock", 4) < 1e-4, "estimate [rad]"
    settings = {setting.scheme: setting for setting in advise(motion, 1e-4)}
    assert "paper" not in settings or settings["paper"].dt < 1e-5, settings
    assert settings["rosenbrock"].dt >= 2.5e-4, settings


def test_errors_that_make_no_sense_are_refused() -> None:
    for wanted in (0.0, -1.0, 1e-13, 2.0, float("nan")):
        with pytest.raises(Refusal, match="advise: error must be from 1e-11 to 1 rad"):
            advise(demo()[0], wanted)


def test_round_numbers() -> None:
    assert round_numbers(1, 26) == [1, 2, 4, 5, 8, 10, 16, 20, 25], "from 1 to 25"
    assert round_numbers(51, 64) == [], "from 51 to 63"


# Where a machine diverges


def diverged(plant: Plant, volts: np.ndarray) -> Diverged:
    with pytest.raises(Diverged) as told:
        for row in volts:
            plant.advance(row, plant.scene.steps_per_period)
    return told.value


@pytest.mark.parametrize("seed", range(4))
def test_advice_is_on_the_values_that_a_machine_has_of_varied_numbers(seed: int) -> None:
    """Stiffer gears are set on an arm that holds: what is told is that of an arm made with them."""
    rng = np.random.default_rng([seed, 9])
    common = {"varied": ["joints.*"], "integrator.scheme": "paper", "integrator.dt": 1e-3}
    scene = load_scene("three_axis", overrides=common)
    values = {}
    for one in scene.varied:
        kind = one.name.split(".", 2)[2]
        decades = {"gear.stiffness": (1.0, 3.0), "gear.damping": (-1.0, 0.3)}.get(kind, (-0.1, 0.1))
        values[one.name] = float(one.value * 10.0 ** rng.uniform(*decades))
    volts = rng.uniform(-20.0, 20.0, (1000, 3))
    plant = Plant(scene)
    plant.advance(volts[0], 100)  # with the scene's own values it holds
    for name, value in values.items():
        plant.set_parameter(name, value)
    plant.reset()
    got = diverged(plant, volts)
    assert {one.name: one.value for one in got.scene.varied} == values, "values at the divergence"
    made_so = Plant(load_scene("three_axis", overrides={**common, **values}))
    expected = diverged(made_so, volts)
    assert got.t == expected.t, "when it diverged"
    hint = what_holds(got)
    assert hint == what_holds(expected), "what would hold for small motions"
    assert "each step multiplies a small motion" in hint, hint
    if seed == 0:  # takes some seconds
        tried, expected_tries = list(attempts(got)), list(attempts(expected))
        assert tried == expected_tries, "trials"
        assert tried[-1].held and tried[-1].integrator.dt < 1e-4, f"no smaller step: {tried}"


# Into the scene file


def scene_copy(folder: Path, **replaced: str) -> Path:
    shutil.copytree(CONFIG / "urdf", folder / "urdf")
    text = (CONFIG / "three_axis.yaml").read_text()
    for old, new in replaced.items():
        assert old in text, f"{old} is not in the scene"
        text = text.replace(old, new)
    file = folder / "three_axis.yaml"
    file.write_bytes(text.encode())
    return file


def add_demo(file: Path) -> None:
    """Name what comes along for three_axis in a scene elsewhere."""
    named = "".join(f"{kind}: three_axis\n" for kind in BESIDE)
    file.write_text(named + file.read_text())


def test_writing_changes_two_values_and_nothing_else(tmp_path: Path) -> None:
    file = scene_copy(tmp_path)
    before = file.read_text().splitlines()
    write_integrator(file, "implicit", 2.5e-5)
    after = file.read_text().splitlines()
    changed = [(old, new) for old, new in zip(before, after, strict=True) if old != new]
    assert [new.split("#")[0].split() for _, new in changed] == [
        ["scheme:", "implicit"],
        ["dt:", "2.5e-5"],
    ], "lines that changed"
    columns = [(old.find("#"), new.find("#")) for old, new in changed]
    assert all(old == new for old, new in columns), f"columns of the comments: {columns}"
    assert load_scene(file).integrator.dt == 2.5e-5, "the step in the file"
    files = sorted(path.name for path in tmp_path.iterdir())
    assert files == ["three_axis.yaml", "urdf"], "files that are left"
    write_integrator(file, load_scene(CONFIG / "three_axis.yaml").integrator.scheme,
                     load_scene(CONFIG / "three_axis.yaml").integrator.dt)  # fmt: skip
    assert file.read_text().splitlines() == before, "written back"


SECTIONS = {
    "one line": ("{scheme: paper, dt: 1e-4}  # mine", "{scheme: implicit, dt: 5.0e-5}  # mine"),
    "no scheme, one line": ("{dt: 1e-4}", "{scheme: implicit, dt: 5.0e-5}"),
    "no scheme": ("\n    dt: 1e-4 # coarse", "\n    scheme: implicit\n    dt: 5.0e-5 # coarse"),
    "quoted": ("\n  'dt': 1e-4\n  scheme: 'paper'", "\n  'dt': 5.0e-5\n  scheme: implicit"),
    "Windows": ("\r\n  dt: 1e-4\r\n  scheme: paper\r", "\r\n  dt: 5.0e-5\r\n  scheme: implicit\r"),
}  # fmt: skip


@pytest.mark.parametrize("kind", SECTIONS)
def test_sections_as_people_write_them(tmp_path: Path, kind: str) -> None:
    old, new = SECTIONS[kind]
    file = scene_copy(tmp_path)
    text = file.read_text()
    head = text[: text.index("integrator:")]
    tail = "\nservo_period: 1.0e-3\nthreads: 1\n"
    file.write_bytes(f"{head}integrator: {old}{tail}".encode())
    write_integrator(file, "implicit", 5e-5)
    assert file.read_bytes().decode() == f"{head}integrator: {new}{tail}", "the file"


def test_what_would_change_more_is_refused(tmp_path: Path) -> None:
    """The step is an anchor that the servo period uses too."""
    file = scene_copy(tmp_path)
    text = file.read_text()
    text = text[: text.index("integrator:")] + "integrator: {dt: &dt 1e-3}\nservo_period: *dt\n"
    file.write_text(text)
    with pytest.raises(Refusal, match=r"three_axis.yaml: |advised.yaml: "):
        write_integrator(file, "implicit", 5e-4)
    assert file.read_text() == text, "a refused change has changed the file"
    files = sorted(path.name for path in tmp_path.iterdir())
    assert files == ["three_axis.yaml", "urdf"], "files that are left"


def run(*arguments: str, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    path = os.pathsep.join([str(CONFIG.parent), os.environ.get("PYTHONPATH", "")])
    return subprocess.run(
        [sys.executable, "-m", "arm_emulator", "advise", *arguments],
        capture_output=True, text=True, timeout=600, check=False, cwd=cwd,
        env={**os.environ, "PYTHONPATH": path, "COLUMNS": "200"},
    )  # fmt: skip


def test_command_shows_the_estimate_beside_the_reference_and_writes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of a shorter part of the demo than a user is shown: the reference takes some time."""
    file = scene_copy(tmp_path)
    add_demo(file)
    monkeypatch.setattr("arm_emulator.advise.SECONDS", 0.3)
    monkeypatch.setattr(
        sys, "argv", ["arm_emulator", "advise", str(file), "--error", "1e-5", "--write"]
    )
    with pytest.raises(SystemExit) as end:
        main()
    assert not end.value.code, "exit code"
    said = capsys.readouterr().out
    lines = said.splitlines()
    words = "scene three_axis, 0.5 s of its demo; wanted: error <= 1e-05"
    assert lines[0].startswith(words), said
    cheapest = next(line.split() for line in lines if line.startswith("cheapest  "))
    _, scheme, dt, estimate, truth, _ = cheapest
    assert ORDERS[scheme] == 2 and float(truth) <= 1e-5, cheapest
    assert float(estimate) == pytest.approx(float(truth), rel=0.1), "estimate, and true error"
    integrator = load_scene(file).integrator
    assert (integrator.scheme, integrator.dt) == (scheme, float(dt)), "told, and written"


def test_command_refuses_in_one_line(tmp_path: Path) -> None:
    done = run("three_axis", "--error", "0")
    assert done.returncode == 2, done.stderr
    last = done.stderr.splitlines()[-1]
    assert last == "advise: error must be from 1e-11 to 1 rad, got 0.0", "the refusal"


def test_a_scene_without_a_demo_moves_by_sines(tmp_path: Path) -> None:
    file = scene_copy(tmp_path).rename(tmp_path / "mine.yaml")
    scene: Scene = load_scene(file)
    voltages, what = record(scene, file)
    assert what.startswith("sines of a quarter of the supply"), what
    assert voltages.shape == (1000, 3), "voltages for 1 s"
    assert np.abs(voltages).max() == pytest.approx(12.0, rel=1e-3), "the largest [V]"
    found: Any = advise(Motion(scene, voltages[:200]), 1e-4)
    assert found[0].estimate <= 1e-4, found
