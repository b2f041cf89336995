"""The judges of runs on a device, against those of the processor, which brute force judges."""

import re
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from draws import some
from test_campaign import TABLE, written
from test_campaign_lanes import TARGETS, VARIED, cases_of, rows_of
from test_gpu_compiler import name_clang, needs_clang
from test_requirements import NAMES, PERIOD, draw_formula

from arm_emulator import load_scene
from arm_emulator.base.expression.formula import Signal, parse_formula
from arm_emulator.toolchain.library_cache import CACHE_VARIABLE
from arm_emulator_campaign.definition.campaign import Campaign
from arm_emulator_campaign.definition.campaign_file import load_campaign
from arm_emulator_campaign.judging.card_kernels import compile_campaign_for_card
from arm_emulator_campaign.judging.device_program import DeviceProgram, build_judges_unit
from arm_emulator_campaign.judging.device_sampler import KERNELS
from arm_emulator_campaign.judging.program import BLOCK, Program, Rows, Targets, judges
from arm_emulator_campaign.judging.requirement import Robustness
from arm_emulator_campaign.simulation.batch_simulator import BatchSimulator, make_simulator
from arm_emulator_campaign.simulation.outcome import Outcomes
from arm_emulator_fleet import gpu_compiler
from arm_emulator_fleet.gpu_compiler import find_ptxas, has_ptxas, load_ptx
from arm_emulator_fleet.processor_device import ProcessorDevice
from arm_emulator_fleet.unit import build_card_units

ROOM = 2 * BLOCK
REDUCTIONS = ("max", "min", "mean", "rms", "last")


def make_program(
    texts: list[str], longest: int, runs: int, program: Any = Program
) -> tuple[Program, list[str]]:
    """Return the judges of formulas and measures, and the signals that they need in their order."""
    rows = Rows(["arm"], PERIOD)
    formulas = [parse_formula(text, "test", "formula") for text in texts]
    requirements = [
        [Robustness(judges(), formula, rows.add_formula, PERIOD, longest) for formula in formulas]
        for _ in range(runs)
    ]
    measures = [(kind, rows.add_expression(Signal("a"))) for kind in REDUCTIONS]
    measures += [
        ("max", rows.add_expression(Signal("target.arm"))),
        ("last", rows.add_expression(Signal("t"))),
    ]
    return program(rows, requirements, measures, [], ROOM), rows.samples


def judge(program: Program, samples: np.ndarray, counts: np.ndarray, targets: Targets) -> Any:
    """Return robustness and measures of runs (runs, S, samples), fed in pieces."""
    program.begin_runs()
    for first in range(0, samples.shape[2], ROOM):
        piece = np.zeros((*samples.shape[:2], ROOM))
        fresh = samples[:, :, first : first + ROOM]
        piece[:, :, : fresh.shape[2]] = fresh
        here: Any = piece
        if isinstance(program, DeviceProgram):
            device = program.device
            here = device.allocate(piece.nbytes)
            device.write(here, piece)
        program.take_samples(here, np.clip(counts - first, 0, ROOM), targets)
    return program.end_runs()


def draw_targets(rng: np.random.Generator, runs: int, longest: int) -> Targets:
    every = []
    for _ in range(runs):
        since = [0, *np.unique(rng.integers(1, longest + 1, 4)).tolist()]
        every.append((since, rng.normal(size=(len(since), 1))))
    return Targets.stack_runs(every)


@pytest.mark.parametrize("seed", some(range(60), 12))
def test_a_device_judges_runs_of_any_length_as_the_processor(seed: int) -> None:
    rng = np.random.default_rng(seed)
    longest = int(rng.integers(1, 4 * BLOCK))
    horizon = int(rng.integers(1, 2 * BLOCK))  # windows end within a block, or blocks later
    texts = [draw_formula(rng, int(rng.integers(0, 4)), horizon)[0] for _ in range(4)]
    texts.append(f"target.arm > {rng.normal():.3f}")
    expected, names = make_program(texts, longest, longest)
    there, _ = make_program(texts, longest, 1, DeviceProgram)
    assert isinstance(there, DeviceProgram) and set(names) <= set(NAMES)
    there.measure_run(longest)
    there.move_runs(ProcessorDevice(2), longest)
    for _ in range(2):  # the next runs begin anew
        counts = rng.permutation(np.arange(1, longest + 1))
        samples = np.round(rng.normal(size=(longest, len(names), longest)) * 4.0) / 4.0
        samples[rng.random(samples.shape) < 0.02] = np.nan
        targets = draw_targets(rng, longest, longest)
        for one, other in zip(
            judge(there, samples, counts, targets),
            judge(expected, samples, counts, targets),
            strict=True,
        ):
            assert one.shape[0] == longest and np.array_equal(one, other, equal_nan=True), texts


