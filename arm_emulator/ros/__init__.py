"""What the nodes and the commands share of ROS; it knows neither the machine nor its control."""
