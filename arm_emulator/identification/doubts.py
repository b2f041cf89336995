"""Objections to the numbers that a record gave."""

from __future__ import annotations

from collections.abc import Sequence

from arm_emulator.identification import inertia
from arm_emulator.identification.found import Found
from arm_emulator.identification.torque_fit import TorqueFit
from arm_emulator.machine.scene import Scene

FAR = 3.0  # prior deviations, beyond which a number is doubted


def doubts_of(scene: Scene, fit: TorqueFit, numbers: Sequence[Found]) -> list[str]:
    """Return objections to the numbers found, as text."""
    names, doubts = scene.joint_names, list[str]()
    for of, body in zip(scene.chain.links, scene.bare, strict=True):
        if not inertia.is_body(body):
            doubts.append(f"links.{of.link}: no body has its inertia; the scene's number is kept")
    for effect in fit.effects:
        joints = ", ".join(names[j] for j in effect.joints)
        if len(effect.joints) == len(names) > 1:
            joints = "all joints"
        size = f", by {effect.size:.3g} {effect.unit}" if effect.unit else ""
        doubts.append(
            f"{joints}: {effect.name}{size}: {100.0 * effect.share:.0f} % of what the scene does "
            "not explain; deviations have in them what this may hide"
        )
    for joint, count in zip(names, fit.far_out, strict=True):
        if count:
            doubts.append(f"{joint}: {count} rows stand out, and count little")
    for one in numbers:
        if one.identified and one.far > FAR:
            doubts.append(
                f"{one.name}: {one.value:.4g} {one.unit} is {one.far:.1f} of the deviations known "
                f"before from {one.before:.4g}; is the record in the units and scale given?"
            )
        if one.left:
            doubts.append(f"{one.name}: {one.left}")
    return doubts
