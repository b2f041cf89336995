"""Drives of field buses in a timeline: any tick of their past and its forks, to the last bit."""

import random
from collections.abc import Callable

import pytest
from cia402 import (
    ACTUAL,
    CONTROL,
    CSP,
    CST,
    CSV,
    ENABLE,
    HM,
    MODE,
    PP,
    PV,
    RICH,
    SHUTDOWN,
    SWITCH_ON,
    TARGET,
    TQ,
    N,
    make,
)  # fmt: skip

from arm_emulator import Refusal, Timeline
from arm_emulator_fieldbus.drives import Drives
from arm_emulator_fieldbus.object_dictionary import Aborted

LAST, EVERY = 400, 64  # ticks


def words(rng: random.Random) -> Callable[[Drives], None]:
    """Return what a master may write between two periods, drawn."""
    seed = rng.randrange(2**32)

    def write(drives: Drives) -> None:
        draw = random.Random(seed)
        for j in range(N):
            control = draw.choice((SHUTDOWN, SWITCH_ON, *[ENABLE] * 6, 0x1F, 0x3F, 0x0B, 0x80))
            drives.write(j, CONTROL, control)
            drives.write(j, MODE, draw.choice((CSP, CSP, CSV, CST, PP, PV, TQ, HM)))
            drives.write(j, TARGET, drives.read(j, ACTUAL) + draw.randrange(-500, 500))
            drives.write(j, 0x60FF, draw.randrange(-20000, 20000))
            drives.write(j, 0x6071, draw.randrange(-300, 300))
            drives.write(j, 0x60B8, draw.choice((0, 0x05, 0x15, 0x17)))  # touch probes
        if draw.random() < 0.05:
            drives.plant.powered = not drives.plant.powered

    return write


def enabled(drives: Drives) -> None:
    """Close the contactors, in which drives spend some periods."""
    for word in (SHUTDOWN, SWITCH_ON, ENABLE):
        for j in range(N):
            drives.write(j, CONTROL, word)
        drives.period(5)


def read_everything(drives: Drives) -> tuple[bytes, list[bytes]]:
    """The machine, and every entry of every dictionary."""
    values = []
    for j in range(N):
        for entry in drives.entries:
            try:
                values.append(drives.upload_entry(j, entry.index, entry.sub))
            except Aborted as no:
                values.append(no.code.to_bytes(4, "little"))
    return drives.plant.save(), values


def draw_changes(seed: int) -> list[tuple[int, Callable[[Drives], None]]]:
    """Changes by their ticks."""
    rng = random.Random(seed)
    return [(tick, words(rng)) for tick in sorted(rng.sample(range(LAST), 60))]


def straight(seed: int, until: int) -> Drives:
    """Drives that went on to a tick without a timeline."""
    drives = make(RICH)
    enabled(drives)
    begin = drives.tick
    for tick, write in draw_changes(seed):
        if tick > until:
            break
        drives.period(begin + tick - drives.tick)
        write(drives)
    drives.period(begin + until - drives.tick)
    return drives


@pytest.mark.parametrize("seed", range(3))
def test_any_tick_of_the_past_has_the_bits_of_the_straight_run(seed: int) -> None:
    drives = make(RICH)
    enabled(drives)
    begin = drives.tick
    line = Timeline(drives, every=EVERY)
    for tick, write in draw_changes(seed):
        line.advance(begin + tick - line.tick)
        line.change("words", write)
    line.advance(begin + LAST - line.tick)
    rng = random.Random(seed)
    for tick in [*rng.sample(range(LAST), 8), LAST]:
        line.go_to(begin + tick)
        assert drives.tick == begin + tick
        assert read_everything(drives) == read_everything(straight(seed, tick)), f"at tick {tick}"


def test_forks_of_drives_go_on_as_if_they_were_alone() -> None:
    drives = make(RICH)
    enabled(drives)
    line = Timeline(drives, every=EVERY)
    line.advance(100)
    fork = line.fork()
    line.change("a", words(random.Random(1)))
    line.advance(100)
    fork.change("b", words(random.Random(2)))
    fork.advance(60)
    second = fork.fork()
    second.change("c", words(random.Random(3)))
    second.advance(40)
    for branch, seeds in ((line, ((0, 1),)), (fork, ((0, 2),)), (second, ((0, 2), (60, 3)))):
        branch.go_to(branch.newest)
        alone = make(RICH)
        enabled(alone)
        alone.period(100)
        for at, seed in seeds:
            alone.period(at)
            words(random.Random(seed))(alone)
        alone.period(branch.newest - alone.tick)
        assert read_everything(drives) == read_everything(alone)


def test_states_of_different_drives_are_refused() -> None:
    first, second = make(), make()
    for state in (second.save(), b"", None):
        with pytest.raises(Refusal, match="the same drives"):
            first.restore(state)  # type: ignore[arg-type]
    before = read_everything(first)
    saved = first.save()
    assert len(saved) > len(saved.machine) + 1000
    first.period(10)
    first.restore(saved)
    assert read_everything(first) == before
