"""Run the paper's experiment with three nodes, and draw it."""

import json
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import rclpy
from cyclopts import Parameter
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool

from arm_emulator.analysis.servo_loop import warn_of_loops
from arm_emulator.base.arrays import Array
from arm_emulator.base.io.config_files import ROBOTS, find_scene
from arm_emulator.base.refusal import Refusal
from arm_emulator.cli.command import command
from arm_emulator.cli.commands.new import find_or_make_scene
from arm_emulator.cli.options import Clock, SceneName
from arm_emulator.cli.output import output
from arm_emulator.demo.demo_plan import DemoPlan
from arm_emulator.demo.fig4 import draw_fig4
from arm_emulator.demo.predicted_rest import NEAR, PredictedRest, predict_rest
from arm_emulator.machine.scene.scene import Scene, load_scene
from arm_emulator.motion.model.kinematics import POSITION_ROWS, Kinematics
from arm_emulator.motion.model.pose import Pose
from arm_emulator.motion.planner.tool_controller import make_controller
from arm_emulator.ros.messages.time_stamp import (
    NANOSECONDS,
    convert_to_nanoseconds,
    convert_to_stamp,
)
from arm_emulator.ros.node.node_shell import COMMAND_QOS, STATE_SUB_QOS
from arm_emulator.ros.process.bringup import Bringup
from arm_emulator.ros.process.ctrl_c import CtrlC
from arm_emulator.ros.process.ros_domain import own_domain
from arm_emulator.runs.gains import Gains, check_fit, load_gains
from arm_emulator.runs.recorder import get_viewer_command
from arm_emulator.runs.true_kinematics import find_true_kinematics
from arm_emulator_msgs.msg import EmulatorStatus

PATIENCE = 120.0  # s, wall: on an idle machine the nodes need a second or two


@dataclass(frozen=True)
class DemoResult:
    """The outcome of the experiment."""

    deviations: Array  # m (K + 1, 3): target minus tool before instruction 0 .. K
    rotations: Array  # rad (K + 1,): angle between tool and target
    oriented: bool  # whether motion control holds the orientation
    real_time_factor: float


@command(
    keys=(
        "`scene`, `clock`, `start_mm`, `residual_mm`, `rotation_mrad`, "
        "`instructions_to_1_percent`, `real_time_factor`, `deviations_m`, `predicted_mm`, "
        "`target` (predicted), `missed` (why target or prediction were not met)"
    ),
)
def run_demo(
    scene: SceneName = "three_axis",
    /,
    *,
    clock: Clock = "lockstep",
    out: Annotated[Path, Parameter(metavar="FOLDER")] = Path("out"),
) -> int:
    """Displace the tool with three nodes, and draw the deviation of each displacement.

    The demo first makes the motion in one process. The exit code is 1 if the tool does not come to
    rest at its target, or rests elsewhere than in one process: in lock-step by a bit, in real time
    by 1 % of the way.

    Args:
        scene: scene file or name, or a robot's URDF.
        out: folder of the results.
    """
    if Path(scene).suffix in ROBOTS:
        scene = str(find_or_make_scene(Path(scene), out))
    console = Console()
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    file = find_scene(scene)
    machine, gains = load_scene(file), load_gains(file)
    machine.refuse_bearings("the demo")
    check_fit(machine, gains.servo, gains.motion)
    warn_of_loops(machine, gains.servo)
    plan = DemoPlan.load_plan(file, round(gains.motion.period * NANOSECONDS))
    predicted = predict_rest(machine, gains, plan)
    console.print(f"predicted residual (mm)   {_format_row(predicted.deviations[-1])}")
    if predicted.missed:
        console.print(f"predicted: the target is {predicted.target}: {predicted.missed}")
    out.mkdir(parents=True, exist_ok=True)
    # A domain of its own, so that a network that is already running is not disturbed.
    with own_domain(unless_named=True) as domain:
        title = f"{machine.name}, {clock}, ROS_DOMAIN_ID {domain}"
        console.print(f"[bold]arm_emulator demo[/bold]: {title}")
        rclpy.init()
        try:
            with Bringup(
                scene,
                clock=clock,
                start="paused",
                emulator={"rerun_file": (out / "demo.rrd").resolve()},
                log=out / "log",
            ) as network:
                result = _run_plan(machine, gains, plan, network, console)
                codes = network.stop_nodes()
        finally:
            rclpy.try_shutdown()
    unclean = {name: code for name, code in codes.items() if code != 0}
    if unclean:
        console.print(f"[red]not ended cleanly: {unclean}, see {out / 'log'}")
    missed = predicted.describe_miss(result.deviations, exact=clock == "lockstep")
    _report_result(machine, clock, predicted, result, missed, out, console)
    return max(output.report_miss("demo", missed), 1 if unclean else 0)


