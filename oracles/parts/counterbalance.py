"""Springs that balance the weight of an arm, apart from their declaration."""

NUMBERS = """
[joints.NAME.counterbalance]
base_distance           m           needed      > 0, <= 100  0.3 to 0.5
link_distance           m           needed      > 0, <= 100  0.05 to 0.2
angle                   rad         0           -1e4 to 1e4  -3 to 3
force                   N           needed      -1e7 to 1e7  20 to 200
length                  m           needed      > 0, <= 200  0.4 to 0.6
stiffness               N/m         0           >= 0    20 to 200
gas_column              m           0           >= 0
"""
FAULTS = """
[of joints]
counterbalance_weakens  1           0.5     0 to 1      counterbalance.force (1 - m) x
                                                        counterbalance.stiffness (1 - m) x
"""
