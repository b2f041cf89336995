"""ROS node `emulator`."""
