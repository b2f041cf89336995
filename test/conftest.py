"""What all tests share."""

import pytest

# So that their bare assertions say what was compared, too.
pytest.register_assert_rewrite("machines", "network")