def _format_row(values: Array) -> str:
    return "  ".join(
        f"{axis} {value * 1e3:+9.4f}" for axis, value in zip("xyz", values, strict=False)
    )


def _run_plan(
    scene: Scene, gains: Gains, plan: DemoPlan, network: Bringup, console: Console
) -> DemoResult:
    motion = gains.motion
    controller = make_controller(scene.urdf, scene.joint_names, motion)
    period_ns = round(motion.period * NANOSECONDS)
    R_WT, p_WT = controller.kinematics.forward(scene.start)
    target = Pose(p_WT + plan.displacement, R_WT)
    true = find_true_kinematics(scene, controller.kinematics)
    observer = _Observer(true, target, period_ns, plan)
    try:
        with console.status("waiting for the three nodes to meet"):
            observer.wait_until(lambda: observer.answered, network, "the nodes to meet")
            observer.send_target(plan.settle_ns)
            observer.wait_until(lambda: observer.target_taken, network, "the target to be taken")
            observer.wait_until(observer.can_go, network, "the emulator's service")
            observer.resume_time()
        started = time.monotonic()
        with Progress(
            TextColumn("instruction {task.completed:>3}"),
            BarColumn(),
            TextColumn("{task.fields[deviation]}"),
            TimeElapsedColumn(),
            console=console,
        ) as progress:
            bar = progress.add_task("", total=plan.instructions, deviation="")

            def is_finished() -> bool:
                if observer.q:
                    deviation = np.linalg.norm(observer.compute_deviation(-1)) * 1e3
                    text = f"deviation {deviation:9.4f} mm"
                    progress.update(bar, completed=len(observer.q) - 1, deviation=text)
                return len(observer.q) > plan.instructions

            observer.wait_until(is_finished, network, "the instructions", patience=15.0 * PATIENCE)
        wall = time.monotonic() - started
        observed = observer.q[: plan.instructions + 1]
        if plan.motion is not None:
            with console.status("a motion to look at"):
                observer.show_target(Pose(p_WT + plan.motion, R_WT))
                end = len(observer.q) + plan.instructions
                observer.wait_until(
                    lambda: len(observer.q) > end, network, "the motion that is shown"
                )
    finally:
        observer.destroy_node()
    logical = (plan.settle_ns + plan.instructions * period_ns) / NANOSECONDS
    return DemoResult(
        deviations=np.array([observer.compute_deviation(k) for k in range(len(observed))]),
        rotations=np.array([observer.compute_rotation(k) for k in range(len(observed))]),
        oriented=controller.kinematics.rows > POSITION_ROWS,
        real_time_factor=logical / wall,
    )


