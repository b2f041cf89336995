"""Numbers of a scene that are data of each machine, not constants of the compiled core."""

import difflib
import fnmatch
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

from arm_emulator.base.arrays import Array
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.urdf.frames import Frame
from arm_emulator.base.validation.number import Number
from arm_emulator.machine.chain import Body, ChainJoint
from arm_emulator.machine.cxx_literals import format_number

Kind = TypeVar("Kind")


@dataclass(frozen=True)
class Varied:
    """One of them; its name is its place in the scene."""

    number: Number
    value: float  # that a machine begins with

    @property
    def name(self) -> str:
        """Its place in the scene."""
        return self.number.name


def choose_names(
    patterns: Sequence[object], possible: Mapping[str, Kind], where: str, key: str, rule: str
) -> tuple[Kind, ...]:
    """Return what is named, each once and in the order of the scene.

    Args:
        patterns: names such as ``payload.mass``, or patterns such as ``joints.*.friction.coulomb``.
        possible: all that can be chosen, by name.
        where: the file, for refusals.
        key: of the list in the file, for refusals.
        rule: for refusals.

    Raises:
        Refusal: a name or pattern that no choice has.
    """
    chosen = set()
    for pattern in patterns:
        matches = fnmatch.filter(possible, pattern) if isinstance(pattern, str) else []
        if not matches:
            near = isinstance(pattern, str) and difflib.get_close_matches(pattern, possible)
            raise Refusal(where, key, rule, pattern, ", ".join(near or possible) or "none")
        chosen.update(matches)
    return tuple(kind for name, kind in possible.items() if name in chosen)


def find_varied(varied: Sequence[Varied], name: object, where: str) -> Varied:
    """Return the one of a scene's varied numbers by its name.

    Raises:
        Refusal: the scene does not list it as varied.
    """
    for number in varied:
        if isinstance(name, str) and number.name == name:
            return number
    names = ", ".join(number.name for number in varied)
    valid = names or "none, see `varied` and `faults` in docs/reference/scene.md"
    raise Refusal(where, "name", "be varied in the scene", name, valid)


AXES = "xyz"
TENSOR = ("xx", "yy", "zz", "xy", "xz", "yz")
NAMES = ("mass", *(f"moment_{x}" for x in AXES), *(f"inertia_{xx}" for xx in TENSOR))


def read_body_numbers(body: Body) -> dict[str, float]:
    """Return mass [kg], first moment [kg m] and inertia about the origin [kg m2] by name."""
    tensor = (body.inertia[AXES.index(xx[0]), AXES.index(xx[1])] for xx in TENSOR)
    return dict(zip(NAMES, map(float, (body.mass, *body.moment, *tensor)), strict=True))


def vary_child(joint: ChainJoint, body: Body | None = None) -> dict[str, float]:
    """Return the numbers of what a joint moves, in the frame of its child link in the URDF."""
    return read_body_numbers((body or joint.body).transform_to(Frame(joint.axes.T)))


def vary_body(joint: ChainJoint) -> list[Varied]:
    """Return the numbers of a joint's body, with the payload, that may be varied."""
    return [
        Varied(_declare_number(f"links.{joint.link}.{name}"), value)
        for name, value in vary_child(joint).items()
    ]


def _declare_number(name: str) -> Number:
    if name.endswith(".mass"):
        return Number(name, "kg", above=0.0)
    if "moment" in name.rsplit(".", 1)[-1]:
        return Number(name, "kg m")
    return Number(name, "kg m2", at_least=0.0 if name[-2] == name[-1] else None)


def write_expressions(joint: ChainJoint, places: Mapping[str, str]) -> dict[str, str] | None:
    """Return the C++ of a link's numbers in the core's frame; None where none of them is varied.

    Args:
        joint: that moves the link.
        places: where the values of varied numbers stand, by their name.
    """
    own = {name: places.get(f"links.{joint.link}.{name}") for name in NAMES}
    if not any(own.values()):
        return None
    values = vary_child(joint)
    terms = {name: own[name] or format_number(values[name]) for name in NAMES}
    R = joint.axes
    vector = {f"moment_{x}": [(f"moment_{y}", R[i, k]) for k, y in enumerate(AXES)]
              for i, x in enumerate(AXES)}  # fmt: skip
    turned = {
        f"inertia_{xx}": _write_tensor(R, AXES.index(xx[0]), AXES.index(xx[1])) for xx in TENSOR
    }
    sums = {name: _sum_terms(parts, terms) for name, parts in (vector | turned).items()}
    return {"mass": terms["mass"], **sums}


def _write_tensor(R: Array, i: int, j: int) -> list[tuple[str, float]]:
    """Return the factors of a tensor's numbers in entry i, j of R I R'."""
    parts = []
    for xx in TENSOR:
        k, m = AXES.index(xx[0]), AXES.index(xx[1])
        factor = R[i, k] * R[j, m] + (R[i, m] * R[j, k] if k != m else 0.0)
        parts.append((f"inertia_{xx}", float(factor)))
    return parts


def _sum_terms(parts: list[tuple[str, float]], terms: Mapping[str, str]) -> str:
    # Exactly 1 and 0: a chain's axes have them wherever rounding alone is the difference.
    products = []
    for name, factor in parts:
        if factor == 1.0:
            products.append(terms[name])
        elif factor != 0.0:
            products.append(f"{format_number(factor)} * {terms[name]}")
    return " + ".join(products) or format_number(0.0)
