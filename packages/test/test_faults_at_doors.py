"""Each fault gives the same at every door, in the same words; the page of doors has the table."""

import json
import os
import re
import subprocess
from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, ClassVar

import numpy as np
import pytest
from cia402 import CST, ERROR, enable, make, state
from documents import DOCUMENTS
from fmu_client import OK, Fmu, Instance
from modbus_line import Master, line_of
from own_firmware import builder, code
from test_driven_machine import compile_client
from test_udp import datagram, read

from arm_emulator import Breakpoint, OfflineRun, Plant, Session, load_gains
from arm_emulator.cli.commands.servo_header import make_servo_data_unit
from arm_emulator.doors.json_lines import JsonLinesServer, TcpServer, UnixSocketServer
from arm_emulator.doors.udp import GREETING, POWER, REFUSED, UdpServer
from arm_emulator.machine.plant.compiler import compile_ahead
from arm_emulator.machine.session.firmware import Firmware
from arm_emulator.motion.trajectory.joint_trajectory import TrajectoryPoint
from arm_emulator.runs.table_run import TableRun
from arm_emulator.runs.target_table import TargetTable
from arm_emulator.toolchain.compile_unit import compile_units
from arm_emulator_fieldbus.drives_unit import CANOPEN, ETHERCAT
from arm_emulator_fmu.export import export
from faults_at_doors import (
    ELBOW,
    FEW,
    JOINTS,
    NO_BREAKPOINTS,
    SCENE,
    STORED,
    VOLT,
    Door,
    Refused,
    check,
    measured_of,
)

GAINS = load_gains("three_axis")


class OfPlant(Door):
    """A door with its plant in this process."""

    plant: Plant

    @property
    def tick(self) -> int:
        return int(self.plant.ticks.tick)

    @property
    def applied(self) -> float:
        return float(self.plant.measured.applied[ELBOW])

    def measured(self) -> list[float]:
        return measured_of(self.plant)

    def _set_fault(self, name: str, size: float) -> None:
        self.plant.set_parameter(name, size)

    def _power(self, on: bool) -> None:
        self.plant.powered = on

    def break_at(self, condition: str) -> None:
        self.stop = Breakpoint(self.plant, condition)
        self.plant.ticks.stop = self.stop.stop


class ByPlant(OfPlant):
    title = "Python, `Plant`"
    lacks: ClassVar = {
        "stale": "commands answer what the caller states",
        "silence": "a command is an argument",
        "breakpoint": NO_BREAKPOINTS,
    }

    def _begin(self) -> None:
        self.plant = Plant(SCENE)

    def _give(self, volt: float, tick: int | None, name: str) -> None:
        self.plant.exchange(row(volt, name))


def row(volt: float, name: str) -> dict[str, float]:
    return dict.fromkeys(JOINTS[:ELBOW], 0.0) | {name: volt}


class BySession(OfPlant):
    title = "Python, `Session`"
    lacks: ClassVar = {"breakpoint": NO_BREAKPOINTS}

    def _begin(self) -> None:
        self.session = Session(SCENE, "lockstep", "first_answer")
        self.plant = self.session.plant

    def _give(self, volt: float, tick: int | None, name: str) -> None:
        values = row(volt, name)
        at = self.session.tick if tick is None else tick
        self.session.offer(at, list(values), list(values.values()))
        self.wait()

    def wait(self) -> None:
        if self.session.may_advance:
            self.session.advance()

    def _power(self, on: bool) -> None:
        self.session.powered = on


class ByTcp(BySession):
    title = "TCP"
    lacks: ClassVar = {"name": "no names in a command: base to tool", "breakpoint": NO_BREAKPOINTS}

    def _begin(self) -> None:
        super()._begin()
        self.server: JsonLinesServer = TcpServer(self.session, port=0)
        self.on = True

    def _power(self, on: bool) -> None:
        self.on = on  # with each command

    def _give(self, volt: float, tick: int | None, name: str) -> None:
        fields: dict[str, Any] = {"command": [*row(volt, name).values()], "power": self.on}
        self._send(fields if tick is None else fields | {"tick": tick})

    def wait(self) -> None:
        self._send({})

    def _send(self, fields: dict[str, Any]) -> None:
        reply = json.loads(self.server.answer_line(json.dumps(fields).encode()))
        if "refused" in reply:
            raise Refused(reply["refused"])


class ByUnixSocket(ByTcp):
    title = "Unix socket"

    def _begin(self) -> None:
        BySession._begin(self)
        with TemporaryDirectory() as folder:
            self.server = UnixSocketServer(self.session, Path(folder) / "s")
        self.on = True


