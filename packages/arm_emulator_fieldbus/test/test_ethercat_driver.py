"""Configurations of masters for ROS 2, as they configure a drive: keys and values of their files.

A file of ethercat_driver_ros2 lists vendor and product, service data for the start, and the time of
SYNC0. It also lists process data with the interfaces of ros2_control. The one below is of the same
form.
"""

import math
import struct

import yaml
from cia402 import CSP, ENABLE, SHUTDOWN, SWITCH_ON
from ethercat_master import OP, PERIOD, SAFEOP, Master, master

__all__ = ["master"]  # a fixture

CONFIG = yaml.safe_load("""
vendor_id: 0x41524D45
product_id: 0x00000402
assign_activate: 0x0300
auto_fault_reset: true
sdo:
  - {index: 0x60C2, sub_index: 1, type: int8, value: 10}
  - {index: 0x60C2, sub_index: 2, type: int8, value: -3}
  - {index: 0x6098, sub_index: 0, type: int8, value: 0}
  - {index: 0x6091, sub_index: 1, type: uint32, value: 1}
  - {index: 0x6091, sub_index: 2, type: uint32, value: 1}
rpdo:
  - index: 0x1603
    channels:
      - {index: 0x6040, sub_index: 0, type: uint16, command_interface: control_word, default: 0}
      - {index: 0x607A, sub_index: 0, type: int32, command_interface: position, default: .nan}
      - {index: 0x60FF, sub_index: 0, type: int32, command_interface: velocity, default: 0}
      - {index: 0x6071, sub_index: 0, type: int16, command_interface: effort, default: 0}
      - {index: 0x60B0, sub_index: 0, type: int32, default: 0}
      - {index: 0x60B1, sub_index: 0, type: int32, default: 0}
      - {index: 0x60B2, sub_index: 0, type: int16, default: 0}
      - {index: 0x6060, sub_index: 0, type: int8, command_interface: mode_of_operation, default: 8}
tpdo:
  - index: 0x1A03
    channels:
      - {index: 0x6041, sub_index: 0, type: uint16, state_interface: status_word}
      - {index: 0x6064, sub_index: 0, type: int32, state_interface: position}
      - {index: 0x606C, sub_index: 0, type: int32, state_interface: velocity}
      - {index: 0x6077, sub_index: 0, type: int16, state_interface: effort}
      - {index: 0x6061, sub_index: 0, type: int8, state_interface: mode_of_operation}
      - {index: 0x60B9, sub_index: 0, type: int16}
      - {index: 0x60BA, sub_index: 0, type: int32}
      - {index: 0x60BB, sub_index: 0, type: int32}
""")
LAYOUT = {"int8": "b", "int16": "h", "int32": "i", "uint16": "H", "uint32": "I"}
CYCLE = 10  # servo periods; the control frequency is 100 Hz


def layout(direction: str) -> str:
    return "<" + "".join(LAYOUT[channel["type"]] for channel in CONFIG[direction][0]["channels"])


def configure(master: Master, k: int) -> None:
    """Bring a slave to PREOP with the file's mapping and service data."""
    master.preop(k)
    assert master.number(k, 0x1018, 1) == CONFIG["vendor_id"]
    assert master.number(k, 0x1018, 2) == CONFIG["product_id"]
    for parameter in CONFIG["sdo"]:
        value = struct.pack("<" + LAYOUT[parameter["type"]], parameter["value"])
        master.download(k, parameter["index"], parameter["sub_index"], value)
    for direction, assignment in (("rpdo", 0x1C12), ("tpdo", 0x1C13)):
        pdo = CONFIG[direction][0]
        master.download(k, assignment, 0, b"\0")
        master.download(k, pdo["index"], 0, b"\0")
        for place, parameter in enumerate(pdo["channels"], 1):
            bits = 8 * struct.calcsize(LAYOUT[parameter["type"]])
            word = parameter["index"] << 16 | parameter["sub_index"] << 8 | bits
            master.download(k, pdo["index"], place, struct.pack("<I", word))
        master.download(k, pdo["index"], 0, bytes([len(pdo["channels"])]))
        master.download(k, assignment, 1, struct.pack("<H", pdo["index"]))
        master.download(k, assignment, 0, b"\1")
    master.write(k, 0x09A0, struct.pack("<I", CYCLE * PERIOD))
    master.write(k, 0x0980, struct.pack("<H", CONFIG["assign_activate"]))


def test_a_configuration_of_ethercat_driver_ros2_moves_the_arm(master: Master) -> None:
    """Cyclic positions at 100 Hz: the drives follow a cosine within one cycle of its speed."""
    for k in range(master.slaves):
        configure(master, k)
    master.out, master.into = master.sizes(0)
    assert master.out == struct.calcsize(layout("rpdo"))
    assert master.into == struct.calcsize(layout("tpdo"))
    for k in range(master.slaves):
        assert master.safeop(k, 0x10000 + k * (master.out + master.into)) == (SAFEOP, 0)
    for k in range(master.slaves):
        assert master.ask(k, OP) == (OP, 0)

    def exchange(word: int, targets: list[int]) -> list[tuple[int, ...]]:
        """Process data of all drives: controlword, targets, offsets, mode."""
        data = [struct.pack(layout("rpdo"), word, target, 0, 0, 0, 0, 0, CSP) for target in targets]
        return [struct.unpack(layout("tpdo"), image) for image in master.exchange(data)]

    start = [report[1] for report in exchange(0, [0] * master.slaves)]
    for word in (SHUTDOWN, SWITCH_ON, ENABLE, ENABLE):
        exchange(word, start)
    before, swing, pulse = master.segment.drives.tick, 4000, 2.0 * math.pi * 0.5  # counts, 1/s
    cycles, worst = 300, 0.0
    targets = start
    for n in range(cycles):
        reported = exchange(ENABLE, targets)
        assert all(report[0] & 0x6F == 0x27 and report[4] == CSP for report in reported), "enabled"
        if n > 20:
            worst = max(
                worst, *(abs(report[1] - at) for report, at in zip(reported, targets, strict=True))
            )
        t = 1e-9 * CYCLE * PERIOD * (n + 1)
        targets = [at + round(0.5 * swing * (1.0 - math.cos(pulse * t))) for at in start]
    assert master.segment.drives.tick - before == cycles * CYCLE, "10 ms in each cycle"
    # A reply has the positions at the end of the cycle before, at the target before: one cycle of
    # the largest speed away from the new one. A tenth of it is for the servo.
    assert worst < 1.1 * 0.5 * swing * pulse * 1e-9 * CYCLE * PERIOD
    assert max(report[1] - at for report, at in zip(reported, start, strict=True)) > 0.9 * swing
