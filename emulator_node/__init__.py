"""The emulated machine: scene, plant, compiled core, and its ROS node."""