class _Observer(Node):
    """Sends the target and watches the true arm, at every instruction."""

    def __init__(
        self, kinematics: Kinematics, target: Pose, period_ns: int, plan: DemoPlan
    ) -> None:
        super().__init__("demo")
        self.q: list[Array] = []  # true joint angles at each instruction
        self.answered = False
        self.target_taken = False
        self._kinematics, self._target = kinematics, target
        self._period_ns, self._start_ns = period_ns, plan.settle_ns
        self._targets = self.create_publisher(PoseStamped, "tool_target", COMMAND_QOS)
        self._pause = self.create_client(SetBool, "emulator/pause")
        self.create_subscription(
            EmulatorStatus, "emulator/status", self._handle_status, STATE_SUB_QOS
        )
        self.create_subscription(
            JointState, "emulator/joint_states", self._handle_truth, rclpy.qos.QoSProfile(depth=100)
        )
        self.create_subscription(DiagnosticArray, "diagnostics", self._handle_diagnostics, 10)

    def wait_until(
        self,
        condition: Callable[[], bool],
        network: Bringup,
        event: str,
        patience: float = PATIENCE,
    ) -> None:
        """Spin until the condition holds; refuse when a node ends or patience does."""
        deadline = time.monotonic() + patience
        see = f"the nodes' output is in {network.log}"
        while not condition():
            with CtrlC.delay_interrupt():
                rclpy.spin_once(self, timeout_sec=0.1)
            ended = network.find_ended()
            if ended is not None:
                name, code = ended
                raise Refusal("demo", f"node {name}", "run", f"exit code {code}", see)
            if time.monotonic() > deadline:
                raise Refusal("demo", event, f"take less than {patience:g} s", "more", see)

    def send_target(self, from_ns: int) -> None:
        """Send the target, repeatedly until accepted: an undiscovered node does not receive it."""
        message = _make_pose_message(self._target, from_ns)

        def send_pose() -> None:
            if not self.target_taken:
                self._targets.publish(message)

        send_pose()
        self.create_timer(0.2, send_pose)

    def show_target(self, pose: Pose) -> None:
        """Send a target to the nodes that have met, from the next instruction on."""
        after = self._start_ns + len(self.q) * self._period_ns
        self._targets.publish(_make_pose_message(pose, after))

    def can_go(self) -> bool:
        return self._pause.service_is_ready()

    def resume_time(self) -> None:
        """Let time continue, and request it again until it does."""

        def request_resume() -> None:
            if not self.q:
                self._pause.call_async(SetBool.Request(data=False))

        request_resume()
        self.create_timer(5.0, request_resume)

    def compute_deviation(self, k: int) -> Array:
        """Target minus tool before instruction k, (3,) [m]."""
        return self._target.p_WT - self._kinematics.forward(self.q[k])[1]

    def compute_rotation(self, k: int) -> float:
        """Angle between the tool and its target before instruction k [rad]."""
        R = self._kinematics.forward(self.q[k])[0].T @ self._target.R_WT
        # From the skew part, since the arc cosine of the trace is inaccurate near 0.
        skew = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
        return float(np.arctan2(np.linalg.norm(skew), np.trace(R) - 1.0))

    def _handle_status(self, status: EmulatorStatus) -> None:
        self.answered = self.answered or status.answered

    def _handle_diagnostics(self, array: DiagnosticArray) -> None:
        for status in array.status:
            if status.name == "motion_controller":
                taken = {pair.key: pair.value for pair in status.values}.get("tool targets", "0")
                self.target_taken = self.target_taken or taken != "0"

    def _handle_truth(self, truth: JointState) -> None:
        now = convert_to_nanoseconds(truth.header.stamp)
        expected = self._start_ns + len(self.q) * self._period_ns
        if now == expected:
            self.q.append(np.array(truth.position))
        elif now > expected:
            raise Refusal("demo", "emulator/joint_states", "come without a gap", f"t = {now} ns")


def _make_pose_message(target: Pose, from_ns: int) -> PoseStamped:
    """Return the message of a tool target that holds from a logical time on."""
    message = PoseStamped()
    message.header.stamp = convert_to_stamp(from_ns)
    pose = message.pose
    pose.position.x, pose.position.y, pose.position.z = map(float, target.p_WT)
    o = pose.orientation
    o.x, o.y, o.z, o.w = map(float, target.quaternion())
    return message


def _report_result(
    scene: Scene,
    clock: str,
    predicted: PredictedRest,
    result: DemoResult,
    missed: str,
    out: Path,
    console: Console,
) -> None:
    deviations = result.deviations
    residual = deviations[-1]
    draw_fig4(
        deviations,
        out / "fig4.png",
        title=f"{scene.name}: deviation of the tool from its target",
    )
    start = float(np.linalg.norm(deviations[0]))
    distance = np.linalg.norm(deviations, axis=1)
    below = np.flatnonzero(distance < NEAR * start)
    summary = {
        "scene": scene.name,
        "clock": clock,
        "start_mm": start * 1e3,
        "residual_mm": (residual * 1e3).tolist(),
        "rotation_mrad": float(result.rotations[-1] * 1e3),
        "instructions_to_1_percent": int(below[0]) if len(below) else None,
        "real_time_factor": result.real_time_factor,
        "deviations_m": deviations.tolist(),
        "predicted_mm": (predicted.deviations[-1] * 1e3).tolist(),
        "target": predicted.target,
        "missed": missed or None,
    }
    console.print(f"residual (mm)             {_format_row(residual)}")
    if not missed:
        near = "" if clock == "lockstep" else "near "
        console.print(f"the target is reached, and the residual is {near}the predicted one")
    output.add_facts(summary)
    (out / "demo.json").write_text(json.dumps(summary, indent=1), encoding="utf-8")
    if result.oriented:
        console.print(f"orientation off by        {result.rotations[-1] * 1e3:.4f} mrad")
    if len(below):
        console.print(f"below 1 % of {start * 1e3:.1f} mm    after {below[0]} instructions")
    console.print(f"real-time factor          {result.real_time_factor:.2f}")
    console.print(
        f"results: {out / 'fig4.png'}; the moving arm:", get_viewer_command(out / "demo.rrd")
    )
