"""Wanted speed and accuracy against those of this run."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from bench import fleet
from bench.physics.stability_map import is_bounded_everywhere
from bench.speed.clocks import FACTOR_ERROR, OLD_SHARE, is_punctual
from bench.speed.ns_per_step import find_fastest_mujoco
from bench.speed.threads import PAPER_RATIO, TITLES, TWO

# what, wanted, reached, whether it is; None: nothing to hold it against, or not measured
Row = tuple[str, str, str, bool | None]

PER_STEP = {"three_axis": 40.0, "ur5": 12.0, "panda": 12.0}
AT_ERROR: dict[str, dict[str, float | None]] = {
    "three_axis": {"0.0001": 250.0, "1e-05": 2000.0, "1e-06": 10000.0},
    "ur5": {"0.0001": None, "1e-05": 300.0, "1e-06": None},
    "panda": {"0.0001": None, "1e-05": 300.0, "1e-06": None},
}
# Many arms: gain of lanes, time of a step and time at 1e-5 rad over MuJoCo's rollout.
FLEET_GAIN, FLEET_PER_STEP, FLEET_AT_ERROR = 4.0, 120.0, 1000.0
LARGE_STEP_ERROR = 5e-4  # rad, rosenbrock at 10 ms on three_axis
READY = 0.05  # s, from the cache
TWO_THREADS_N = "24"  # is to pay as two threads paid in the paper
FASTER = {"lockstep": 5.0, "offline": 200.0}  # smallest real-time factors
FROM_TABLE = {"ur5": 1000.0, "three_axis": 2500.0}  # the same, servo in C and targets from a table


def list_requirements(sections: dict[str, Any]) -> list[Row]:
    """Return the table's rows, of the sections that were measured."""
    rows: list[Row] = []
    for name, make in (
        ("ns_per_step", _check_per_step),
        ("fleet", _check_fleet),
        ("work_precision", _check_at_error),
        ("stability_map", _check_stability),
        ("threads", _check_threads),
        ("clocks", _check_clocks),
        ("first_use", _check_first_use),
    ):
        if name in sections:
            rows += make(sections[name])
    return rows


def _check_per_step(figures: dict[str, Any]) -> Iterator[Row]:
    for arm, minimum in PER_STEP.items():
        if arm not in figures["arms"]:
            continue
        times = figures["arms"][arm]["times"]
        name, mujoco = find_fastest_mujoco(times)
        paper = times["paper"]["median"]
        ratio = mujoco / paper
        yield (
            f"{arm}: time per step, {name} / paper",
            f"at least {minimum:g}" + (", aim for 20" if minimum < 20 else ""),
            f"{ratio:.1f} ({mujoco * 1e9:.0f} / {paper * 1e9:.1f} ns)",
            ratio >= minimum,
        )


def _check_fleet(figures: dict[str, Any]) -> Iterator[Row]:
    schemes = figures["throughput"][fleet.PEER]
    gain = min(fleet.compare_lanes(figures, fleet.PEER, scheme) for scheme in schemes)
    quantity = (
        f"{figures['count']} {fleet.PEER} on one core: arm-steps/s over one arm's, every scheme"
    )
    yield quantity, f"at least {FLEET_GAIN:g}", f"{gain:.2f}", gain >= FLEET_GAIN
    peer, ours, ratio = fleet.compare_per_step(figures)
    quantity = (
        f"{figures['count']} {fleet.PEER}, one core: time per step, {peer} by rollout / {ours}"
    )
    yield quantity, f"at least {FLEET_PER_STEP:g}", f"{ratio:.0f}", ratio >= FLEET_PER_STEP
    at = fleet.compare_at_error(figures)
    quantity = (
        f"{figures['count']} {fleet.PEER}, one core: time at {fleet.TARGET:g} rad, rollout / ours"
    )
    reached = f"{at[2]:.0f} ({at[0]} / {at[1]})" if at else "one of them did not get there"
    yield quantity, f"at least {FLEET_AT_ERROR:g}", reached, at[2] >= FLEET_AT_ERROR if at else None


