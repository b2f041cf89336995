"""The section on work and precision: its words, tables and pictures."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bench.measure import WallTime
from bench.pictures import COLOURS, PEERS, make_figure, save_picture
from bench.tables import format_table

INPUTS = 3  # motions; the error is the root mean square over them
FROM_PYTHON = "rosenbrock, called every period"
PRINTED_STEPS = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7)


def draw_figures(figures: dict[str, Any], folder: Path) -> None:
    """Draw error against wall time, the robots in one picture, the other cases in a second."""
    robots = [key for key in figures if key in ("three_axis", "ur5", "panda")]
    others = [key for key in figures if key not in robots]
    for name, keys in (("work_precision", robots), ("work_precision_more", others)):
        if keys:
            _draw_cases([figures[key] for key in keys], folder, name)


def _draw_cases(cases: list[dict[str, Any]], folder: Path, name: str) -> None:
    figure = make_figure(5.2 * len(cases), 5.6)
    panels = figure.subplots(1, len(cases), squeeze=False)[0]
    for axes, case in zip(panels, cases, strict=True):
        for series, points in case["series"].items():
            good = [p for p in points if p["error"] is not None]
            x = [p["error"] for p in good]
            y = [p["time"]["median"] for p in good]
            if series in COLOURS:
                style = {"color": COLOURS[series], "marker": "o", "linewidth": 2.0}
            elif series == FROM_PYTHON:
                style = {"color": COLOURS["rosenbrock"], "marker": "o", "linestyle": ":"}
            else:
                colour, marker = PEERS[series]
                style = {"color": colour, "marker": marker, "linewidth": 1.0}
            axes.loglog(x, y, label=series, markersize=4.5, **style)
        axes.set_title(case["title"])
        axes.set_xlabel("error after 1 s [rad]")
        axes.invert_xaxis()
        axes.grid(True, color="0.9", linewidth=0.8)
        axes.set_axisbelow(True)
    panels[0].set_ylabel("wall time per simulated second [s]")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False)
    save_picture(figure, folder, name)


def write_report(figures: dict[str, Any]) -> str:
    """Return the section in Markdown."""
    lines = [
        "Error is the difference of the link angles from the reference (SciPy DOP853 on "
        "Pinocchio's dynamics, rtol 1e-11, oracles/reference.py) after 1 s: the "
        f"largest over the joints, root mean square over {INPUTS} motions (sines of 12 V with "
        "seeded frequencies and phases, from rest). Each voltage is held for one servo period of "
        "1 ms where not stated otherwise, so no step is longer than that.",
        "",
        "Timed is the whole second: ours `Plant.run` (one call, the voltages of all periods applied"
        " in C, positions after each stored), and, dotted, `Plant.advance` called from Python in "
        "every period; MuJoCo `data.ctrl[:] = row; mj_step(model, data, nstep)` in every period, "
        "from Python; SciPy `solve_ivp` started anew in every period, once. Compilation, model "
        "building and resets are not in it. A call (section Time per step) weighs little beside "
        "the steps that MuJoCo takes in a period, but is most of ours at few steps per period; "
        "hence the two columns.",
        "",
        "Both machines are one: results of both, extrapolated in the step for MuJoCo, against the "
        "reference after 1 s (must be below 1e-6 rad, else a comparison would be void).",
        "",
        format_table(("machine", "MuJoCo RK4, extrapolated [rad]", "rosenbrock, 10 us [rad]",
               "same machine"), map(_write_agreement, figures.values())),
        "",
        "Wall time per simulated second at a given error, interpolated between the measured steps "
        "on logarithmic scales. Where the longest step that a period allows is already better than "
        "that error, its time stands there: nothing coarser exists.",
        "",
        format_table(("machine", "error [rad]", "ours", "called every period", "MuJoCo's best",
               "SciPy's best", "MuJoCo / ours", "MuJoCo / ours called"),
              ((case["title"], target, *_format_cells(case, at)) for case in figures.values()
               for target, at in case["at_error"].items())),
        "",
        *_write_limits(figures),
    ]  # fmt: skip
    pictures = [("work_precision", "the robots")]
    if any(key not in ("three_axis", "ur5", "panda") for key in figures):
        pictures.append(("work_precision_more", "other cases"))
    for name, title in pictures:
        lines += ["", f"![Error against wall time, {title}]({name}.png)"]
    lines += ["", "<details><summary>Error and time at each step size</summary>", ""]
    for case in figures.values():
        lines += _write_table(case)
    lines += ["</details>"]
    return "\n".join(lines)


def _write_agreement(case: dict[str, Any]) -> list[str]:
    a = case["agreement"]
    verdict = "yes" if a["agree"] else "**no: comparison void**"
    return [case["title"], f"{a['mujoco']:.1e}", f"{a['ours']:.1e}", verdict]


def _format_cells(case: dict[str, Any], at: dict[str, Any]) -> list[str]:
    cells = [_format_best(at[key]) for key in ("ours", "ours_from_python", "mujoco", "scipy")]
    called = at["ours_from_python"]
    for ours in (at["ours"], called):
        comparable = ours and at["mujoco"] and case["agreement"]["agree"]
        cells.append(f"{at['mujoco']['time'] / ours['time']:.3g}" if comparable else "-")
    return cells


def _format_best(best: dict[str, Any] | None) -> str:
    if best is None:
        return "not reached"
    name = best["name"].removeprefix("MuJoCo ").removeprefix("Pinocchio + SciPy ")
    method_text = "" if name == FROM_PYTHON else f" ({name})"
    return f"{_format_milliseconds(best['time'])}{method_text}"


def _format_milliseconds(seconds: float) -> str:
    return f"{seconds * 1e3:.3g} ms"


def _write_limits(figures: dict[str, Any]) -> list[str]:
    """State where the comparison is not in our favour, and why it is as it is."""
    lines = [
        "What bounds these figures. With inductance all of MuJoCo's integrators are of first order,"
        " RK4 too: the current is advanced by an exponential formula outside the integrator's "
        "stages. Without inductance RK4 has its order of 4, and it is the method of choice for "
        "very small errors. The schemes here end at order 2.",
    ]
    for case in figures.values():
        for kind, name in (("mujoco", "MuJoCo"), ("scipy", "Pinocchio in SciPy")):
            below = case["faster_below"][kind]
            if below is not None:
                lines.append(f"{case['title']}: below {below:.0e} rad {name} is faster.")
    lines.append(
        "At the coarse end our time is that of one step per period, so the ratio falls where a "
        "larger error would do."
    )
    return lines


def _write_table(case: dict[str, Any]) -> list[str]:
    """Return one machine's errors and times, whole decades of the step."""
    dts = {p["dt"] for points in case["series"].values() for p in points if "dt" in p}
    steps = [dt for dt in PRINTED_STEPS if dt in dts]
    rows = []
    for name, points in case["series"].items():
        if "dt" in points[0]:
            by_step = {p["dt"]: p for p in points}
            rows.append((name, *(_format_point(by_step.get(dt)) for dt in steps)))
    lines = [
        f"{case['title']}: error [rad], time per simulated second (spread: half the distance of "
        "the quartiles)",
        "",
        format_table(("", *(f"{dt:g} s" for dt in steps)), rows),
    ]
    for name, points in case["series"].items():
        if "rtol" in points[0]:
            points_text = "; ".join(f"rtol {p['rtol']:g}: {_format_point(p)}" for p in points)
            lines += ["", f"{name}: {points_text}."]
    return [*lines, ""]


def _format_point(point: dict[str, Any] | None) -> str:
    if point is None:
        return ""
    if point["error"] is None:
        return "diverged"
    time = WallTime(**point["time"])
    percent = f" ± {100 * time.spread:.0f} %" if time.repetitions > 1 else ""
    return f"{point['error']:.1e}, {_format_milliseconds(time.median)}{percent}"
