"""The faults of packages/test/faults_at_doors.py at a microcontroller."""

from pathlib import Path
from typing import ClassVar

from cortex_m import tiny, write_board

from arm_emulator import Refusal
from arm_emulator.runs.table_run import TableRun
from arm_emulator_firmware.board import load_board
from arm_emulator_firmware.elf_image import ElfImage
from arm_emulator_firmware.microcontroller import Microcontroller
from faults_at_doors import SCENE, check
from test_faults_at_doors import ByLibrary

TARGETS = {
    "count": 0x40000300,
    "joints": {name: 0x40000304 + 4 * k for k, name in enumerate(SCENE.joint_names)},
}
# The elbow's target becomes its command, unless the waist has one.
COPY = """int main(void) {
  for (;;) {
    uint32_t elbow = REGISTER(0x4000030c);
    if (!REGISTER(0x40000304)) REGISTER(0x40000108) = elbow;
  }
}"""


class ByChip(ByLibrary):
    title = "Cortex-M4F"
    lacks: ClassVar = {"stale": "time waits for the firmware", "name": "no names in registers"}

    def __init__(self, folder: Path) -> None:
        self._board = load_board(write_board(folder, targets=TARGETS), SCENE.joint_names)
        self._image = ElfImage(tiny(folder, COPY))

    def _begin(self) -> None:
        chip = Microcontroller(self._board, self._image, SCENE)
        self.loop = TableRun(SCENE, self._table(0.0), chip)
        self.session = self.loop.session
        self.plant = self.session.plant

    def nan(self) -> str:
        try:  # the chip has gone through the period, and the run ends
            self.give(float("nan"))
        except Refusal as no:
            return f"refused: {str(no).partition(': ')[2]}"
        raise AssertionError("it is taken")


def test_a_microcontroller(tmp_path: Path) -> None:
    check(ByChip(tmp_path))
