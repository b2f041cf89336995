"""Compare a real machine with measurements or with independent solutions."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from arm_emulator.extension.base import Refusal
from arm_emulator.extension.commands import command, output

MACHINES = ("manutec_r3", "kuka_kr300")


@command(keys="`machine`, `good`, `failures` or `runs`, `rows`, `order`, `pictures`")
def validate_machine(
    machine: str,
    /,
    *runs: Path,
    out: Annotated[Path, Parameter(metavar="FOLDER")] = Path("out"),
) -> int:
    """Compare the emulation of a real machine with measurements or with independent solutions.

    Args:
        machine: manutec_r3 or kuka_kr300.
        runs: of kuka_kr300: further records (default: those shipped).
        out: folder of the pictures.
    """
    if machine not in MACHINES:
        raise Refusal("validate", "machine", "be known", machine, ", ".join(MACHINES))
    if machine == "manutec_r3":
        if runs:
            raise Refusal(
                "validate", "records", "be absent: it is compared with published results", runs[0]
            )
        from arm_emulator_identification.validation.manutec_r3 import WIDTH, validate_manutec

        facts = validate_manutec(out, output.make_console(WIDTH))
    else:
        from arm_emulator_identification.validation.kuka_kr300 import WIDTH, validate_kuka

        facts = validate_kuka(runs, out, output.make_console(WIDTH))
    output.add_facts({"machine": machine, **facts})
    return 0 if facts["good"] else 1
