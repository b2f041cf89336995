"""The command that opens the Rerun viewer."""

from __future__ import annotations

import os
import shlex
import shutil
import sys
from pathlib import Path


def viewer_command(source: str | Path) -> str:
    """Return the command that shows a recording, for a shell in the working folder.

    Args:
        source: file of the recording, or address of a running stream.
    """
    viewer = Path(sys.executable).parent / "rerun"
    by_path = shutil.which("rerun") or not viewer.exists()
    # Without it, rerun takes whoever listens at its own port, 9876, for a viewer, and opens none.
    connect = ["--connect"] if "://" in str(source) else []
    return shlex.join(["rerun" if by_path else os.path.relpath(viewer), *connect, str(source)])
