"""Warnings about a scene: joints that stick while events are not located."""

from typing import Any

import pytest
from draws import with_slow

from arm_emulator.cli.commands.check_scene import check_scene
from arm_emulator.machine.scene.known_parts import LINK_FRICTIONS, ROTOR_FRICTIONS
from arm_emulator.machine.scene.scene import load_scene

# Sections of each law of friction alone; whether a shaft at rest is held by it.
FRICTIONS: dict[str, tuple[dict[str, float], bool]] = {
    "viscous": ({"viscous": 2.0}, False),
    "none": ({"coulomb": 0.0}, False),
    "coulomb": ({"coulomb": 0.4}, True),
    "stribeck": ({"coulomb": 0.4, "breakaway": 0.6, "stribeck": 0.1}, True),
    "load": ({"load": 0.2}, True),
    "no load": ({"load": 0.0}, False),
}


@pytest.mark.parametrize("law", FRICTIONS)
@pytest.mark.parametrize("place", ["elbow.friction", "shoulder.motor.friction"])
def test_a_joint_that_sticks_is_warned_of_by_name_unless_located(place: str, law: str) -> None:
    section, sticks = FRICTIONS[law]
    keys: dict[str, Any] = {f"joints.{place}": section}
    for events in ("step", "located"):
        for scheme in ("rosenbrock", "extrapolated", "implicit"):
            if scheme == "implicit" and events == "located":
                continue  # refused: of first order anyway
            overrides = {"integrator.events": events, "integrator.scheme": scheme}
            warnings = load_scene("three_axis", keys | overrides).warnings
            expected = sticks and events == "step" and scheme != "implicit"
            assert len(warnings) == expected, f"{events}, {scheme}: {warnings}"
            if expected:
                joint, free_joint = place.split(".", maxsplit=1)[0], "waist"
                assert (
                    f"({joint})" in warnings[0]
                    and free_joint not in warnings[0]
                    and "\n" not in warnings[0]
                )


@pytest.mark.parametrize("place", ["elbow.friction", "shoulder.motor.friction"])
def test_load_friction_behind_a_rigid_gear_is_warned_of_by_name(place: str) -> None:
    joint = place.split(".", maxsplit=1)[0]
    keys: dict[str, Any] = {f"joints.{place}": {"load": 0.2}, "integrator.events": "located"}
    assert load_scene("three_axis", keys).warnings == []
    gear = f"joints.{joint}.gear"
    rigid = {f"{gear}.stiffness": None, f"{gear}.damping": None}
    assert f"a rigid gear ({joint})" in load_scene("three_axis", keys | rigid).warnings[0]
    without = keys | rigid | {f"joints.{place}": {"coulomb": 0.2}}
    assert load_scene("three_axis", without).warnings == []


def test_every_law_of_friction_is_tried() -> None:
    keys = {key for kind in (*LINK_FRICTIONS, *ROTOR_FRICTIONS) for key in kind.named_by}
    assert keys <= {key for section, _ in FRICTIONS.values() for key in section}, keys


@pytest.mark.parametrize("name", with_slow(["ur5", "panda"], 1))
def test_the_shipped_arms_stick_and_are_located(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = load_scene(name)
    for joint in scene.joints:
        assert any(part.can_stick for part in joint.parts), f"{joint.name}: real joints stick"
    assert scene.warnings == []
    check_scene(name)
    assert "stick" not in capsys.readouterr().err
    taken = load_scene(name, {"integrator.events": "step"}).warnings
    assert all(joint in taken[0] for joint in scene.joint_names), taken
