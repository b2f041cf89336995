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
    if shutil.which("rerun") or not viewer.exists():
        return shlex.join(["rerun", str(source)])
    return shlex.join([os.path.relpath(viewer), str(source)])
