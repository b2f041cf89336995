"""`arm_emulator ethercat`: the joints of a scene as drives on EtherCAT."""

from __future__ import annotations

import contextlib
import os
import sys
from pathlib import Path

from arm_emulator.analysis.mode_loops import withheld_words
from arm_emulator.analysis.scene_warnings import warn_of_scene
from arm_emulator.base.config_files import find_scene
from arm_emulator.base.kept import NOTHING, Kept
from arm_emulator.base.refusal import Refusal
from arm_emulator.build.c_header import CData
from arm_emulator.doors.fieldbus.esi import esi
from arm_emulator.doors.fieldbus.ethercat import Segment
from arm_emulator.machine.scene import Scene, load_scene
from arm_emulator.runs.gains import check_servo, load_gains
from arm_emulator.runs.recorder import Recorder

_TURN = 0.1  # s after which Ctrl-C is looked for


def serve(scene_name: str, interface: str, lockstep: bool, kept: Kept = NOTHING) -> int:
    """Serve a master until Ctrl-C.

    Args:
        scene_name: scene file or name.
        interface: network interface.
        lockstep: a servo period per frame of process data; else by the clock.
        kept: record and viewer.

    Raises:
        Refusal: the scene, its gains or the interface are not taken.
    """
    scene, segment = _segment(scene_name, lockstep)
    descriptor = segment.open(interface)
    # Masters wait some milliseconds for a frame, which a busy host may exceed before it wakes us.
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(50))
    clock = "lockstep" if lockstep else "realtime"
    print(f"ethercat: scene {scene.name}, clock {clock}")
    print(f"ethercat: slaves: {', '.join(scene.joint_names)}")
    for line in withheld_words(scene, segment.drives.withheld):
        print(f"ethercat: {line}")
    with contextlib.suppress(OSError, ValueError):
        flags = int(Path(f"/sys/class/net/{interface}/flags").read_text(), 16)
        if not flags & 1:
            print(f"ethercat: {interface} is down: ip link set {interface} up", file=sys.stderr)
    try:
        with Recorder(segment.drives.plant, kept, waits=lockstep):
            print(f"ethercat: on {interface}, until Ctrl-C", flush=True)
            while not segment.figures.diverged:
                segment.serve(descriptor, _TURN)
        print(f"scene {scene.name}: the machine has diverged", file=sys.stderr)
        return 1
    finally:
        os.close(descriptor)
        _report(segment.figures, lockstep)


def write_esi(scene_name: str, file: Path) -> int:
    """Write the description of a scene's slaves that engineering tools read.

    Raises:
        Refusal: the scene or its gains are not taken, or the file cannot be written.
    """
    _, segment = _segment(scene_name, True)
    try:
        file.write_text(esi(segment.drives), encoding="utf-8")
    except OSError as error:
        raise Refusal("ethercat", f"the file {file}", "be writable", error.strerror) from None
    return 0


def _segment(scene_name: str, lockstep: bool) -> tuple[Scene, Segment]:
    path = find_scene(scene_name)
    scene = load_scene(path)
    warn_of_scene(scene)
    servo = load_gains(path).servo
    check_servo(scene, servo)
    return scene, Segment(scene, servo, lockstep)


def _report(figures: CData, lockstep: bool) -> None:
    print(f"frames            {figures.frames}, of which with all process data {figures.exchanges}")
    print(f"servo periods     {figures.periods}")
    if not lockstep:
        print(f"cycles lost       {figures.lost_cycles} without process data of all drives in OP")
        print(f"periods lost      {figures.late_periods}, for which the host was too late")
    print(
        f"thrown away       {figures.malformed} malformed frames, {figures.foreign} foreign, "
        f"{figures.circulating} circulating"
    )
    print(f"unknown commands  {figures.unknown}")
    print(f"watchdogs         {figures.watchdogs} that ran out", flush=True)
