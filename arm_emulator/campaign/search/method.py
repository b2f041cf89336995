"""A method of search: it asks for runs, gets their margins, and ends with a finding.

Its course is a generator: it yields points of independent standard normal numbers, from which all
that varies follows (`Variation.values_at`), is sent the margins of the runs there, and returns
what it has found.
It has no other input than its numbers and a seed, so that a search that was interrupted takes the
same course again, with what is done taken from its results.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass
from typing import ClassVar

from arm_emulator.base.section import Section
from arm_emulator.campaign.variation import Variation
from arm_emulator.machine.chain import Array


@dataclass(frozen=True)
class Finding:
    """Result of a search, as a table.

    Attributes:
        title: of the table.
        about: it, in a sentence.
        head: names of the columns.
        rows: their entries.
    """

    title: str
    about: str
    head: tuple[str, ...]
    rows: tuple[tuple[str | float, ...], ...]

    def texts(self) -> list[tuple[str, ...]]:
        """Return the rows as texts."""
        return [
            tuple(f"{one:.4g}" if isinstance(one, float) else str(one) for one in row)
            for row in self.rows
        ]


Course = Generator[Array, Array, Finding]


@dataclass(frozen=True, kw_only=True)
class Method:
    """Base of all methods.

    Attributes:
        kind: its name in files.
        package: module and pip's name of a package that it needs; empty: none.
        of: requirement whose margin it gets; empty: the least of all.
    """

    kind: ClassVar[str] = ""
    package: ClassVar[tuple[str, ...]] = ()

    of: str = ""

    def check(self, section: Section, variation: Variation) -> None:
        """Refuse a campaign that it cannot search.

        Raises:
            Refusal: see above.
        """
        if not variation.numbers:
            raise section.refusal("method", "have numbers that vary", "none")

    def runs(self, D: int) -> int:
        """Return how many runs it takes at most."""
        raise NotImplementedError

    def course(self, D: int, of: str, seed: int) -> Course:
        """Return its course.

        Args:
            D: how many numbers vary.
            of: whose margin it gets: the generator is sent arrays (K,) for points (K, D).
            seed: of its random numbers.
        """
        raise NotImplementedError
