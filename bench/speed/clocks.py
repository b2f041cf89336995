"""Punctuality of real time and speed of logical time, with all three nodes as processes."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from arm_emulator import load_gains, load_scene
from arm_emulator.base.arrays import Array
from arm_emulator.base.cpu_load import load_processors
from arm_emulator.base.io.config_files import find_scene
from arm_emulator.ros.process.ros_domain import own_domain
from arm_emulator.runs.servo_step import ServoStep
from arm_emulator.runs.table_run import TableRun
from arm_emulator.runs.target_table import TargetTable
from arm_emulator.servo.servo_arm import ServoArm
from bench.measure import show_progress
from bench.tables import format_table

TITLE = "Two clocks"

SECONDS = 30.0  # of real time
OFFLINE_SECONDS = 10.0
TABLE_SECONDS, TABLE_ROW = 60.0, 0.01
TRACKED = 20  # looks at the links, a second apart
LOCKSTEP_TICKS = 60_000
# Real time is punctual below both: error of the real-time factor, share of old commands.
FACTOR_ERROR, OLD_SHARE = 1e-3, 0.01


def run_bench(quick: bool) -> dict[str, Any]:
    """Measure both clocks, and the offline run."""
    seconds = 10.0 if quick else SECONDS
    figures: dict[str, Any] = {"real_time": {}, "lockstep": {}, "offline": {}, "table": {}}
    with show_progress("two clocks", 8) as done:
        figures["real_time"]["three_axis"] = _measure_in_process("real_time", "three_axis", seconds)
        done("real time")
        with load_processors(1):
            figures["real_time"]["three_axis, one core busy"] = _measure_in_process(
                "real_time", "three_axis", seconds
            )
        done("real time under load")
        for scene in ("three_axis", "ur5"):
            figures["lockstep"][scene] = _measure_in_process("lockstep", scene, 0.0)
            done(f"lock-step, {scene}")
            figures["offline"][scene] = _measure_offline(scene)
            done(f"offline, {scene}")
            figures["table"][scene] = _measure_table(scene)
            done(f"targets from a table, {scene}")
    return figures


def _measure_in_process(clock: str, scene: str, seconds: float) -> dict[str, Any]:
    """Measure in a process of its own, on a ROS domain of its own."""
    command = [sys.executable, "-m", "bench.speed.clocks", clock, scene, str(seconds)]
    with own_domain():
        done = subprocess.run(
            command,
            capture_output=True,
            text=True,
            check=True,
            cwd=Path(__file__).resolve().parents[2],
        )
    figures: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return figures


def measure_network(clock_name: str, scene: str, seconds: float) -> dict[str, Any]:
    """Run the three nodes and return the emulator's status at the end."""
    import rclpy

    from arm_emulator.ros.node.node_shell import STATE_SUB_QOS
    from arm_emulator.ros.process.bringup import Bringup
    from arm_emulator_msgs.msg import EmulatorStatus

    clock = "realtime" if clock_name == "real_time" else "lockstep"
    rclpy.init()
    node = rclpy.create_node("bench")
    received: list[tuple[float, EmulatorStatus]] = []
    node.create_subscription(
        EmulatorStatus,
        "emulator/status",
        lambda status: received.append((time.monotonic(), status)),
        STATE_SUB_QOS,
    )

    def wait_for_motion() -> list[tuple[float, EmulatorStatus]]:
        return [pair for pair in received if pair[1].tick > 0]

    with Bringup(scene, clock=clock, start="first_answer", log=Path("out/bench/log")) as network:
        while True:
            rclpy.spin_once(node, timeout_sec=0.1)
            if network.find_ended() is not None:
                raise RuntimeError(f"a node ended: {network.find_ended()}")
            ran = wait_for_motion()
            if not ran:
                continue
            # The time while processes start and meet is not measured.
            if clock == "realtime" and ran[-1][0] - ran[0][0] >= seconds:
                break
            if clock == "lockstep" and ran[-1][1].tick >= LOCKSTEP_TICKS:
                break
    (first_wall, first), (last_wall, last) = wait_for_motion()[0], wait_for_motion()[-1]
    node.destroy_node()
    rclpy.try_shutdown()
    ticks = last.tick - first.tick
    return {
        "seconds": last_wall - first_wall,
        "ticks": ticks,
        "real_time_factor": (last.logical_time - first.logical_time) / (last_wall - first_wall),
        "lost_periods": last.overruns,
        "old_commands_share": (last.old_commands - first.old_commands) / ticks,
        "lateness_p50": last.median_lateness,
        "lateness_p99": last.p99_lateness,
        "lateness_max": last.worst_lateness,
        "real_time_priority": last.real_time_priority,
        "memory_locked": last.memory_locked,
        "refused": last.commands_refused,
    }


