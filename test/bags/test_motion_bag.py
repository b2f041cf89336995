"""Bags of runs in which trajectories and paths moved the arm."""

from pathlib import Path

from geometry_msgs.msg import PoseStamped
from in_process import in_process
from nav_msgs.msg import Path as ToolPath

from arm_emulator.cli.commands.check_bag import check_bag
from arm_emulator.machine.scene.scene import load_scene
from arm_emulator.ros.messages.message_types import read_definition
from arm_emulator.ros.recording.bag import Bag


def test_a_bag_with_trajectories_paths_and_their_status_is_complete_and_checks(
    tmp_path: Path,
) -> None:
    bag = tmp_path / "bag"
    with in_process() as nodes:
        nodes.begin_record()
        nodes.run_to(5)
        nodes.call("emulator/reset")
        nodes.run_to(20)
        controller = nodes.nodes["motion_controller"]._controller
        _, p = controller.kinematics.forward(load_scene("three_axis").start)
        target = PoseStamped()
        target.pose.position.x, target.pose.position.y, target.pose.position.z = map(float, p)
        target.pose.position.y += 0.01
        target.pose.orientation.w = 1.0
        nodes.send("tool_path", ToolPath(poses=[target]))
        nodes.run_to(150)
        nodes.write(bag)
    assert Bag(bag).topics["/motion/status"].definition, "the definition of its type is in the bag"
    for kind in ("nav_msgs/msg/Path", "trajectory_msgs/msg/JointTrajectory"):
        assert read_definition(kind), f"{kind} can be recorded"
    assert check_bag(bag, scene="three_axis") == 0, "the run is repeated to the last bit"