def _check_at_error(figures: dict[str, Any]) -> Iterator[Row]:
    for machine, targets in AT_ERROR.items():
        if machine not in figures:
            continue
        case = figures[machine]
        for target, required in targets.items():
            at = case["at_error"][target]
            quantity = f"{machine}: time at {target} rad, MuJoCo's best / ours"
            aim = "report" if required is None else f"aim for {required:g}"
            if machine == "three_axis":
                aim = f"at least {required:g}"
            if not case["agreement"]["agree"]:
                yield quantity, aim, "void: the machines differ", False
            elif at["ratio"] is None:
                missing = "ours" if at["ours"] is None else "MuJoCo"
                yield quantity, aim, f"{missing} did not get there in this run", None
            else:
                called = at["mujoco"]["time"] / at["ours_from_python"]["time"]
                reached = (
                    f"{at['ratio']:.0f} ({at['mujoco']['time'] * 1e3:.3g} ms "
                    f"{at['mujoco']['name'].removeprefix('MuJoCo ')} / "
                    f"{at['ours']['time'] * 1e3:.3g} ms {at['ours']['name']}; "
                    f"called from Python every period: {called:.0f})"
                )
                yield quantity, aim, reached, None if required is None else at["ratio"] >= required
    if "three_axis_10ms" in figures:
        points = figures["three_axis_10ms"]["series"]["rosenbrock"]
        error = next(p["error"] for p in points if p["dt"] == 1e-2)
        met = error is not None and error < LARGE_STEP_ERROR
        error_text = "diverged" if error is None else f"{error:.1e} rad"
        yield (
            "three_axis: error of rosenbrock at a step of 10 ms",
            f"below {LARGE_STEP_ERROR:g} rad",
            error_text,
            met,
        )


def _check_stability(figures: dict[str, Any]) -> Iterator[Row]:
    for scheme in ("rosenbrock", "extrapolated", "implicit"):
        holds = is_bounded_everywhere(figures, scheme)
        reached = "everywhere" if holds else "not everywhere"
        yield f"{scheme} bounded on the stability map", "everywhere", reached, holds


def _check_threads(figures: dict[str, Any]) -> Iterator[Row]:
    loop = figures["loops"][TWO_THREADS_N]
    ratios = {kind: loop[kind]["median"] / loop["one"]["median"] for kind in TWO}
    yield (
        f"time per step, two threads / one, N = {TWO_THREADS_N}",
        f"at most {PAPER_RATIO:g}",
        ", ".join(f"{ratio:.2f} ({TITLES[kind]})" for kind, ratio in ratios.items()),
        min(ratios.values()) <= PAPER_RATIO,
    )


def _check_clocks(figures: dict[str, Any]) -> Iterator[Row]:
    row = figures["real_time"]["three_axis"]
    factor, old = row["real_time_factor"], row["old_commands_share"]
    yield (
        f"real time, three nodes, {row['seconds']:.0f} s: factor; old commands",
        f"1 within {FACTOR_ERROR:.1%}; below {OLD_SHARE:.0%}",
        f"{factor:.5f}; {old:.2%}",
        is_punctual(row),
    )
    reached = {
        "lockstep": figures["lockstep"]["three_axis"]["real_time_factor"],
        "offline": figures["offline"]["three_axis"],
    }
    for clock, minimum in FASTER.items():
        rate = reached[clock]
        quantity = f"three_axis, {clock.replace('lockstep', 'lock-step')}: real-time factor"
        yield quantity, f"at least {minimum:g}", f"{rate:.1f}", rate >= minimum
    for scene, minimum in FROM_TABLE.items():
        rate = figures["table"][scene]["factor"]
        quantity = f"{scene}, servo in C, targets from a table: real-time factor"
        yield quantity, f"at least {minimum:g}", f"{rate:.0f}", rate >= minimum


def _check_first_use(figures: dict[str, Any]) -> Iterator[Row]:
    for scene, figure in figures.items():
        ready = figure["ready"]["median"]
        yield (
            f"{scene}: from the cache to a ready plant, imports included",
            f"below {READY * 1e3:g} ms, no ROS",
            f"{ready * 1e3:.1f} ms (compiled: {figure['first']['ready']:.1f} s)",
            ready < READY and not figure["ros"],
        )
