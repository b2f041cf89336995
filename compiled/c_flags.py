"""Flags for control code and loops in C."""

# No contraction of products and sums: the same bits whatever the processor has.
C_FLAGS = tuple(
    "-x c -std=c99 -O2 -shared -fPIC -ffp-contract=off -fno-semantic-interposition".split()
)
