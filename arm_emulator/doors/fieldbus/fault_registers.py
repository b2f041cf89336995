"""Faults of a scene as registers: a magnitude each, and a name."""

from __future__ import annotations

import struct
from collections.abc import Sequence

from arm_emulator.base.refusal import Refusal
from arm_emulator.doors.fieldbus.modbus_rtu import Code, ModbusException
from arm_emulator.machine.session import Session

PER_FAULT = 40  # registers of a fault's name
_PER_MAGNITUDE = 4  # a float64


class FaultRegisters:
    """Words of the faults that a scene lists, in its order.

    Args:
        session: the machine.
    """

    def __init__(self, session: Session) -> None:
        self._session = session
        self._faults = [one.varied for one in session.scene.faults]

    def names(self) -> list[int]:
        """Return the words of all names, filled up with zeros."""
        size = 2 * PER_FAULT
        raw = b"".join(one.name.encode()[:size].ljust(size, b"\0") for one in self._faults)
        return list(struct.unpack(f">{len(raw) // 2}H", raw))

    def magnitudes(self) -> list[int]:
        """Return the words of all magnitudes that the machine has now."""
        present = self._session.plant.parameters
        raw = struct.pack(f">{len(self._faults)}d", *(present[one.name] for one in self._faults))
        return list(struct.unpack(f">{len(raw) // 2}H", raw))

    def take(self, at: int, words: Sequence[int]) -> None:
        """Set magnitudes from now on, all of them or none.

        Args:
            at: the first word, of those of `magnitudes`.
            words: of whole magnitudes.

        Raises:
            ModbusException: a part of a magnitude, or one out of its range; nothing has changed.
        """
        if at % _PER_MAGNITUDE or len(words) % _PER_MAGNITUDE:
            raise ModbusException(Code.VALUE)
        raw = struct.pack(f">{len(words)}H", *words)
        values = struct.unpack(f">{len(words) // _PER_MAGNITUDE}d", raw)
        chosen = self._faults[at // _PER_MAGNITUDE :]
        try:
            for one, value in zip(chosen, values, strict=False):
                one.number.take("modbus", value)
        except Refusal:
            raise ModbusException(Code.VALUE) from None
        for one, value in zip(chosen, values, strict=False):
            self._session.set_varied(one.name, value)
