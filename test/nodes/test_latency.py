"""Lateness in real time: counts agree with the wall clock, whatever the machine does."""

import json
import time
from pathlib import Path

import numpy as np
import pytest

from arm_emulator import Refusal, load_scene
from arm_emulator.cli.commands.latency import (
    measure_latency,
    measure_wake_up_latency,
    probe_latency,
)
from arm_emulator.cli.output import output


@pytest.mark.parametrize("rate", [200.0, pytest.param(3000.0, marks=pytest.mark.slow)])
def test_every_period_is_a_wake_up_or_lost(rate: float) -> None:
    began = time.monotonic()
    result = measure_wake_up_latency(load_scene("three_axis"), 1.0 / rate, 2.5)
    wall = time.monotonic() - began
    periods = len(result.late) + result.lost
    # A busy machine may keep the thread from its last wake-ups.
    assert 2.0 * rate <= periods <= wall * rate, "those that begin and end within it"
    assert (result.late >= 0.0).all() and (result.spent > 0.0).all()
    assert (
        result.quantiles == sorted(result.quantiles) and result.quantiles[-1] == result.late.max()
    )
    # A wake-up that is late by whole periods has lost them.
    assert result.lost == int(np.sum(np.floor(result.late / round(1e9 / rate) * 1e9 + 1e-9)))


def test_a_wake_up_is_waited_for_beyond_the_requested_time() -> None:
    """A machine may be so busy that the thread does not run meanwhile."""
    result = measure_wake_up_latency(load_scene("three_axis"), 0.02, 0.0)
    assert len(result.late) > 0 and result.quantiles[0] >= 0.0


@pytest.mark.slow
def test_emulator_and_servo_run_at_another_rate() -> None:
    responses = probe_latency("three_axis", 2e-3, 0.4)
    assert 0.4 / 2e-3 <= responses.periods < 60.0 / 2e-3
    assert 0 <= responses.old <= responses.periods and responses.lost >= 0
    assert 0.0 < responses.p99_lateness and 0.0 < responses.worst_lateness


def test_rates_are_reported_plotted_and_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with output.print_at_end(as_json=True):
        picture = tmp_path / "late.png"
        code = measure_latency(rates=(100.0, 900.0), seconds=0.1, alone=True, picture=picture)
    rates = json.loads(capsys.readouterr().out)["rates"]
    assert [*rates] == ["100", "900"]
    for value in rates.values():
        assert value["held"] == (value["lost"] < 1e-3 * value["periods"])
    assert code == (not all(value["held"] for value in rates.values()))
    assert picture.read_bytes().startswith(b"\x89PNG")
    rule = "--rates must be a number from 1 to 20000 Hz, got 0.0"
    with pytest.raises(Refusal, match=rule):
        measure_latency(rates=(0.0,))
