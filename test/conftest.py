"""What all tests share."""

import pytest

# So that their bare assertions say what was compared, too.
pytest.register_assert_rewrite(
    "doors", "fuzz", "in_process", "machines", "network", "random_messages", "random_scenes"
)
