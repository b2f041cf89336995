"""The card of this machine, for tests that need one."""

import pytest

from arm_emulator import Refusal
from arm_emulator_fleet.device import Device
from arm_emulator_fleet.open_device import open_device


@pytest.fixture(scope="session")
def card() -> Device:
    try:
        return open_device("test", "gpu")
    except Refusal as refused:
        pytest.skip(str(refused))
