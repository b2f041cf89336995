"""Faults of the line between controller and drives, and of the controller at its end."""

from __future__ import annotations

from arm_emulator.base.number import Number
from arm_emulator.machine.faults.fault import HOLDS, RISES, Fault, share
from arm_emulator.machine.parts.line import LATEST

LATE = Number("magnitude", "servo periods", at_least=0.0, at_most=LATEST, default=3.0)


def _kind(name: str, text: str, key: str, magnitude: Number, expression: str = HOLDS) -> Fault:
    sets = {f"line.{key}": expression}
    return Fault(name=name, text=text, sets=sets, magnitude=magnitude, absent=0.0)


FAULTS = (
    *(
        one
        for way, receiver in (("command", "the drive"), ("measurement", "the controller"))
        for one in (
            _kind(f"{way}_late", f"{receiver} receives each {way} whole periods late",
                  f"{way}_late", LATE, RISES),
            _kind(f"{way}_lost", f"{way}s are lost with a probability, and the one before stands",
                  f"{way}_lost", share(0.3)),
            _kind(f"{way}_repeated", f"the {way} before comes once more, behind the newest",
                  f"{way}_repeated", share(0.3)),
            _kind(f"{way}_overtaken", f"{way}s come a period later, behind the one that follows",
                  f"{way}_overtaken", share(0.3)),
            _kind(f"{way}_corrupted", f"a bit of a {way} is received wrong",
                  f"{way}_corrupted", share(0.1)),
        )
    ),
    _kind("controller_frozen", "the controller stops, and its last command stands",
          "command_lost", share()),
    _kind("controller_restarts", "no command comes, and the drive is disabled", "silent", share()),
    _kind("encoders_swapped", "the plugs of its encoders and the next joint's are swapped",
          "swapped", share()),
)  # fmt: skip
