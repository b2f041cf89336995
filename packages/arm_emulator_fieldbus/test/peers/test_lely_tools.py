"""Lely's tools, which prepare masters such as ros2_canopen, read the data sheets of our nodes."""

import shutil
import struct
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from canopen_master import put
from draws import some

from arm_emulator.design.new_scene import write_new
from arm_emulator.machine.scene.urdf_file import find_example_robot_data
from arm_emulator_fieldbus.commands.canopen import load_segment, write_eds
from oracles.own_robots import OWN

pytestmark = pytest.mark.skipif(
    shutil.which("dcfchk") is None, reason="dcfchk and dcfgen (package dcf-tools) are missing"
)

needs_robots = pytest.mark.skipif(
    find_example_robot_data() is None, reason="needs the package example-robot-data (make robots)"
)
# All scenes with gains.
SCENES = ["three_axis", *(pytest.param(name, marks=needs_robots) for name in ("ur5", "panda"))]
NEW = ("planar", "scara", "gantry", "telescopic", "five_joints")
NEW += ("spherical_wrist", "tilted", "seven_joints", "on_a_rail", "nine_joints")
# The drive of a joint as a configuration of ros2_canopen has it: interpolation over 50 ms at a
# SYNC of 10 ms, statusword and mode, position and speed out, controlword and mode, targets in.
# Beside it the period of SYNC, which our nodes need in lock-step, and guarding.
NODE: dict[str, Any] = {
    "revision_number": 0x10000,
    "guard_time": 100,
    "life_time_factor": 3,
    "sdo": [
        {"index": 0x1006, "sub_index": 0, "value": 10000},
        {"index": 0x60C2, "sub_index": 1, "value": 50},
        {"index": 0x60C2, "sub_index": 2, "value": -3},
        {"index": 0x6081, "sub_index": 0, "value": 1000},
        {"index": 0x6083, "sub_index": 0, "value": 2000},
    ],
    "tpdo": {
        1: {"enabled": True, "cob_id": "auto", "transmission": 1, "mapping": [0x6041, 0x6061]},
        2: {"enabled": True, "cob_id": "auto", "transmission": 1, "mapping": [0x6064, 0x606C]},
        3: {"enabled": False},
        4: {"enabled": False},
    },
    "rpdo": {
        1: {"enabled": True, "cob_id": "auto", "mapping": [0x6040, 0x6060]},
        2: {"enabled": True, "cob_id": "auto", "mapping": [0x607A, 0x60FF]},
    },
}


def run(*words: str | Path) -> None:
    """Run a tool, which must neither fail nor warn."""
    done = subprocess.run(list(map(str, words)), capture_output=True, text=True, check=False)
    # setuptools warns that the tool imports pkg_resources.
    reported = [line for line in done.stderr.splitlines() if "pkg_resources" not in line]
    assert done.returncode == 0 and not reported, done.stderr


def bus(sheets: list[Path], folder: Path) -> Path:
    """Write the configuration of a bus with the drives as nodes 2, 3, ...; return its file."""
    nodes = {}
    for number, sheet in enumerate(sheets, 2):
        node = dict(NODE, node_id=number, dcf=str(sheet))
        for direction in ("tpdo", "rpdo"):
            node[direction] = {
                k: dict(pdo, mapping=[{"index": index} for index in pdo.get("mapping", ())])
                for k, pdo in NODE[direction].items()
            }
        nodes[f"joint_{number}"] = node
    master = {"node_id": 1, "sync_period": 10000}
    file = folder / "bus.yml"
    file.write_text(
        yaml.safe_dump({"options": {"dcf_path": str(folder)}, "master": master, **nodes})
    )
    return file


def downloads(concise: bytes) -> Iterator[tuple[int, int, bytes]]:
    """Yield index, sub-index and value from a configuration as CiA 302 stores it (0x1F22)."""
    (count,), at = struct.unpack_from("<I", concise), 4
    for _ in range(count):
        index, sub, size = struct.unpack_from("<HBI", concise, at)
        yield index, sub, concise[at + 7 : at + 7 + size]
        at += 7 + size
    assert at == len(concise)


@pytest.mark.parametrize("name", [*some(SCENES, 2), *some(NEW, 1)])
def test_dcfchk_and_dcfgen_accept_every_data_sheet(name: str, tmp_path: Path) -> None:
    """Sheets of all joints; the nodes then accept the configuration that dcfgen has made."""
    scene = name
    if name in NEW:
        (tmp_path / f"{name}.urdf").write_text(OWN[name]())
        scene = str(write_new(tmp_path / f"{name}.urdf", tmp_path / "new").file)
    write_eds(scene, tmp_path / "eds")
    segment = load_segment(scene, 2)
    segment.boot_nodes()
    sheets = sorted((tmp_path / "eds").iterdir())
    assert len(sheets) == len(segment.nodes)
    for sheet in sheets:
        run("dcfchk", "--print", "--node_id", "5", sheet)
    run("dcfgen", "--remote-pdo", "--directory", tmp_path, bus(sheets, tmp_path))
    for node in segment.nodes:
        expected = list(downloads((tmp_path / f"joint_{node.number}.bin").read_bytes()))
        indices = {index for index, *_ in expected}
        assert indices >= {0x100C, 0x100D, 0x1006, 0x60C2, 0x6081, 0x6083, 0x1401, 0x1801, 0x1A01}
        for index, sub, value in expected:
            put(segment, node.number, index, sub, int.from_bytes(value, "little"), len(value))
    assert segment.periods_per_sync == round(0.01 / segment.scene.servo_period)
