"""Registries: parts, schemes and faults are those that are registered, whatever inherits them."""

import subprocess
import sys
from pathlib import Path

import pytest

from arm_emulator import Refusal, load_scene
from arm_emulator.base.registry import Registry
from arm_emulator.machine.parts.part import Part
from arm_emulator.machine.parts.registry import list_kinds, register_part
from arm_emulator.machine.scene.known_parts import PARTS
from arm_emulator.machine.schemes.known import KNOWN
from arm_emulator.machine.schemes.paper import Paper
from arm_emulator_campaign.definition.fault import list_faults
from arm_emulator_campaign.definition.faults.payload import Payload

# Before anything of the emulator has read a registry, as in the first lines of a user's file.
HIJACK = """
import importlib, pkgutil, sys
from arm_emulator.machine import parts, schemes
from arm_emulator.machine.parts.part import Part
from arm_emulator_campaign.definition import fault, faults
made = []
for package in (parts, schemes, faults):
    for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
        if module.name.endswith((".known", ".sensors")):
            continue  # they read the registry
        for kind in vars(importlib.import_module(module.name)).values():
            if isinstance(kind, type) and kind.__module__.startswith(package.__name__ + "."):
                if issubclass(kind, (Part, schemes.scheme.Scheme, fault.Fault)):
                    made.append(type("My" + kind.__name__, (kind,), {}))
assert len(made) > 50, len(made)
from arm_emulator.machine.scene.known_parts import PARTS
from arm_emulator.machine.parts.measuring.sensors import ANALOG
from arm_emulator.machine.schemes.known import KNOWN
from arm_emulator import load_scene
kinds = [*PARTS, *ANALOG, *KNOWN.values(), *fault.list_faults().values()]
for joint in load_scene("ur5").joints:
    kinds += map(type, (*joint.parts, *joint.sensors.parts.values()))
strangers = {kind.__name__ for kind in kinds if not kind.__module__.startswith("arm_emulator")}
print(*sorted(strangers))
print(*[kind.__name__ for kind in PARTS])
"""


def test_classes_that_inherit_replace_nothing(tmp_path: Path) -> None:
    """A subclass of each part, scheme and fault, made before the registries are read."""
    file = tmp_path / "mine.py"
    file.write_text(HIJACK)
    done = subprocess.run(
        [sys.executable, file], check=False, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    strangers, parts = done.stdout.splitlines()
    assert strangers == ""
    assert parts.split() == [kind.__name__ for kind in PARTS]


def test_a_second_owner_of_a_name_is_refused() -> None:
    for kind in list_kinds(Part):
        with pytest.raises(Refusal, match=r"have one owner") as refused:
            register_part(type("Second", (kind,), {}))
        assert str(refused.value.got).endswith(kind.__name__)
    assert list_kinds(Part) and load_scene("three_axis").joints


def test_a_class_that_comes_too_late_is_refused() -> None:
    """In place of a part that scenes ignore without a word."""
    late = type("Late", (Part,), {"section": "late"})
    with pytest.raises(Refusal, match="registered before the parts are read"):
        register_part(late)


def test_a_registry_has_each_class_by_its_name() -> None:
    registry = Registry[type]("thing", "arm_emulator.machine.schemes", lambda kind: kind.__name__)
    names = {registry.register(type(name, (), {})) for name in "ba"}
    assert [*registry.list_kinds()] == ["a", "b"] and set(registry.list_kinds().values()) == names


def test_the_registries_have_their_own_names() -> None:
    assert KNOWN["paper"] is Paper and list_faults()["payload"] is Payload
