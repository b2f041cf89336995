"""Serve a CANopen master with a CiA 402 drive per joint."""

import contextlib
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from arm_emulator.extension.base import (
    KEEP_NOTHING,
    Refusal,
    find_scene,
    parse_address,
    print_warnings,
)
from arm_emulator.extension.commands import (
    Clock,
    Keep,
    PageAt,
    SceneName,
    command,
    output,
    serve_controls,
)
from arm_emulator.extension.machine import Plant, describe_withheld_modes, load_scene
from arm_emulator.extension.runs import Recorder, load_gains
from arm_emulator_fieldbus.can_bus import Bus, BusService, open_bus
from arm_emulator_fieldbus.can_server import CanServer
from arm_emulator_fieldbus.canopen_segment import CanSegment
from arm_emulator_fieldbus.drives import Drives
from arm_emulator_fieldbus.drives_unit import CANOPEN
from arm_emulator_fieldbus.eds import make_eds as data_sheet


def load_segment(
    scene_name: str, first: int = 1, *, lockstep: bool = True, sync_period: float = 0.0
) -> CanSegment:
    """Return the nodes of a scene, its drives with the gains that belong to it.

    Raises:
        Refusal: a file is missing or refused, the gains do not fit, or node-IDs or the time
            between SYNCs [s] are out of range.
    """
    file = find_scene(scene_name)
    scene, servo = load_scene(file), load_gains(file).servo
    print_warnings(*scene.warnings)
    drives = Drives(Plant(scene), servo, CANOPEN)
    return CanSegment(drives, first, lockstep=lockstep, sync_period=sync_period)


@contextlib.contextmanager
def open_requested_bus(
    listen: str, bus: str | None, channel: str | None, bitrate: int | None
) -> Iterator[tuple[Bus, str]]:
    """Open the requested bus for a block; yield it with its description.

    Raises:
        Refusal: the bus is unknown, or does not open.
    """
    if bus is not None:
        with open_bus(bus, channel or "", bitrate) as can_bus:
            yield can_bus, f"{bus} {channel or ''}".rstrip()
        return
    for name, value in (("channel", channel), ("bitrate", bitrate)):
        if value is not None:
            raise Refusal("canopen", name, "come with --bus", value)
    server = CanServer(*parse_address("canopen", "--listen", listen))
    with contextlib.closing(server):
        yield server, "socketcand on {}:{}".format(*server.address)


@command(
    until_stopped=True,
    keys="`scene`, `bus`, `clock`, `nodes`, `ignored`; with the option eds `files`",
)
def serve_canopen(
    scene: SceneName = "three_axis",
    /,
    *,
    listen: Annotated[str, Parameter(metavar="[HOST:]PORT")] = "127.0.0.1:29536",
    bus: str | None = None,
    channel: str | None = None,
    bitrate: int | None = None,
    first_node: Annotated[int, Parameter(metavar="ID")] = 1,
    clock: Clock = "lockstep",
    sync_period: Annotated[float, Parameter(metavar="SECONDS")] = 0.0,
    eds: Annotated[Path | None, Parameter(metavar="FOLDER")] = None,
    page: PageAt = None,
    outputs: Keep = KEEP_NOTHING,
) -> int:
    """Serve CANopen masters until Ctrl-C.

    Args:
        listen: address of the bus, served as by socketcand.
        bus: instead, a bus of python-can: socketcan, udp_multicast, ...
        channel: of that bus, such as can0.
        bitrate: for buses that need it.
        first_node: node-ID of the first joint; the others follow.
        sync_period: time between SYNCs (0x1006) until a master writes it; 0: a servo period in
            lock-step.
        eds: folder for the drives' data sheets, which are written instead.
    """
    outputs.check_options("canopen")
    if eds is not None:
        return write_eds(scene, eds)
    lockstep = clock == "lockstep"
    with open_requested_bus(listen, bus, channel, bitrate) as (on, name):
        segment = load_segment(scene, first_node, lockstep=lockstep, sync_period=sync_period)
        machine, withheld = segment.scene, segment.drives.withheld
        nodes = {
            joint: node.number
            for node, joint in zip(segment.nodes, machine.joint_names, strict=True)
        }
        output.add_facts({"scene": machine.name, "bus": name, "clock": clock, "nodes": nodes})
        print(f"canopen: scene {machine.name}, {name}, clock {clock}")
        for joint, number in nodes.items():
            print(f"canopen: node {number}: {joint}")
        for line in describe_withheld_modes(machine, withheld):
            print(f"canopen: {line}")
        period = None if lockstep else round(machine.servo_period * 1e9)
        try:
            plant = segment.drives.plant
            with Recorder(plant, outputs, waits=lockstep), serve_controls(plant, page) as server:
                print("canopen: ready", flush=True)
                BusService(on, segment, period).serve_nodes(server.poll_requests)
        finally:
            output.add_facts({"ignored": on.ignored})
            if on.ignored:
                print(f"canopen: {on.ignored} times something came that was no frame of ours")
    return 0


def write_eds(scene_name: str, folder: Path) -> int:
    """Write the data sheet of each joint's drive, and report the files.

    Raises:
        Refusal: see `load_segment`, or the folder cannot be written to.
    """
    segment = load_segment(scene_name)
    scene, files = segment.scene, list[Path]()
    for node, joint in zip(segment.nodes, scene.joint_names, strict=True):
        file = folder / (re.sub(r"[^\w.-]", "_", f"{scene.name}_{joint}") + ".eds")
        try:
            folder.mkdir(parents=True, exist_ok=True)
            file.write_text(data_sheet(node, file.name, f"{scene.name} {joint}"), encoding="utf-8")
        except OSError as error:
            raise Refusal("canopen", f"file {file}", "be writable", error.strerror) from None
        output.print_line(str(file))
        files.append(file)
    output.add_facts({"files": files})
    return 0
