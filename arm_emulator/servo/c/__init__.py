"""Control code in portable C, see docs/firmware.md."""

from pathlib import Path

FOLDER = Path(__file__).resolve().parent
