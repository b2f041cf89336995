"""The command line as a module: ``python -m arm_emulator COMMAND``."""

import os
import sys


def main() -> None:
    """Run one command, see `arm_emulator.cli.command_line`."""
    from arm_emulator.base.standard_files import open_standard_files

    open_standard_files()
    # Ctrl-C is kept back until it is known how this command ends: `end_at_once` lets it in.
    from arm_emulator.ros.process.ctrl_c import block_signals

    block_signals()
    # Before NumPy is loaded: matrices here are small, and threads that share them wait for each
    # other.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from arm_emulator.cli.command_line import main as run

    run()


if __name__ == "__main__":
    # Nothing of the user's folder is imported, whatever its files are called.
    if sys.path[0] != os.path.dirname(os.path.dirname(__file__)):
        sys.path[:] = [folder for folder in sys.path[1:] if folder != sys.path[0]]
    main()
