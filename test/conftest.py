"""What all tests share."""

import os

import pytest

# Before NumPy is loaded: matrices of tests are small, and threads that work on them together beside
# other work mostly wait for each other, spinning.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# So that their bare assertions say what was compared, too.
pytest.register_assert_rewrite(
    "doors",
    "fuzz",
    "in_process",
    "machines",
    "network",
    "random_messages",
    "random_scenes",
    "stick_slip",
)
