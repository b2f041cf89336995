"""The machine behind a UDP socket: a datagram of commands in, one of measurements out.

For control software in any language that is neither ROS nor a field bus. All numbers are
little-endian and 8 bytes long, in an order that a scene determines (`Datagrams`). `write_header`
returns them as structs of C.
"""

import select
import socket
import threading
import zlib

import numpy as np

from arm_emulator.base.escape import escape_c_comment, escape_c_string
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.validation.address import refuse_taken_address
from arm_emulator.machine.parts.output import AXES
from arm_emulator.machine.plant.inputs import list_further_inputs, list_input_units
from arm_emulator.machine.plant.measured import Measured
from arm_emulator.machine.plant.outputs import list_outputs, list_units
from arm_emulator.machine.scene.scene import Scene
from arm_emulator.machine.session.command_buffer import DuplicateCommand
from arm_emulator.machine.session.session import Session
from arm_emulator.machine.session.submit_command import submit_command

PORT = 50770
LARGEST = 65507  # bytes of a datagram
LOOK = 0.05  # s, between two looks whether to end
GREETING = -1  # a tick that asks for the measurement and commands nothing
POWER, RESET = 1, 2  # bits of `control`
POWERED, STOPPED = 1, 2  # bits of `status`
REFUSED = b"\0" * 8  # in the place of `layout`, before the text of a refusal


class Datagrams:
    """Layout of the datagrams of a scene.

    Attributes:
        command: tick answered, `control`, command of each joint, further inputs.
        measurement: tick, `status`, the scene's outputs by their names.
        layout: first number of both; other scenes have another one.

    Args:
        scene: of the machine.
    """

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self.outputs = list_outputs(scene)
        self.inputs = list_further_inputs(scene)
        N, M = len(scene.joints), len(scene.imus)
        rows = [
            (
                output.name,
                "<f8" if output.kind == "number" else "<i8",
                (M, AXES) if output.per_unit else N,
            )
            for output in self.outputs
        ]
        head = [("layout", "<u8"), ("tick", "<i8")]
        self.command = np.dtype(
            [*head, ("control", "<i8"), *((name, "<f8", N) for name in ("command", *self.inputs))]
        )
        self.measurement = np.dtype([*head, ("status", "<i8"), *rows])
        words = repr(
            (scene.joint_names, self.command.descr, self.measurement.descr, self._list_units())
        )
        self.layout = zlib.crc32(words.encode()) + 1  # 0 is that of refusals

    def _list_units(self) -> dict[str, tuple[str, ...]]:
        """Return the units of each joint by the names of numbers, none of those without."""
        scene = self._scene
        command = tuple(joint.unit for joint in scene.joints)
        inputs = {name: list_input_units(scene, name) for name in self.inputs}
        return {"command": command} | inputs | {o.name: list_units(scene, o) for o in self.outputs}

    def write_header(self) -> str:
        """Return the layout as a header in C."""
        units = self._list_units()

        def write_struct(name: str, kind: np.dtype[np.void]) -> str:
            lines = []
            for field in kind.names or ():
                base, shape = kind[field].base, kind[field].shape
                size = "".join(f"[{n}]" for n in shape)
                unit = " or ".join(dict.fromkeys(units.get(field, ())))
                c_type = {"u": "uint64_t", "i": "int64_t", "f": "double"}[base.kind]
                lines.append(f"  {c_type} {field}{size};" + (f"  /* {unit} */" if unit else ""))
            return "typedef struct {\n" + "\n".join(lines) + f"\n}} {name};\n"

        names = ", ".join(map(escape_c_string, self._scene.joint_names))
        scene = escape_c_comment(self._scene.name)
        return f"""\
/* Datagrams of `arm_emulator udp {scene}`, numbers little-endian. --header writes it. */
#ifndef ARM_UDP_H
#define ARM_UDP_H

#include <stdint.h>

#define ARM_UDP_PORT {PORT}
#define ARM_UDP_LAYOUT UINT64_C({self.layout})
#define ARM_UDP_JOINTS {len(self._scene.joints)}
enum {{ ARM_UDP_GREETING = {GREETING} }};                /* tick of a command */
enum {{ ARM_UDP_POWER = {POWER}, ARM_UDP_RESET = {RESET} }};     /* bits of control */
enum {{ ARM_UDP_POWERED = {POWERED}, ARM_UDP_STOPPED = {STOPPED} }}; /* bits of status */

static const char* const arm_udp_joint_names[ARM_UDP_JOINTS] = {{{names}}};

{write_struct("arm_udp_command", self.command)}
{write_struct("arm_udp_measurement", self.measurement)}
#endif
"""


