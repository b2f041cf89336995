"""Rate of a node's health messages: at each change, and every second."""

import functools
from collections.abc import Iterator

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from in_process import InProcess, in_process

import servo_node.node
from arm_emulator.base.refusal import Refusal
from arm_emulator.motion.executor.goal_status import GoalState, GoalStatus, Kind
from arm_emulator.ros.node.node_shell import NodeLog


@pytest.fixture(scope="module")
def nodes() -> Iterator[InProcess]:
    with in_process() as running:
        yield running


@pytest.fixture
def printed(nodes: InProcess, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return the servo's health messages, with nothing else running."""
    printed: list[str] = []

    def hear(message: DiagnosticArray) -> None:
        printed.extend(status.message for status in message.status)

    monkeypatch.setattr(nodes.nodes["servo"]._diagnostics, "send", hear)
    return printed


def test_a_message_whose_figures_change_waits_for_its_second(
    nodes: InProcess, printed: list[str]
) -> None:
    health = nodes.nodes["servo"]._diagnostics
    for tick in range(1000):  # what a servo that holds reports at each tick
        health.report_warning(
            f"holding: no joint target for {1e-3 * tick:.3g} s, more than hold_after"
        )
    health.publish_now()  # as once in a second
    assert len(printed) == 2, "the first at once, and the newest when its second has come"
    assert "for 0 s" in printed[0] and "for 0.999 s" in printed[1]


def test_changed_words_or_another_level_are_published_immediately(
    nodes: InProcess, printed: list[str]
) -> None:
    health = nodes.nodes["servo"]._diagnostics
    health.report_ok("following")
    health.report_warning("following")
    health.report_warning("holding: 1e-5 rad")
    health.report_warning("holding: -2.5e+3 rad")
    health.report_error("holding: 7 rad")
    assert printed == ["following", "following", "holding: 1e-5 rad", "holding: 7 rad"]


def test_refusals_are_logged_once_in_a_while_and_those_between_are_counted() -> None:
    lines: list[str] = []

    class Logger:
        warning = staticmethod(lines.append)
        info = staticmethod(lines.append)

    at = 0.0
    log = NodeLog(Logger(), lambda: at)
    for k in range(1000):  # 10 s, a refusal every 10 ms; and beside them one of another kind
        at = 0.01 * k
        log.warn_about("motor_commands", f"refused: {k}")
        if k == 300:
            log.log_info("REACHED", "tool target 1 reached")
    assert lines == ["refused: 0", "tool target 1 reached", "refused: 500 (and 499 more before)"]


def test_a_node_logs_refusals_and_outcomes(
    nodes: InProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    lines: list[tuple[str, str, str]] = []
    for node in nodes.nodes.values():
        for level in ("log_info", "warn_about"):
            log = node._diagnostics.log
            put = functools.partial(
                lambda level, kind, line: lines.append((level, kind, line)), level
            )
            monkeypatch.setattr(log, level, put)
    nodes.nodes["servo"]._diagnostics.refuse_input("motor_states", Refusal("here", "q", "be 1", 2))
    motion = nodes.nodes["motion_controller"]
    motion._motion.reports.waiting.extend(
        GoalStatus(state, "a reason", 0.0012, kind=Kind.TOOL_TARGET, number=1, stamp_ns=0)
        for state in GoalState
    )
    motion._report_status()
    assert lines == [
        ("warn_about", "motor_states: be #", "refused: here: q must be 1, got 2"),
        ("log_info", "REACHED", "tool target 1 reached, 1.2 mm left: a reason"),
        ("warn_about", "UNREACHABLE", "tool target 1 unreachable, 1.2 mm left: a reason"),
        ("log_info", "REPLACED", "tool target 1 replaced, 1.2 mm left: a reason"),
        ("warn_about", "ABORTED", "tool target 1 aborted, 1.2 mm left: a reason"),
    ]


def test_a_servo_reports_a_silence_from_its_time_to_cut_on(
    nodes: InProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    nodes.run_to(5)
    servo, warned = nodes.nodes["servo"], list[str]()
    monkeypatch.setattr(servo._diagnostics, "report_warning", warned.append)
    times = servo._config.hold_after, servo._config.cut_after
    assert times == (0.2, 2.0)
    for silence, count in ((0.3, 0), (1.9, 0), (2.1, 1)):
        now = servo._at.heard + round(silence * 1e9)
        monkeypatch.setattr(servo_node.node, "read_clock", lambda now=now: now)
        servo._check_silence()
        assert len(warned) == count, f"{warned} after {silence} s"
