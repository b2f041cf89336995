"""Truths of all sensors with an amplifier and a converter; U: unit of the quantity."""

NUMBERS_OF_CONVERTERS = """
gain_error              1           none        -1 to 1
noise                   U           none        0 to 1e6
range                   U           none        > 0
resolution              U           none        > 0
held                    1           none        0 to 1
drift                   U/s         none        -1e6 to 1e6
"""
NUMBERS_OF_SENSORS = f"""{NUMBERS_OF_CONVERTERS}\
offset                  U           none        -1e6 to 1e6
delay                   servo periods  0        whole 0 to 100
"""
# {}: the key of the reading where the quantity is 0.
FAULTS_OF_CONVERTERS = """
S_offset                U           0.5     -1e6 to 1e6  S.{} x + m
S_drifts                U/s         0.5     -1e6 to 1e6  S.drift x + m
S_gain                  1           0.1     -1 to 1     S.gain_error x + m
S_stuck                 1           1       0 to 1      S.held 1 - (1 - x) (1 - m)
S_noisy                 U           0.1     0 to 1e6    S.noise x + m
S_saturates             1           0.9     0 to 0.999  S.range (1 - m) x
"""
FAULTS_OF_SENSORS = FAULTS_OF_CONVERTERS.format("offset")
