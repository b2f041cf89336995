"""ROS node `servo`."""
