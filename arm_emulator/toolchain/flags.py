"""Compiler flags shared by several units."""

# A library calls its own functions, even if the process has loaded others of the same names
# globally, for example an FMU beside a scene.
SHARED = ("-shared", "-fPIC", "-Wl,-Bsymbolic")

# Version of the arithmetic of machines and servos. It is raised with every change of which the
# purpose or the price is that the same numbers are rounded otherwise.
_ARITHMETIC = 3
ARITHMETIC = f"portable {_ARITHMETIC}"  # as bags and results of runs state it

# All C++ that computes machines and motions. Sums and products are computed as they are written, so
# that every compiler and processor gives the same bits. The code never asks for errno, traps or the
# sign of zero.
CPP_FLAGS = (
    *"-std=c++20 -O3 -fno-math-errno -fno-trapping-math -fno-signed-zeros".split(),
    "-ffp-contract=off",
    f"-DARM_ARITHMETIC={_ARITHMETIC}",
    *SHARED,
)

# Control code and loops in C. Without contraction of products and sums, all processors give the
# same bits.
C_FLAGS = (*"-x c -std=c99 -O2 -ffp-contract=off -fno-semantic-interposition".split(), *SHARED)
