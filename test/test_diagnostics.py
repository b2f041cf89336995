"""Rate of a node's health messages: at each change, and every second."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from in_process import InProcess, in_process


@pytest.fixture(scope="module")
def nodes() -> Iterator[InProcess]:
    with in_process() as one:
        yield one


@pytest.fixture
def printed(nodes: InProcess, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return the servo's health messages, with nothing else running."""
    printed: list[str] = []

    def hear(message: DiagnosticArray) -> None:
        printed.extend(one.message for one in message.status)

    monkeypatch.setattr(nodes.nodes["servo"]._diagnostics, "send", hear)
    return printed


def test_a_message_whose_figures_change_waits_for_its_second(
    nodes: InProcess, printed: list[str]
) -> None:
    health = nodes.nodes["servo"]._diagnostics
    for tick in range(1000):  # what a servo that holds reports at each tick
        health.warn(f"holding: no joint target for {1e-3 * tick:.3g} s, more than hold_after")
    health.publish()  # as once in a second
    assert len(printed) == 2, "the first at once, and the newest when its second has come"
    assert "for 0 s" in printed[0] and "for 0.999 s" in printed[1]


def test_other_words_or_another_level_are_published_at_once(
    nodes: InProcess, printed: list[str]
) -> None:
    health = nodes.nodes["servo"]._diagnostics
    health.ok("following")
    health.warn("following")
    health.warn("holding: 1e-5 rad")
    health.warn("holding: -2.5e+3 rad")
    health.error("holding: 7 rad")
    assert printed == ["following", "following", "holding: 1e-5 rad", "holding: 7 rad"]
