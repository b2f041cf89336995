"""Bytes damaged in the ways that any file may be."""

import numpy as np

Rng = np.random.Generator


NUMBERS = (0, 1, 2**15, 2**16 - 1, 2**31 - 1, 2**31, 2**32 - 1, 2**63 - 1, 2**64 - 1)


def damaged(rng: Rng, data: bytes) -> bytes:
    """Return some bytes, spoiled in one to four places."""
    body = bytearray(data)
    for _ in range(int(rng.integers(1, 5))):
        size = len(body)
        if size == 0:
            break
        # Often at the begin or the end, where headings and indices are.
        at = int(rng.choice([rng.integers(size), min(size - 1, int(rng.exponential(100.0))),
                             max(0, size - 1 - int(rng.exponential(100.0)))]))  # fmt: skip
        much = int(rng.integers(1, 65))
        match int(rng.integers(10)):
            case 0:
                body[at] ^= 1 << int(rng.integers(8))
            case 1:
                del body[at:]
            case 2:
                del body[at : at + much]
            case 3:
                body[at:at] = rng.bytes(much)
            case 4:
                body[at : at + much] = rng.bytes(len(body[at : at + much]))
            case 5:
                body[at : at + much] = bytes(len(body[at : at + much]))
            case 6:
                source = int(rng.integers(size))
                body[at:at] = body[source : source + int(rng.integers(1, size + 1))]
            case 7:
                number = int(rng.choice(np.array(NUMBERS, dtype=object)))
                width = int(rng.choice([2, 4, 8]))
                number &= (1 << 8 * width) - 1
                body[at : at + width] = number.to_bytes(width, "little")
            case 8:
                body += bytes(int(10 ** rng.uniform(0, 6)))
            case _:
                replacements = (b"", rng.bytes(size), bytes(size), body + body, body[::-1])
                body[:] = replacements[int(rng.integers(len(replacements)))]
    return bytes(body)
