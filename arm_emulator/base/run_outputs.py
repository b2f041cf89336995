"""Outputs of a run without a network, as requested by the user."""

from dataclasses import dataclass
from pathlib import Path

from arm_emulator.base.refusal import Refusal

SUFFIXES = (".mcap", ".csv", ".parquet", ".npz")


@dataclass(frozen=True)
class RunOutputs:
    """Files and viewer to which a run is written.

    Args:
        record: new file for true and measured values (.mcap, .csv, .parquet or .npz).
        rerun: port at which a Rerun viewer may connect, or an .rrd file to write.
    """

    record: Path | None = None
    rerun: str | None = None

    def check_options(self, where: str) -> None:
        """Refuse unusable options before anything starts.

        Raises:
            Refusal: the suffix is unknown, or the value is neither port nor file.
        """
        if self.record is not None:
            check_suffix(where, "--record", self.record)
        if self.rerun is not None and not (self.is_port or self.rerun.endswith(".rrd")):
            raise Refusal(where, "--rerun", "be a port or end in .rrd", self.rerun)

    @property
    def is_port(self) -> bool:
        """Whether a viewer may connect."""
        return self.rerun is not None and self.rerun.isascii() and self.rerun.isdecimal()


NOTHING = RunOutputs()


def check_suffix(where: str, quantity: str, file: Path) -> None:
    """Refuse files of a kind that cannot hold rows."""
    if file.suffix not in SUFFIXES:
        raise Refusal(where, quantity, "end in a known kind", file.name, ", ".join(SUFFIXES))
