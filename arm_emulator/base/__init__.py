"""Base of all other packages: refusals, bounds, files, parameters; no physics, no ROS."""
