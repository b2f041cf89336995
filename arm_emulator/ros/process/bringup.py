"""The three nodes as three processes that live and end together."""

import contextlib
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Self

from arm_emulator.base.io.config_files import find_beside, find_scene
from arm_emulator.base.io.yaml_file import read_yaml
from arm_emulator.base.refusal import Refusal
from arm_emulator.ros.process.ctrl_c import CtrlC, block_signals
from arm_emulator.ros.process.end_with_parent import get_parent_environment
from arm_emulator.ros.process.node_forks import ForkedNode, get_forks, get_python_path

# Module and kind of configuration file of each node.
MODULES = {
    "emulator": ("emulator_node.node", None),
    "servo": ("servo_node.node", "servo"),
    "motion_controller": ("motion_controller_node.node", "motion"),
}
NODES = tuple(MODULES)
STOP_PATIENCE = 15.0  # s, wall: for a node to end by itself, on a busy machine too


@dataclass
class _NodeProcess:
    name: str
    process: subprocess.Popen[bytes] | ForkedNode


class Bringup:
    """Starts emulator, servo and motion controller; use it in a `with` block.

    Args:
        scene: a scene file, or the name of a shipped scene. Gains are those that belong
            to it, see `find_beside`.
        clock: "lockstep" or "realtime".
        start: see the emulator's parameter.
        emulator: more parameters of the emulator, by name. Without a `real_time_factor` the network
            is as fast as the nodes compute.
        log: folder for one log file per node; None: their output goes to this process's terminal.
        only: names of the nodes to start, for users with nodes of their own.
        namespace: of all nodes and topics, such as "/cell1".
        use_sim_time: whether the nodes' own clocks follow the emulator's.
        params_file: a ROS parameter file for all nodes; it overrides all of the above.
        forked: fork the nodes from a process that has imported them, see `node_forks`: networks
            after the first one of this process start without imports.

    Raises:
        Refusal: a configuration file is missing, or a namespace that is not valid.
    """

    def __init__(
        self,
        scene: str,
        *,
        clock: str = "lockstep",
        start: str = "first_answer",
        emulator: Mapping[str, object] | None = None,
        log: Path | None = None,
        only: tuple[str, ...] = NODES,
        namespace: str = "",
        use_sim_time: bool = False,
        params_file: Path | None = None,
        forked: bool = False,
    ) -> None:
        file = find_scene(scene)
        self.log = log
        self._running: list[_NodeProcess] = []
        forked &= hasattr(os, "pidfd_open")  # Linux
        self._forks = get_forks([module for module, _ in MODULES.values()]) if forked else None
        self._words: dict[str, list[str]] = {}
        own = {"scene": file, "clock": clock, "start": start, "real_time_factor": 0.0}
        emulator_parameters = {**own, **(emulator or {})}
        parameters: dict[str, dict[str, object]] = {
            "emulator": emulator_parameters,
            "servo": {"clock": clock},
            "motion_controller": {},
        }
        common = _list_common_arguments(namespace, use_sim_time, params_file)
        for name in only:
            _, kind = MODULES[name]
            words = ["--ros-args"]
            if kind is not None:
                words += ["--params-file", str(find_beside(file, kind))]
            for key, value in parameters[name].items():
                words += ["-p", f"{key}:={value}"]
            self._words[name] = words + common

    def __enter__(self) -> Self:
        try:
            for name in self._words:
                self.start_node(name)
        except BaseException:
            self.stop_nodes()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.stop_nodes()

    def start_node(self, name: str) -> None:
        """Start one node (again)."""
        log: IO[bytes] | None = None
        if self.log is not None:
            self.log.mkdir(parents=True, exist_ok=True)
            log = (self.log / f"{name}.log").open("wb")
        module, words = MODULES[name][0], self._words[name]
        process: subprocess.Popen[bytes] | ForkedNode
        if self._forks is not None:
            output = None if log is None else log.fileno()
            process = self._forks.fork_node(
                module, words, {**os.environ, **get_python_path()}, output
            )
        else:
            with CtrlC.delay_interrupt():  # which is printed and lost in what Python does at forks
                process = subprocess.Popen(
                    [sys.executable, "-P", "-m", module, *words],
                    stdin=subprocess.DEVNULL,
                    stdout=log,
                    stderr=subprocess.STDOUT if log is not None else None,
                    process_group=0,  # no signals from the terminal: `stop_nodes` passes them on
                    preexec_fn=block_signals,  # noqa: PLW1509 - one system call, no lock
                    env={**os.environ, **get_parent_environment(), **get_python_path()},
                )
        if log is not None:
            log.close()
        self._running.append(_NodeProcess(name, process))

    def get_process(self, name: str) -> subprocess.Popen[bytes] | ForkedNode:
        """Return the process of a running node."""
        return next(node.process for node in reversed(self._running) if node.name == name)

    def find_ended(self) -> tuple[str, int] | None:
        """Return name and exit code of a node that has ended, None while all run."""
        for node in self._running:
            code = node.process.poll()
            if code is not None:
                return node.name, code
        return None

    def stop_nodes(self) -> dict[str, int]:
        """End every node as Ctrl-C does, by force if it does not react; return the exit codes."""
        for patience, how in (
            (STOP_PATIENCE, signal.SIGINT),
            (STOP_PATIENCE, signal.SIGTERM),
            (STOP_PATIENCE, signal.SIGKILL),
        ):
            alive = [node for node in self._running if node.process.poll() is None]
            for node in alive:
                node.process.send_signal(how)
            deadline = time.monotonic() + patience
            # Another Ctrl-C ends the nodes faster.
            with contextlib.suppress(subprocess.TimeoutExpired, KeyboardInterrupt):
                for node in alive:
                    node.process.wait(max(0.0, deadline - time.monotonic()))
        return {node.name: node.process.wait() for node in self._running}


def _list_common_arguments(
    namespace: str, use_sim_time: bool, params_file: Path | None
) -> list[str]:
    """Return ROS arguments for every node; the last ones take precedence."""
    arguments = []
    if namespace:
        full = f"/{namespace.strip('/')}"
        if not re.fullmatch(r"(/[A-Za-z_][A-Za-z0-9_]*)+", full) or "__" in full:
            rule = "be names of letters, digits and _, with / between them"
            raise Refusal("arm_emulator", "the namespace", rule, namespace, "cell1, /line2/cell1")
        arguments += ["-r", f"__ns:={full}"]
    if use_sim_time:
        # Nodes on simulated time listen to /clock; the emulator publishes it in its namespace.
        arguments += ["-p", "use_sim_time:=true", "-r", "/clock:=clock"]
    if params_file is not None:
        read_yaml(params_file)  # invalid YAML is refused here, not by each node
        arguments += ["--params-file", str(params_file.resolve())]
    return arguments
