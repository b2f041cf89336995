"""Breakpoints: C stops at the tick at which Python's condition begins to hold."""

import random
import time
from collections.abc import Callable

import numpy as np
import pytest
from by_hand import CLOCKS, go_on, session_of
from draws import some, with_slow
from in_process import InProcess, in_process
from network import PATIENCE

from arm_emulator import Breakpoint, Condition, Plant, Refusal, Session, load_scene
from arm_emulator_msgs.msg import MotorCommand
from arm_emulator_msgs.srv import BreakWhen

SIGNALS = (
    "q.waist", "v.elbow", "current.shoulder", "theta_m.elbow", "gear_torque.waist", "energy",
    "measured.encoder_counts.elbow", "measured.current.waist", "tool.x", "tool.y", "tool.z", "t",
)  # fmt: skip


def arithmetic(draw: random.Random, depth: int) -> str:
    if depth == 0 or draw.random() < 0.3:
        return draw.choice(SIGNALS) if draw.random() < 0.8 else f"{draw.uniform(-2.0, 2.0):.3g}"
    first, second = arithmetic(draw, depth - 1), arithmetic(draw, depth - 1)
    return draw.choice([
        f"({first} + {second})", f"({first} - {second})", f"({first} * {second})",
        f"({first} / {second})", f"abs({first})", f"sqrt({first})", f"min({first}, {second})",
        f"max({first}, {second}, 0.1)",
    ])  # fmt: skip


def formula(draw: random.Random, depth: int) -> str:
    if depth == 0 or draw.random() < 0.3:
        left = draw.choice(("v.*", "abs(q.*)")) if draw.random() < 0.2 else arithmetic(draw, 2)
        return f"{left} {draw.choice(('<', '<=', '>', '>='))} {arithmetic(draw, 1)}"
    first, second = formula(draw, depth - 1), formula(draw, depth - 1)
    return draw.choice([
        f"({first}) and ({second})", f"({first}) or ({second})", f"not ({first})",
        f"({first}) implies ({second})",
    ])  # fmt: skip


@pytest.mark.parametrize("seed", some(range(100), 25))
def test_it_stops_where_the_condition_begins_to_hold(seed: int) -> None:
    draw = random.Random(seed)
    # Beside the plane in which tool.y is 0 but for rounding, which the two compute in other orders.
    scene = load_scene("three_axis", {"joints.waist.start": 0.1})
    volts = [draw.uniform(-20.0, 20.0) for _ in scene.joints]
    text = formula(draw, 3)
    session = Session(scene, "lockstep", "first_answer")
    stops, condition = Breakpoint(session.plant, text), Condition(text, scene)
    before = condition.holds(session)
    for tick in range(60):
        session.offer(tick, scene.joint_names, [volt * np.cos(0.3 * tick) for volt in volts])
        session.advance()
        now = condition.holds(session)
        assert stops.take_hit() == (now and not before), (text, tick)
        if now and not before:
            assert stops.tick == session.tick
        before = now
    stops.close()


def test_a_condition_that_is_no_condition_is_refused() -> None:
    plant = Plant("three_axis")
    for text, rule in (("v.elbw > 1", "name signals"), ("always v.elbow > 1", "one moment")):
        with pytest.raises(Refusal, match=rule):
            Breakpoint(plant, text)
    deep = "+".join(["(1"] * 70) + ")" * 70
    with pytest.raises(Refusal, match="must"):
        Breakpoint(plant, f"{deep} > q.waist")


def test_two_breakpoints_of_a_plant_are_independent() -> None:
    plant = Plant("three_axis")
    early, late = Breakpoint(plant, "tick >= 3"), Breakpoint(plant, "tick >= 5")
    hits = []
    for tick in range(1, 8):
        plant.exchange(np.zeros(3))
        hits += [
            (tick, breakpoint.condition.text)
            for breakpoint in (early, late)
            if breakpoint.take_hit()
        ]
        if tick == 3:
            early.close()
    assert hits == [(3, "tick >= 3"), (5, "tick >= 5")]


@pytest.mark.parametrize("clock", with_slow(CLOCKS, 1))
def test_the_network_stands_where_a_condition_begins_to_hold(clock: str) -> None:
    with in_process(clock) as nodes:
        session = session_of(nodes)
        go_on(nodes, 20)
        refused = nodes.call("emulator/break_when", BreakWhen.Request(condition="v.elbw > 1"))
        assert not refused.success and "name signals" in refused.message
        nodes.call("emulator/pause", True)  # else real time may pass it before the call returns
        at = session.tick + 30
        assert nodes.call(
            "emulator/break_when", BreakWhen.Request(condition=f"tick >= {at}")
        ).success
        nodes.call("emulator/pause", False)
        stand(nodes)
        assert session.tick == at
        assert session.plant.t == pytest.approx(at * session.scene.servo_period)
        # The thread that counts ticks names the reason after it has stopped the time.
        values = nodes.nodes["emulator"]._diagnostics.values
        deliver_until(nodes, lambda: f"stopped at tick {at}" in str(values))
        nodes.call("emulator/pause", False)
        go_on(nodes, 20)
        assert not session.paused, "it stops where it begins to hold, once"


@pytest.mark.parametrize("trigger", ["events", "refusals"])
def test_the_network_stands_at_changes_and_refusals(trigger: str) -> None:
    with in_process("lockstep") as nodes:
        session = session_of(nodes)
        go_on(nodes, 20)
        assert nodes.call("emulator/break_when", BreakWhen.Request(**{trigger: True})).success
        go_on(nodes, 5)
        assert not session.paused
        if trigger == "events":
            assert nodes.call("emulator/power", False).success
        else:
            nodes.send("motor_commands", MotorCommand(tick=session.tick, joint_names=["elbow"]))
        assert session.paused
        assert nodes.call("emulator/break_when", BreakWhen.Request()).success
        nodes.call("emulator/pause", False)
        assert nodes.call("emulator/power", True).success
        go_on(nodes, 5)


def stand(nodes: InProcess) -> None:
    """Deliver until time stands still."""
    deliver_until(nodes, lambda: session_of(nodes).paused)


def deliver_until(nodes: InProcess, is_reached: Callable[[], bool]) -> None:
    """Deliver until a condition holds."""
    deadline = time.monotonic() + PATIENCE
    while not is_reached():
        assert time.monotonic() < deadline
        if not nodes.deliver():
            time.sleep(1e-4)
