"""Every scene at rest without a command, in random poses, with each law of friction alone.

For each shipped scene, each law of friction at its links or its rotors, and each scheme: the
machine is put at rest in a random pose, takes a few steps without a command, and two claims are
held against it:

- it does not diverge;
- joints that move do so as the equations demand, and joints that rest do so because friction can
  hold them (without weights all rest). Gears are not wound up then: M dv/dt + nle + friction = 0.
  The mean of dv/dt over a us is the machine's, M and nle are Pinocchio's. Friction follows from a
  law's own numbers, against the motion, and at rest is at most the holding torque. Coulomb's
  friction at several joints has one solution only, so a joint at rest must have a reason.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from arm_emulator import Diverged, Plant, Scene, load_scene
from arm_emulator.base.arrays import Array
from arm_emulator.base.io.config_files import find_config
from arm_emulator.base.io.yaml_file import read_yaml
from arm_emulator.machine.parts.frictions.brake import Brake
from arm_emulator.machine.scene.known_parts import (
    EXTRAS,
    LINK_FRICTIONS,
    ROTOR_FRICTIONS,
    remove_kind,
)
from arm_emulator.machine.schemes.known import LOCATING_SCHEMES
from oracles.reference import make_links_model

SHIPPED = ("three_axis", "ur5", "panda", "manutec_r3", "kuka_kr300")
STEPS = 40  # of the scene's length, which a machine must survive
INSTANT, PARTS = 1e-7, 10  # s and steps, in which no gear is wound up
REACH = 1.5  # rad, of random poses
SHARE = 0.3  # of the weight that a joint carries on average: the size of its dry friction
BEND = 0.01  # rad, of bristles at the link
RESOLVED = 0.01  # of the torques at a joint: what winding up and speed make of them by then

# The law stands alone: other friction, brakes and springs are put away.
ALONE: dict[str, Any] = {
    "gravity": [0.0, 0.0, -9.81],
    **remove_kind((*LINK_FRICTIONS, *ROTOR_FRICTIONS, Brake, *EXTRAS)),
}

Numbers = dict[str, float]


def list_frictions(dry: float, inertia: float, bend: float) -> dict[str, tuple[str, Numbers]]:
    """Return sections of friction by name, with the key of the section, for a shaft.

    Args:
        dry: torque of sliding [N m].
        inertia: by which viscous friction and bristles are sized [kg m2].
        bend: of bristles that slip [rad].
    """
    coulomb, breakaway = {"coulomb": dry}, {"coulomb": dry, "breakaway": 1.5 * dry}
    bristles = {
        "coulomb": dry, "breakaway": 1.5 * dry, "bristle_stiffness": dry / bend,
        "bristle_damping": inertia,
    }  # fmt: skip
    return {
        "viscous": ("friction", {"viscous": inertia}),
        "coulomb": ("friction", coulomb),
        "breakaway": ("friction", breakaway),
        "stribeck": ("friction", {**breakaway, "stribeck": 0.1}),
        "load": ("friction", {"load": 0.3}),
        "load and coulomb": ("friction", {**coulomb, "load": 0.3}),
        "lugre": ("lugre", bristles),
    }


FRICTIONS = tuple(list_frictions(1.0, 1.0, 1.0))
PLACES = ("link", "rotor")


@dataclass(frozen=True)
class RestCase:
    """A scene with one law alone, and how it is solved."""

    scene: str
    place: str
    law: str
    scheme: str
    events: str = "step"
    weightless: bool = False


class RestEquations:
    """Equilibrium of a scene at rest: Pinocchio's M and nle, and the magnitudes of friction."""

    def __init__(self, scene: Scene, payload: Mapping[str, Any] | None) -> None:
        self.model = make_links_model(scene, payload)
        self.data = self.model.createData()
        self.carried = np.array(
            [
                getattr(joint.motor, "rotor_inertia", 0.0) / joint.gear.ratio**2
                if joint.gear.stiffness is None
                else 0.0
                for joint in scene.joints
            ]
        )
        self.ratio = np.array([abs(joint.gear.ratio) for joint in scene.joints])
        poses = np.random.default_rng(0).uniform(-REACH, REACH, (200, len(scene.joints)))
        self.dry = SHARE * np.mean([np.abs(self.compute_weight(q)) for q in poses], axis=0) + 1e-2
        self.inertia = np.mean([np.diag(self.compute_mass(q)) for q in poses], axis=0)

    def compute_mass(self, q: Array) -> Array:
        """Return M with the rotors that turn with their links."""
        M = pin.crba(self.model, self.data, q)
        return np.asarray(np.triu(M) + np.triu(M, 1).T + np.diag(self.carried))

    def compute_weight(self, q: Array) -> Array:
        """Return the torques that hold the links."""
        return np.array(pin.computeGeneralizedGravity(self.model, self.data, q))

    def compute_residual(self, case: RestCase, q: Array, v: Array) -> float:
        """Return by how much torques at q do not add up, of a weight, where v came from rest."""
        weight = self.compute_weight(q) * (not case.weightless)
        left = -weight - self.compute_mass(q) @ v / (PARTS * INSTANT)  # that friction takes
        slides, holds = self._compute_friction(case)
        off = np.where(
            v == 0.0, np.maximum(np.abs(left) - holds, 0.0), np.abs(left - np.sign(v) * slides)
        )
        return float(off.max() / (self.dry.max() / SHARE))

    def _compute_friction(self, case: RestCase) -> tuple[Array, Array]:
        """Return what friction takes of joints that begin to move, and what it holds at most."""
        # Nothing loads the gears yet, and what a rotor behind an elastic one does is not felt yet.
        felt = self.dry * (1.0 if case.place == "link" else self.carried > 0.0)
        slides, holds = {
            "coulomb": (1.0, 1.0),
            "breakaway": (1.0, 1.5),
            "stribeck": (1.5, 1.5),
            "load and coulomb": (1.0, 1.0),
        }.get(case.law, (0.0, 0.0))
        return slides * felt, holds * felt