class ByUdp(ByTcp):
    title = "UDP"

    def _begin(self) -> None:
        BySession._begin(self)
        self.udp, self.on = UdpServer(self.session, port=0), True

    def _give(self, volt: float, tick: int | None, name: str) -> None:
        at = self.session.tick if tick is None else tick
        self._answer(at, list(row(volt, name).values()))

    def wait(self) -> None:
        self._answer(GREETING, 0.0)

    def _answer(self, tick: int, command: object) -> None:
        kinds = self.udp.datagrams
        reply = self.udp.answer_datagram(datagram(kinds, tick, command, POWER * self.on))
        if reply.startswith(REFUSED):
            raise Refused(reply[len(REFUSED) :].decode())
        assert read(self.udp, reply)["tick"] == self.tick


class ByModbus(OfPlant):
    title = "Modbus"
    lacks: ClassVar = {
        "stale": "no ticks in a request",
        "name": "no names on this bus",
        "nan": "words of 16 bits are numbers",
        "breakpoint": NO_BREAKPOINTS,
    }

    def _begin(self) -> None:
        line, converter = line_of(SCENE)
        self.master, self.plant = Master(line), converter.session.plant

    def _give(self, volt: float, tick: int | None, name: str) -> None:
        self.master.write(2001, 0, 0, round(volt / SCENE.supply_voltage * 32768))

    def _power(self, on: bool) -> None:
        self.master.write(2000, int(on))


class ByDrives(OfPlant):
    """Drives in cyclic synchronous torque: a rated torque in the place of a voltage."""

    raw = False
    lacks: ClassVar = {
        "stale": "no ticks in a frame",
        "name": "no names on this bus",
        "nan": "targets are whole numbers",
    }

    def __init__(self, title: str, bus: int) -> None:
        self.title, self._bus = title, bus

    def _begin(self) -> None:
        self.drives = make(SCENE, self._bus)
        self.plant = self.drives.plant
        enable(self.drives, CST)

    def _give(self, volt: float, tick: int | None, name: str) -> None:
        self.drives.write(ELBOW, 0x6071, round(100.0 * volt))
        self.wait()

    def wait(self) -> None:
        self.drives.period()

    def run(self, periods: int) -> None:
        self.drives.period(periods)

    def cut(self) -> str:
        words = super().cut()
        assert state(self.drives, ELBOW) == "fault"
        return f"{words}; Fault 0x{self.drives.read(ELBOW, ERROR):04X}"


class OfRun(OfPlant):
    """A door with its run in this process."""

    loop: OfflineRun | TableRun

    def run(self, periods: int) -> None:
        self.loop.advance(periods)

    def _set_fault(self, name: str, size: float) -> None:
        self.loop.session.set_varied(name, size)

    def _power(self, on: bool) -> None:
        self.loop.session.powered = on


class ByLibrary(OfRun):
    title = "C library"
    lacks: ClassVar = {
        "stale": "time waits for the step",
        "name": "no names in a command: base to tool",
    }

    def __init__(self, library: Path) -> None:
        self._library = library

    def _begin(self) -> None:
        self.loop = TableRun(SCENE, self._table(0.0), Firmware(self._library))
        self.plant = self.loop.session.plant

    @staticmethod
    def _table(volt: float, silent: float = 0.0) -> TargetTable:
        return TargetTable(np.zeros(1), np.array([[silent, 0.0, volt]]))

    def _give(self, volt: float, tick: int | None, name: str) -> None:
        self.loop.set_table(self._table(volt))
        self.loop.advance(1)

    def wait(self) -> None:
        self.loop.set_table(self._table(0.0, silent=1.0))
        self.loop.advance(1)


class ByRun(OfRun):
    """The run in one process of `arm_emulator run`, which moves the elbow alone."""

    title = "`run` in one process"
    raw = False
    lacks: ClassVar = {
        "stale": "servo and machine have one tick",
        "silence": "servo and machine have one tick",
        "nan": "the servo's commands are finite",
    }

    def _begin(self) -> None:
        self.loop = OfflineRun(SCENE, GAINS.servo, GAINS.motion)
        self.plant = self.loop.session.plant
        self._aim("elbow")

    def _aim(self, name: str) -> None:
        points = [TrajectoryPoint(10**9, [SCENE.start[ELBOW] + 0.3])]
        self.loop.instructor.add_trajectory(self.loop.controller, [name], points)

    def _give(self, volt: float, tick: int | None, name: str) -> None:
        if name != "elbow":
            self._aim(name)
        self.run(1)


