"""A ROS domain of one's own: no process is in it, and none joins it."""

import os
import random
import socket
import subprocess
import sys
from contextlib import ExitStack

import pytest

from arm_emulator.base.refusal import Refusal
from arm_emulator.ros.process.ros_domain import (
    DOMAINS,
    PORTS,
    claim_domain,
    is_occupied,
    own_domain,
)

CLAIM_SOME = """
import sys
from arm_emulator.ros.process.ros_domain import own_domain
with own_domain() as domain:
    print(domain, flush=True)
    sys.stdin.read()
"""


@pytest.mark.slow
def test_processes_that_choose_at_once_choose_differently() -> None:
    """More processes than there are domains to choose from first."""
    count = len(DOMAINS[0]) + 5
    command = [sys.executable, "-c", CLAIM_SOME]
    with ExitStack() as ending:
        others = [
            subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
            for _ in range(count)
        ]
        for process in others:
            ending.enter_context(process)  # which ends with its standard input
        chosen = [
            int(process.stdout.readline()) for process in others if process.stdout is not None
        ]
        assert len(set(chosen)) == count, f"of {count} processes, the domains {sorted(chosen)}"
        assert all(claim_domain(domain) is None for domain in chosen), (
            "a claimed domain was given away"
        )


@pytest.mark.parametrize("seed", range(5))
def test_a_domain_that_somebody_is_in_is_not_chosen(seed: int) -> None:
    """The first participant may have left, and a later one still be there."""
    rng = random.Random(seed)
    with own_domain() as domain:
        assert not is_occupied(domain), f"domain {domain} was chosen though somebody is in it"
        port = 7400 + PORTS * domain + 10 + 2 * rng.randrange(100) + rng.randrange(2)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as participant:
            participant.bind(("127.0.0.1" if rng.random() < 0.5 else "0.0.0.0", port))
            assert is_occupied(domain), f"port {port} is taken, and domain {domain} counts as free"


def test_the_environment_is_as_before_afterwards(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    with own_domain() as domain:
        assert os.environ["ROS_DOMAIN_ID"] == str(domain)
    assert os.environ["ROS_DOMAIN_ID"] == "7"
    with own_domain(unless_named=True) as domain:
        assert domain == 7
    monkeypatch.setenv("ROS_DOMAIN_ID", "seven")
    words = "ROS_DOMAIN_ID must be a whole number from 0 to 232, got seven"
    with pytest.raises(Refusal, match=words), own_domain(unless_named=True):
        pass
