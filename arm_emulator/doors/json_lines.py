"""The machine behind TCP or a Unix socket: lines of JSON, a command in, a measurement out.

For control software in languages and tools that have sockets and JSON, and no structs of bytes.
"""

import contextlib
import json
import math
import select
import socket
import stat
import threading
from pathlib import Path
from typing import Any

from arm_emulator.base.refusal import Refusal
from arm_emulator.base.validation.address import refuse_taken_address
from arm_emulator.machine.plant.inputs import list_further_inputs
from arm_emulator.machine.plant.outputs import list_outputs, list_units
from arm_emulator.machine.session.command_buffer import DuplicateCommand
from arm_emulator.machine.session.session import Session
from arm_emulator.machine.session.submit_command import submit_command

PORT = 50780
LONGEST = 2**16  # bytes of a line
LOOK = 0.05  # s, between two looks whether to end
PATIENCE = 5.0  # s, with a client that does not read


class JsonLinesServer:
    """Answers each line of a client with the measurement of a session.

    In lock-step a line with a command lets a servo period pass. Clients come one after the other;
    the machine stays as it is between them.

    Attributes:
        refused: lines that changed nothing; each is answered with the reason.

    Args:
        where: name of the door in refusals.
        session: the machine.
        listening: the socket.
    """

    def __init__(self, where: str, session: Session, listening: socket.socket) -> None:
        self._where, self._session, self._socket = where, session, listening
        self._outputs = list_outputs(session.scene)
        self._inputs = list_further_inputs(session.scene)
        self._keys = {"tick", "power", "reset", "command", *self._inputs}
        self.refused = 0
        self._closing = threading.Event()

    def serve(self) -> None:
        """Serve until `close`."""
        with self._socket:
            while not self._closing.is_set():
                if select.select([self._socket], [], [], LOOK)[0]:
                    with self.accept_client() as client:
                        client.settimeout(PATIENCE)
                        self._serve_client(client)

    def accept_client(self) -> socket.socket:
        """Return the next client."""
        return self._socket.accept()[0]

    def close(self) -> None:
        """Let `serve` end."""
        self._closing.set()

    def _serve_client(self, client: socket.socket) -> None:
        """Answer a client until it goes, or sends a line that is too long."""
        partial = b""
        try:
            client.sendall(self.build_greeting())
            while not self._closing.is_set():
                if not select.select([client], [], [], LOOK)[0]:
                    continue
                data = client.recv(LONGEST)
                if not data:
                    return
                *lines, partial = (partial + data).split(b"\n")
                for line in lines:
                    client.sendall(self.answer_line(line))
                if len(partial) > LONGEST:
                    return
        except OSError:  # it has gone, or does not read
            return

    def build_greeting(self) -> bytes:
        """Return the line with which a client is met: what the scene has, in its units."""
        scene = self._session.scene
        units = {output.name: list_units(scene, output) for output in self._outputs}
        return _write_line({
            "scene": scene.name, "joints": scene.joint_names, "period": scene.servo_period,
            "command": [joint.unit for joint in scene.joints], "inputs": self._inputs,
            "outputs": units,
        })  # fmt: skip

    def answer_line(self, line: bytes) -> bytes:
        """Take a line, and return the reply."""
        if self._session.is_self_clocked:
            self._session.take(newest=True)
        try:
            self._take_line(line)
        except DuplicateCommand:
            pass
        except Refusal as reason:
            self.refused += 1
            return _write_line({"refused": str(reason)})
        return self._write_measurement()

    def _take_line(self, line: bytes) -> None:
        try:
            request = json.loads(line)
        except (ValueError, RecursionError) as error:
            raise Refusal(self._where, "line", "be JSON", error) from None
        if not isinstance(request, dict) or not self._keys >= request.keys():
            rule, valid = "be an object with keys that are known", ", ".join(sorted(self._keys))
            raise Refusal(self._where, "line", rule, request, valid)
        on, again = (self._read_flag(request, key) for key in ("power", "reset"))
        names = self._session.scene.joint_names
        rows = {
            key: self._read_numbers(key, request[key], len(names))
            for key in ("command", *self._inputs)
            if key in request
        }
        command = rows.pop("command", None)
        if command is None and (rows or (on is not None and not again)):
            raise Refusal(
                self._where, "command", "be given with power or further inputs", "nothing"
            )
        with self._session.turn:
            tick = request.get("tick", self._session.tick)
            if isinstance(tick, bool) or not isinstance(tick, int):
                raise Refusal(self._where, "tick", "be a whole number", tick)
            if again:
                self._session.reset()
            elif command is not None:
                submit_command(self._session, tick, names, command, rows, powered=on is not False)

    def _read_flag(self, request: dict[str, Any], key: str) -> bool | None:
        flag = request.get(key)
        if flag is None or isinstance(flag, bool):
            return flag
        raise Refusal(self._where, key, "be true or false", flag)

    def _read_numbers(self, key: str, values: object, count: int) -> list[float]:
        """Return a list of so many numbers.

        Raises:
            Refusal: it is something else.
        """
        if isinstance(values, list) and len(values) == count:
            if not any(isinstance(x, bool) or not isinstance(x, int | float) for x in values):
                return values
        raise Refusal(self._where, key, f"be {count} numbers, base to tool", values)

    def _write_measurement(self) -> bytes:
        session = self._session
        with session.turn:
            measured = session.measured
            rows = {output.name: measured.place(output).tolist() for output in self._outputs}
            state = {"tick": session.tick, "power": session.powered}
            return _write_line({**state, "stopped": session.fault is not None, **rows})


