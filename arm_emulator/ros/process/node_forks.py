"""Nodes forked from a process that has imported them: a start costs no imports.

`get_forks` starts that process, which forks nodes for as long as the process that uses them lives.
"""

import gc
import importlib
import json
import os
import select
import signal
import socket
import subprocess
import sys
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from arm_emulator.base.refusal import Refusal
from arm_emulator.ros.process.ctrl_c import block_signals, end_at_once
from arm_emulator.ros.process.end_with_parent import VARIABLE

LARGEST = 1 << 17  # bytes of a request: the environment is the most of it
NUMBER = 8  # bytes of a number: of a process, and later its exit code


class ForkedNode:
    """A node's process, used as one of `subprocess.Popen`.

    Attributes:
        pid: its number.
    """

    def __init__(self, connection: socket.socket) -> None:
        self._connection = connection
        self.pid = self._receive_number()
        self._code: int | None = None

    def poll(self) -> int | None:
        """Return the exit code, None while it runs."""
        if self._code is None and select.select([self._connection], [], [], 0.0)[0]:
            self._end_node()
        return self._code

    def wait(self, timeout: float | None = None) -> int:
        """Wait for its end at most `timeout` [s]; return the exit code.

        Raises:
            subprocess.TimeoutExpired: it still runs.
        """
        if self._code is None:
            if not select.select([self._connection], [], [], timeout)[0]:
                raise subprocess.TimeoutExpired(f"process {self.pid}", timeout or 0.0)
            self._end_node()
        assert self._code is not None
        return self._code

    def send_signal(self, number: int) -> None:
        """Send a signal, unless the process has ended."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def _end_node(self) -> None:
        self._code = self._receive_number()
        self._connection.close()

    def _receive_number(self) -> int:
        actual = self._connection.recv(NUMBER, socket.MSG_WAITALL)
        # Without an answer the forking process has ended, and with it its nodes.
        return int.from_bytes(actual, "little", signed=True) if actual else -signal.SIGKILL


class Forks:
    """Starts the process that has imported modules, and asks it for nodes.

    Args:
        modules: of nodes, each with a function `main`.
        environment: of the process.
    """

    def __init__(self, modules: Sequence[str], environment: Mapping[str, str]) -> None:
        self._control, its = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", __name__, str(its.fileno()), *modules],
            stdin=subprocess.DEVNULL,
            pass_fds=[its.fileno()],
            process_group=0,
            env=dict(environment),
        )
        its.close()

    @property
    def is_running(self) -> bool:
        """Whether the process runs."""
        return self._process.poll() is None

    def fork_node(
        self,
        module: str,
        words: Sequence[str],
        environment: Mapping[str, str],
        output: int | None,
    ) -> ForkedNode:
        """Fork a node.

        Args:
            module: one of those imported.
            words: its arguments.
            environment: its environment.
            output: file descriptor for its output and errors; None: those of this process.

        Raises:
            Refusal: the process that imports the modules has ended, with its reason on stderr.
        """
        mine, its = socket.socketpair()
        outputs = (1, 2) if output is None else (output, output)
        request = {"module": module, "words": [*words], "folder": os.getcwd()}
        with its:
            packet = json.dumps({**request, "environment": dict(environment)}).encode()
            try:
                socket.send_fds(self._control, [packet], [its.fileno(), *outputs])
            except OSError as error:
                raise Refusal("nodes", module, "be imported", error) from None
        return ForkedNode(mine)


@cache
def _start_forks(modules: tuple[str, ...], process: int, attempt: int) -> Forks:
    return Forks(modules, {**os.environ, **get_python_path()})


def get_forks(modules: Sequence[str]) -> Forks:
    """Return this process's forks of nodes, started again if they have ended."""
    attempt = 0
    while not (forks := _start_forks(tuple(modules), os.getpid(), attempt)).is_running:
        attempt += 1
    return forks


def get_python_path() -> dict[str, str]:
    """Return the module path of nodes: that of this process without its working folder."""
    folders = [folder for folder in os.environ.get("PYTHONPATH", "").split(os.pathsep) if folder]
    return {"PYTHONPATH": os.pathsep.join([*folders, str(Path(__file__).resolve().parents[3])])}


def _serve_requests(control: socket.socket) -> dict[str, Any]:
    """Fork a node for each request; return the request in the node's process.

    The process ends with the one that asks, and its nodes with it, see `end_with_parent`.
    """
    asks = control.fileno()
    running: dict[
        int, tuple[int, socket.socket]
    ] = {}  # by descriptor: process, and its waiting client
    while True:
        ready, _, _ = select.select([asks, *running], [], [])
        for descriptor in running.keys() & set(ready):
            process, waits = running.pop(descriptor)
            os.close(descriptor)
            code = os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
            _send_exit_code(waits, code)
            waits.close()
        if asks not in ready:
            continue
        packet, descriptors, _, _ = socket.recv_fds(control, LARGEST, 3)
        if not packet:
            os._exit(0)
        parent, process = os.getpid(), os.fork()
        if process == 0:
            control.close()
            for sibling, (_, waits) in running.items():
                os.close(sibling)
                waits.close()
            _set_up_process(json.loads(packet), descriptors, parent)
            return dict(json.loads(packet))
        waits = socket.socket(fileno=descriptors[0])
        for descriptor in descriptors[1:]:
            os.close(descriptor)
        running[os.pidfd_open(process)] = process, waits
        _send_exit_code(waits, process)


def _send_exit_code(waits: socket.socket, number: int) -> None:
    try:
        waits.sendall(number.to_bytes(NUMBER, "little", signed=True))
    except OSError:  # its client has ended
        return


def _set_up_process(request: dict[str, Any], descriptors: Sequence[int], parent: int) -> None:
    """Give the forked process what a started one has of its own."""
    os.setpgid(0, 0)  # takes no signals from the terminal
    for at, descriptor in enumerate(descriptors):
        if at:
            os.dup2(descriptor, at)
        os.close(descriptor)
    os.chdir(request["folder"])
    os.environ.clear()
    os.environ.update({**request["environment"], VARIABLE: str(parent)})
    sys.argv = [request["module"], *request["words"]]


def main() -> None:
    """Import the modules, and fork nodes until the process that asks for them ends."""
    block_signals()
    control = socket.socket(fileno=int(sys.argv[1]))
    nodes = {name: importlib.import_module(name) for name in sys.argv[2:]}
    gc.freeze()
    request = _serve_requests(control)
    end_at_once(0)
    nodes[request["module"]].main()


if __name__ == "__main__":
    main()
