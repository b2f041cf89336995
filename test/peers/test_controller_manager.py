"""A controller manager and a joint_trajectory_controller of ros2_control, unchanged, move our arms.

The tests need ros2_control, built or installed, on AMENT_PREFIX_PATH.
"""

from __future__ import annotations

import os
import subprocess
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from arm_emulator.cli.commands.ros2_control import ros2_control
from arm_emulator.machine.scene import load_scene

PACKAGE = Path(__file__).resolve().parents[2] / "arm_emulator_hardware"
PREFIXES = [Path(one) for one in os.environ.get("AMENT_PREFIX_PATH", "").split(":") if one]
WANTED = ("controller_manager", "joint_trajectory_controller")
TARGETS = {
    "three_axis": {"waist": 0.4, "shoulder": 0.8, "elbow": 1.0},
    "ur5": {
        "shoulder_pan_joint": 0.5, "shoulder_lift_joint": -1.2, "elbow_joint": 1.0,
        "wrist_1_joint": -1.0, "wrist_2_joint": -1.2, "wrist_3_joint": 0.3,
    },
}  # fmt: skip
SECONDS = 2.0

absent = [one for one in WANTED if not any((at / "share" / one).is_dir() for at in PREFIXES)]
pytestmark = pytest.mark.skipif(bool(absent), reason=f"not there: {', '.join(absent)}")


@pytest.fixture(scope="module")
def prefix(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Our package, installed."""
    at = tmp_path_factory.mktemp("hardware")
    for words in (
        ("-S", str(PACKAGE), "-B", str(at / "build"), f"-DCMAKE_INSTALL_PREFIX={at / 'install'}",
         "-DCMAKE_EXE_LINKER_FLAGS=-Wl,--unresolved-symbols=ignore-in-shared-libs"),
        ("--build", str(at / "build")),
        ("--install", str(at / "build")),
    ):  # fmt: skip
        free = {name: value for name, value in os.environ.items() if name != "LD_PRELOAD"}
        done = subprocess.run(
            ("cmake", *words), capture_output=True, text=True, env=free, check=False
        )
        assert done.returncode == 0, done.stdout + done.stderr
        assert "warning:" not in done.stderr
    return at / "install"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("scenes")


def move(prefix: Path, description: Path, controllers: Path, target: Mapping[str, float]
         ) -> subprocess.CompletedProcess[str]:  # fmt: skip
    paths = f"{prefix}:{os.environ['AMENT_PREFIX_PATH']}"
    libraries = f"{prefix / 'lib'}:{os.environ.get('LD_LIBRARY_PATH', '')}"
    words = [f"{joint}={value}" for joint, value in target.items()]
    return subprocess.run(
        [prefix / "lib/arm_emulator_hardware/trajectory", description, controllers, str(SECONDS),
         *words],
        capture_output=True, text=True, timeout=60, check=False,
        env={**os.environ, "AMENT_PREFIX_PATH": paths, "LD_LIBRARY_PATH": libraries},
    )  # fmt: skip


@pytest.mark.parametrize("name", TARGETS)
def test_a_trajectory_is_followed_with_equal_bits(prefix: Path, folder: Path, name: str) -> None:
    ros2_control(name, into=folder)
    files = folder / f"{name}.urdf", folder / f"{name}_controllers.yaml"
    runs = [move(prefix, *files, TARGETS[name]) for _ in range(2)]
    assert runs[0].returncode == 0, runs[0].stderr
    digest, *lines = runs[0].stdout.splitlines()
    assert digest.startswith("digest ") and runs[1].stdout == runs[0].stdout
    scene = load_scene(name)
    for line, joint in zip(lines, scene.joints, strict=True):
        word, *numbers = line.split()
        true, measured, start = map(float, numbers)
        assert word == joint.name and start == pytest.approx(joint.start, abs=1e-9)
        # A gear that carries the arm's weight is wound up by some tenths of a mrad.
        assert np.allclose([true, measured], TARGETS[name][word], atol=1.5e-3), line


@pytest.mark.parametrize(
    ("old", "new", "why"),
    [
        ('name="scene"', 'name="scenes"', "param must be known, got scenes; valid: scene"),
        ('<command_interface name="velocity"', '<command_interface name="speed"',
         "command_interface must be known, got speed; valid: position, velocity, effort"),
        ('<state_interface name="current"', '<state_interface name="amps"',
         "state_interface must be known, got amps"),
        ("three_axis</param>", "nothing</param>", "scene must be FOLDER/NAME after"),
        ('name="elbow"', 'name="bend"',
         "joint must be one of the scene, got bend; valid: waist, shoulder, elbow"),
    ],
)  # fmt: skip
def test_wrong_descriptions_are_one_line(
    prefix: Path, folder: Path, old: str, new: str, why: str, tmp_path: Path
) -> None:
    ros2_control("three_axis", into=folder)
    text = (folder / "three_axis.urdf").read_text()
    assert old in text
    (tmp_path / "wrong.urdf").write_text(text.replace(old, new))
    controllers = folder / "three_axis_controllers.yaml"
    done = move(prefix, tmp_path / "wrong.urdf", controllers, TARGETS["three_axis"])
    assert done.returncode != 0
    assert len([line for line in done.stderr.splitlines() if why in line]) == 1, done.stderr
