"""Every pair of parts, at one joint and at two, keeps the order that the pages promise."""

import itertools
from functools import cache
from pathlib import Path

import pytest
from draws import FULL, some

from arm_emulator.machine.scene.known_parts import PARTS
from arm_emulator.machine.schemes.known import LOCATING_SCHEMES, SCHEMES
from oracles import part_pairs

DRAWS = 40 if FULL else 8  # of each machine: 1 000 with each scheme
SHARES = (1, 0, 2, 3, 4, 5)  # of the machines; the first has play opposite dry friction
AT_STEPS = [scheme for scheme in SCHEMES if scheme not in LOCATING_SCHEMES]


@cache
def machines() -> list[tuple[part_pairs.RandomJoint, part_pairs.RandomJoint]]:
    return list(part_pairs.draw_machines())


def judge(share: int, scheme: str, folder: Path) -> None:
    """Hold the claim against all draws of the machines of a share."""
    for machine, joints in some(list(enumerate(machines()))[share :: len(SHARES)], 1):
        place = folder / str(machine)
        place.mkdir()
        file = part_pairs.write_machine(place, joints, machine)
        for seed in range(DRAWS):
            verdict = part_pairs.judge_pair(file, joints, machine, seed, scheme)
            assert verdict.in_order, verdict


@pytest.mark.slow
@pytest.mark.parametrize(("share", "scheme"), some(itertools.product(SHARES, LOCATING_SCHEMES), 1))
def test_located_events_keep_order_two(share: int, scheme: str, tmp_path: Path) -> None:
    judge(share, scheme, tmp_path)


@pytest.mark.skipif(not FULL, reason="another scheme is compiled for each: make test-in-full")
@pytest.mark.parametrize(("share", "scheme"), list(itertools.product(SHARES, AT_STEPS)))
def test_events_at_steps_have_order_1(share: int, scheme: str, tmp_path: Path) -> None:
    judge(share, scheme, tmp_path)


@pytest.mark.slow
def test_the_machines_have_every_part_beside_and_opposite_every_part() -> None:
    """The list of pairs is drawn: each part must be in it, with all that a joint may have."""
    pairs = set().union(*map(part_pairs.list_pairs, machines()))
    assert pairs == part_pairs.list_all_pairs()
    for kind in PARTS:
        assert (False, frozenset({kind.__name__})) in pairs, f"{kind.__name__} opposite itself"
