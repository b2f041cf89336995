"""Time of steps and of nodes, beside their error and beside other simulators."""
