"""The programs of examples/ that use the library: each runs, and comes to its result."""

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_manners import VARIED

from arm_emulator.machine.scene.scene import load_scene
from arm_emulator.toolchain.compiler_command import find_compiler

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "examples"
OURS = {
    "computed_torque.py": 40, "sweep.py": 40, "vector_env.py": 60, "my_network_tests.py": 40,
    "my_tests.py": 40, "my_observer.c": 40,
}  # fmt: skip


def run(folder: Path, *command: str | Path) -> str:
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=folder)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.parametrize("name", OURS)
def test_each_example_is_no_longer_than_a_page_and_in_the_documents(name: str) -> None:
    assert len((EXAMPLES / name).read_text().splitlines()) <= OURS[name]
    page = (ROOT / "docs" / "how_to" / "programs.md").read_text()
    assert f"<!-- generated: file examples/{name} -->" in page


@pytest.mark.slow
def test_computed_torque_follows(tmp_path: Path) -> None:
    text = run(tmp_path, sys.executable, EXAMPLES / "computed_torque.py")
    result = re.search(r"largest error ([\d.]+) mrad", text)
    # An encoder's count is 0.06 mrad of a link; the filtered speed is 5 periods late, at up to
    # 1.5 rad/s2 and Kd / Kp = 0.1 s: some 0.75 mrad.
    assert result and float(result[1]) < 1.0
    assert (tmp_path / "computed_torque.png").stat().st_size > 1000


@pytest.mark.slow
def test_a_sweep_ranks_its_numbers(tmp_path: Path) -> None:
    text = run(tmp_path, sys.executable, EXAMPLES / "sweep.py")
    friction, mass = map(float, re.findall(r": (-[\d.]+)$", text, re.M))
    assert friction < -0.9 and -0.5 < mass < 0.0


