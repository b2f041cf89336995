"""`arm_emulator canopen`: the drives of a scene as CANopen nodes, one per joint."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator
from pathlib import Path

from arm_emulator.analysis.mode_loops import withheld_words
from arm_emulator.analysis.scene_warnings import warn_of_scene
from arm_emulator.base.config_files import find_scene
from arm_emulator.base.kept import NOTHING, Kept
from arm_emulator.base.refusal import Refusal
from arm_emulator.doors.fieldbus.can_bus import Bus, BusService, can_bus
from arm_emulator.doors.fieldbus.can_server import CanServer
from arm_emulator.doors.fieldbus.canopen_segment import Segment
from arm_emulator.doors.fieldbus.drives import CANOPEN, Drives
from arm_emulator.doors.fieldbus.eds import eds
from arm_emulator.machine.plant import Plant
from arm_emulator.machine.scene import load_scene
from arm_emulator.runs.gains import check_servo, load_gains
from arm_emulator.runs.recorder import Recorder


def load_segment(scene_name: str, first: int = 1, *, lockstep: bool = True) -> Segment:
    """Return the nodes of a scene, its drives with the gains that belong to it.

    Raises:
        Refusal: a file is missing or refused, the gains do not fit, or node-IDs are out of
            range.
    """
    file = find_scene(scene_name)
    scene, servo = load_scene(file), load_gains(file).servo
    warn_of_scene(scene)
    check_servo(scene, servo)
    return Segment(Drives(Plant(scene), servo, CANOPEN), first, lockstep=lockstep)


@contextlib.contextmanager
def opened(
    listen: str, bus: str | None, channel: str | None, bitrate: int | None
) -> Iterator[tuple[Bus, str]]:
    """Open the requested bus for a block; yield it with its description.

    Raises:
        Refusal: the bus is unknown, or does not open.
    """
    if bus is not None:
        with can_bus(bus, channel or "", bitrate) as one:
            yield one, f"{bus} {channel or ''}".rstrip()
        return
    for name, value in (("channel", channel), ("bitrate", bitrate)):
        if value is not None:
            raise Refusal("canopen", name, "come with --bus", value)
    host, _, port = listen.rpartition(":")
    if not re.fullmatch(r"[0-9]{1,5}", port):
        raise Refusal("canopen", "--listen", "be PORT or HOST:PORT", listen)
    server = CanServer(host or "127.0.0.1", int(port))
    with contextlib.closing(server):
        yield server, "socketcand on {}:{}".format(*server.address)


def canopen(
    scene_name: str,
    *,
    listen: str,
    bus: str | None,
    channel: str | None,
    bitrate: int | None,
    first: int,
    clock: str,
    kept: Kept = NOTHING,
) -> int:
    """Serve a bus until Ctrl-C.

    Raises:
        Refusal: see `load_segment`, or the bus does not open.
    """
    lockstep = clock == "lockstep"
    with opened(listen, bus, channel, bitrate) as (on, name):
        segment = load_segment(scene_name, first, lockstep=lockstep)
        scene = segment.scene
        print(f"canopen: scene {scene.name}, {name}, clock {clock}")
        for node, joint in zip(segment.nodes, scene.joint_names, strict=True):
            print(f"canopen: node {node.number}: {joint}")
        for line in withheld_words(scene, segment.drives.withheld):
            print(f"canopen: {line}")
        period = None if lockstep else round(scene.servo_period * 1e9)
        try:
            with Recorder(segment.drives.plant, kept, waits=lockstep):
                print("canopen: ready", flush=True)
                BusService(on, segment, period).serve()
        finally:
            if on.ignored:
                print(f"canopen: {on.ignored} times something came that was no frame of ours")
    return 0


def write_eds(scene_name: str, folder: Path) -> int:
    """Write the data sheet of each joint's drive, and report the files.

    Raises:
        Refusal: see `load_segment`, or the folder cannot be written to.
    """
    segment = load_segment(scene_name)
    scene = segment.scene
    for node, joint in zip(segment.nodes, scene.joint_names, strict=True):
        file = folder / (re.sub(r"[^\w.-]", "_", f"{scene.name}_{joint}") + ".eds")
        try:
            folder.mkdir(parents=True, exist_ok=True)
            file.write_text(eds(node, file.name, f"{scene.name} {joint}"), encoding="utf-8")
        except OSError as error:
            raise Refusal("canopen", f"file {file}", "be writable", error.strerror) from None
        print(file)
    return 0
