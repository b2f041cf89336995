"""`validate`: a machine that stands somewhere, computed again and compared."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from arm_emulator.base.refusal import Refusal

MACHINES = ("manutec_r3", "kuka_kr300")


def validate(machine: str, runs: Sequence[Path], folder: Path) -> int:
    """Compare a machine with what others found; exit code 1 if it is not as close as it should be.

    Args:
        machine: one of `MACHINES`.
        runs: records to compare with, beside or in place of the shipped ones.
        folder: of the pictures.

    Raises:
        Refusal: no such machine, or a record that cannot be of it.
    """
    if machine == "manutec_r3":
        if runs:
            raise Refusal("validate", "records", "be absent, others have computed it", runs[0])
        from arm_emulator.validation.manutec_table import validate_manutec

        return validate_manutec(folder)
    if machine == "kuka_kr300":
        from arm_emulator.validation.kuka_table import validate_kuka

        return validate_kuka(runs, folder)
    raise Refusal("validate", "machine", "be known", machine, ", ".join(MACHINES))
