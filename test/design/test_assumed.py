"""Every figure of a motor, a gear or friction states its origin, and what it does is reported."""

import re
from pathlib import Path

import numpy as np
import pytest
from documents import page_of
from machines import CONFIG

from arm_emulator import Refusal, load_scene
from bench.physics.assumed import ARMS, list_assumed, simulate_demos
from bench.physics.origins import SECTIONS, list_origins

PAGE = page_of("assumed").read_text()
# Scenes that mark anything mark everything.
MARKED = sorted(
    file for file in CONFIG.glob("*.yaml") if re.search(r"#.*\bassumed [\d.]", file.read_text())
)


@pytest.mark.parametrize("file", MARKED, ids=lambda file: file.stem)
def test_every_figure_has_a_source_or_a_range(file: Path) -> None:
    result = list_origins(file)
    names = [name for figure in result for name in figure.list_names()]
    assert len(names) == len(set(names)), "a figure is reported twice"
    there = {
        f"joints.{joint.name}.{section}"
        for joint in load_scene(str(file)).joints
        for section in SECTIONS
        if joint.motor is not None or section == "friction"
    }
    reported = {name.rpartition(".")[0] for name in names}
    # A joint's friction stands at its link, at its rotor, or at both.
    reported |= {
        name.replace(".motor.", ".") for name in reported if name.endswith(".motor.friction")
    }
    assert there <= reported, "sections of the scene without figures that report their origin"


def test_the_real_arms_are_among_them() -> None:
    assert {CONFIG / f"{name}.yaml" for name in ARMS} <= set(MARKED), f"marked: {MARKED}"


# Numbers of three_axis that data sheets leave open.
VARIED = sorted(
    f"joints.{joint}.{name}"
    for joint in ("waist", "shoulder", "elbow")
    for name in ("motor.torque_constant", "motor.back_emf_constant", "gear.stiffness")
)


@pytest.mark.parametrize("file", MARKED, ids=lambda file: file.stem)
def test_a_figure_that_does_not_state_where_it_is_from_is_refused(
    file: Path, tmp_path: Path
) -> None:
    """Each of them in turn: without a mark, off its range, with an unnamed source."""
    text, second = file.read_text(), tmp_path / file.name
    lines, rng = text.splitlines(), np.random.default_rng(1)
    of_figures = {
        origin.line - 1: f"{origin.section}.{origin.key}"
        for origin in list_origins(file)
        if origin.assumed
    }
    assert of_figures, "figures that are assumed"
    for k, figure in of_figures.items():
        bare = lines[k].partition("#")[0]
        wrong = {
            "have a source": [bare, f"{bare}# about so", f"{bare}# see [99]"],
            "be within what is assumed": [re.sub(r"assumed \S+ to [^\s;:,]+", far, lines[k])
                                          for far in ("assumed 1e7 to 1e8", "assumed -2 to -1")],
        }  # fmt: skip
        rule = str(rng.choice(list(wrong)))
        line = str(rng.choice(wrong[rule]))
        second.write_text("\n".join([*lines[:k], line, *lines[k + 1 :]]))
        with pytest.raises(Refusal) as refusal:
            list_origins(second)
        printed = str(refusal.value)
        expected = f"{file.name}, line {k + 1}: {figure} must {rule}"
        assert printed.startswith(expected) and "\n" not in printed, printed


def test_a_figure_may_have_a_source_that_the_head_names(tmp_path: Path) -> None:
    lines = (CONFIG / "ur5.yaml").read_text().splitlines()
    (k,) = [k for k, line in enumerate(lines) if "resistance: 0.3 " in line]
    lines[k] = "      resistance: 0.3  # ohm [1]"
    (tmp_path / "ur5.yaml").write_text("\n".join(lines))
    (origin,) = [origin for origin in list_origins(tmp_path / "ur5.yaml") if origin.line == k + 1]
    assert origin.assumed is None and origin.source.startswith(
        "Universal Robots, Max. joint torques"
    )


@pytest.mark.parametrize("name", ARMS)
def test_the_page_has_a_row_of_every_figure_that_is_assumed(name: str) -> None:
    for figure in list_assumed(CONFIG / f"{name}.yaml"):
        joints = f"{figure.joints[0]} to {figure.joints[-1]} | {figure.value:.3g}"
        row = f"| `{figure.label}` | {joints} | {figure.low:.3g} to {figure.high:.3g} | "
        assert row in PAGE, f"{row}: make the tables anew by python -m bench --only assumed"


def test_a_gear_of_another_ratio_is_as_motors_of_scaled_constants() -> None:
    """A rotor turns 1/r times as fast: constants, dry friction grow by r0/r, the rest squared."""
    for figure in list_assumed(CONFIG / "ur5.yaml"):
        if figure.label == "gear.ratio":
            values = figure.scale_numbers(0.5 * figure.value)
            for name, value in values.items():
                power = 2.0 if name.endswith(("rotor_inertia", "viscous")) else 1.0
                assert value == pytest.approx(figure.nominal[name] * 2.0**power), name
            assert len(values) == 3 * len(figure.joints), "constants, back EMF and inertia of each"


def test_an_arm_with_changed_numbers_runs_another_demo() -> None:
    name = "three_axis"
    numbers = {number.name: number.value for number in load_scene(name, {"varied": VARIED}).varied}
    stiff = {
        number: value * (2.0 if "stiffness" in number else 1.0) for number, value in numbers.items()
    }
    result = simulate_demos(name, [{}, numbers, stiff], 6)
    assert result[1] == pytest.approx(result[0], abs=1e-9), "the scene's own numbers"
    assert np.abs(result[0, -1]).max() < 0.5 * np.abs(result[0, 0]).max(), "the tool is on its way"
    assert np.abs(result[2] - result[0]).max() > 1e-6, "the other arm moves otherwise"
