"""docs/reference/modes.md: eigenvalues of every loop of the drives of the shipped scenes.

    python -m bench.motion.modes

writes it anew.
"""

from __future__ import annotations

from pathlib import Path

from arm_emulator import load_gains, load_scene
from arm_emulator.base.io.config_files import find_scene
from arm_emulator.cli.commands.check_scene import build_mode_rows, format_page_table

PAGE = Path(__file__).resolve().parents[2] / "docs" / "reference" / "modes.md"
SCENES = ("three_axis", "ur5", "panda")
HEAD = """\
# Eigenvalues of every mode

```sh
arm_emulator check-scene SCENE --modes
```

prints these tables. For each joint and each loop that a mode of its drive
([Drives behind a field bus](drives.md)) can select, they show the eigenvalues of one servo period
at the worst of four poses, with the brake open and closed.

- `largest` is the growth factor of the fastest growing motion per period. It is 1 for a motion that
  rests or drifts; in torque loops it exceeds 1 by the arm's own fall.
- `slowest swing` is the largest factor of the oscillating motions.
- `growth` is the fastest growth at the worst gain: in torque loops less the arm's fall, in speed
  loops less a tenth of it.

Modes 1 and 8 are position, 3 and 9 speed, 4 and 10 torque and torque at the speed limit, 6 position
and speed. Stiction, encoder steps and limits are not included. `python -m bench.motion.modes`
writes this page; a test compares it with the code.
"""


def make_modes_table(name: str) -> str:
    """Return a scene's section of the page."""
    file = find_scene(name)
    rows = build_mode_rows(load_scene(file), load_gains(file).servo)
    return f"#### {name}\n\n{format_page_table(rows)}\n"


def main() -> None:
    """Write the page."""
    PAGE.write_text("\n".join([HEAD, *map(make_modes_table, SCENES)]), encoding="utf-8")


if __name__ == "__main__":
    main()