def load_equations(name: str) -> RestEquations:
    """Return those of a shipped scene."""
    payload = read_yaml(find_config(name, ".yaml")).get("payload")
    return RestEquations(load_scene(name, ALONE), payload)


def make_case_scene(case: RestCase, equations: RestEquations, dt: float | None = None) -> Scene:
    """Return the scene of a case, friction sized to what its joints carry; dt: of its steps."""
    at_rotor = case.place == "rotor"
    ratio = equations.ratio if at_rotor else np.ones_like(equations.ratio)
    overrides: dict[str, Any] = {
        **ALONE, "integrator.scheme": case.scheme, "integrator.events": case.events
    }  # fmt: skip
    if case.weightless:
        overrides["gravity"] = None
    if dt is not None:
        overrides |= {"integrator.dt": dt, "servo_period": PARTS * dt}
    key = ""
    for j, joint in enumerate(load_scene(case.scene, ALONE).joints):
        dry, inertia, bend = equations.dry * ratio, equations.inertia * ratio**2, BEND / ratio
        key, numbers = list_frictions(float(dry[j]), float(inertia[j]), float(bend[j]))[case.law]
        key = f"motor.{key}" if at_rotor else key
        overrides[f"joints.{joint.name}.{key}"] = numbers
    # Laws of one kind share a library.
    return load_scene(case.scene, {**overrides, "varied": [f"joints.*.{key}.*"]})


def judge_poses(case: RestCase, poses: int, equations: RestEquations) -> list[str]:
    """Return in a line each what is wrong in so many random poses."""
    rng = np.random.default_rng(zlib.crc32(repr(case).encode()))
    plant = Plant(make_case_scene(case, equations))
    instant = Plant(make_case_scene(case, equations, INSTANT))
    still, wrong = np.zeros(len(equations.ratio)), []
    for _ in range(poses):
        q = rng.uniform(-REACH, REACH, len(still))
        plant.reset(q)
        try:
            plant.advance(still, STEPS)
        except Diverged as fault:
            wrong.append(f"{case}: at {q.tolist()}: {fault}")
            continue
        instant.reset(q)
        instant.advance(still, PARTS)
        off = equations.compute_residual(case, q, instant.state.v)
        if off > RESOLVED:
            wrong.append(f"{case}: at {q.tolist()}: torques differ by {off:.2g}")
    return wrong


def list_cases(scenes: tuple[str, ...], schemes: tuple[str, ...]) -> list[RestCase]:
    """Return all cases; schemes that locate events do so and do not."""
    return [
        RestCase(scene, place, law, scheme, events, weightless)
        for scene in scenes
        for weightless in (False, True)
        for place in PLACES
        for law in FRICTIONS
        for scheme in schemes
        for events in (("step", "located") if scheme in LOCATING_SCHEMES else ("step",))
    ]
