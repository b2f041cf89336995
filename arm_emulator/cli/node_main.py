"""Entry points of `ros2 run arm_emulator ..._node`: Ctrl-C ends them while they import, too."""

import importlib

from arm_emulator.ros.process.ctrl_c import end_at_once


def emulator() -> None:
    """Run the node `emulator`."""
    _run_module("emulator_node.node")


def servo() -> None:
    """Run the node `servo`."""
    _run_module("servo_node.node")


def motion_controller() -> None:
    """Run the node `motion_controller`."""
    _run_module("motion_controller_node.node")


def _run_module(module: str) -> None:
    end_at_once(0)
    importlib.import_module(module).main()
