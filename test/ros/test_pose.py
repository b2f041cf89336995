"""Poses of tools: quaternions of messages, and what is refused."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from arm_emulator import Pose, Refusal


def test_pose_takes_quaternions_as_messages_give_them() -> None:
    for seed in range(50):
        turn = Rotation.random(random_state=seed)
        pose = Pose.from_quaternion([1, 2, 3], turn.as_quat() * 1.0009)
        assert np.allclose(pose.R_WT, turn.as_matrix(), rtol=0, atol=1e-14)
        back = Rotation.from_quat(pose.quaternion())
        assert (back * turn.inv()).magnitude() < 1e-14
        assert pose.quaternion()[3] >= 0.0


@pytest.mark.parametrize("half_turn", [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]])
def test_quaternion_of_a_half_turn(half_turn: list[float]) -> None:
    assert np.allclose(np.abs(Pose.from_quaternion([0, 0, 0], half_turn).quaternion()), half_turn)


@pytest.mark.parametrize(
    ("position", "quaternion", "words"),
    [
        ([0, 0], [0, 0, 0, 1], "position must have 3 values"),
        ([0, 0, math.nan], [0, 0, 0, 1], "position must be numbers within"),
        ([0, 0, 0], [0, 0, 0], "orientation must have 4 values"),
        ([0, 0, 0], [0, 0, 0, math.inf], "orientation must be finite"),
        ([0, 0, 0], [0, 0, 0, 0], "orientation must be a quaternion of length 1"),
        ([0, 0, 0], [0, 0, 0, 1.01], "orientation must be a quaternion of length 1"),
    ],
)
def test_bad_poses_are_refused(position: list[float], quaternion: list[float], words: str) -> None:
    with pytest.raises(Refusal, match=f"^tool_target: {words}"):
        Pose.from_quaternion(position, quaternion)
