"""Compiler flags shared by several units."""

# A library calls its own functions, even if the process has loaded others of the same names
# globally, for example an FMU beside a scene.
SHARED = ("-shared", "-fPIC", "-Wl,-Bsymbolic")

# Control code and loops in C. Without contraction of products and sums, all processors give the
# same bits.
C_FLAGS = (*"-x c -std=c99 -O2 -ffp-contract=off -fno-semantic-interposition".split(), *SHARED)
