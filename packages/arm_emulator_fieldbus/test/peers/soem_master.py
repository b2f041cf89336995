"""A master by pysoem: python soem_master.py INTERFACE scan | move MOTION LOG | pull | leave.

Run in a network namespace of its own by test_ethercat_masters.py, which states what the files hold.
Prints one line of JSON.
"""

import json
import struct
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pysoem

OUT = INTO = 14  # bytes of process data of a drive
TIMEOUT = 2000  # us, of a frame
TRIES = 50
KP, KD = 0.3, 0.006  # 0.1 % of the rated torque per count, and per count/s: of the loop around CST
ENABLE = {0x40: 0x06, 0x21: 0x07, 0x23: 0x0F, 0x27: 0x0F, 0x08: 0x80}  # by the statusword


class Line:
    """The slaves of an interface, their process data, and a log of every exchange of these."""

    def __init__(self, interface: str) -> None:
        self.master = pysoem.Master()
        self.master.open(interface)
        for _ in range(TRIES):  # the segment may still be starting, or the host be busy
            if self.master.config_init() > 0:
                break
            time.sleep(0.1)
        self.slaves = self.master.slaves
        self.emergencies: list[tuple[int, int]] = []  # slave, error code
        for slave in self.slaves:
            slave.add_emergency_callback(
                lambda emergency: self.emergencies.append(
                    (emergency.slave_pos, emergency.error_code)
                )
            )
        self.log: list[bytes] = []
        self.bad = 0

    def exchange(self, outputs: list[bytes]) -> bool:
        """Whether the frame came back in time, with every slave's process data."""
        for slave, output in zip(self.slaves, outputs, strict=True):
            slave.output = output
        self.master.send_processdata()
        good = self.master.receive_processdata(TIMEOUT) == self.master.expected_wkc
        self.bad += not good
        inputs = b"".join(slave.input for slave in self.slaves)
        self.log.append(bytes([good]) + b"".join(outputs) + inputs)
        return bool(good)

    def to_op(self) -> None:
        self.master.config_dc()
        self.master.config_map()
        assert all(len(slave.output) == OUT and len(slave.input) == INTO for slave in self.slaves)
        self.state(pysoem.SAFEOP_STATE)
        nothing = [bytes(OUT)] * len(self.slaves)
        self.exchange(nothing)
        self.state(pysoem.OP_STATE, nothing)

    def state(self, target: int, outputs: list[bytes] | None = None) -> None:
        for _ in range(TRIES):
            self.master.state = target
            self.master.write_state()
            for _ in range(20):
                if outputs:
                    self.exchange(outputs)
                if self.master.state_check(target, 5000) == target:
                    return
        self.master.read_state()
        reported = [(slave.state, hex(slave.al_status)) for slave in self.slaves]
        raise SystemExit(f"slaves do not reach state {target}: {reported}")


def patiently(ask: Any) -> Any:
    """A busy host answers late: ask again."""
    for last in range(TRIES):
        try:
            return ask()
        except (pysoem.MailboxError, pysoem.PacketError, pysoem.WkcError):
            if last == TRIES - 1:
                raise
    return None


def scan(line: Line) -> dict[str, Any]:
    """All slaves, and all entries of the first one's dictionary, by SDO information and by SDO."""
    values, texts = {}, {}
    for sdo_object in patiently(lambda: line.slaves[0].od):
        entries = (
            patiently(lambda sdo_object=sdo_object: sdo_object.entries)
            if sdo_object.object_code != 7
            else [None]
        )
        texts[sdo_object.index] = sdo_object.name.decode()
        for sub in range(len(entries)):
            value = patiently(
                lambda sub=sub, sdo_object=sdo_object: line.slaves[0].sdo_read(
                    sdo_object.index, sub
                )
            )
            values[f"{sdo_object.index}:{sub}"] = value.hex()
    return {
        "slaves": [(slave.name, slave.man, slave.id, slave.rev) for slave in line.slaves],
        "objects": texts,
        "values": values,
    }


