"""The programs of examples/ that use the library: each runs, and comes to its result."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
OURS = ("computed_torque", "sweep", "vector_env", "my_tests")


def run(name: str, *arguments: str) -> str:
    command = [sys.executable, str(EXAMPLES / f"{name}.py"), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize("name", OURS)
def test_none_is_longer_than_a_page(name: str) -> None:
    assert len((EXAMPLES / f"{name}.py").read_text().splitlines()) <= 40


def test_computed_torque_follows(tmp_path: Path) -> None:
    picture = tmp_path / "error.png"
    found = re.search(r"largest error ([\d.]+) mrad", run("computed_torque", str(picture)))
    # An encoder's count is 0.06 mrad of a link; the filtered speed is 5 periods late, at up to
    # 1.5 rad/s2 and Kd / Kp = 0.1 s: some 0.75 mrad.
    assert found and float(found[1]) < 1.0
    assert picture.stat().st_size > 1000


def test_a_sweep_finds_what_matters() -> None:
    shown = run("sweep")
    found = re.search(r"friction: (-[\d.]+)", shown)
    assert found and float(found[1]) < -0.95 and "0 diverged" in shown


def test_arms_of_an_environment_begin_anew_each_for_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(EXAMPLES))
    from vector_env import ReachEnv  # type: ignore[import-not-found]

    env = ReachEnv(num_envs=16, last=60)
    seen, _ = env.reset(seed=1)
    assert seen.shape == (16, 6)
    env.age[:8] = 20  # half of them end earlier
    began = env.fleet.state.q
    for step in range(1, 41):
        seen, reward, _, over, _ = env.step(4.0 * (seen[:, 3:] - seen[:, :3]))
        assert (reward <= 0.0).all() and over[:8].all() == (step == 40) and not over[8:].any()
    t = env.fleet.state.t
    assert (t[:8] == 0.0).all() and np.allclose(t[8:], 40 * env.scene.servo_period)
    assert (np.abs(env.fleet.state.q[8:] - began[8:]).max(axis=1) > 1e-3).all(), "none moved"


def test_the_tests_of_a_user_pass() -> None:
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider"]
    done = subprocess.run(
        [*command, str(EXAMPLES / "my_tests.py")],
        capture_output=True, text=True, check=False, timeout=300, cwd=EXAMPLES.parent,
    )  # fmt: skip
    assert done.returncode == 0 and "5 passed" in done.stdout, done.stdout
