"""The emulated machine: scene, plant, fleet, session. Without ROS."""
