"""The schemes, from their registry."""

from arm_emulator.machine.schemes.registry import SCHEME_KINDS
from arm_emulator.machine.schemes.scheme import Scheme


def _get_rank(scheme: type[Scheme]) -> tuple[bool, int, int, str]:
    """The default first, then the cheapest: by evaluations, and by order among these."""
    return not scheme.default, scheme.evaluations, -scheme.order, scheme.name


# By name; the first is the default.
KNOWN = {value.name: value for value in sorted(SCHEME_KINDS.list_kinds().values(), key=_get_rank)}
SCHEMES = tuple(KNOWN)
LOCATING_SCHEMES = tuple(name for name, kind in KNOWN.items() if kind.locates)
