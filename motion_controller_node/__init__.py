"""ROS node `motion_controller`."""
