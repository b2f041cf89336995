"""Shared memory of processes that were killed goes, that of others stays."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Int64

import arm_emulator.workarounds.fastdds_shared_memory
from arm_emulator.ros.process.ros_domain import own_domain
from arm_emulator.workarounds.fastdds_shared_memory import PORT_MAGIC, SHARED, clear_left_over

PATIENCE = 120.0  # s, wall: for what takes some seconds on an idle machine
READER = 20_612  # bytes from a port's number to its first reader's state, in Fast DDS 2.14
IN_USE, WAITS, READS = 1, 2, 4  # its bits

NODE = """
import os, rclpy, sys
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Int64
rclpy.init()
node = rclpy.create_node("x")
late = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
node.create_publisher(Int64, "process", late).publish(Int64(data=os.getpid()))
for one in os.listdir("/proc/self/fd"):
    try:
        name = os.readlink(f"/proc/self/fd/{one}")
    except OSError:
        continue
    if "/fastrtps_" in name and name.endswith("_el") and "port" not in name:
        print(name.removesuffix("_el"), end=" ")
print(flush=True)
rclpy.spin(node)
"""


def segments(process: subprocess.Popen[str]) -> set[Path]:
    """Return what a node that has just started owns."""
    assert process.stdout is not None
    return {Path(name) for name in process.stdout.readline().split()}


@pytest.mark.slow
@pytest.mark.skipif(not SHARED.is_dir(), reason="no shared memory here")
def test_shared_memory_of_killed_nodes_is_removed_and_of_running_nodes_remains() -> None:
    with own_domain():
        nodes = [
            subprocess.Popen([sys.executable, "-c", NODE], stdout=subprocess.PIPE, text=True)
            for _ in range(2)
        ]
        try:
            left, owned = (segments(node) for node in nodes)
            if not left:
                pytest.skip("this middleware keeps no segments")
            time.sleep(arm_emulator.workarounds.fastdds_shared_memory.YOUNG)
            clear_left_over()
            assert all(file.exists() for file in left), "it lives"
            nodes[0].kill()
            nodes[0].wait()
            deadline = time.monotonic() + PATIENCE
            while any(file.exists() for file in left):  # another process may be at it, too
                assert time.monotonic() < deadline, "what the killed one left"
                clear_left_over()
            assert owned and all(file.exists() for file in owned), "what the living one has"
        finally:
            for node in nodes:
                node.send_signal(signal.SIGKILL)
                node.wait()
                assert node.stdout is not None
                node.stdout.close()


@pytest.mark.skipif(not SHARED.is_dir(), reason="no shared memory here")
def test_a_port_whose_maker_was_killed_while_it_created_it_hangs_no_process() -> None:
    """A node that opens it waits indefinitely: so it goes before a node is made."""
    with own_domain() as domain:
        ports = [SHARED / f"fastrtps_port{7400 + 250 * domain + 11 + 2 * k}" for k in range(2)]
        try:
            for port in ports:
                port.write_bytes(bytes(52400))
                os.utime(port, (1.0, 1.0))
            assert clear_left_over() >= len(ports)
            assert not any(port.exists() for port in ports)
            node = subprocess.Popen([sys.executable, "-c", NODE], stdout=subprocess.PIPE, text=True)
            owned = segments(node)
            node.send_signal(signal.SIGKILL)
            node.wait()
            assert node.stdout is not None
            node.stdout.close()
            if owned:  # else this middleware has no ports there
                assert ports[0].read_bytes()[: len(PORT_MAGIC)] == PORT_MAGIC, (
                    "a whole port begins so"
                )
        finally:
            for port in ports:
                port.unlink(missing_ok=True)


def stopped_with(node: subprocess.Popen[str]) -> list[str]:
    """Stop a process; return the files that it has open."""
    node.send_signal(signal.SIGSTOP)
    while psutil.Process(node.pid).status() != psutil.STATUS_STOPPED:
        time.sleep(0.001)
    return [
        os.readlink(file) for file in Path(f"/proc/{node.pid}/fd").iterdir() if file.is_symlink()
    ]


def kill_between_two_messages(node: subprocess.Popen[str]) -> bool:
    """Kill a node as if in the microseconds between; False: the middleware's state is another."""
    while "_mutex" in " ".join(locks := stopped_with(node)):  # it opens a port
        node.send_signal(signal.SIGCONT)
        time.sleep(0.01)
    ports = [lock.removesuffix("_el") for lock in locks if "_port" in lock and lock.endswith("_el")]
    node.kill()
    node.wait()
    for port in ports:
        number = int(port.rpartition("port")[2])
        with open(port, "r+b") as file:
            at = file.read().index(number.to_bytes(4, "little")) + READER
            file.seek(at)
            if file.read(1)[0] not in (IN_USE, IN_USE | WAITS, IN_USE | READS):
                return False
            file.seek(at)
            file.write(bytes([IN_USE]))
        os.utime(f"{port}_el", (1.0, 1.0))  # as if it had been made long ago
    return bool(ports)


