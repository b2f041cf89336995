"""Sends a tool target, x y z [m] in the world: python examples/move_tool.py 0.43 0.05 0.64

For arms whose target is a position; one whose target is a pose would turn its tool upright, too.
"""

import math
import sys

import rclpy
from geometry_msgs.msg import PoseStamped

try:
    x, y, z = map(float, sys.argv[1:])
    if not all(map(math.isfinite, (x, y, z))):
        raise ValueError
except ValueError:
    got = " ".join(sys.argv[1:]) or "none"
    sys.exit(f"move_tool: the target must be three finite numbers, x y z [m], got {got}")
rclpy.init()
node = rclpy.create_node("move_tool")
publisher = node.create_publisher(PoseStamped, "tool_target", 1)
target = PoseStamped()  # stamp 0: holds at once
target.pose.position.x, target.pose.position.y, target.pose.position.z = x, y, z
# The motion controller listens; so do the emulator, to show it, and recorders. Who has not found us
# yet would miss it: it is published for a second after the first two have.
sent = waited = 0
while sent < 10:
    rclpy.spin_once(node, timeout_sec=0.1)
    if publisher.get_subscription_count() >= 2:
        publisher.publish(target)
        sent += 1
    elif (waited := waited + 1) == 30:
        print("waiting for a motion controller that listens to tool_target")
publisher.wait_for_all_acked()
print("published on tool_target; motion/status reports when it is reached")
