"""The registry of schemes: each is registered in its file, by its name."""

from arm_emulator.base.registry import Registry
from arm_emulator.machine.schemes.scheme import Scheme

SCHEME_KINDS = Registry[Scheme]("scheme", __package__ or "", lambda kind: str(kind.name))
register_scheme = SCHEME_KINDS.register
