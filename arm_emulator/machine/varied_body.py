"""Masses of links that are data of each machine."""

from __future__ import annotations

from collections.abc import Mapping

from arm_emulator.base.number import Number
from arm_emulator.machine.chain import Array, Body, ChainJoint, Frame
from arm_emulator.machine.cxx_literals import number
from arm_emulator.machine.varied import Varied

AXES = "xyz"
TENSOR = ("xx", "yy", "zz", "xy", "xz", "yz")
NAMES = ("mass", *(f"moment_{x}" for x in AXES), *(f"inertia_{xx}" for xx in TENSOR))


def numbers_of(body: Body) -> dict[str, float]:
    """Return mass [kg], first moment [kg m] and inertia about the origin [kg m2] by name."""
    tensor = (body.inertia[AXES.index(xx[0]), AXES.index(xx[1])] for xx in TENSOR)
    return dict(zip(NAMES, map(float, (body.mass, *body.moment, *tensor)), strict=True))


def of_child(joint: ChainJoint, body: Body | None = None) -> dict[str, float]:
    """Return the numbers of what a joint moves, in the frame of its child link in the URDF."""
    return numbers_of((body or joint.body).seen_from(Frame(joint.axes.T)))


def varied_body(joint: ChainJoint) -> list[Varied]:
    """Return the numbers of a joint's body, with the payload, that may be varied."""
    return [
        Varied(_number(f"links.{joint.link}.{name}"), value)
        for name, value in of_child(joint).items()
    ]


def _number(name: str) -> Number:
    if name.endswith(".mass"):
        return Number(name, "kg", above=0.0)
    if "moment" in name.rsplit(".", 1)[-1]:
        return Number(name, "kg m")
    return Number(name, "kg m2", at_least=0.0 if name[-2] == name[-1] else None)


def expressions(joint: ChainJoint, places: Mapping[str, str]) -> dict[str, str] | None:
    """Return the C++ of a link's numbers in the core's frame; None where none of them is varied.

    Args:
        joint: that moves the link.
        places: where the values of varied numbers stand, by their name.
    """
    own = {name: places.get(f"links.{joint.link}.{name}") for name in NAMES}
    if not any(own.values()):
        return None
    values = of_child(joint)
    terms = {name: own[name] or number(values[name]) for name in NAMES}
    R = joint.axes
    vector = {f"moment_{x}": [(f"moment_{y}", R[i, k]) for k, y in enumerate(AXES)]
              for i, x in enumerate(AXES)}  # fmt: skip
    turned = {f"inertia_{xx}": _tensor(R, AXES.index(xx[0]), AXES.index(xx[1])) for xx in TENSOR}
    sums = {name: _sum(parts, terms) for name, parts in (vector | turned).items()}
    return {"mass": terms["mass"], **sums}


def _tensor(R: Array, i: int, j: int) -> list[tuple[str, float]]:
    """Return the factors of a tensor's numbers in entry i, j of R I R'."""
    parts = []
    for xx in TENSOR:
        k, m = AXES.index(xx[0]), AXES.index(xx[1])
        factor = R[i, k] * R[j, m] + (R[i, m] * R[j, k] if k != m else 0.0)
        parts.append((f"inertia_{xx}", float(factor)))
    return parts


def _sum(parts: list[tuple[str, float]], terms: Mapping[str, str]) -> str:
    # Exactly 1 and 0: a chain's axes have them wherever rounding alone is the difference.
    shown = []
    for name, factor in parts:
        if factor == 1.0:
            shown.append(terms[name])
        elif factor != 0.0:
            shown.append(f"{number(factor)} * {terms[name]}")
    return " + ".join(shown) or number(0.0)
