"""The line between a controller and its drives, apart from its declaration."""

NUMBERS = """
[joints.NAME.line]
command_late            servo periods  none     0 to 16
command_lost            1           none        0 to 1
command_repeated        1           none        0 to 1
command_overtaken       1           none        0 to 1
command_corrupted       1           none        0 to 1
measurement_late        servo periods  none     0 to 16
measurement_lost        1           none        0 to 1
measurement_repeated    1           none        0 to 1
measurement_overtaken   1           none        0 to 1
measurement_corrupted   1           none        0 to 1
silent                  1           none        0 to 1
swapped                 1           none        0 to 1
"""
FAULTS = """
[of joints]
command_late            servo periods  3    0 to 16  line.command_late x + m
command_lost            1           0.3     0 to 1  line.command_lost 1 - (1 - x) (1 - m)
command_repeated        1           0.3     0 to 1  line.command_repeated 1 - (1 - x) (1 - m)
command_overtaken       1           0.3     0 to 1  line.command_overtaken 1 - (1 - x) (1 - m)
command_corrupted       1           0.1     0 to 1  line.command_corrupted 1 - (1 - x) (1 - m)
measurement_late        servo periods  3    0 to 16  line.measurement_late x + m
measurement_lost        1           0.3     0 to 1  line.measurement_lost 1 - (1 - x) (1 - m)
measurement_repeated    1           0.3     0 to 1  line.measurement_repeated 1 - (1 - x) (1 - m)
measurement_overtaken   1           0.3     0 to 1  line.measurement_overtaken 1 - (1 - x) (1 - m)
measurement_corrupted   1           0.1     0 to 1  line.measurement_corrupted 1 - (1 - x) (1 - m)
controller_frozen       1           1       0 to 1  line.command_lost 1 - (1 - x) (1 - m)
controller_restarts     1           1       0 to 1  line.silent 1 - (1 - x) (1 - m)
encoders_swapped        1           1       0 to 1  line.swapped 1 - (1 - x) (1 - m)
"""
