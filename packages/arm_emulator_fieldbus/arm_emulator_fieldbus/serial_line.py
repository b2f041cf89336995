"""A serial line such as RS485: times of transmission, and damage."""

import math
import random

from arm_emulator.extension.base import Refusal

BITS_PER_BYTE = 11  # start, 8 of data, parity or a second stop, stop
LARGEST_BAUD = 100_000_000
SMALLEST_RATE = 1e-12  # of damaged bytes, other than none


def compute_bytes_time(count: int, baud: int) -> int:
    """Return the time of transmission of bytes [ns]."""
    return -(-count * BITS_PER_BYTE * 10**9 // baud)


def compute_silence(baud: int) -> int:
    """Return the silence between Modbus frames [ns]: 3.5 bytes, beyond 19200 bit/s 1.75 ms."""
    return 1_750_000 if baud > 19_200 else -(-7 * BITS_PER_BYTE * 10**9 // (2 * baud))


class LineErrors:
    """Damages bytes on their way, at random but the same for the same seed.

    The draws go by bytes, so that it does not matter in which pieces the line brings them. Half of
    the damaged bytes are lost, the others come with one to eight of their bits flipped.

    Attributes:
        count: how many bytes were damaged.

    Args:
        rate: share of damaged bytes, from 0 to less than 1.
        seed: of the draws.

    Raises:
        Refusal: no such share.
    """

    def __init__(self, rate: float, seed: int) -> None:
        if rate != 0.0 and not SMALLEST_RATE <= rate < 1.0:
            rule = f"be 0, or from {SMALLEST_RATE:g} to less than 1"
            raise Refusal("line", "error rate", rule, rate)
        self.count = 0
        self._random = random.Random(seed)
        self._scale = 1.0 / math.log1p(-rate) if rate else None
        self._until = self._draw_gap()

    def _draw_gap(self) -> int:
        """Return how many sound bytes come before the next one that is damaged."""
        if self._scale is None:
            return -1
        return int(math.log(1.0 - self._random.random()) * self._scale)

    def damage_bytes(self, data: bytes) -> bytes:
        """Return what arrives of bytes."""
        if self._scale is None:
            return data
        if self._until >= len(data):
            self._until -= len(data)
            return data
        arrived = bytearray()
        for byte in data:
            if self._until:
                self._until -= 1
                arrived.append(byte)
                continue
            self.count += 1
            self._until = self._draw_gap()
            if self._random.random() < 0.5:
                mask = 0
                while not mask:  # each bit with one half
                    mask = self._random.getrandbits(8)
                arrived.append(byte ^ mask)
        return bytes(arrived)
