"""Encoders."""

from __future__ import annotations

from dataclasses import dataclass

from emulator_node.section import LARGEST_COUNT, Section

# What a joint without an encoder reports, since encoder counts are whole numbers.
IDEAL_COUNTS_PER_TURN = 2**20


@dataclass(frozen=True, kw_only=True)
class Encoder:
    """Incremental encoder on the motor shaft: floor(theta_m / (2 pi) * counts_per_turn)."""

    counts_per_turn: int

    @classmethod
    def read(cls, section: Section) -> Encoder:
        """Return the encoder that a section describes."""
        count = section.integer("counts_per_turn", at_least=1, at_most=LARGEST_COUNT)
        return cls(counts_per_turn=count)
