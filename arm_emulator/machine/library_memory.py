"""Memory that a shared library with control code has from step to step."""

from __future__ import annotations

import ctypes

from arm_emulator.base.refusal import Refusal
from arm_emulator.build.elf import address_in, called_functions, written_memory

# Functions of others that remember nothing.
_MATHEMATICS = """acos acosh asin asinh atan atan2 atanh cbrt ceil copysign cos cosh erf erfc exp
    exp2 expm1 fabs fdim floor fma fmax fmin fmod frexp hypot ilogb ldexp llrint llround log log10
    log1p log2 logb lrint lround modf nearbyint nextafter pow remainder remquo rint round scalbln
    scalbn sin sincos sinh sqrt tan tanh tgamma trunc""".split()
_FORGETFUL = {
    *(f"{name}{kind}" for name in _MATHEMATICS for kind in ("", "f", "l")),
    *"abs labs llabs memchr memcmp memcpy memmove memset strcmp strlen strncmp".split(),
    *"__memcpy_chk __memmove_chk __memset_chk __stack_chk_fail".split(),
    *"__cxa_atexit __cxa_guard_acquire __cxa_guard_release __cxa_pure_virtual".split(),
}


class LibraryMemory:
    """Variables of a loaded library, in functions and outside of them.

    Args:
        name: of its file, for refusals.
        content: of the file.
        known: name of one of its functions.
        at: address of that in memory.
    """

    def __init__(self, name: str, content: bytes, known: str, at: int) -> None:
        self._name = name
        base = at - address_in(content, known)
        self._pieces = [(base + begin, size) for begin, size in written_memory(content)]
        self._others = called_functions(content) - _FORGETFUL

    def save(self) -> bytes:
        """Return the variables as they are now.

        Raises:
            Refusal: the library may remember more than its variables.
        """
        if self._others or not self._pieces:
            got = ", ".join(sorted(self._others)) if self._pieces else "variables of threads"
            rule = "remember nothing but its variables, to be saved"
            valid = "control code that calls mathematics and memcpy alone; or a run from its start"
            raise Refusal(self._name, "the library", rule, got, valid)
        return b"".join(ctypes.string_at(begin, size) for begin, size in self._pieces)

    def restore(self, saved: bytes) -> None:
        """Set the variables to what `save` has returned."""
        for begin, size in self._pieces:
            ctypes.memmove(begin, saved[:size], size)
            saved = saved[size:]