class ByFmu(Door):
    title = "FMU"
    lacks: ClassVar = {
        "stale": "values hold from when they are set",
        "name": "variables are numbers",
        "breakpoint": NO_BREAKPOINTS,
    }

    def __init__(self, unit: Fmu) -> None:
        self._unit = unit

    def _begin(self) -> None:
        self.one = Instance(self._unit)
        self.one.start()

    def _set(self, name: str, value: object) -> None:
        if self.one.set(name, value) != OK:
            raise Refused(self.one.printed[-1][2])

    def _give(self, volt: float, tick: int | None, name: str) -> None:
        self._set("command", list(row(volt, name).values()))
        self.wait()

    def wait(self) -> None:
        assert self.one.step(SCENE.servo_period) == OK, self.one.printed

    def _set_fault(self, name: str, size: float) -> None:
        self._set(name, size)

    def _power(self, on: bool) -> None:
        self._set("power", on)

    @property
    def tick(self) -> int:
        return round(self.one.time / SCENE.servo_period)

    @property
    def applied(self) -> float:
        return float(self.one.get("applied")[ELBOW])

    def measured(self) -> list[float]:
        return [float(x) for name in ("encoder_counts", "current") for x in self.one.get(name)]


class ByRos2Control(Door):
    """The machine of the hardware component; it reports currents, and not what it has applied."""

    title = "ros2_control"
    raw = False
    lacks: ClassVar = {
        "stale": "no ticks in a command",
        "nan": "NaN is no command, the newest one holds",
        "breakpoint": NO_BREAKPOINTS,
    }

    def __init__(self, folder: Path) -> None:
        words = [str(folder / "client"), str(folder / SCENE.name)]
        free = {name: value for name, value in os.environ.items() if name != "LD_PRELOAD"}
        pipe = subprocess.PIPE
        self.client = subprocess.Popen(words, stdin=pipe, stdout=pipe, text=True, env=free)

    def _ask(self, *words: object) -> None:
        assert self.client.stdin and self.client.stdout
        print(*words, file=self.client.stdin, flush=True)
        reply = self.client.stdout.readline()
        if reply.startswith("refused "):
            raise Refused(reply.removeprefix("refused ").strip())
        self._outcome, self._tick, self._current = (float(text) for text in reply.split())

    def _begin(self) -> None:
        self._ask("begin")

    def _give(self, volt: float, tick: int | None, name: str) -> None:
        self._ask("give", name, volt)

    def wait(self) -> None:
        self._ask("wait")

    def _set_fault(self, name: str, size: float) -> None:
        self._ask("set", name, size)

    def _power(self, on: bool) -> None:
        self._ask("power", int(on))

    @property
    def tick(self) -> int:
        return int(self._tick)

    @property
    def applied(self) -> float:
        return self._current

    def cut(self) -> str:
        self.power(False)  # at rest no current flows then
        for _ in range(FEW):
            self.give(VOLT)
            assert self.applied == 0.0 and self._outcome == 1.0
        return "every command is 0; the component is deactivated"


def test_each_door_is_in_the_table_and_refuses_in_the_same_words() -> None:
    """But for what the page of doors states."""
    stored = json.loads(STORED.read_text())
    pages = [page.read_text() for page in DOCUMENTS]
    doors = [title for page in pages for title in re.findall(r"^<!-- door: (.+?) \|", page, re.M)]
    assert doors and not [
        door for door in doors if not any(title.startswith(door) for title in stored)
    ]
    cells = {(fault, cell) for row in stored.values() for fault, cell in row.items()}
    refused = Counter(fault for fault, cell in cells if cell.startswith("refused"))
    assert refused == {"stale": 1, "name": 1, "nan": 1}


@pytest.mark.parametrize(
    "door",
    [
        ByPlant(), BySession(), ByTcp(), ByUnixSocket(), ByUdp(), ByModbus(), ByRun(),
        ByDrives("EtherCAT", ETHERCAT), ByDrives("CANopen", CANOPEN),
    ],
    ids=lambda door: door.title,
)  # fmt: skip
def test_doors_in_this_process(door: Door) -> None:
    check(door)


def test_a_library_in_c(tmp_path: Path) -> None:
    body = "for (int j = 0; j < 3 && !in->q_target[0]; ++j) out->joint[j].value = in->q_target[j];"
    check(ByLibrary(builder(tmp_path)(code(body))))


def test_a_unit(tmp_path: Path) -> None:
    export(SCENE, tmp_path / "arm.fmu", "native")
    check(ByFmu(Fmu(tmp_path / "arm.fmu", tmp_path / "unpacked")))


def test_the_machine_of_ros2_control(tmp_path: Path) -> None:
    compile_ahead(SCENE, "native", tmp_path)
    compile_units([make_servo_data_unit("three_axis")], "native", tmp_path)
    compile_client(tmp_path, Path(__file__).with_name("commanded_machine.cpp"), "-O0")
    door = ByRos2Control(tmp_path)
    with door.client:
        check(door)
        assert door.client.stdin
        door.client.stdin.close()
