"""`validate`: a machine that stands somewhere, computed again and compared."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from arm_emulator.base.refusal import Refusal
from arm_emulator.cli.output import Output

MACHINES = ("manutec_r3", "kuka_kr300")


def validate(machine: str, runs: Sequence[Path], folder: Path, *, json: bool) -> int:
    """Compare a machine with what others found; exit code 1 if it is not as close as it should be.

    Args:
        machine: one of `MACHINES`.
        runs: records to compare with, beside or in place of the shipped ones.
        folder: of the pictures.
        json: whether a program reads what is printed.

    Raises:
        Refusal: no such machine, or a record that cannot be of it.
    """
    if machine not in MACHINES:
        raise Refusal("validate", "machine", "be known", machine, ", ".join(MACHINES))
    output = Output(json)
    if machine == "manutec_r3":
        if runs:
            raise Refusal("validate", "records", "be absent, others have computed it", runs[0])
        from arm_emulator.validation.manutec_table import WIDTH, validate_manutec

        facts = validate_manutec(folder, output.console(WIDTH))
    else:
        from arm_emulator.validation.kuka_table import WIDTH, validate_kuka

        facts = validate_kuka(runs, folder, output.console(WIDTH))
    output.facts({"machine": machine, **facts})
    return 0 if facts["good"] else 1
