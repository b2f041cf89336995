"""Serve an EtherCAT master with a CiA 402 drive per joint."""

import contextlib
import os
import sys
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from arm_emulator.extension.base import KEEP_NOTHING, Refusal, find_scene, print_warnings
from arm_emulator.extension.commands import Keep, PageAt, SceneName, command, output, serve_controls
from arm_emulator.extension.compiler import CData
from arm_emulator.extension.machine import Scene, describe_withheld_modes, load_scene
from arm_emulator.extension.runs import Recorder, load_gains
from arm_emulator_fieldbus.esi import make_esi as description_of
from arm_emulator_fieldbus.ethercat import Segment

FIGURES = ("frames", "exchanges", "periods", "lost_cycles", "late_periods", "malformed", "foreign",
           "circulating", "unknown", "watchdogs", "diverged")  # fmt: skip
_TURN = 0.1  # s after which Ctrl-C is looked for


@command(
    until_stopped=True,
    keys="`scene`, `clock`, `slaves`, `figures`; with the option esi `file`",
)
def serve_ethercat(
    scene: SceneName = "three_axis",
    /,
    *,
    interface: Annotated[str | None, Parameter(metavar="IF")] = None,
    esi: Annotated[Path | None, Parameter(metavar="FILE")] = None,
    lockstep: bool = False,
    realtime: bool = False,
    page: PageAt = None,
    outputs: Keep = KEEP_NOTHING,
) -> int:
    """Serve an EtherCAT master until Ctrl-C.

    Args:
        interface: network interface that the master is connected to.
        esi: file for the description of the slaves (ESI), which is written instead.
        lockstep: a servo period per frame of process data (default).
        realtime: servo periods by the clock.
    """
    outputs.check_options("ethercat")
    if lockstep and realtime:
        raise Refusal("ethercat", "--realtime", "stand without --lockstep", "both")
    if esi is not None:
        return write_esi(scene, esi)
    if interface is None:
        raise Refusal("ethercat", "--interface", "name a network interface", "none")
    machine, segment = _load_segment(scene, not realtime)
    joints, withheld = machine.joint_names, segment.drives.withheld
    descriptor = segment.open_interface(interface)
    # Masters wait some milliseconds for a frame, which a busy host may exceed before it wakes us.
    with contextlib.suppress(PermissionError):
        policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK  # not for recorder and page
        os.sched_setscheduler(0, policy, os.sched_param(50))
    clock = "realtime" if realtime else "lockstep"
    output.add_facts({"scene": machine.name, "clock": clock, "slaves": joints})
    print(f"ethercat: scene {machine.name}, clock {clock}")
    print(f"ethercat: slaves: {', '.join(joints)}")
    for line in describe_withheld_modes(machine, withheld):
        print(f"ethercat: {line}")
    with contextlib.suppress(OSError, ValueError):
        flags = int(Path(f"/sys/class/net/{interface}/flags").read_text(), 16)
        if not flags & 1:
            print(f"ethercat: {interface} is down: ip link set {interface} up", file=sys.stderr)
    try:
        plant = segment.drives.plant
        with Recorder(plant, outputs, waits=not realtime), serve_controls(plant, page) as server:
            print(f"ethercat: on {interface}, until Ctrl-C", flush=True)
            while not segment.figures.diverged and server.poll_requests():
                segment.serve_frames(descriptor, _TURN)
        print(f"scene {machine.name}: the machine has diverged", file=sys.stderr)
        return 1
    finally:
        os.close(descriptor)
        _report_figures(segment.figures, not realtime)


def write_esi(scene_name: str, file: Path) -> int:
    """Write the description of a scene's slaves that engineering tools read.

    Raises:
        Refusal: the scene or its gains are not taken, or the file cannot be written.
    """
    _, segment = _load_segment(scene_name, True)
    try:
        file.write_text(description_of(segment.drives), encoding="utf-8")
    except OSError as error:
        raise Refusal("ethercat", f"the file {file}", "be writable", error.strerror) from None
    output.add_facts({"file": file})
    return 0


def _load_segment(scene_name: str, lockstep: bool) -> tuple[Scene, Segment]:
    path = find_scene(scene_name)
    scene = load_scene(path)
    print_warnings(*scene.warnings)
    servo = load_gains(path).servo
    return scene, Segment(scene, servo, lockstep)


def _report_figures(figures: CData, lockstep: bool) -> None:
    output.add_facts({"figures": {name: getattr(figures, name) for name in FIGURES}})
    print(f"frames            {figures.frames}, of which with all process data {figures.exchanges}")
    print(f"servo periods     {figures.periods}")
    if not lockstep:
        print(f"cycles lost       {figures.lost_cycles} without process data of all drives in OP")
        print(f"periods lost      {figures.late_periods}, for which the host was too late")
    print(
        f"discarded         {figures.malformed} malformed frames, {figures.foreign} foreign, "
        f"{figures.circulating} circulating"
    )
    print(f"unknown commands  {figures.unknown}")
    print(f"watchdogs         {figures.watchdogs} expired", flush=True)
