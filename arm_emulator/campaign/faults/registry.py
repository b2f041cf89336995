"""The registry of faults of campaigns: each is registered in its file, by its `kind`."""

from __future__ import annotations

from arm_emulator.base.registry import Registry
from arm_emulator.campaign.fault import Fault

FAULT_KINDS = Registry[Fault]("fault", __package__ or "", lambda kind: str(kind.kind))
register_fault = FAULT_KINDS.register
