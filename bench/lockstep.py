"""Lock-step of three processes beside bare messages in the same minute, and where its time goes.

    python -m bench.lockstep

A round is a message there and one back between two processes, of the size of those of three_axis.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from arm_emulator.build.c_header import Header
from arm_emulator.build.flags import C_FLAGS
from arm_emulator.build.unit import Unit, library
from arm_emulator.ros.bringup import NODES, Bringup
from arm_emulator.ros.c import FOLDER as ROS_FOLDER
from arm_emulator.ros.ros_domain import own_domain
from bench.measure import processor_time

ROUNDS = 6000
SECONDS = 5.0  # wall, of each lock-step run
TURNS = 2
JOINTS = ("waist", "shoulder", "elbow")
SILENCE = 0.2  # s, wall, after which a round begins anew
HOW = {
    "executor": "rclpy with bytes, SingleThreadedExecutor",
    "lean": "rclpy with bytes, the executor of our nodes",
    "c": "the same messages taken and published in C",
}
HERE = Path(__file__).resolve().parent
EXAMPLE = HERE.parent / "examples" / "my_servo.py"
# The example with the executor of docs/tutorials/your_servo.md.
LEAN = f"""
import rclpy, runpy
from arm_emulator.ros.lean_executor import LeanExecutor
rclpy.spin = lambda node: LeanExecutor(node).spin()
runpy.run_path({str(EXAMPLE)!r})
"""
OTHERS = ("emulator", "motion_controller")
RUNS: tuple[tuple[str, str, tuple[str, ...], list[str]], ...] = (
    ("three_axis", "three_axis", NODES, []),
    ("ur5", "ur5", NODES, []),
    ("three_axis, examples/my_servo.py", "three_axis", OTHERS, [str(EXAMPLE)]),
    ("the same with the executor of our nodes", "three_axis", OTHERS, ["-c", LEAN]),
)


def main() -> None:
    """Measure in turns and print two tables."""
    rounds: dict[str, list[float]] = {how: [] for how in HOW}
    runs: dict[str, list[dict[str, float]]] = {name: [] for name, *_ in RUNS}
    for _ in range(TURNS):
        for how, took in rounds.items():
            took.append(_round(how))
        for name, scene, only, servo in RUNS:
            runs[name].append(_run(scene, only, servo))
    print("| a round | us, median of each turn |\n|---|---|")
    for how, words in HOW.items():
        print(f"| {words} | {_all(rounds[how])} |")
    print("\n| lock-step | real-time factor | us per tick | processor time of that [us] |")
    print("|---|---|---|---|")
    for name, of in runs.items():
        factor, tick = ([one.pop(key) for one in of] for key in ("factor", "tick"))
        shares = ", ".join(f"{key} {_all([one[key] for one in of])}" for key in of[0])
        print(f"| {name} | {_all(factor, 2)} | {_all(tick)} | {shares} |")


def _all(figures: list[float], digits: int = 0) -> str:
    return " and ".join(f"{one:.{digits}f}" for one in figures)


def _round(how: str) -> float:
    """Return the median time of a round [us]."""
    command = [sys.executable, "-m", "bench.lockstep", how]
    with own_domain(), subprocess.Popen([*command, "echo"]) as echo:
        try:
            done = subprocess.run([*command, "ask"], check=True, capture_output=True, text=True)
        finally:
            echo.kill()
    return float(done.stdout.split()[-1])


def _run(scene: str, only: tuple[str, ...], servo: list[str]) -> dict[str, float]:
    """Return factor and time of a tick, and the processor time of each process in it [us].

    Args:
        scene: by its name.
        only: our nodes.
        servo: words for Python that run a user's one; none: it is ours.
    """
    with (
        own_domain(),
        Bringup(scene, start="first_answer", log=Path("out/bench/log"), only=only) as network,
        listener() as ticks,
    ):
        users = {"servo": subprocess.Popen([sys.executable, *servo])} if servo else {}
        processes = {name: network.process(name) for name in only} | users
        try:
            while ticks() < 500:
                if network.ended() is not None:
                    raise RuntimeError(f"a node ended: {network.ended()}")
            begin, began = ticks(anew=True), time.monotonic()
            spent = {name: processor_time(one.pid) for name, one in processes.items()}
            while time.monotonic() - began < SECONDS:
                end = ticks(anew=True)
            wall = time.monotonic() - began
            new = end - begin
            return {
                "factor": new * 1e-3 / wall,
                "tick": wall / new * 1e6,
                **{
                    name.replace("_", " "): (processor_time(one.pid) - spent[name]) / new * 1e6
                    for name, one in processes.items()
                },
            }
        finally:
            for user in users.values():
                user.kill()
                user.wait()


@contextmanager
def listener() -> Iterator[Any]:
    """Yield a function that returns the tick of the newest status, or of a new one."""
    import rclpy

    from arm_emulator.ros.node_shell import STATE_SUB_QOS
    from arm_emulator_msgs.msg import EmulatorStatus

    rclpy.init()
    node = rclpy.create_node("bench")
    seen: list[int] = []

    def heard(status: EmulatorStatus) -> None:
        seen.append(status.tick)

    node.create_subscription(EmulatorStatus, "emulator/status", heard, STATE_SUB_QOS)

    def newest(anew: bool = False) -> int:
        count = len(seen)
        while len(seen) == count or not seen:
            rclpy.spin_once(node, timeout_sec=0.1)
            if not anew and len(seen) == count:
                break
        return seen[-1] if seen else -1

    try:
        yield newest
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


class _InC:
    """Messages that are answered in C, see echo.h and `HotPath`."""

    takes: Sequence[tuple[Any, Any, Any]]
    outgoing: Sequence[Any]

    def __init__(self, subscription: Any, answer: Any, finished: Callable[[Any], None]) -> None:
        from arm_emulator.ros.middleware import middleware

        header = Header(HERE / "echo.h", (ROS_FOLDER,))
        unit = Unit(
            "echo", '#include "echo.c"\n', C_FLAGS, (HERE, ROS_FOLDER), (header,), "bench",
            "an echo", "echo.c",
        )  # fmt: skip
        self._took, self._finished = np.zeros(ROUNDS + 1, np.int64), finished
        self._echo = header.new(
            "echo",
            publish=middleware().ros_publish,
            answer=answer.struct,
            took=self._took,
            room=len(self._took),
            began=time.monotonic_ns(),
        )
        argument = header.ffi.cast("void *", self._echo)
        self.takes = [(subscription, library(unit).echo_take, argument)]
        self.outgoing = [answer]

    def begin(self) -> None:
        """Do nothing, see `HotPath`."""

    def end(self) -> None:
        """Finish after the last round."""
        if self._echo.rounds == len(self._took):
            self._finished(self._took.tolist())


def _take_part(how: str, role: str) -> None:
    """Echo messages, or ask, and print the median time of a round."""
    import rclpy
    from rclpy.executors import SingleThreadedExecutor

    from arm_emulator.ros import node_shell as shell
    from arm_emulator.ros.lean_executor import LeanExecutor
    from arm_emulator.ros.middleware import Outgoing
    from arm_emulator_msgs.msg import MotorCommand, MotorState

    rclpy.init()
    node = rclpy.create_node(f"bench_{role}")
    names, zeros = list(JOINTS), [0.0] * len(JOINTS)
    state = MotorState(joint_names=names, encoder_counts=[0, 0, 0], current=zeros, applied=zeros)
    command = MotorCommand(joint_names=names, command=zeros)
    asks = MotorState, "motor_states", shell.STATE_PUB_QOS, shell.STATE_SUB_QOS, state
    answers = MotorCommand, "motor_commands", shell.COMMAND_QOS, shell.COMMAND_SUB_QOS, command
    given, got = (asks, answers) if role == "ask" else (answers, asks)
    sent = Outgoing(node.create_publisher(*given[:3]), given[4])
    data, took = sent.layout.data(), [time.monotonic_ns()]

    def finished(took: list[int]) -> None:
        if role == "ask":
            print(median(took[ROUNDS // 10 :]) / 1e3, flush=True)
            os._exit(0)

    def heard(_: bytes) -> None:
        took.append(time.monotonic_ns())
        sent.publisher.publish(data)
        if len(took) == ROUNDS:
            finished([later - one for one, later in pairwise(took)])

    subscription = node.create_subscription(got[0], got[1], heard, got[3], raw=True)
    if role == "ask":  # once more, where a message was lost
        node.create_timer(SILENCE, lambda: sent.publisher.publish(data))
    if how == "executor":
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        executor.spin()
    LeanExecutor(node, _InC(subscription, sent, finished) if how == "c" else None).spin()


if __name__ == "__main__":
    if len(sys.argv) == 1:
        main()
    else:
        _take_part(*sys.argv[1:])
