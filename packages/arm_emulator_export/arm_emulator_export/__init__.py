"""Files of a scene for programs of others: ros2_control, MoveIt, Foxglove."""
