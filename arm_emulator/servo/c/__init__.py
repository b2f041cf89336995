"""Control code in portable C, see docs/tutorials/your_firmware.md."""

from pathlib import Path

FOLDER = Path(__file__).resolve().parent
