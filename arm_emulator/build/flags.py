"""Flags of the compiler that are the same for several units."""

# A library calls its own functions, whatever others of these names a process has loaded for all to
# see: for example an FMU beside a scene.
SHARED = ("-shared", "-fPIC", "-Wl,-Bsymbolic")

# Control code and loops in C. No contraction of products and sums: the same bits whatever the
# processor has.
C_FLAGS = (*"-x c -std=c99 -O2 -ffp-contract=off -fno-semantic-interposition".split(), *SHARED)
