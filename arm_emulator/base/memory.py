"""Detection of errors that mean out of memory, which libraries report in various ways."""

import errno

_WORDS = ("cannot allocate memory", "failed to map segment", "can't start new thread", "bad_alloc")


def is_out_of_memory(error: BaseException | None) -> bool:
    """Return whether an error, or its cause, is a lack of memory."""
    while error is not None:
        if isinstance(error, MemoryError) or getattr(error, "errno", None) == errno.ENOMEM:
            return True
        text = str(error).lower()
        if any(words in text for words in _WORDS):
            return True
        error = error.__cause__ or error.__context__
    return False
