"""A test by launch_testing: a launch file starts the nodes, time stands until a target is known.

launch_test examples/my_launch_test.py
"""

import unittest
from contextlib import ExitStack

from ament_index_python.packages import get_package_share_path
from launch import LaunchDescription
from launch.actions import IncludeLaunchDescription
from launch_testing import ProcInfoHandler, post_shutdown_test
from launch_testing.actions import ReadyToTest
from launch_testing.asserts import assertExitCodes

from arm_emulator import testing
from arm_emulator.ros.process.ros_domain import own_domain

# Held until this process ends: no other network of this computer has the domain.
ExitStack().enter_context(own_domain())


def generate_test_description() -> LaunchDescription:
    """Start the three nodes; another launch file, with a servo of yours, takes this one's place."""
    file = get_package_share_path("arm_emulator") / "launch/bringup.launch.py"
    arguments = {"scene": "three_axis", "start": "paused"}
    bringup = IncludeLaunchDescription(str(file), launch_arguments=arguments.items())
    return LaunchDescription([bringup, ReadyToTest()])


class TestTargets(unittest.TestCase):
    """Every call waits until the nodes can serve it."""

    def test_the_tool_reaches_its_target(self) -> None:
        with testing.joined() as net:
            target = net.send_tool_target((0.43, 0.05, 0.64), at=0.2)
            net.go_on()
            net.wait_for(target)
            self.assertLess(net.time, 2.0)


@post_shutdown_test()
class TestEnd(unittest.TestCase):
    """After the nodes were ended."""

    def test_every_node_ends_well(self, proc_info: ProcInfoHandler) -> None:
        assertExitCodes(proc_info)
