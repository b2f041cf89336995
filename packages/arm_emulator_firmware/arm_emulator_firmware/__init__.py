"""Unmodified firmware of a Cortex-M4F in the loop with a machine."""

from pathlib import Path

FOLDER = Path(__file__).resolve().parent
CORE_FOLDER = FOLDER / "core"
