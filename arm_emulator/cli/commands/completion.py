"""Print a script that completes commands and options in a shell."""

from __future__ import annotations

from typing import Literal

from arm_emulator.cli.command import command


@command()
def completion(shell: Literal["bash", "zsh", "fish"], /) -> int:
    """Print a script that completes commands and options in a shell.

    Args:
        shell: such as in `eval "$(arm_emulator completion bash)"`.
    """
    from arm_emulator.cli.arguments import completion_script

    print(completion_script(shell))
    return 0
