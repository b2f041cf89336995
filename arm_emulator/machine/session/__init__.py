"""A plant over logical time: commands, clocks, controllers, records."""
