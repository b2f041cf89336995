"""The arm in the browser, without a browser."""

import dataclasses
import re
from unittest.mock import MagicMock

import numpy as np
import pytest

from arm_emulator import load_scene
from arm_emulator_page.arm_scene import ArmScene

pytest.importorskip("trimesh", reason="see requirements-peers.txt")
SCENE = load_scene("three_axis")
VISUAL = re.compile(r"<visual>.*?</visual>", re.S)
UNREADABLE = '<visual><geometry><mesh filename="file:///no/such.stl"/></geometry></visual>'


@pytest.mark.parametrize(
    ("shape", "words"), [("", "the robot description has none"), (UNREADABLE, "/no/such.stl")]
)
def test_an_arm_without_readable_shapes_appears_as_its_tool(shape: str, words: str) -> None:
    scene = dataclasses.replace(SCENE, true_urdf=VISUAL.sub(shape, SCENE.true_urdf))
    assert scene.true_urdf != SCENE.true_urdf
    with_shapes, bare = (ArmScene(MagicMock(), scene) for scene in (SCENE, scene))
    assert with_shapes.missing == "" and words in bare.missing
    assert bare.size == pytest.approx(with_shapes.size, rel=0.5)
    for arm in (with_shapes, bare):
        arm.show_arm(np.array(SCENE.start) + 0.3)
    np.testing.assert_array_equal(bare.p_WT, with_shapes.p_WT)
