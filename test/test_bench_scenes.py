"""Scenes that benches make of the shipped ones: every scheme takes them."""

from __future__ import annotations

import pytest

from arm_emulator.base.config_files import config_folder
from arm_emulator.machine.scene import load_scene
from arm_emulator.machine.schemes.known import SCHEMES
from bench import what_each_part_costs
from bench.bare import BARE, odd_parts

SHIPPED = sorted(file.stem for file in config_folder().glob("*.yaml"))


@pytest.mark.parametrize("name", SHIPPED)
def test_every_scheme_takes_a_scene_without_its_extras(name: str) -> None:
    for scheme in SCHEMES:
        scene = load_scene(name, {**BARE, "integrator.scheme": scheme})
        assert not [one for one in odd_parts(scene) if not one.endswith(".motor")]  # they stay
        assert scene.integrator.events == "step"


def test_every_part_can_be_taken_out_and_put_in() -> None:
    scenes = list(what_each_part_costs.timed_scenes(("three_axis", "ur5", "panda")))
    assert {one.integrator.scheme for one in scenes} == set(what_each_part_costs.TIMED)
