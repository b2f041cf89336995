"""Mastering of KUKA arms, from their machine data `$machine.dat`.

At its mark the controller takes an axis to stand at `$MAMES[axis]` [deg, mm of a slide]. The mark
is where the machine data of the type have it; what those of a machine state otherwise is by
how much its encoders report another position. Files of Absolute Accuracy (`.pid`) have a form
that KUKA does not publish.
"""

import math
import re
from collections.abc import Mapping
from pathlib import Path

from arm_emulator.base.calibration.deviation import Deviation
from arm_emulator.base.calibration.joint_path import JointPath
from arm_emulator.base.io.text_file import read_text
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.validation.number import Number

MAX_BYTES = 1 << 20
_MARK = re.compile(r"^\s*(?:DECL\s+)?(?:REAL\s+)?\$MAMES\[(\d+)\]\s*=\s*([^\s;]+)", re.I | re.M)
_POSITION = Number.bound_size("$MAMES", "deg or mm", 1e5)


def read_kuka_zeros(file: Path, nominal: Path, path: JointPath) -> Mapping[str, Deviation]:
    """Return what the encoders of a machine report at 0, by joint; axes go from base to flange.

    Args:
        file: machine data of the machine.
        nominal: those of its type.
        path: of its description.

    Raises:
        Refusal: a file without mastering positions, or without one of an axis.
    """
    of_machine, of_type = _read_marks(file), _read_marks(nominal)
    deviations = {}
    for place, joint in enumerate(path.moving, start=1):
        for marks, where in ((of_machine, file.name), (of_type, nominal.name)):
            if place not in marks:
                rule = f"be given, as of joint {joint.name}"
                raise Refusal(where, f"$MAMES[{place}]", rule, "nothing")
        unit = 1e-3 if joint.kind == "prismatic" else math.pi / 180.0
        zero = (of_machine[place] - of_type[place]) * unit
        deviations[joint.name] = Deviation(encoder_zero=zero)
    return deviations


def _read_marks(file: Path) -> Mapping[int, float]:
    """Return the positions at which axes are mastered, by number."""
    text = read_text(file, MAX_BYTES)
    marks = {}
    for number, word in _MARK.findall(text):
        try:
            value = float(word)
        except ValueError:
            raise Refusal(file.name, f"$MAMES[{number}]", "be a number", repr(word)) from None
        marks[int(number)] = _POSITION.check_value(file.name, value, f"$MAMES[{number}]")
    if not marks:
        raise Refusal(file.name, "file", "have lines $MAMES[1]=... of axes", "none")
    return marks
