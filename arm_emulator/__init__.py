"""An emulated industrial arm: a machine, its servo and its motion control."""