class UdpServer:
    """Answers datagrams with the measurement of a session.

    In lock-step each command that answers the tick lets a servo period pass, and the reply has the
    next tick. A command that comes again is answered again and changes nothing, so a client
    repeats what it has had no reply to. In real time the measurement of each tick also goes to the
    client that sent last.

    Attributes:
        address: host and port where it listens.
        refused: datagrams that changed nothing; each is answered with the reason.

    Args:
        session: the machine.
        host: of the interface that it listens on.
        port: 0: any that is free.

    Raises:
        Refusal: it cannot listen there.
    """

    def __init__(self, session: Session, host: str = "127.0.0.1", port: int = PORT) -> None:
        self.datagrams = Datagrams(session.scene)
        self._session = session
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((host, port))
        except (OSError, OverflowError) as error:
            self._socket.close()
            raise refuse_taken_address("udp", host, port, error) from None
        self.address: tuple[str, int] = self._socket.getsockname()
        self.refused = 0
        self._peer: tuple[str, int] | None = None  # the client that sent last
        self._closing = threading.Event()
        self._record = np.zeros((), self.datagrams.measurement)
        self._record["layout"] = self.datagrams.layout

    def serve(self) -> None:
        """Serve until `close`."""
        ticks = None
        if self._session.is_self_clocked:
            ticks = threading.Thread(target=self._report_ticks, daemon=True)
            ticks.start()
        try:
            while not self._closing.is_set():
                if select.select([self._socket], [], [], LOOK)[0]:
                    data, self._peer = self._socket.recvfrom(LARGEST)
                    self._send_reply(self.answer_datagram(data), self._peer)
        finally:
            self.close()
            if ticks is not None:
                ticks.join()
            self._socket.close()

    def close(self) -> None:
        """Let `serve` end."""
        self._closing.set()

    def answer_datagram(self, data: bytes) -> bytes:
        """Take a datagram, and return the reply."""
        session, kind = self._session, self.datagrams.command
        try:
            if len(data) != kind.itemsize:
                raise Refusal("udp", "datagram", f"have {kind.itemsize} bytes", len(data))
            datagram = np.frombuffer(data, kind)[0]
            if datagram["layout"] != self.datagrams.layout:
                rule = f"be {self.datagrams.layout}, that of {session.scene.name}"
                raise Refusal("udp", "layout", rule, int(datagram["layout"]))
            self._take_command(datagram)
        except DuplicateCommand:
            pass
        except Refusal as reason:
            self.refused += 1
            return REFUSED + str(reason).encode()
        return self._write_measurement()

    def _take_command(self, datagram: np.void) -> None:
        session, control = self._session, int(datagram["control"])
        if not 0 <= control <= POWER + RESET:
            raise Refusal("udp", "control", "have no bits but power 1, reset 2", control)
        tick, further = int(datagram["tick"]), self.datagrams.inputs
        with session.turn:
            if control & RESET:
                session.reset()
            if control & RESET or tick == GREETING:
                return
            rows = {name: datagram[name] for name in further}
            names, on = session.scene.joint_names, bool(control & POWER)
            submit_command(session, tick, names, datagram["command"], rows, powered=on)

    def _write_measurement(self) -> bytes:
        session, record = self._session, self._record
        with session.turn:
            record["tick"] = session.tick
            record["status"] = POWERED * session.powered | STOPPED * (session.fault is not None)
            measured: Measured = session.measured
            for output in self.datagrams.outputs:
                record[output.name] = measured.place(output)
            return record.tobytes()

    def _report_ticks(self) -> None:
        """Send the measurement of each tick of a loop to the client that sent last."""
        session = self._session
        while not self._closing.is_set():
            if session.wait(LOOK):
                while session.take():
                    if self._peer is not None:
                        self._send_reply(self._write_measurement(), self._peer)

    def _send_reply(self, data: bytes, peer: tuple[str, int]) -> None:
        try:
            self._socket.sendto(data, peer)
        except OSError:  # it has gone, or its buffer is full: a datagram may be lost
            return
