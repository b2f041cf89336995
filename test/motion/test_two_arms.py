"""Two arms of one machine do not run into each other."""

import numpy as np
import pytest
from draws import some

from arm_emulator.motion.model.config import MotionConfig
from arm_emulator.motion.model.kinematics import Kinematics
from arm_emulator.motion.planner.collision_guard import CollisionGuard

MARGIN = 0.01  # m
JOINTS = tuple(f"{side}{k}" for side in ("left", "right") for k in range(3))


def two_arms(apart: float, rods: tuple[float, float, float]) -> str:
    """Two arms beside each other, of three links each, bars along their x axes."""
    parts = ['<robot name="two_arms"><link name="base"/>']
    for side, y in (("left", 0.5 * apart), ("right", -0.5 * apart)):
        parent, at = "base", f"0 {y} 0.5"
        for k, (axis, rod) in enumerate(zip(("0 0 1", "0 1 0", "0 1 0"), rods, strict=True)):
            parts.append(
                f'<link name="{side}_link{k}"><collision><origin xyz="{0.5 * rod} 0 0"/>'
                f'<geometry><box size="{0.8 * rod} 0.06 0.06"/></geometry></collision></link>'
                f'<joint name="{side}{k}" type="revolute"><parent link="{parent}"/>'
                f'<child link="{side}_link{k}"/><origin xyz="{at}"/><axis xyz="{axis}"/>'
                '<limit lower="-2.5" upper="2.5" effort="60" velocity="2"/></joint>'
            )
            parent, at = f"{side}_link{k}", f"{rod} 0 0"
        parts.append(
            f'<link name="{side}_hand"/><joint name="{side}_flange" type="fixed">'
            f'<parent link="{parent}"/><child link="{side}_hand"/><origin xyz="{at}"/></joint>'
        )
    return "".join([*parts, "</robot>"])


@pytest.mark.parametrize("seed", some(range(60), 12))
def test_a_path_is_refused_where_the_arms_would_meet(seed: int) -> None:
    """Held against a look at 400 configurations of each way, with parts of both arms named."""
    rng = np.random.default_rng(seed)
    rods = tuple(rng.uniform(0.15, 0.35, 3).tolist())
    kinematics = Kinematics(two_arms(rng.uniform(0.3, 0.6), rods), JOINTS, "left_hand")
    config = MotionConfig(tool="left_hand", collisions="stop", collision_margin=MARGIN)
    guard = CollisionGuard(kinematics, config)
    across = 0
    for _ in range(6):
        start, end = rng.uniform(-1.5, 1.5, (2, 6))
        if guard.collisions.find_first_contact(start):
            continue
        looks = [start + part * (end - start) for part in np.linspace(0.0, 1.0, 400)]
        touching = [guard.collisions.find_first_contact(q) for q in looks]
        contact = guard.find_contact_along(lambda part, a=start, b=end: a + part[:, None] * (b - a))  # type: ignore[misc]
        if contact is None:
            assert not any(touching)
            continue
        part, pair = contact
        assert any(touching)
        assert pair == guard.collisions.find_first_contact(start + part * (end - start))
        across += "left_" in pair and "right_" in pair
    assert across or seed not in (0, 2), "parts of both arms are tested against each other"
