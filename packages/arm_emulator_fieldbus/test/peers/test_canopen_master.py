"""The package `canopen` as the master of our nodes, on the virtual bus of python-can."""

import re
import signal
import subprocess
import sys
import textwrap
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from documents import page_of
from draws import FULL

from arm_emulator import Plant, load_gains
from arm_emulator.base.io.config_files import find_scene
from arm_emulator_fieldbus.can_bus import BusService, open_bus
from arm_emulator_fieldbus.canopen_segment import CanSegment
from arm_emulator_fieldbus.commands.canopen import load_segment, write_eds
from arm_emulator_fieldbus.drives import Drives
from arm_emulator_fieldbus.drives_unit import CANOPEN
from arm_emulator_fieldbus.object_dictionary import list_entries

canopen: Any = pytest.importorskip("canopen")
pytest.importorskip("can")

ROOT = Path(__file__).resolve().parents[4]
ENTRIES = [entry for entry in list_entries() if entry.buses & CANOPEN]


@contextmanager
def network_of(segment: CanSegment, channel: str, period: int | None = None) -> Iterator[Any]:
    """Our nodes in a thread, and a network of the master's on the same virtual bus."""
    with open_bus("virtual", channel, None) as bus:
        goes_on = threading.Event()
        goes_on.set()
        service = BusService(bus, segment, period)
        network = canopen.Network()
        network.NOTIFIER_SHUTDOWN_TIMEOUT = 5.0
        network.connect(interface="virtual", channel=channel)
        thread = threading.Thread(target=service.serve_nodes, args=(goes_on.is_set,))
        thread.start()
        try:
            yield network
        finally:
            goes_on.clear()
            thread.join()
            network.disconnect()


def wait_until(there: Any, condition: str) -> None:
    until = time.monotonic() + 30.0
    while not there():
        assert time.monotonic() < until, condition
        time.sleep(0.001)


def test_scan_and_upload_of_the_full_dictionary(tmp_path: Path) -> None:
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
            assert len(remote.object_dictionary) >= len({entry.index for entry in ENTRIES})
            for entry in ENTRIES:
                reported = remote.sdo.upload(entry.index, entry.sub)
                assert reported == node.upload_entry(entry.index, entry.sub), entry
                variable = remote.sdo[entry.index]
                if entry.code != 7:
                    variable = variable[entry.sub]
                assert variable.od.name == entry.name or entry.sub == 0
                if entry.access == "const":
                    assert variable.raw == variable.od.default, entry
            with remote.sdo[0x1008].open("rb", block_transfer=True) as blocks:
                assert blocks.read() == b"three_axis"
            with remote.sdo[0x607A].open("wb", size=4, block_transfer=True) as blocks:
                blocks.write(b"\1\2\3\4")
            assert remote.sdo.upload(0x607A, 0) == b"\1\2\3\4"
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
        reported = remote.emcy.wait(timeout=20)
        assert reported is not None and reported.code == 0x8130
        beats: list[bytes] = []
        network.subscribe(0x701, lambda _id, data, _time: beats.append(bytes(data)))
        remote.nmt.state = "RESET"
        wait_until(lambda: b"\0" in beats, "the node boots")


def test_profile_position_in_real_time_by_sdo_alone(tmp_path: Path) -> None:
    """Without SYNC, servo periods pass by the wall clock, never faster."""
    segment = load_segment("three_axis", lockstep=False)
    period = round(segment.scene.servo_period * 1e9)
    write_eds("three_axis", tmp_path)
    started = time.monotonic()
    with network_of(segment, "clock", period) as network:
        node = network.add_node(3, str(tmp_path / "three_axis_elbow.eds"))
        status, control = node.sdo["Statusword"], node.sdo["Controlword"]
        node.sdo["Modes of operation"].raw = 1
        for word, reached in ((6, 0x21), (7, 0x23), (15, 0x27)):
            control.raw = word
            wait_until(lambda reached=reached: status.raw & 0x6F == reached, f"state {reached:x}")
        target = node.sdo["Position actual value"].raw + 1500
        node.sdo["Target position"].raw = target
        control.raw = 0x3F
        wait_until(lambda: status.raw & 0x1000, "the set-point is acknowledged")
        control.raw = 0x2F
        wait_until(lambda: status.raw & 0x400, "the target is reached")
        assert abs(node.sdo["Position actual value"].raw - target) <= 10, "within its window"
        passed = time.monotonic() - started
        assert 0.1 < segment.now / 1e9 <= passed
    assert segment.fault is None


