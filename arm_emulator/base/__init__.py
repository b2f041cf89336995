"""What all other packages build on: refusals, bounds, files, parameters; no physics, no ROS."""
