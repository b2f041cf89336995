"""Current loops of synchronous motors, apart from their declaration."""

from oracles.parts import current_loop

NUMBERS = """
[joints.NAME.motor.current_loop of pmsm]
bandwidth               Hz          none        > 0
proportional_gain       V/A         none        > 0
integral_gain           V/(A s)     none        >= 0
emf_feedforward         1           1           0 to 1
"""
ON_BASE = "FieldOrientedLoop<Pmsm>{{}, {}, {1.0, 1.0, 1.0, 1.0, 1.0, 1.0}}", "R"
draw_section = current_loop.draw_section