def is_punctual(figures: dict[str, Any]) -> bool:
    """Whether a run in real time kept its limits."""
    late = abs(figures["real_time_factor"] - 1.0) >= FACTOR_ERROR
    return not late and bool(figures["old_commands_share"] < OLD_SHARE)


def _measure_offline(scene: str) -> float:
    """Return the real-time factor of the offline run."""
    from arm_emulator.runs.offline import load_offline_run

    offline_run = load_offline_run(scene)
    offline_run.advance(100)
    ticks = round(OFFLINE_SECONDS / offline_run.session.scene.servo_period)
    started = time.perf_counter()
    offline_run.advance(ticks)
    return OFFLINE_SECONDS / (time.perf_counter() - started)


def _measure_table(scene_name: str) -> dict[str, float]:
    """Return the real-time factor of our servo in C, with joint targets from a table.

    Beside it stands how far the links are from where steps of a sixteenth of the servo period lead
    them [rad].
    """
    period = load_scene(scene_name).servo_period
    off = float(np.abs(_track_links(scene_name) - _track_links(scene_name, period / 16)).max())
    table_run = _load_table_run(scene_name)
    started = time.perf_counter()
    table_run.advance(round(TABLE_SECONDS / period))
    return {"factor": TABLE_SECONDS / (time.perf_counter() - started), "off": off}


def _track_links(scene_name: str, step: float | None = None) -> Array:
    """Return where the links are at each look (TRACKED, N) [rad]."""
    table_run, track = _load_table_run(scene_name, step), []
    for _ in range(TRACKED):
        table_run.advance(round(1.0 / table_run.session.scene.servo_period))
        track.append(table_run.session.state.q)
    return np.array(track)


def _load_table_run(scene_name: str, step: float | None = None) -> TableRun:
    file = find_scene(scene_name)
    scene = load_scene(file, {"integrator.dt": step} if step else None)
    config = load_gains(file).servo
    t = np.arange(0.0, TABLE_SECONDS, TABLE_ROW)
    speeds = 0.7 + 0.1 * np.arange(len(scene.joints))  # rad/s, of swings by 0.4 rad
    q = scene.start + 0.2 * (1.0 - np.cos(speeds * t[:, None]))
    place = [scene.joint_names.index(name) for name in config.joint_names]
    return TableRun(scene, TargetTable(t, q), ServoStep(ServoArm(config), place))


def write_report(figures: dict[str, Any]) -> str:
    """Return the section in Markdown."""
    lines = [
        "Emulator, servo and motion controller as three processes, servo period 1 ms.",
        "",
        "Real time. Lateness is that of the wake-up of the core's own thread at the end of each "
        "servo period; a lost period is a deadline missed by a whole period, which logical time "
        "does not make up for; an old command answers a state more than two periods old.",
        "",
    ]
    rows = []
    for name, row in figures["real_time"].items():
        late = " / ".join(f"{row[f'lateness_{k}'] * 1e6:.0f}" for k in ("p50", "p99", "max"))
        rows.append((
            name, f"{row['seconds']:.1f}", f"{row['real_time_factor']:.5f}",
            f"{row['lost_periods']} of {row['ticks']}", f"{row['old_commands_share']:.3%}", late,
            _format_flag(row["real_time_priority"]), _format_flag(row["memory_locked"]),
        ))  # fmt: skip
    heads = ("scene", "wall [s]", "real-time factor", "lost periods", "old commands",
             "lateness p50 / p99 / max [us]", "SCHED_FIFO", "memory locked")  # fmt: skip
    lines.append(format_table(heads, rows))
    lines += [
        "",
        "Logical time: the same in lock-step, and offline (`arm_emulator run`: the same objects "
        "and bits in one process, without a network), and there with joint targets from a table "
        "in place of the motion controller, where no Python is in the loop. Beside this factor "
        "stands how far links are from where steps of a sixteenth of the period lead them.",
        "",
    ]
    logical = []
    for scene, row in figures["lockstep"].items():
        factor, by_table = row["real_time_factor"], figures["table"][scene]
        logical.append((
            scene, f"{factor:.2f}", f"{1e3 / factor:.0f}", f"{figures['offline'][scene]:.1f}",
            f"{by_table['factor']:.0f}", f"{by_table['off']:.0e} rad",
        ))  # fmt: skip
    titles = ("scene", "lock-step, real-time factor", "us per tick", "offline, real-time factor",
             "from a table", "there")  # fmt: skip
    lines.append(format_table(titles, logical))
    lines += [
        "",
        "In lock-step nearly all of a tick is two messages through the middleware; the core's "
        "steps are below one per cent of it.",
    ]
    return "\n".join(lines)


def _format_flag(value: bool) -> str:
    return "yes" if value else "no"


if __name__ == "__main__":
    print(json.dumps(measure_network(sys.argv[1], sys.argv[2], float(sys.argv[3]))))
