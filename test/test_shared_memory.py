"""Shared memory of processes that were killed goes, that of others stays."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import arm_emulator.ros.shared_memory
from arm_emulator.ros.ros_domain import own_domain
from arm_emulator.ros.shared_memory import SHARED, clear_left_over

NODE = """
import os, rclpy, sys
rclpy.init()
node = rclpy.create_node("x")
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


@pytest.mark.skipif(not SHARED.is_dir(), reason="no shared memory here")
def test_shared_memory_of_killed_nodes_is_removed_and_of_running_ones_kept(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with own_domain():
        nodes = [
            subprocess.Popen([sys.executable, "-c", NODE], stdout=subprocess.PIPE, text=True)
            for _ in range(2)
        ]
        try:
            left, kept = (segments(node) for node in nodes)
            if not left:
                pytest.skip("this middleware keeps no segments")
            time.sleep(arm_emulator.ros.shared_memory.YOUNG)
            clear_left_over()
            assert all(file.exists() for file in left), "it lives"
            nodes[0].kill()
            nodes[0].wait()
            clear_left_over()
            assert not any(file.exists() for file in left), "what the killed one left"
            assert kept and all(file.exists() for file in kept), "what the living one has"
        finally:
            for node in nodes:
                node.send_signal(signal.SIGKILL)
                node.wait()
                assert node.stdout is not None
                node.stdout.close()


def test_young_files_of_other_users_or_other_names_are_kept(tmp_path: Path) -> None:
    name = "fastrtps_0123456789abcdef"
    for other in ("fastrtps_port7000_el", "fastrtps_xyz_el", f"{name}_el_", "mine_el"):
        (tmp_path / other).touch()
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
