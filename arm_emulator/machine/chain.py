"""Bodies and the tree of moving joints, in the core's frames."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.base.products import apply_matrix, multiply_matrices
from arm_emulator.base.urdf.couplings import Coupling
from arm_emulator.base.urdf.frames import Frame, compute_cross


@dataclass(frozen=True)
class Body:
    """Inertia about an origin: mass [kg], first moment [kg m] (3,), tensor [kg m2] (3, 3)."""

    mass: float = 0.0
    moment: Array = field(default_factory=lambda: np.zeros(3))
    inertia: Array = field(default_factory=lambda: np.zeros((3, 3)))

    @classmethod
    def from_center(cls, mass: float, com: Array, inertia: Array) -> Body:
        """Return the body of `mass` whose `inertia` is given about its centre of mass `com`."""
        return Bodies.from_center(np.array([mass]), com[None], inertia[None]).get_body(0)

    def __add__(self, other: Body) -> Body:
        return Body(
            self.mass + other.mass, self.moment + other.moment, self.inertia + other.inertia
        )

    def scale_mass(self, factor: float) -> Body:
        """Return a body of that many times this one."""
        return Body(factor * self.mass, factor * self.moment, factor * self.inertia)

    def transform_to(self, frame: Frame) -> Body:
        """Return this body in the frame from which its own is seen as `frame`."""
        mass, moment = np.array([self.mass]), self.moment[None]
        alone = Bodies(mass, moment, self.inertia[None])
        return alone.transform_to(frame.R[None], frame.p[None]).get_body(0)


@dataclass(frozen=True)
class Bodies:
    """Many bodies (K of them) side by side, since a URDF may have thousands of links."""

    mass: Array
    moment: Array
    inertia: Array

    @classmethod
    def from_center(cls, mass: Array, com: Array, inertia: Array) -> Bodies:
        """Return the bodies whose `inertia` (K, 3, 3) is given about their `com` (K, 3)."""
        c, m = compute_cross(com), mass[:, None, None]
        return cls(mass, mass[:, None] * com, inertia - multiply_matrices(m * c, c))

    def transform_to(self, R: Array, p: Array) -> Bodies:
        """Return them in frames from which their own are seen as R (K, 3, 3), p (K, 3)."""
        h = apply_matrix(R, self.moment)
        p_x, h_x = compute_cross(p), compute_cross(h)
        shift = multiply_matrices(p_x, h_x) + multiply_matrices(h_x, p_x)
        shift = shift + multiply_matrices(self.mass[:, None, None] * p_x, p_x)
        inertia = multiply_matrices(R, self.inertia, R.transpose(0, 2, 1)) - shift
        return Bodies(self.mass, h + self.mass[:, None] * p, inertia)

    def get_body(self, index: int) -> Body:
        """Return one of them."""
        return Body(float(self.mass[index]), self.moment[index], self.inertia[index])

    def select_bodies(self, indices: list[int]) -> Bodies:
        """Return those at `indices`."""
        return Bodies(self.mass[indices], self.moment[indices], self.inertia[indices])

    def sum_bodies(self) -> Body:
        """Return all of them as one, added one after the other."""
        return Body(
            float(self.mass.cumsum()[-1]),
            self.moment.cumsum(axis=0)[-1],
            self.inertia.cumsum(axis=0)[-1],
        )


@dataclass(frozen=True)
class ChainJoint:
    """A moving joint and its link, in the frames of `core/mechanics/scene.hpp`.

    The link's frame has its origin on the joint axis and z along it. The turn from the parent's
    frame is Rz(gamma) Rx(alpha) Rz(q + theta_0), with gamma 0 for the first child of a parent. `p`
    (3,) [m] is the origin in the parent's frame. `parent` is the place of the link that carries
    it, -1 for the base.

    The joint's child in the URDF has the same origin; `axes` (3, 3) turns vectors of the child's
    frame into this one's. `links` has the child, with all that is fixed to it, as frames seen from
    the child.
    """

    name: str
    kind: str
    parent: int
    cos_gamma: float
    sin_gamma: float
    cos_alpha: float
    sin_alpha: float
    theta_0: float
    p: Array
    body: Body
    axes: Array
    links: Mapping[str, Frame]

    @property
    def link(self) -> str:
        """Name of the joint's child in the URDF."""
        return next(iter(self.links))

    @property
    def R(self) -> Array:
        """Rotation (3, 3) of its frame in the parent's, with the joint at 0."""
        c, s = self.cos_alpha, self.sin_alpha
        tilt = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
        C, S = math.cos(self.theta_0), math.sin(self.theta_0)
        turn = np.array([[C, -S, 0.0], [S, C, 0.0], [0.0, 0.0, 1.0]])
        c, s = self.cos_gamma, self.sin_gamma
        leading = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        return multiply_matrices(leading, multiply_matrices(tilt, turn))


@dataclass(frozen=True)
class Chain:
    """The moving joints from base to tips, and the base's frame.

    Parents come before children, and what a joint carries follows it before anything else.

    `links` has all of them; `shafts` those by whose names the drives' shafts go, which is all where
    each joint has a drive of its own; `joints` those of these that controllers know. The others are
    `deflections` of bearings, by name: between a joint and its body, with links without a body
    between them. `coupling` relates the links' joints to the shafts.

    `R_BW` (3, 3) turns world vectors (gravity) into the base's frame, from which the first joint is
    seen; both have their origin at the URDF's root link. `carried` has the URDF's links that move,
    each with the joint that carries it and its frame in that of the joint's child link. `R_core`
    (N, 3, 3) turns the child link's frame into the core's.
    """

    links: tuple[ChainJoint, ...]
    coupling: Coupling
    R_BW: Array
    R_core: Array
    carried: Mapping[str, tuple[int, Frame]]
    deflections: tuple[str, ...] = ()

    @property
    def shafts(self) -> tuple[ChainJoint, ...]:
        """Joints of the shafts."""
        return tuple(self.links[k] for k in self.link_of)

    @property
    def joints(self) -> tuple[ChainJoint, ...]:
        """Joints of the shafts that controllers know."""
        return tuple(shaft for shaft in self.shafts if shaft.name not in self.deflections)

    @property
    def bodies(self) -> dict[int, ChainJoint]:
        """Links that have a body, by their places among all."""
        return {k: link for k, link in enumerate(self.links) if link.link not in self.deflections}

    @property
    def link_of(self) -> tuple[int, ...]:
        """Place among the links of each shaft's joint."""
        names = [link.name for link in self.links]
        return tuple(map(names.index, self.coupling.shafts))

    @property
    def is_branched(self) -> bool:
        """Whether a joint is not carried by the one before."""
        return any(link.parent != k - 1 for k, link in enumerate(self.links))

    def find_path(self, joint: int) -> list[int]:
        """Return the joints from the base to one of them, which is the last."""
        path: list[int] = []
        while joint >= 0:
            path.append(joint)
            joint = self.links[joint].parent
        return path[::-1]

    def place_of(self, link: str) -> tuple[int, Frame]:
        """Return the joint that carries a link of `carried`, and the frame in the core's of it."""
        joint, frame = self.carried[link]
        return joint, Frame(self.R_core[joint]) @ frame
