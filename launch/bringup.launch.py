"""Starts the emulated arm, its servo and its motion controller; all end when one ends.

ros2 launch arm_emulator bringup.launch.py scene:=ur5 clock:=realtime rerun:=9876
"""

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from arm_emulator.config_files import find_config

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
]


def nodes(context: LaunchContext) -> list[Node]:
    """Return the three nodes, with the parameter files of the chosen scene."""
    scene, clock, start, rerun = (
        LaunchConfiguration(argument.name).perform(context) for argument in ARGUMENTS
    )
    file = find_config(scene, ".yaml").resolve()
    gains = {kind: str(find_config(file.stem, ".yaml", kind)) for kind in ("servo", "motion")}

    emulator = {"scene": str(file), "clock": clock, "start": start}
    if rerun.isdecimal():
        emulator["rerun_port"] = int(rerun)
    elif rerun:
        emulator["rerun_file"] = rerun

    def node(name: str, *parameters: dict | str) -> Node:
        return Node(
            package="arm_emulator",
            executable=f"{name}_node",
            name=name,
            parameters=list(parameters),
            output="screen",
            on_exit=Shutdown(reason=f"{name} ended"),
        )

    return [
        node("emulator", emulator),
        node("servo", gains["servo"], {"clock": clock}),
        node("motion_controller", gains["motion"]),
    ]


def generate_launch_description() -> LaunchDescription:
    """Return what `ros2 launch` is to start."""
    return LaunchDescription([*ARGUMENTS, OpaqueFunction(function=nodes)])
