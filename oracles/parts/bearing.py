"""Bearings that give way, apart from their declaration."""

NUMBERS = """
[joints.NAME.bearing.shift_x]
[joints.NAME.bearing.shift_y]
[joints.NAME.bearing.shift_z]
stiffness               N/m         needed      > 0     1e5 to 1e7
damping                 N s/m       0           >= 0    0 to 1e3

[joints.NAME.bearing.tilt_x]
[joints.NAME.bearing.tilt_y]
[joints.NAME.bearing.tilt_z]
stiffness               N m/rad     needed      > 0     1e3 to 1e5
damping                 N m s/rad   0           >= 0    0 to 10
"""
OUTPUTS = {f"bearing_shift_{axis}": ("m", "m") for axis in "xyz"} | {
    f"bearing_tilt_{axis}": ("rad", "rad") for axis in "xyz"
}
