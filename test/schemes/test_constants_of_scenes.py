"""Constants of scenes and servos have the same bits with any BLAS."""

import os
import platform
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from arm_emulator.base.products import apply_matrix, measure_length, multiply_matrices

ROOT = Path(__file__).parents[2]
DIGESTS = """
import hashlib, pathlib, sys, tempfile
from portable_bits import drawings
from arm_emulator import load_gains
from arm_emulator.machine.plant.scene_unit import write_scene_unit
from arm_emulator.servo.servo_numbers import make_servo_numbers

with tempfile.TemporaryDirectory() as folder:
    for name, drawn in drawings(pathlib.Path(folder)).items():
        print(name, hashlib.sha256(write_scene_unit(drawn({})).encode()).hexdigest())
for name in ("three_axis", "ur5", "panda"):
    servo = load_gains(name).servo
    numbers = make_servo_numbers(servo.joints, servo.period, servo.supply_voltage)
    print(name, hashlib.sha256(numbers.tobytes()).hexdigest())
"""
BARE = """
import hashlib
import numpy as np

A = np.random.default_rng(1).normal(size=(99, 99))
print(hashlib.sha256(A @ A).hexdigest())
"""


@pytest.mark.slow
@pytest.mark.skipif(platform.machine() != "x86_64", reason="kernels of x86-64")
def test_kernels_of_blas_change_nothing() -> None:
    """A kernel with fused products and one without give equal constants; BLAS itself differs."""
    paths = os.pathsep.join([str(ROOT), str(ROOT / "test"), os.environ.get("PYTHONPATH", "")])

    def digests(words: str) -> list[str]:
        result = []
        for kernel in ("Haswell", "Nehalem"):
            env = os.environ | {"OPENBLAS_CORETYPE": kernel, "PYTHONPATH": paths}
            command = [sys.executable, "-c", words]
            done = subprocess.run(command, capture_output=True, check=False, env=env)
            assert done.returncode == 0, done.stderr.decode()
            result.append(done.stdout.decode())
        return result

    bare = digests(BARE)
    if bare[0] == bare[1]:
        pytest.skip("this BLAS has one kernel")
    result = digests(DIGESTS)
    assert result[0] == result[1]


def test_products_are_those_of_numpy() -> None:
    rng = np.random.default_rng(2)
    A, B, C = rng.normal(size=(5, 3, 4)), rng.normal(size=(5, 4, 2)), rng.normal(size=(2, 2))
    assert multiply_matrices(A, B, C) == pytest.approx(A @ B @ C, rel=1e-13)
    v = rng.normal(size=(5, 4))
    assert apply_matrix(A, v) == pytest.approx((A @ v[..., None])[..., 0], rel=1e-13)
    assert measure_length(v[0]) == pytest.approx(np.linalg.norm(v[0]), rel=1e-15)
