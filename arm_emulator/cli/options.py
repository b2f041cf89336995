"""Arguments shared by several commands."""

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from arm_emulator.base.run_outputs import RunOutputs

SceneName = Annotated[str, Parameter(metavar="SCENE", help="scene file or name")]
Clock = Annotated[
    Literal["lockstep", "realtime"],
    Parameter(help="logical time, the same bits every time, or the wall clock"),
]
RunNumber = Annotated[int, Parameter(metavar="NUMBER")]
When = Annotated[
    str | None,
    Parameter(metavar="CONDITION", help="such as 'current.elbow > 20 and abs(v.elbow) < 0.01'"),
]
Topics = Annotated[list[str] | None, Parameter(metavar="TOPIC ...", help="these only")]
Json = Annotated[bool, Parameter(help="print one JSON object, for programs")]
Seconds = Annotated[
    float | None,
    Parameter(metavar="S", help="logical time (default: 10, or as long as the table lasts)"),
]
PageAt = Annotated[
    str | None,
    Parameter(
        metavar="[HOST:]PORT",
        help="page in the browser, for this machine alone unless HOST is another address of it "
        "(port 0: any that is free)",
    ),
]
Keep = Annotated[RunOutputs, Parameter(name="*")]
TargetFile = Annotated[
    Path | None,
    Parameter(metavar="TABLE", help="joint targets: CSV with t and the joints' names"),
]
