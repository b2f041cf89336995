"""A method of search: it asks for runs, gets their margins, and ends with findings.

Its course is a generator. It yields points of independent standard normal numbers, from which all
varied values follow (`Variation.place_values`). It is sent the outputs of the runs at these points,
and returns findings. Its numbers and a seed are its only inputs. An interrupted search therefore
takes the same course again, and takes the finished runs from its results.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass
from typing import ClassVar

from arm_emulator.extension.base import Array, Section
from arm_emulator_campaign.sampling.variation import Variation


@dataclass(frozen=True)
class Finding:
    """A table of what was found.

    Attributes:
        title: of the table.
        about: it, in a sentence.
        head: names of the columns.
        rows: their entries.
        bars: column whose numbers the report draws as bars, named by the columns before it; empty:
            none.
    """

    title: str
    about: str
    head: tuple[str, ...]
    rows: tuple[tuple[str | float, ...], ...]
    bars: str = ""

    def format_rows(self) -> list[tuple[str, ...]]:
        """Return the rows as texts; a name that stands in the row before is left out."""
        rows, before = [], ""
        for name, *rest in self.rows:
            texts = [f"{value:.4g}" if isinstance(value, float) else str(value) for value in rest]
            first = str(name) if isinstance(name, str) else f"{name:.4g}"
            rows.append(("" if first == before else first, *texts))
            before = first
        return rows


Sampler = Generator[Array, Array, list[Finding]]


@dataclass(frozen=True, kw_only=True)
class Method:
    """Base of all methods.

    Attributes:
        kind: its name in files.
        package: module and pip's name of a package that it needs; empty: none.
        every: whether it gets all requirements and measures, instead of one margin.
        forks: whether it forks runs in their midst, instead of a course of whole runs.
        of: requirement whose margin it gets; empty: the least of all.
    """

    kind: ClassVar[str] = ""
    package: ClassVar[tuple[str, ...]] = ()
    every: ClassVar[bool] = False
    forks: ClassVar[bool] = False

    of: str = ""

    def check_campaign(self, section: Section, variation: Variation) -> None:
        """Refuse a campaign that it cannot search."""
        if not variation.numbers:
            raise section.make_refusal("method", "have numbers that vary", "none")

    def count_runs(self, D: int) -> int:
        """Return how many runs it takes at most."""
        raise NotImplementedError

    def make_sampler(self, names: Sequence[str], outputs: Sequence[str], seed: int) -> Sampler:
        """Return its course.

        Args:
            names: of the numbers that vary, D.
            outputs: of a run, M: the generator is sent arrays (K, M) for points (K, D).
            seed: of its random numbers.
        """
        raise NotImplementedError
