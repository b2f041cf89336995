"""`validate`: the emulation of a real machine compared with measurements."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from arm_emulator.base.refusal import Refusal
from arm_emulator.cli.output import Output

MACHINES = ("manutec_r3", "kuka_kr300")


def validate(machine: str, runs: Sequence[Path], folder: Path, *, json: bool) -> int:
    """Compare a machine with its reference; exit code 1 if a limit is exceeded.

    Args:
        machine: one of `MACHINES`.
        runs: further records for the comparison, or instead of the shipped ones.
        folder: of the pictures.
        json: whether to print JSON.

    Raises:
        Refusal: the machine is unknown, or a record cannot be of it.
    """
    if machine not in MACHINES:
        raise Refusal("validate", "machine", "be known", machine, ", ".join(MACHINES))
    output = Output(json)
    if machine == "manutec_r3":
        if runs:
            raise Refusal(
                "validate", "records", "be absent: it is compared with published results", runs[0]
            )
        from arm_emulator.validation.manutec_table import WIDTH, validate_manutec

        facts = validate_manutec(folder, output.console(WIDTH))
    else:
        from arm_emulator.validation.kuka_table import WIDTH, validate_kuka

        facts = validate_kuka(runs, folder, output.console(WIDTH))
    output.facts({"machine": machine, **facts})
    return 0 if facts["good"] else 1
