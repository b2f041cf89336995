"""Warnings about a scene, printed before the arm moves."""

from __future__ import annotations

from arm_emulator.base.warning import warn
from arm_emulator.machine.scene import Scene


def warn_of_scene(scene: Scene) -> None:
    """Print the warnings of a scene to stderr."""
    for line in scene.warnings:
        warn(line)