def move(line: Line, motion: bytes, log: Path) -> dict[str, Any]:
    """Enable all drives; follow the motion, a third each in CSP, CSV and CST; stop."""
    drives = len(line.slaves)
    rows = [
        [struct.unpack_from("<iih", motion, at + 10 * k) for k in range(drives)]
        for at in range(0, len(motion), 10 * drives)
    ]
    line.to_op()
    reported = [struct.unpack_from("<Hiihb", slave.input) for slave in line.slaves]
    outputs = [bytes(OUT)] * drives
    enabled = row = waited = 0
    started = 0.0
    while row < len(rows):
        mode = 8 + min(2, 3 * row // len(rows))
        enabled = all(report[0] & 0x6F == 0x27 for report in reported)
        if enabled and not started:
            started = time.perf_counter()
        waited += not enabled
        if waited > 5000:
            raise SystemExit(f"drives are not enabled: {[hex(report[0]) for report in reported]}")
        for k, (status, q, v, _, _) in enumerate(reported):
            word = ENABLE.get(status & 0x6F, ENABLE.get(status & 0x4F, 0x06))
            position, speed, torque = rows[row][k] if enabled else (q, 0, 0)
            torque += round(KP * (position - q) + KD * (speed - v))
            if mode == 9:
                speed += 10 * (position - q)
            torque = max(-1000, min(1000, torque if enabled else 0))
            outputs[k] = struct.pack("<HiihbB", word, position, speed, torque, mode, 0)
        line.exchange(outputs)
        reported = [struct.unpack_from("<Hiihb", slave.input) for slave in line.slaves]
        row += enabled
    took = time.perf_counter() - started
    moved = len(line.log)
    bad = line.bad
    # Throughput of the line: the same outputs, as fast as possible.
    hold = list(outputs)
    for k, (_, q, _, _, _) in enumerate(reported):
        hold[k] = struct.pack("<HiihbB", 0x0F, q, 0, 0, 8, 0)
    count = 20_000
    for slave, output in zip(line.slaves, hold, strict=True):
        slave.output = output
    started = time.perf_counter()
    for _ in range(count):
        line.master.send_processdata()
        line.bad += line.master.receive_processdata(TIMEOUT) != line.master.expected_wkc
    rate = count / (time.perf_counter() - started)
    log.write_bytes(b"".join(line.log))
    line.state(pysoem.INIT_STATE)
    return {
        "exchanges": moved,
        "before_motion": moved - len(rows),
        "bad": bad,
        "moved_per_s": len(rows) / took,
        "exchanges_per_s": rate,
        "bad_of_20000": line.bad - bad,
    }


def enable(line: Line, cycles: int) -> list[int]:
    """Exchange until all drives are in Operation enabled; return their statuswords."""
    words = [0] * len(line.slaves)
    for _ in range(cycles):
        reported = [struct.unpack_from("<Hi", slave.input) for slave in line.slaves]
        words = [status for status, _ in reported]
        if all(status & 0x6F == 0x27 for status in words):
            break
        line.exchange(
            [
                struct.pack("<HiihbB", ENABLE.get(s & 0x6F, ENABLE.get(s & 0x4F, 6)), q, 0, 0, 8, 0)
                for s, q in reported
            ]
        )
        time.sleep(0.0005)
    return words


def pull(line: Line, interface: str) -> dict[str, Any]:
    """Enable all drives, take the link down, put it up again, acknowledge, enable anew."""
    line.to_op()
    enabled = enable(line, 5000)
    subprocess.run(["ip", "link", "set", interface, "down"], check=True)
    time.sleep(1.0)  # the watchdog needs 0.1 s; a busy host some more
    subprocess.run(["ip", "link", "set", interface, "up"], check=True)
    for _ in range(TRIES):
        line.master.read_state()
        if all(slave.state & 0xF == pysoem.SAFEOP_STATE for slave in line.slaves):
            break
        time.sleep(0.02)
    states = [(slave.state, slave.al_status) for slave in line.slaves]
    errors = [
        patiently(lambda slave=slave: slave.sdo_read(0x603F, 0)).hex() for slave in line.slaves
    ]
    status = [
        patiently(lambda slave=slave: slave.sdo_read(0x6041, 0)).hex() for slave in line.slaves
    ]
    for slave in line.slaves:
        slave.state = pysoem.SAFEOP_STATE | pysoem.STATE_ACK
        slave.write_state()
    line.state(pysoem.OP_STATE, [bytes(OUT)] * len(line.slaves))
    again = enable(line, 5000)
    return {
        "enabled": enabled,
        "states": states,
        "errors": errors,
        "status": status,
        "again": again,
        "emergencies": sorted(line.emergencies),
    }


def leave(line: Line) -> dict[str, Any]:
    """Take the second slave from OP to each state; return the working counter there."""
    counters = {}
    for state in (pysoem.OP_STATE, pysoem.SAFEOP_STATE, pysoem.PREOP_STATE, pysoem.INIT_STATE):
        line.to_op()
        line.slaves[1].state = state
        line.slaves[1].write_state()
        reached = line.slaves[1].state_check(state, 500_000)
        assert reached == state, f"the slave stays in state {reached}"
        for _ in range(TRIES):  # a busy host answers late: -1, no frame
            line.master.send_processdata()
            counters[state] = line.master.receive_processdata(TIMEOUT)
            if counters[state] >= 0:
                break
        line.state(pysoem.INIT_STATE)
        line.master.config_init()
        line.slaves = line.master.slaves
    return {"counters": counters, "expected": line.master.expected_wkc}


def main() -> None:
    """Do what the command line states."""
    line = Line(sys.argv[1])
    if sys.argv[2] == "scan":
        result = scan(line)
    elif sys.argv[2] == "pull":
        result = pull(line, sys.argv[1])
    elif sys.argv[2] == "leave":
        result = leave(line)
    else:
        result = move(line, Path(sys.argv[3]).read_bytes(), Path(sys.argv[4]))
    line.master.close()
    print(json.dumps(result))


if __name__ == "__main__":
    main()