def _write_line(of: dict[str, Any]) -> bytes:
    """Return an object as a line; numbers that are not finite are null."""

    def replace_infinite(value: Any) -> Any:
        if isinstance(value, list):
            return [replace_infinite(element) for element in value]
        return None if isinstance(value, float) and not math.isfinite(value) else value

    return json.dumps({key: replace_infinite(value) for key, value in of.items()}).encode() + b"\n"


class TcpServer(JsonLinesServer):
    """Answers clients that connect by TCP.

    Attributes:
        address: host and port where it listens.

    Args:
        session: the machine.
        host: of the interface that it listens on.
        port: 0: any that is free.

    Raises:
        Refusal: it cannot listen there.
    """

    def __init__(self, session: Session, host: str = "127.0.0.1", port: int = PORT) -> None:
        try:
            listening = socket.create_server((host, port), backlog=1)
        except (OSError, OverflowError) as error:
            raise refuse_taken_address("tcp", host, port, error) from None
        super().__init__("tcp", session, listening)
        self.address: tuple[str, int] = listening.getsockname()

    def accept_client(self) -> socket.socket:
        """Return the next client, whose lines are not held back for longer ones."""
        client = super().accept_client()
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return client


class UnixSocketServer(JsonLinesServer):
    """Answers clients that connect to a file, which the user alone may open.

    Attributes:
        address: the file; it goes when serving ends.

    Args:
        session: the machine.
        path: a name that is free, or a socket that a server has left.

    Raises:
        Refusal: it cannot listen there.
    """

    def __init__(self, session: Session, path: str | Path) -> None:
        self.address = Path(path)
        listening = socket.socket(socket.AF_UNIX)
        try:
            if _is_left(self.address):
                self.address.unlink()
            listening.bind(str(self.address))
            self.address.chmod(stat.S_IRUSR | stat.S_IWUSR)
            listening.listen(1)
        except (OSError, ValueError) as error:
            listening.close()
            why = getattr(error, "strerror", None) or error
            raise Refusal("unix-socket", "path", "be free", f"{path}: {why}") from None
        super().__init__("unix-socket", session, listening)

    def serve(self) -> None:
        """Serve until `close`."""
        try:
            super().serve()
        finally:
            self.address.unlink(missing_ok=True)


def _is_left(path: Path) -> bool:
    """Return whether a file is a socket without a listener."""
    with contextlib.suppress(FileNotFoundError), socket.socket(socket.AF_UNIX) as client:
        if stat.S_ISSOCK(path.lstat().st_mode):
            try:
                client.connect(str(path))
            except ConnectionRefusedError:
                return True
    return False
