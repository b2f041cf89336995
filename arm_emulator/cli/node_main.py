"""Entry points of `ros2 run arm_emulator ..._node`: Ctrl-C ends them while they import, too."""

import importlib

from arm_emulator.ros.process.ctrl_c import end_at_once


def emulator() -> None:
    """Run the node `emulator`."""
    _run("emulator_node.node")


def servo() -> None:
    """Run the node `servo`."""
    _run("servo_node.node")


def motion_controller() -> None:
    """Run the node `motion_controller`."""
    _run("motion_controller_node.node")


def _run(module: str) -> None:
    end_at_once(0)
    importlib.import_module(module).main()
