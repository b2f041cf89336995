"""ROS functions shared by nodes and commands, independent of machine and control."""
