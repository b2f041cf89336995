"""Validation: what it measures of our machines, and that it rejects machines that are wrong."""

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from draws import some, with_slow

from arm_emulator import Refusal, Scene, load_scene
from arm_emulator_identification.validation import manutec_r3
from arm_emulator_identification.validation.figure import Figure
from arm_emulator_identification.validation.kuka_kr300 import (
    SHIPPED,
    compare,
    compute_torques,
    list_torque_figures,
    list_wind_up_figures,
    load,
    predict,
)
from arm_emulator_identification.validation.manutec_r3 import LIMITS, PICTURED, list_failures
from arm_emulator_identification.wind_up import compute_wind_up


def figures(scene: Scene, path: Path) -> Iterator[Figure]:
    """Checks without a simulation."""
    run = load(path, scene)
    yield from list_torque_figures(scene, run, *compute_torques(scene, run))
    yield from list_wind_up_figures(run, compute_wind_up(run, scene))


def failures(scene: Scene, path: Path) -> list[str]:
    return [line for figure in figures(scene, path) for line in figure.failures]


def wrong(kind: str) -> Scene:
    """The identified machine with one thing wrong."""
    scene = load_scene("kuka_kr300")
    elastic = {
        f"joints.{joint.name}.gear": joint.gear
        for joint in scene.joints
        if joint.gear.stiffness is not None
    }
    changes: dict[str, Any] = {}
    if kind == "no compliance":
        changes = {f"{name}.stiffness": None for name in elastic}
        changes |= {f"{name}.damping": None for name in elastic}
    elif kind.endswith("times as stiff"):
        factor = float(kind.split(maxsplit=1)[0])
        changes = {f"{name}.stiffness": factor * gear.stiffness for name, gear in elastic.items()}
    elif kind == "no counterbalance":
        changes = {"joints.*.counterbalance": None}
    elif kind == "no friction":
        changes = {"joints.*.motor.friction": None}
    elif kind == "another payload":
        changes = {"payload": {"mass": 100.0, "com": [0.0, 0.0, 0.3]}}
    return load_scene("kuka_kr300", changes)


@pytest.mark.slow
@pytest.mark.parametrize("path", with_slow(SHIPPED[::-1], 1), ids=lambda path: path.stem)
def test_the_identified_machine_keeps_every_limit(path: Path) -> None:
    assert not failures(load_scene("kuka_kr300"), path)


WRONG = [
    ("no compliance", "wind-up|not computed"),
    ("10 times as stiff", "not computed"),
    ("no friction", "torque explained"),
    ("0.3 times as stiff", "not computed"),
    ("no counterbalance", "torque explained"),
    ("another payload", "torque explained"),
]


@pytest.mark.parametrize("path", some(SHIPPED[::-1], 1), ids=lambda path: path.stem)
@pytest.mark.parametrize(("kind", "word"), with_slow(WRONG, 2), ids=[kind for kind, _ in WRONG])
def test_a_wrong_machine_is_rejected_on_every_run(kind: str, word: str, path: Path) -> None:
    """A limit that a machine without the thing in question keeps would prove nothing."""
    lines = failures(wrong(kind), path)
    assert any(each in line for each in word.split("|") for line in lines), lines


@pytest.mark.parametrize("path", some(SHIPPED, 0))
def test_free_runs_are_nearer_than_null_models(path: Path) -> None:
    comparison = compare(path)
    assert comparison.is_good, comparison.failures
    judged = [figure for figure in comparison.figures if not figure.yardstick]
    assert {figure.title.strip().split(",")[0] for figure in judged} >= {
        "free run of 0.6 s", "free run of 2 s",
    }  # fmt: skip
    for judged_figure in judged:  # every figure that is shown can fail
        ends = [
            list(dataclasses.replace(judged_figure, values=np.full(6, end), overall=None).failures)
            for end in (-1e9, 1e9)
        ]
        assert any(ends), judged_figure.title


def test_the_wave_of_the_encoder_is_that_of_run_a() -> None:
    """826 waves per turn of the link: it comes again in both runs."""
    scene = load_scene("kuka_kr300")
    of_b = compute_wind_up(load(SHIPPED[1], scene), scene)
    assert of_b.order[1] == pytest.approx(predict().wave_order[1], abs=2.0)
    assert of_b.ripple[1] == pytest.approx(predict().wave[1], rel=0.2)


def test_the_verdict_on_the_manutec_takes_order_speed_and_every_figure() -> None:
    axes = np.ones(6)

    def like(period: float, **more: Any) -> tuple[manutec_r3.SolutionErrors, float]:
        size = (period / PICTURED) ** 2
        errors = {name: 0.5 * limit * size * axes for name, limit in LIMITS.items()}
        comparison = manutec_r3.SolutionErrors(**errors, other_modes=20, rows=4688)
        speed = more.pop("speed", 100.0)
        return dataclasses.replace(comparison, **more), speed

    periods = (2e-4, PICTURED, 2e-5, 1e-5, 5e-6)
    good = {period: like(period) for period in periods}
    assert not list(list_failures(good))
    for name in LIMITS:
        bad = {**good, PICTURED: like(PICTURED, **{name: 2.0 * LIMITS[name] * axes})}
        assert any(name in line for line in list_failures(bad)), name
    assert list(list_failures({**good, PICTURED: like(PICTURED, speed=0.5)}))
    assert list(list_failures({**good, 2e-4: like(2e-4, other_modes=100)}))
    first = {period: like(period, q=1e-6 * period / PICTURED * axes) for period in periods}
    assert any("order" in line for line in list_failures(first))


def test_a_record_of_another_machine_is_refused(tmp_path: Path) -> None:
    with pytest.raises(Refusal):
        compare(tmp_path / "none.npz")
