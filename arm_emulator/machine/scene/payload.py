"""The payload of a scene, and what a varied mass of it adds to the link that carries it."""

from dataclasses import dataclass

import numpy as np

from arm_emulator.base.validation.number import Number
from arm_emulator.base.validation.section import Section
from arm_emulator.machine.chain import Body, Chain
from arm_emulator.machine.scene.urdf_bodies import check_inertia

MASS = Number(
    "mass",
    "kg",
    at_least=0.0,
    text="mass at the tool",
)
COM = Number.bound_size("com", "m", 100.0)
INERTIA = Number.bound_size("inertia", "kg m2", 1e6)


@dataclass(frozen=True)
class Load:
    """A payload whose mass is varied: its link, and its share of the link's inertia."""

    link: int
    bare: Body  # the link without it
    per_kg: Body  # what 1 kg more adds


def read_payload(section: Section, mass: float | None = None) -> Body:
    """Return the payload in the frame of the tool; `mass` takes the place of the scene's."""
    stated = section.read_number(MASS)
    mass = stated if mass is None else mass
    com = section.read_vector(COM) or (0.0, 0.0, 0.0)
    entries = section.read_vector(INERTIA, size=6)
    inertia = np.zeros((3, 3))
    if entries is not None:
        xx, yy, zz, xy, xz, yz = entries
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        check_inertia(inertia, "payload.inertia", section.where)
    section.refuse_unread_keys()
    return Body.from_center(mass, np.array(com), inertia)


def load_of(light: Chain, heavy: Chain) -> Load | None:
    """Return the load of 1 and 2 kg in two chains; None where it rests on the base."""
    for link, (empty, two) in enumerate(zip(light.links, heavy.links, strict=True)):
        if empty.body.mass != two.body.mass:
            per_kg = two.body + empty.body.scale_mass(-1.0)
            return Load(link, empty.body + per_kg.scale_mass(-1.0), per_kg)
    return None