@pytest.mark.skipif(not SHARED.is_dir(), reason="no shared memory here")
def test_partners_of_a_killed_node_hear_its_successor() -> None:
    """The next one takes the dead one's ports, which the partner has open."""
    heard: list[int] = []
    nodes: list[subprocess.Popen[str]] = []
    with own_domain() as domain:
        context = rclpy.Context()
        context.init(domain_id=domain)
        partner = rclpy.create_node("partner", context=context)
        late = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)

        def keep(message: Int64) -> None:
            heard.append(message.data)

        partner.create_subscription(Int64, "process", keep, late)
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(partner)

        def hear_next() -> subprocess.Popen[str]:
            node = subprocess.Popen([sys.executable, "-c", NODE], stdout=subprocess.PIPE, text=True)
            nodes.append(node)
            deadline = time.monotonic() + PATIENCE
            while node.pid not in heard:
                assert time.monotonic() < deadline, f"{node.pid} is not among {heard}"
                executor.spin_once(timeout_sec=0.1)
            return node

        try:
            if not kill_between_two_messages(hear_next()):
                pytest.skip("this middleware's ports are of another form")
            clear_left_over()
            hear_next()
        finally:
            executor.shutdown()
            partner.destroy_node()
            context.shutdown()
            for node in nodes:
                node.kill()
                node.wait()
                assert node.stdout is not None
                node.stdout.close()


def test_ports_that_are_intact_young_or_foreign_remain(tmp_path: Path) -> None:
    port = tmp_path / "fastrtps_port64419"
    port.write_bytes(bytes(52400))
    assert clear_left_over(tmp_path) == 0, "its maker may be at it"
    os.utime(port, (1.0, 1.0))
    if os.geteuid() == 0:
        os.chown(port, 65534, 65534)
        assert clear_left_over(tmp_path) == 0, "it is somebody else's"
        os.chown(port, 0, 0)
    assert clear_left_over(tmp_path) == 1 and not port.exists()
    port.write_bytes(PORT_MAGIC + bytes(52396))
    os.utime(port, (1.0, 1.0))
    assert clear_left_over(tmp_path) == 0, "it is whole"


def test_young_files_of_foreign_users_or_foreign_names_remain(tmp_path: Path) -> None:
    name = "fastrtps_0123456789abcdef"
    for foreign_name in ("fastrtps_port7000_el", "fastrtps_xyz_el", f"{name}_el_", "mine_el"):
        (tmp_path / foreign_name).touch()
    (tmp_path / "fastrtps_00000000000000aa_el").symlink_to(tmp_path / "mine_el")
    before = sorted(tmp_path.iterdir())
    for file in (tmp_path / name, tmp_path / f"{name}_el"):
        file.touch()
    assert clear_left_over(tmp_path) == 0, "it is young"
    for file in tmp_path.iterdir():
        os.utime(file, (0.0, 0.0))
    if os.geteuid() == 0:
        os.chown(tmp_path / f"{name}_el", 65534, 65534)
        assert clear_left_over(tmp_path) == 0, "it is somebody else's"
        os.chown(tmp_path / f"{name}_el", 0, 0)
    assert clear_left_over(tmp_path) == 1, "its owner is gone"
    assert sorted(tmp_path.iterdir()) == before, "what else is there"
    assert clear_left_over(tmp_path / "nothing") == 0, "no such folder"
