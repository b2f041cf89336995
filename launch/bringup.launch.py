"""Starts the emulated arm, its servo and its motion controller; all end when one ends.

Where robot_state_publisher is installed it is started, too, for `/tf`.

ros2 launch arm_emulator bringup.launch.py scene:=ur5 clock:=realtime rerun:=9876
"""

import sys
from pathlib import Path

from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch.events.process import ProcessExited
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from arm_emulator.base.io.config_files import find_beside, find_scene
from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.scene.scene import Scene, load_scene
from arm_emulator.machine.session.pace import parse_factor
from arm_emulator.ros.process.end_with_parent import get_parent_environment

ARGUMENTS = [
    DeclareLaunchArgument(
        "scene", default_value="three_axis", description="Name of a scene, or a file"
    ),
    DeclareLaunchArgument(
        "clock",
        default_value="lockstep",
        choices=["lockstep", "realtime"],
        description="lockstep: logical time waits for the servo; realtime: paced by the wall clock",
    ),
    DeclareLaunchArgument(
        "pace",
        default_value="1",
        description="Logical time per wall time in lock-step, or max: as fast as the nodes compute",
    ),
    DeclareLaunchArgument(
        "start",
        default_value="first_answer",
        choices=["free_run", "first_answer", "paused"],
        description="What the emulator does until the first command comes",
    ),
    DeclareLaunchArgument(
        "rerun",
        default_value="",
        description="Where to show the arm: a file to write (.rrd), or a port for a Rerun viewer",
    ),
    DeclareLaunchArgument(
        "record", default_value="", description="New bag that the emulator writes, a folder"
    ),
    DeclareLaunchArgument(
        "namespace", default_value="", description="Of all nodes and topics, such as /cell1"
    ),
    DeclareLaunchArgument(
        "use_sim_time",
        default_value="false",
        choices=["true", "false"],
        description="Whether the nodes' own clocks follow the emulator's",
    ),
    DeclareLaunchArgument(
        "params_file",
        default_value="",
        description="ROS parameter file that rules over all other parameters",
    ),
    DeclareLaunchArgument(
        "allow_second",
        default_value="false",
        choices=["true", "false"],
        description="Whether to start beside a network that runs on the same topics",
    ),
]


class Ends:
    """Ends the nodes when one has ended, and the launch with the exit code of the first failure.

    `ros2 launch` itself ends with 0 when a node has failed.

    Attributes:
        running: number of nodes that have not ended.
    """

    def __init__(self) -> None:
        self.running, self._code = 0, 0

    def __call__(self, event: ProcessExited, _: LaunchContext) -> Shutdown:
        """Take the end of a node."""
        code = event.returncode
        self._code = self._code or (code if code >= 0 else 128 - code)
        self.running -= 1
        if self._code and self.running == 0:
            sys.exit(self._code)
        return Shutdown(reason=f"{event.action.name} ended")


def make_nodes_or_exit(context: LaunchContext) -> list[Node]:
    """Return the nodes, or end the launch in a line with exit code 2 if they are refused."""
    try:
        return make_nodes(context)
    except Refusal as refusal:
        print(refusal, file=sys.stderr)
        sys.exit(2)  # not as an exception, of which `ros2 launch` makes exit code 1


def make_nodes(context: LaunchContext) -> list[Node]:
    """Return the three nodes, with the parameter files of the chosen scene.

    Raises:
        Refusal: an argument is not valid, or such a network runs already.
    """
    scene, clock, pace, start, rerun, record, namespace, use_sim_time, params_file, allow_second = (
        LaunchConfiguration(argument.name).perform(context) for argument in ARGUMENTS
    )
    factor = parse_factor("bringup", pace)
    file = find_scene(scene)
    gains = {kind: str(find_beside(file, kind)) for kind in ("servo", "motion")}

    emulator = {"scene": str(file), "clock": clock, "start": start}
    emulator["alone"] = allow_second == "false"
    emulator["real_time_factor"] = factor
    if rerun.isdecimal():
        emulator["rerun_port"] = int(rerun)
    elif rerun:
        emulator["rerun_file"] = rerun

    if record:
        emulator["record"] = str(Path(record).resolve())

    every = {"use_sim_time": use_sim_time == "true"}
    if params_file and not Path(params_file).is_file():
        raise Refusal("bringup", f"file {params_file}", "exist", "no such file")
    chosen = [str(Path(params_file).resolve())] if params_file else []
    ends = Ends()

    def make_node(name: str, *parameters: dict | str) -> Node:
        return Node(
            package="arm_emulator",
            executable=f"{name}_node",
            name=name,
            namespace=namespace,
            parameters=[*parameters, every, *chosen],
            # Nodes on simulated time listen to /clock; the emulator publishes it in its namespace.
            remappings=[("/clock", "clock")],
            # `ros2 launch` leaves its nodes alone when it is ended by SIGTERM, or killed.
            additional_env=get_parent_environment(),
            output="screen",
            on_exit=ends,
        )

    three = [
        make_node("emulator", emulator),
        make_node("servo", gains["servo"], {"clock": clock}),
        make_node("motion_controller", gains["motion"]),
    ]
    ends.running = len(three)
    return [*three, *make_frame_publishers(load_scene(file), namespace, every)]


def make_frame_publishers(scene: Scene, namespace: str, every: dict) -> list[Node]:
    """Return what publishes the links' frames on /tf, where it is installed.

    It gets the servo's `joint_states`. The description that the emulator publishes on
    `robot_description` is its parameter, since it does not listen there at its start.
    """
    package, prefix = "robot_state_publisher", f"{namespace.strip('/')}/".lstrip("/")
    try:
        get_package_prefix(package)
    except PackageNotFoundError:
        return []
    return [
        Node(
            package=package,
            executable=package,
            namespace=namespace,
            parameters=[{"robot_description": scene.urdf, "frame_prefix": prefix}, every],
            # The emulator publishes the description already.
            remappings=[("/clock", "clock"), ("robot_description", "~/robot_description")],
            output="screen",
        )
    ]


def generate_launch_description() -> LaunchDescription:
    """Return what `ros2 launch` is to start."""
    return LaunchDescription([*ARGUMENTS, OpaqueFunction(function=make_nodes_or_exit)])