@pytest.fixture
def env(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(str(EXAMPLES))
    from vector_env import ReachEnv  # type: ignore[import-not-found]

    scene = load_scene("three_axis", VARIED)
    return ReachEnv(scene, num_envs=16, seconds=np.where(np.arange(16) < 8, 0.04, 0.06))


def test_an_environment_keeps_the_rules_of_gymnasium(env: Any) -> None:
    observed, _ = env.reset(seed=1)
    again, _ = env.reset(seed=1)
    assert np.array_equal(observed, again), "a seed decides"
    for name in ("observation", "action"):
        space, single = getattr(env, f"{name}_space"), getattr(env, f"single_{name}_space")
        assert space.shape == (16, *single.shape) and space.dtype == single.dtype
    env.action_space.seed(1)
    observed, reward, fallen, over, _ = env.step(env.action_space.sample())
    assert env.observation_space.contains(observed) and reward.shape == (16,)
    assert fallen.dtype == over.dtype == np.bool_ and env.metadata["autoreset_mode"]


def test_arms_of_an_environment_restart_separately(env: Any) -> None:
    observed, _ = env.reset(seed=1)
    began = env.fleet.state.q
    for step in range(1, 42):
        target = observed[:, 3:]
        observed, reward, _, over, _ = env.step(4.0 * (target - observed[:, :3]))
        assert (reward <= 0.0).all() and over[:8].all() == (step == 40) and not over[8:].any()
    # In the step after their last one these began anew: no reward, another target.
    assert (reward[:8] == 0.0).all() and (reward[8:] < 0.0).all()
    assert (observed[:8, 3:] != target[:8]).all() and (observed[8:, 3:] == target[8:]).all()
    for friction in env.fleet.parameters.values():
        assert len(set(friction)) == 16, "each has friction of its own"
    t = env.fleet.state.t
    assert (t[:8] == 0.0).all() and np.allclose(t[8:], 41 * env.fleet.scene.servo_period)
    assert (np.abs(env.fleet.state.q[8:] - began[8:]).max(axis=1) > 1e-3).all(), "none moved"


def step_seeded(env: Any, steps: int) -> list[np.ndarray]:
    """Return all that an environment gives under seeded actions, over episodes that end."""
    observed, _ = env.reset(seed=5)
    xp, rng, observations = env.xp, np.random.default_rng(6), [observed]
    for _ in range(steps):
        actions = rng.uniform(-1.5, 1.5, env.action_space.shape).astype(np.float32)
        observations += env.step(xp.asarray(actions))[:4]
    return [np.array(numbers) for numbers in observations]


@pytest.mark.slow
@pytest.mark.parametrize("library", ["numpy", "torch"])
def test_an_environment_on_a_device_gives_the_numbers_of_lanes(env: Any, library: str) -> None:
    xp = pytest.importorskip(library)
    more = {"seconds": np.where(np.arange(16) < 8, 0.04, 0.06), "device": "processor", "xp": xp}
    on_device = type(env)(env.fleet.scene, num_envs=16, **more)
    assert on_device.fleet.device == "processor"
    expected, computed = step_seeded(env, 100), step_seeded(on_device, 100)
    assert sum(over.sum() for over in expected[4::4]) > 16, "no second episode"
    for own, actual in zip(expected, computed, strict=True):
        assert own.dtype == actual.dtype
        # The sum of a reward's three terms may be in another order in another library.
        np.testing.assert_allclose(actual, own, rtol=1e-15 if library == "torch" else 0.0)


@pytest.mark.slow
def test_a_step_on_a_device_copies_no_array_to_the_host(
    env: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    from arm_emulator_fleet.processor_device import ProcessorDevice

    on_device = type(env)(env.fleet.scene, num_envs=16, device="processor")
    on_device.reset(seed=1)
    read, sizes = ProcessorDevice.read, []

    def count(self: Any, memory: Any, dtype: Any, shape: Any, offset: int = 0) -> Any:
        array = read(self, memory, dtype, shape, offset)
        sizes.append(array.nbytes)
        return array

    monkeypatch.setattr(ProcessorDevice, "read", count)
    for _ in range(2):
        on_device.step(np.zeros((16, 3), np.float32))
    # The arms that refused before and during the motion, which every call asks for.
    assert set(sizes) == {8}


def test_draws_of_an_environment_are_of_their_ranges_and_of_each_episode(env: Any) -> None:
    env.reset(seed=3)
    everything = env.draws >= 0.0
    draws = []
    for _ in range(200):
        env._begin(everything[:, 0])
        draws.append(env.draws)
    assert np.min(draws) >= 0.0 and np.max(draws) < 1.0
    # The mean of draws that are independent in pairs has the deviation of independent draws, with
    # longer tails: 10 of them are exceeded with a probability below 0.01 (Chebyshev).
    assert np.abs(np.mean(draws, axis=(0, 1)) - 0.5).max() < 10.0 / np.sqrt(12 * 200 * 16)
    assert all(len(np.unique(column)) == 200 for column in np.array(draws)[:, :, 0].T)


@pytest.mark.slow
def test_the_tests_of_a_user_pass(tmp_path: Path) -> None:
    words = ["-m", "pytest", "-q", "-p", "no:cacheprovider", f"--basetemp={tmp_path / 'all'}"]
    text = run(ROOT, sys.executable, *words, EXAMPLES / "my_tests.py")
    assert "5 passed" in text


@pytest.mark.slow
def test_a_repository_that_follows_the_layout_passes_its_tests(tmp_path: Path) -> None:
    """The lines of its README are run as they stand, but for docker."""
    (tmp_path / "examples").symlink_to(EXAMPLES)
    readme = (EXAMPLES / "my_repository" / "README.md").read_text()
    begin, image = re.findall(r"```sh\n(.*?)```", readme, re.S)
    run(tmp_path, "bash", "-ec", begin)
    assert "docker run --rm -v $PWD/out:/out my_servo" in image
    compiled = tmp_path / "my_repository"
    (tmp_path / "out").mkdir()  # as docker's -v does
    docker = (compiled / "Dockerfile").read_text()
    (tests,) = re.findall(r"pytest --basetemp=\S+", docker)
    words = tests.replace("/out", str(tmp_path / "out")).split()
    text = run(compiled, sys.executable, "-m", *words, "-q", "-p", "no:cacheprovider")
    assert "1 passed" in text


@pytest.mark.slow
def test_a_servo_with_an_observer_brings_the_arm_to_its_targets(tmp_path: Path) -> None:
    library = tmp_path / "libobserver.so"
    flags = ["-x", "c", "-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O2", "-fPIC"]
    include = f"-I{ROOT / 'arm_emulator/core/boundary'}"
    source = EXAMPLES / "my_observer.c"
    run(tmp_path, *find_compiler(), *flags, "-shared", include, source, "-o", library)
    table = ROOT / "arm_emulator/servo/c/template/targets.csv"
    words = ["-m", "arm_emulator", "run", "three_axis", "--servo", library, "--targets", table]
    text = run(tmp_path, sys.executable, *words)
    off = re.findall(r"[xyz] ([+-][\d.]+)", text)
    # Half a count at each motor is 0.03 mrad of a link, at 0.6 m.
    assert len(off) == 3 and np.abs(np.array(off, float)).max() < 0.02, text
