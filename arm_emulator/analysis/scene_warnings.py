"""Warnings about a scene, printed before anything moves."""

from __future__ import annotations

import sys

from arm_emulator.machine.scene import Scene


def warn_of_scene(scene: Scene) -> None:
    """Print the warnings of a scene to stderr."""
    for line in scene.warnings:
        print(f"warning: {line}", file=sys.stderr)
