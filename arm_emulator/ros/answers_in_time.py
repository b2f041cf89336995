"""Emulator and servo as two processes in real time: which answers come in time."""

from __future__ import annotations

import math
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from arm_emulator.base.config_files import find_beside, find_scene
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.yaml_file import read_yaml
from arm_emulator.ros.bringup import Bringup
from arm_emulator.ros.network_guest import guest
from arm_emulator.ros.node_shell import STATE_SUB_QOS
from arm_emulator.ros.ros_domain import own_domain
from arm_emulator_msgs.msg import EmulatorStatus

PATIENCE = 60.0  # s, wall: for two processes to begin, a compilation included
SETTLED = 0.5  # s of logical time, before which nodes still find each other


class AnswersInTime(NamedTuple):
    """Figures of a network in real time.

    Attributes:
        periods: servo periods that passed.
        lost: periods that were over before the machine's wake-up.
        old: periods under a command that answers a state more than two periods old.
        p99_lateness, worst_lateness: of wake-ups, since the start [s].
    """

    periods: int
    lost: int
    old: int
    p99_lateness: float
    worst_lateness: float


def answers_in_time(scene: str, period: float, seconds: float) -> AnswersInTime:
    """Run emulator and servo of a scene with another servo period, in a ROS domain of their own.

    Args:
        scene: a scene file, or the name of one that comes with the emulator.
        period: servo period [s].
        seconds: how long [s].

    Raises:
        Refusal: the network does not begin.
    """
    with tempfile.TemporaryDirectory() as folder, own_domain():
        file = _with_period(find_scene(scene), period, Path(folder))
        log = Path(folder) / "log"
        with (
            Bringup(str(file), clock="realtime", log=log, only=("emulator", "servo")) as network,
            guest("latency", "") as node,
        ):
            node.listen("emulator/status", EmulatorStatus, STATE_SUB_QOS)

            def newest() -> Any:
                return node.newest.get("emulator/status")

            def settled() -> bool:
                if network.ended() is not None:
                    rule, got = "run in real time", _last_line(log)
                    raise Refusal("latency", f"nodes of {scene} at {period:g} s", rule, got)
                status = newest()
                moving = status is not None and status.phase == EmulatorStatus.PHASE_RUNNING
                return moving and bool(status.logical_time >= SETTLED)

            if not node.spin_until(settled, PATIENCE):
                got = f"no answer within {PATIENCE:g} s"
                raise Refusal("latency", "the servo", "answer the emulator", got)
            begin = newest()
            node.spin_until(lambda: newest().logical_time >= begin.logical_time + seconds,
                            2.0 * seconds + PATIENCE)  # fmt: skip
            end = newest()
    return AnswersInTime(
        end.tick - begin.tick,
        end.overruns - begin.overruns,
        end.old_commands - begin.old_commands,
        end.p99_lateness,
        end.worst_lateness,
    )


def _with_period(scene: Path, period: float, folder: Path) -> Path:
    """Write a scene and its servo with another servo period; return the scene's file."""
    machine = dict(read_yaml(scene))
    step = machine["integrator"]["dt"]
    machine["integrator"] = {**machine["integrator"], "dt": period / math.ceil(period / step)}
    machine["servo_period"] = period
    machine["urdf"] = _absolute(scene, machine["urdf"])
    file = folder / f"{scene.stem}.yaml"
    gains = dict(read_yaml(find_beside(scene, "servo")))
    for node in gains.values():
        node["ros__parameters"]["period"] = period
    path = folder / "servo" / file.name
    path.parent.mkdir()
    path.write_text(yaml.safe_dump(gains), encoding="utf-8")
    machine.pop("servo", None)
    file.write_text(yaml.safe_dump(machine), encoding="utf-8")
    return file


def _absolute(scene: Path, urdf: str) -> str:
    beside = scene.parent / urdf
    return str(beside.resolve()) if beside.is_file() else urdf


def _last_line(log: Path) -> str:
    lines = [line for one in log.glob("*.log") for line in one.read_text().splitlines() if line]
    return lines[-1] if lines else "no reason"
