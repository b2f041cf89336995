"""Common parts of the nodes: states, parameters, health, executor."""
