"""Torques on a link as a table over its angle."""

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.base.validation.number import LARGEST, Number
from arm_emulator.base.validation.section import Section
from arm_emulator.machine import cxx_literals
from arm_emulator.machine.parts.joint_effects.joint_effect import JointEffect
from arm_emulator.machine.parts.key import Key
from arm_emulator.machine.parts.registry import register_part
from arm_emulator.machine.parts.shaft_motion import ShaftMotion

MIN_POINTS, MAX_POINTS = 4, 256  # points
CLOSEST = 1e-6  # rad (m)
_ANGLES = Number.bound_size("angles", "rad", 1e4)
_TORQUES = Number.bound_size("torques", "N m", LARGEST)


@register_part
class TorqueTable(JointEffect):
    """A torque over the angle: points, joined by monotone cubics."""

    section = "torque_table"
    rank = 5
    of_angle = True
    header = "joint_effects/torque_table.hpp"
    cxx = "TorqueTable"

    keys = (
        Key(
            "angles",
            unit="rad (m)",
            range=f"{MIN_POINTS} to {MAX_POINTS} numbers, size ≤ 10000, "
            f"each ≥ {CLOSEST:g} above the one before",
            absent="refused",
            text="angles of the joint",
        ),
        Key(
            "torques",
            unit="N m (N)",
            range=f"as many, size ≤ {LARGEST:g}",
            absent="refused",
            text="torques on the link; of a periodic table the last equals the first",
        ),
        Key(
            "periodic",
            range="`true`, `false`",
            absent="`false`",
            text="whether the table repeats, or keeps the torque of its ends",
        ),
    )

    angles: tuple[float, ...]  # rad (m), increasing
    torques: tuple[float, ...]  # N m (N), on the link
    periodic: bool = False

    @classmethod
    def read_numbers(cls, section: Section) -> dict[str, Any]:  # noqa: D102
        return {
            "angles": _read_row(section, _ANGLES),
            "torques": _read_row(section, _TORQUES),
            "periodic": section.is_true("periodic"),
        }

    def check_numbers(self, section: Section) -> None:  # noqa: D102
        if len(self.torques) != len(self.angles):
            rule = f"have as many numbers as angles, {len(self.angles)}"
            raise section.make_refusal("torques", rule, len(self.torques))
        for angle, following in pairwise(self.angles):
            if following - angle < CLOSEST:
                rule = f"increase by at least {CLOSEST:g} rad each"
                raise section.make_refusal("angles", rule, f"{following!r} after {angle!r}")
        if self.periodic and self.torques[0] != self.torques[-1]:
            rule = "end with the torque that they begin with, as the table is periodic"
            raise section.make_refusal(
                "torques", rule, f"{self.torques[0]!r} and {self.torques[-1]!r}"
            )

    @property
    def cxx_type(self) -> str:  # noqa: D102
        periodic = "true" if self.periodic else "false"
        return f"arm::{self.cxx}<{len(self.angles) - 1}, {periodic}>"

    def list_members(self, joint: str, places: Mapping[str, str]) -> list[tuple[str, str]]:  # noqa: D102
        q, T = np.array(self.angles), self.compute_coefficients()
        h = np.diff(q)
        works = h * (T[0] + h * (T[1] / 2.0 + h * (T[2] / 3.0 + h * T[3] / 4.0)))
        U = [0.0, *np.cumsum(-works)]
        rows = zip(q[:-1], *T, U[:-1], strict=True)
        pieces = ", ".join(
            "{" + ", ".join(map(cxx_literals.format_number, row)) + "}" for row in rows
        )
        return [
            ("pieces", "{{" + pieces + "}}"),
            ("end", cxx_literals.format_number(q[-1])),
            ("U_end", cxx_literals.format_number(U[-1])),
        ]

    def compute_effort(self, motion: ShaftMotion) -> Array:  # noqa: D102
        from scipy.interpolate import PPoly

        at, q = np.array(self.angles), motion.angle
        within = np.clip(q, at[0], at[-1])
        if self.periodic:
            within = at[0] + np.mod(q - at[0], at[-1] - at[0])
        torque: Array = -PPoly(self.compute_coefficients()[::-1], at)(within)
        return torque

    def compute_coefficients(self) -> Array:
        """Return T0 to T3 of each piece (4, pieces), by PCHIP of the table with what is beyond it.

        Source: F. N. Fritsch and J. Butland, SIAM J. Sci. Stat. Comput. 5, 1984.
        """
        from scipy.interpolate import (
            PchipInterpolator,
        )  # slow to import, and few scenes have tables

        q, T = np.array(self.angles), np.array(self.torques)
        if self.periodic:
            period, before = q[-1] - q[0], len(q) - 1
            q = np.concatenate([q[:-1] - period, q, q[1:] + period])
            T = np.concatenate([T[:-1], T, T[1:]])
        else:
            before = 1
            q = np.concatenate([[q[0] - 1.0], q, [q[-1] + 1.0]])
            T = np.concatenate([T[:1], T, T[-1:]])
        with np.errstate(over="ignore"):  # of slopes that are next to 0
            cubics: Array = PchipInterpolator(q, T).c[::-1]
        return cubics[:, before : before + len(self.angles) - 1]


def _read_row(section: Section, number: Number) -> tuple[float, ...]:
    entries = section.read_entries(number.name)
    rule = f"have {MIN_POINTS} to {MAX_POINTS} {number.range.replace('number', 'numbers')}"
    if not MIN_POINTS <= len(entries) <= MAX_POINTS:
        raise section.make_refusal(number.name, rule, len(entries))
    for entry in entries:
        if not number.is_in_range(entry):
            raise section.make_refusal(number.name, rule, repr(entry))
    return tuple(map(float, entries))  # type: ignore[arg-type]
