"""The package `canopen` as the master of our nodes, on the virtual bus of python-can."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from arm_emulator.canopen import load_segment, write_eds
from fieldbus.can_bus import BusService, can_bus
from fieldbus.canopen_segment import Segment
from fieldbus.drives import CANOPEN, dictionary

canopen: Any = pytest.importorskip("canopen")
pytest.importorskip("can")

ENTRIES = [one for one in dictionary() if one.buses & CANOPEN]


@contextmanager
def network_of(segment: Segment, channel: str) -> Iterator[Any]:
    """Our nodes in a thread, and a network of the master's on the same virtual bus."""
    with can_bus("virtual", channel, None) as bus:
        goes_on = threading.Event()
        goes_on.set()
        service = BusService(bus, segment, None)
        network = canopen.Network()
        network.NOTIFIER_SHUTDOWN_TIMEOUT = 5.0
        network.connect(interface="virtual", channel=channel)
        thread = threading.Thread(target=service.serve, args=(goes_on.is_set,))
        thread.start()
        try:
            yield network
        finally:
            goes_on.clear()
            thread.join()
            network.disconnect()


def wait_until(there: Any, what: str) -> None:
    until = time.monotonic() + 30.0
    while not there():
        assert time.monotonic() < until, what
        time.sleep(0.001)


def test_scan_and_upload_of_the_whole_dictionary(tmp_path: Path) -> None:
    """All nodes are found, and every entry is read by its data sheet as the drive has it."""
    segment = load_segment("three_axis", 10)
    write_eds("three_axis", tmp_path)
    with network_of(segment, "scan") as network:
        network.scanner.search()
        wait_until(lambda: len(network.scanner.nodes) == 3, "all nodes answer")
        assert sorted(network.scanner.nodes) == [10, 11, 12]
        for node, joint in zip(segment.nodes, segment.scene.joint_names, strict=True):
            sheet = tmp_path / f"three_axis_{joint}.eds"
            remote = network.add_node(node.number, str(sheet))
            assert len(remote.object_dictionary) >= len({one.index for one in ENTRIES})
            for one in ENTRIES:
                told = remote.sdo.upload(one.index, one.sub)
                assert told == node.upload(one.index, one.sub), one
                variable = remote.sdo[one.index]
                if one.code != 7:
                    variable = variable[one.sub]
                assert variable.od.name == one.name or one.sub == 0
                if one.access == "const":
                    assert variable.raw == variable.od.default, one
            remote.nmt.state = "OPERATIONAL"
            assert remote.sdo["Device type"].raw == 0x00020192
            with pytest.raises(canopen.SdoAbortedError) as no:
                remote.sdo.download(0x1000, 0, bytes(4))
            assert no.value.code == 0x06010002
            with pytest.raises(canopen.SdoAbortedError) as no:
                remote.sdo[0x1010][1].raw = int.from_bytes(b"save", "little")
            assert no.value.code == 0x08000020
        wait_until(lambda: all(int(node.state) == 5 for node in segment.nodes), "operational")


def test_heartbeat_and_emergency_reach_the_master(tmp_path: Path) -> None:
    segment = load_segment("three_axis")
    write_eds("three_axis", tmp_path)
    with network_of(segment, "beat") as network:
        remote = network.add_node(1, str(tmp_path / "three_axis_waist.eds"))
        remote.sdo["Producer heartbeat time"].raw = 20
        remote.nmt.wait_for_heartbeat(timeout=20)
        assert remote.nmt.state == "PRE-OPERATIONAL"
        remote.sdo[0x1016][1].raw = 0x7F << 16 | 5
        network.send_message(0x77F, [5])
        for _ in range(10):
            network.sync.transmit()
        told = remote.emcy.wait(timeout=20)
        assert told is not None and told.code == 0x8130
        beats: list[bytes] = []
        network.subscribe(0x701, lambda _id, data, _time: beats.append(bytes(data)))
        remote.nmt.state = "RESET"
        wait_until(lambda: b"\0" in beats, "the node boots")
