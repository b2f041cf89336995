"""Encoders at motors and at links, apart from their declaration."""

NUMBERS = """
[joints.NAME.encoder]
[joints.NAME.link_encoder]
offset                  rad         none        -1e4 to 1e4
eccentricity            rad         none        0 to 1
eccentricity_phase      rad         none        -1e4 to 1e4
ripple                  rad         none        0 to 1
ripple_phase            rad         none        -1e4 to 1e4
noise                   rad         none        0 to 1
missed                  1           none        0 to 0.5
held                    1           none        0 to 1
flips                   1           none        0 to 1
counts_per_turn         counts      needed      whole 1 to 1e9
delay                   servo periods  0        whole 0 to 100
ripple_order            -           2           whole 1 to 1e6
"""
FAULTS = """
[of joints, S = encoder]
[of joints, S = link_encoder]
S_slips                 rad         0.1     -1000 to 1000  S.offset x + m
S_misses_edges          1           0.1     0 to 0.5    S.missed x + m (1 - 2 x)
S_stuck                 1           1       0 to 1      S.held 1 - (1 - x) (1 - m)
S_flips_bits            1           0.1     0 to 1      S.flips 1 - (1 - x) (1 - m)
S_noisy                 rad         1e-3    0 to 1      S.noise x + m
S_off_centre            rad         0.01    0 to 1      S.eccentricity x + m
S_ripples               rad         1e-3    0 to 1      S.ripple x + m
"""
OUTPUTS = {
    "index_counts": ("", ""),
    "index_pulses": ("", ""),
    "link_encoder_counts": ("", ""),
    "link_index_counts": ("", ""),
    "link_index_pulses": ("", ""),
}