def test_a_run_that_is_longer_than_stated_is_an_error_and_no_wrong_number() -> None:
    text = ["always eventually[0, 3] a > 0"]
    program, _ = make_program(text, BLOCK, 1, DeviceProgram)
    assert isinstance(program, DeviceProgram)
    program.measure_run(BLOCK)
    program.move_runs(ProcessorDevice(1), 2)
    samples, targets = np.ones((2, 1, 8 * BLOCK)), draw_targets(np.random.default_rng(1), 2, 9)
    with pytest.raises(MemoryError):
        judge(program, samples, np.full(2, 8 * BLOCK), targets)
    robustness, _ = judge(program, samples[:, :, :BLOCK], np.full(2, BLOCK), targets)
    assert np.all(robustness == 1.0), "the next runs are judged again"


REQUIREMENTS = {
    "requirements": {
        "near": "always abs(error.*) < 0.3",
        "returns": "eventually[0.05, 0.15] always[0, 0.01] abs(v.elbow) < 0.05",
        "slow": "(abs(v.waist) < 3) until[0.02, 0.1] (abs(q.elbow - target.elbow) < 0.2)",
        "never": "always (t > 0.1 -> eventually[0, 0.03] v.shoulder > 0)",
    },
    "measures": {
        "error": "max(abs(error.elbow))",
        "gear": "rms(gear_torque.*)",
        "current": "mean(measured.current.elbow)",
        "energy": "min(energy)",
        "target": "last(target.elbow)",
    },
}
# A length that varies: how much a requirement keeps of a run is not known.
HERE = [name for name in VARIED if name != "a run's length and its start"]


def load(folder: Path, name: str) -> Campaign:
    (folder / "targets.csv").write_text(TARGETS)
    return load_campaign(written(folder, TABLE | REQUIREMENTS | VARIED[name]))


@pytest.mark.parametrize("name", some(HERE, 2))
def test_runs_judged_on_a_device_equal_those_in_lanes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    campaign, count = load(tmp_path, name), 23
    expected = rows_of(
        Outcomes.join_outcomes(
            list(BatchSimulator(campaign).simulate_runs(cases_of(campaign, range(count))))
        )
    )
    assert len(np.unique(expected, axis=0)) == count
    pieces = []
    take = DeviceProgram.take_samples
    monkeypatch.setattr(
        DeviceProgram,
        "take_samples",
        lambda self, *piece: pieces.append(piece) or take(self, *piece),
    )
    there = make_simulator(campaign, "processor")
    rows = rows_of(
        Outcomes.join_outcomes(list(there.simulate_runs(cases_of(campaign, range(count)))))
    )
    assert np.array_equal(rows, expected, equal_nan=True)
    assert pieces, "judged there, not from copies of samples"


def test_requirements_for_the_processor_alone_are_judged_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(DeviceProgram, "take_samples", None)
    changes: list[dict[str, Any]] = [
        {"measures": {"tool": "max(tool.z)"}},
        {"vary": {"scenario.seconds": "uniform(0.05, 0.3)"}},
    ]
    for change in changes:
        campaign = load_campaign(written(tmp_path, TABLE | REQUIREMENTS | change))
        lanes, there = (make_simulator(campaign, device) for device in (None, "processor"))
        rows, expected = (
            rows_of(Outcomes.join_outcomes(list(each.simulate_runs(cases_of(campaign, range(9))))))
            for each in (there, lanes)
        )
        assert np.array_equal(rows, expected, equal_nan=True)


def test_kernels_of_campaigns_are_compiled_ahead(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    does = 'for w; do case "$w" in *.cu) (echo ".version"; cat "$w") > "$out";; esac; done'
    name_clang(monkeypatch, tmp_path / "bin", does, "clang version 19.1")
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "cache"))
    monkeypatch.setattr(gpu_compiler, "has_ptxas", lambda: False)
    scene = load_scene("three_axis")
    files = compile_campaign_for_card(scene, "sm_90", tmp_path / "into")
    arms, smooth, judging = (file.read_text(errors="replace") for file in files)
    assert "fleet_kernels.hpp" in arms and "sampler_kernels.hpp" in arms
    assert "advance_to_event.hpp" in smooth and "sampler_kernels.hpp" in smooth
    assert "judges_kernels.hpp" in judging
    # A campaign loads the same kernels.
    units = *build_card_units(scene, KERNELS), build_judges_unit()
    for unit, file in zip(units, files, strict=True):
        assert load_ptx(unit, "sm_90") in file.read_bytes()


@pytest.mark.slow
@needs_clang
def test_judges_call_nothing_that_a_card_has_not(tmp_path: Path) -> None:
    ptx = load_ptx(build_judges_unit(), "sm_90")
    text = ptx.decode()
    kernels = re.findall(r"\.visible \.entry (\w+)\(", text)
    assert sorted(kernels) == ["judge_add_samples", "judge_begin", "judge_build", "judge_end"]
    assert not re.findall(r"^\s*\.extern .*", text, re.M)
    if has_ptxas():
        source = tmp_path / "judges.ptx"
        source.write_bytes(ptx)
        words = [*find_ptxas(), "--fmad=false", "-arch=sm_90", source, "-o", "/dev/null"]
        done = subprocess.run(words, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
