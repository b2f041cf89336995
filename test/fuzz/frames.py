"""Random and mutated Ethernet frames for a segment of EtherCAT slaves that watches itself.

python -m fuzz.frames SEED FIRST STEP: batch FIRST, FIRST + STEP, ... of a seed, until it is ended.

Compiled with AddressSanitizer and UBSan. A frame that is not sound changes nothing but the counters
of errors; after any frame slaves are in a known state.
"""

import itertools
import sys
import traceback
from pathlib import Path

from arm_emulator import load_gains, load_scene
from arm_emulator.base.io.config_files import find_scene
from arm_emulator.core import BOUNDARY
from arm_emulator.servo.c import FOLDER
from arm_emulator.toolchain.c_header import Header, Library, read_text
from arm_emulator.toolchain.compile_unit import load_library as compiled
from arm_emulator_fieldbus.drives_unit import DRIVES_CORE, drives_unit
from arm_emulator_fieldbus.ethercat import SEGMENT, Segment
from fuzz.line import FAILED, REFUSED, TAKEN, report

FRAMES = 10_000  # of a batch
SCENE = "three_axis"
_SOURCE = Path(__file__).with_name("ethercat.cpp")
FUZZ = Header(Path(__file__).with_name("ethercat_fuzz.h"), (DRIVES_CORE, BOUNDARY, FOLDER))


def library() -> Library:
    """Return drives, segment and what makes the frames, in one library."""
    source = '#include "ethercat/ethercat.cpp"\n' + FUZZ.path.read_text() + _SOURCE.read_text()
    about = "the EtherCAT segment and its frames"
    return compiled(drives_unit("ethercat-fuzz", source, (SEGMENT, FUZZ), about))


def case(seed: int, number: int, frames: int = FRAMES) -> dict[str, int]:
    """Let a batch of frames through a new segment; return how many were sound and how many not."""
    calls = library()
    path = find_scene(SCENE)
    segment = Segment(load_scene(path), load_gains(path).servo, number % 2 == 0, calls)
    why = FUZZ.ffi.new("char[]", 200)
    sound = calls.ethercat_fuzz(
        segment.pointer, segment.drives.pointer, seed * 1_000_003 + number, frames, why
    )
    assert sound >= 0, f"batch {number} of seed {seed}: {read_text(why)}"
    figures = segment.figures
    thrown = figures.malformed + figures.foreign + figures.circulating
    assert figures.frames == sound and thrown > frames // 20, "hardly one frame was malformed"
    return {TAKEN: frames - thrown, REFUSED: thrown}


def main() -> None:
    """Report of each batch before and after it."""
    seed, first, step = map(int, sys.argv[1:])
    for number in itertools.count(first, step):
        report(begin=number)
        try:
            count = case(seed, number)
        except Exception:  # whatever it is, it is what is looked for
            report(outcome=FAILED, count=1, what=traceback.format_exc(limit=-4))
        else:
            for outcome, much in count.items():
                report(outcome=outcome, count=much)
            report(sent=FRAMES)


if __name__ == "__main__":
    main()
