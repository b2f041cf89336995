"""The emulated machine: scene, plant, fleet, session. Knows nothing of ROS."""
