"""An unused ROS domain on this computer."""

import os
import random
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from arm_emulator.base.refusal import Refusal
from arm_emulator.workarounds.fastdds_shared_memory import clear_left_over

# Domains whose ports are not among Linux's ephemeral ports. The upper ones come first: users and
# their scripts take small numbers, and may join a domain at any time.
DOMAINS = (range(215, 232), range(1, 102))
LARGEST = 232
PORTS = 250  # of a domain, from 7400 on (DDSI-RTPS 9.6.2)


@contextmanager
def own_domain(unless_named: bool = False) -> Iterator[int]:
    """Put this process and its children into a ROS domain that is not in use.

    The domain is held until the end of the block: no other process gets it, of any user.

    Args:
        unless_named: stay in the domain that the environment names, if it names one.

    Raises:
        Refusal: every domain is taken, or the named one is invalid.
    """
    named = os.environ.get("ROS_DOMAIN_ID")
    if unless_named and named:
        if not (named.isdecimal() and int(named) <= LARGEST):
            rule = f"be a whole number from 0 to {LARGEST}"
            raise Refusal("environment", "ROS_DOMAIN_ID", rule, named)
        yield int(named)
        return
    clear_left_over()  # whoever joins a domain opens its ports
    domain, claim = _free_domain()
    mine = {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    before = {name: os.environ.get(name) for name in mine}
    os.environ.update(mine)
    try:
        with claim:
            yield domain
    finally:
        for name, value in before.items():
            os.environ.pop(name)
            if value is not None:
                os.environ[name] = value


def _free_domain() -> tuple[int, socket.socket]:
    for domains in DOMAINS:
        for domain in random.SystemRandom().sample(domains, len(domains)):
            claim = claim_domain(domain)
            if claim is not None:
                return domain, claim
    raise Refusal("arm_emulator", "ROS domain", "be free", "all taken", "end a network, then again")


def claim_domain(domain: int) -> socket.socket | None:
    """Return an object that holds a domain until closed, None if it is claimed or in use.

    The claim comes first: checking whether a domain is free and taking it later would let two
    processes take the same one.
    """
    # A name without a file: it ends with the process, and serves every user.
    claim = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        claim.bind(f"\0arm_emulator: ROS domain {domain}")
    except OSError:
        claim.close()
        return None
    if is_occupied(domain):
        claim.close()
        return None
    return claim


def is_occupied(domain: int) -> bool:
    """Whether a participant, the first or a later one, has a port of the domain."""
    first = 7400 + PORTS * domain
    for table in ("udp", "udp6"):
        try:
            lines = Path("/proc/net", table).read_text(encoding="ascii").splitlines()[1:]
        except OSError:
            continue
        for line in lines:
            port = int(line.split()[1].rpartition(":")[2], 16)
            if first <= port < first + PORTS:
                return True
    return False
