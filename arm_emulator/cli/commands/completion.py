"""Print a script that completes commands and options in a shell."""

from typing import Literal

from arm_emulator.cli.arguments import write_completion_script
from arm_emulator.cli.command import command
from arm_emulator.cli.output import output


@command(keys="`shell`, `script`")
def print_completion(shell: Literal["bash", "zsh", "fish"], /) -> int:
    """Print a script that completes commands and options in a shell.

    Args:
        shell: whose completions are printed.
    """
    script = write_completion_script(shell)
    output.print_line(script)
    output.add_facts({"shell": shell, "script": script})
    return 0