def test_page_shows_the_real_output(tmp_path: Path) -> None:
    """The master of docs/how_to/canopen.md, in another process than the nodes."""
    page = page_of("canopen").read_text()
    blocks = re.findall(r"(?:^    .*\n|^\n)+", page, re.M)
    (place,) = [k for k, block in enumerate(blocks) if "import canopen" in block]
    example = textwrap.dedent(blocks[place]).strip()
    script, _, printed = example.rpartition("\n\n")
    assert "port=29536" in script
    write_eds("three_axis", tmp_path / "eds")
    command = [sys.executable, "-m", "arm_emulator", "canopen", "three_axis", "--listen", "0"]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as nodes:
        try:
            assert nodes.stdout is not None and nodes.stderr is not None
            lines = [nodes.stdout.readline()]
            while lines[-1] and "ready" not in lines[-1]:
                lines.append(nodes.stdout.readline())
            match = re.search(r"socketcand on 127\.0\.0\.1:(\d+)", "".join(lines))
            assert match, lines
            master = subprocess.run(
                [sys.executable, "-c", script.replace("29536", match[1])],
                cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False,
            )  # fmt: skip
            assert master.returncode == 0, master.stderr
            assert master.stdout.strip() == printed
            nodes.send_signal(signal.SIGINT)
            assert nodes.wait(timeout=30) == 0
            assert "Traceback" not in nodes.stderr.read()
        finally:
            nodes.kill()


SECONDS = 60.0 if FULL else 6.0  # of the motion of ur5
CYCLE = 4  # servo periods between targets, as a line of 1 Mbit/s allows for six drives
CSP = 8


def test_ur5_moves_as_its_drives_do_in_process(tmp_path: Path) -> None:
    """Cyclic positions of six drives by the master's PDOs and SYNC, as drives and plant predict.

    Drives in this process get the same targets. Every statusword and position that the master gets
    is compared with theirs, and in the end every bit of the machine.
    """
    segment = load_segment("ur5")
    scene = segment.scene
    write_eds("ur5", tmp_path)
    drives = Drives(Plant(scene), load_gains(find_scene("ur5")).servo, CANOPEN)
    with network_of(segment, "ur5") as network:
        nodes = []
        for number, joint in enumerate(scene.joint_names, 1):
            node = canopen.BaseNode402(number, str(tmp_path / f"ur5_{joint}.eds"))
            network.add_node(node)
            node.sdo[0x1006].raw = 1000 * CYCLE
            node.rpdo.read()
            node.tpdo.read()
            for k in (1, 3, 4):
                node.tpdo[k].enabled = False
            node.tpdo.save()
            nodes.append(node)
        network.nmt.state = "OPERATIONAL"
        wait_until(lambda: all(int(node.state) == 5 for node in segment.nodes), "operational")
        reported: list[tuple[int, ...]] = []
        received: list[tuple[int, ...]] = []
        for k, node in enumerate(nodes):
            node.tpdo[2].add_callback(
                lambda pdo, k=k: received.append((k, pdo[0].raw, pdo[1].raw))  # type: ignore[misc]
            )

        def exchange() -> list[tuple[int, ...]]:
            """Send SYNC, and wait for what six drives report."""
            received.clear()
            network.sync.transmit()
            wait_until(lambda: len(received) == 6, "six drives answer SYNC")
            return sorted(received)

        for word in (6, 7, 15):
            for k, node in enumerate(nodes):
                node.rpdo[1]["Controlword"].raw = word
                node.rpdo[1]["Modes of operation"].raw = CSP
                node.rpdo[1].transmit()
                drives.write(k, 0x60C2, CYCLE, 1)
                drives.write(k, 0x6060, CSP)
                drives.write(k, 0x6040, word)
            exchange()
            drives.period(CYCLE)
        start = [position for _, _, position in exchange()]
        assert start == [drives.read(k, 0x6064) for k in range(6)]
        drives.period(CYCLE)
        counts = np.array([joint.counts_per_turn for joint in scene.joints])
        counts = 0.4 * counts / (2 * np.pi) / scene.gear_ratios  # 0.4 rad
        hertz = np.random.default_rng(1).uniform(0.2, 0.5, 6)
        worst = 0.0
        for cycle in range(round(SECONDS / (CYCLE * scene.servo_period))):
            t = cycle * CYCLE * scene.servo_period
            travel = counts * (1 - np.cos(2 * np.pi * hertz * t)) / 2
            targets = [at + round(step) for at, step in zip(start, travel.tolist(), strict=True)]
            for node, target in zip(nodes, targets, strict=True):
                node.rpdo[2]["Controlword"].raw = 15
                node.rpdo[2]["Target position"].raw = target
                node.rpdo[2].transmit()
            reported = exchange()
            predicted = [(k, drives.read(k, 0x6041), drives.read(k, 0x6064)) for k in range(6)]
            assert reported == predicted, f"at {t:g} s"
            assert all(status & 0x6F == 0x27 for _, status, _ in reported), "Operation enabled"
            for k, target in enumerate(targets):
                drives.write(k, 0x6040, 15)
                drives.write(k, 0x607A, target)
            drives.period(CYCLE)
            off = np.array(targets) - [position for *_, position in reported]
            worst = max(worst, float(np.abs(off / counts * 0.4).max()))
        exchange()
        drives.period(CYCLE)
        assert worst < 0.02, "rad at the links, behind the targets"
        print(f"worst distance to the targets {worst:.4f} rad")
    assert segment.drives.plant.save() == drives.plant.save()
