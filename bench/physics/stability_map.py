"""Stable regions of each scheme: step over gear stiffness, electrical time, rotor inertia."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from arm_emulator import Diverged, Plant, Scene, load_scene
from arm_emulator.base.arrays import Array
from arm_emulator.machine.schemes.known import SCHEMES
from bench.measure import compile_all, map_on_all_cores
from bench.pictures import make_figure, save_picture
from bench.reference_motions import make_sines
from bench.speed.mujoco_peer import INTEGRATORS, MujocoArm, PeerDiverged
from bench.tables import format_table
from oracles.reference import make_links_model

TITLE = "Stability map"

SCENE = "three_axis"
# One library per scheme serves the whole map.
VARIED = [
    "joints.*.gear.stiffness",
    "joints.*.motor.inductance",
    "joints.*.motor.rotor_inertia",
]
PERIOD = 1e-2  # s, over which a voltage is held: the largest step
STEPS = (1e-2, 5e-3, 2e-3, 1e-3, 5e-4, 2e-4, 1e-4, 5e-5)  # s
ACCURATE = 1e-3  # rad, largest error within the second
# The motion spans less than 3 rad; beyond this it is not the motion any more.
BOUND = 10.0  # rad from the truth
FINE = 1e-6  # s, step of the truth

# Symbols of a cell, the best first.
ACCURATE_CELL, BOUNDED_CELL, DETECTED_CELL, LOST_CELL = range(4)
MEANING = ("accurate", "bounded", "diverged, detected", "diverged, not detected")


def run_bench(quick: bool) -> dict[str, Any]:
    """Fill the maps."""
    axes = _list_axes(quick)
    compile_all(
        _load_scene(overrides, scheme, PERIOD)
        for axis in axes.values()
        for overrides in axis["overrides"]
        for scheme in SCHEMES
    )
    figures: dict[str, Any] = {"steps": STEPS, "meaning": MEANING, "accurate": ACCURATE}
    figures["axes"] = {}
    machines = [overrides for axis in axes.values() for overrides in axis["overrides"]]
    measured = iter(map_on_all_cores("stability map", _try_column, machines))
    for name, axis in axes.items():
        columns = [next(measured) for _ in axis["values"]]
        figures["axes"][name] = {
            "values": axis["values"],
            "label": axis["label"],
            "truth_differs": [column.pop("truth") for column in columns],
            "cells": {key: [column[key][0] for column in columns] for key in columns[0]},
            "errors": {key: [column[key][1] for column in columns] for key in columns[0]},
        }
    return figures


def _list_axes(quick: bool) -> dict[str, dict[str, Any]]:
    """Return the three parameters that are varied, each as overrides of the scene."""
    per_decade = 1 if quick else 2

    def list_decades(first: int, last: int) -> list[float]:
        return [float(x) for x in np.logspace(first, last, per_decade * (last - first) + 1)]

    scene = load_scene(SCENE)
    stiffness, constants, ratios = list_decades(2, 8), list_decades(-7, -2), list_decades(-4, 4)
    inertia = _link_inertia(scene)
    data = scene.joints[0].servo_data
    resistance = data.resistance if data and data.resistance else 1.0
    return {
        "stiffness": {
            "label": "gear stiffness [N m/rad]",
            "values": stiffness,
            "overrides": [{"joints.*.gear.stiffness": value} for value in stiffness],
        },
        "time_constant": {
            "label": "L/R [s]",
            "values": constants,
            "overrides": [{"joints.*.motor.inductance": value * resistance} for value in constants],
        },
        "inertia": {
            "label": "rotor inertia behind the gear / link inertia",
            "values": ratios,
            "overrides": [
                {
                    f"joints.{joint.name}.motor.rotor_inertia": value * own * joint.gear.ratio**2
                    for joint, own in zip(scene.joints, inertia, strict=True)
                }
                for value in ratios
            ],
        },
    }


def _link_inertia(scene: Scene) -> Array:
    """Return the diagonal of M at the start (N,) [kg m2]."""
    model = make_links_model(scene)
    M = pin.crba(model, model.createData(), scene.start)
    return np.array(np.diag(M))


def _load_scene(overrides: Mapping[str, Any], scheme: str, dt: float) -> Scene:
    own = {"servo_period": PERIOD, "integrator.scheme": scheme, "integrator.dt": dt}
    return load_scene(SCENE, {**overrides, **own, "varied": VARIED})


def _try_column(overrides: Mapping[str, Any]) -> dict[str, Any]:
    """Try every scheme and step on one machine."""
    scene = _load_scene(overrides, "rosenbrock", FINE)
    voltages = make_sines(len(scene.joints), 0, PERIOD)
    fine, half = (
        Plant(_load_scene(overrides, "rosenbrock", dt)).run(voltages, round(PERIOD / dt))
        for dt in (FINE, 2 * FINE)
    )
    column: dict[str, Any] = {"truth": float(np.abs(fine - half).max())}
    for scheme in SCHEMES:
        column[scheme] = _judge_cells(
            [_run_ours(overrides, scheme, dt, voltages) for dt in STEPS], fine
        )
    for integrator in INTEGRATORS:
        column[f"MuJoCo {integrator}"] = _judge_cells(
            [_run_mujoco(scene, integrator, dt, voltages) for dt in STEPS], fine
        )
    return column


def _run_ours(
    overrides: Mapping[str, Any], scheme: str, dt: float, voltages: Array
) -> Array | None:
    try:
        return Plant(_load_scene(overrides, scheme, dt)).run(voltages, round(PERIOD / dt))
    except Diverged:
        return None


def _run_mujoco(scene: Scene, integrator: str, dt: float, voltages: Array) -> Array | None:
    try:
        return MujocoArm(scene, integrator, dt).trace_rows(voltages, round(PERIOD / dt))
    except PeerDiverged:
        return None


def _judge_cells(runs: list[Array | None], truth: Array) -> tuple[list[int], list[float | None]]:
    cells: list[int] = []
    errors: list[float | None] = []
    for q in runs:
        if q is None:
            cells.append(DETECTED_CELL)
            errors.append(None)
            continue
        error = float(np.abs(q - truth).max())
        errors.append(error if np.isfinite(error) else None)
        if error <= ACCURATE:
            cells.append(ACCURATE_CELL)
        elif error <= BOUND:
            cells.append(BOUNDED_CELL)
        else:
            cells.append(LOST_CELL)
    return cells, errors


def is_bounded_everywhere(figures: dict[str, Any], scheme: str) -> bool:
    """Whether a scheme is accurate or bounded in every cell of every map."""
    return all(
        cell in (ACCURATE_CELL, BOUNDED_CELL)
        for axis in figures["axes"].values()
        for column in axis["cells"][scheme]
        for cell in column
    )


def draw_figures(figures: dict[str, Any], folder: Path) -> None:
    """Draw the maps: a row for each parameter, a column for each scheme."""
    import matplotlib as mpl
    from matplotlib.colors import BoundaryNorm, ListedColormap

    axes = figures["axes"]
    names = list(next(iter(axes.values()))["cells"])
    figure = make_figure(2.3 * len(names) + 1.5, 8.2)
    panels = figure.subplots(len(axes), len(names), squeeze=False)
    # Decades of the error: blue is accurate, yellow to brown bounded, red and black diverged.
    edges = [*np.arange(-10.0, 2.0), 2.0, 3.0]
    blues = mpl.colormaps["GnBu"](np.linspace(0.95, 0.35, 7))
    browns = mpl.colormaps["YlOrBr"](np.linspace(0.15, 0.65, 4))
    colours = ListedColormap([*blues, *browns, "#c62828", "#000000"])
    norm = BoundaryNorm(edges, colours.N)
    image = None
    for name, panel in zip(names, panels[0], strict=True):
        panel.set_title(name, fontsize=11)
    for row, axis in zip(panels, axes.values(), strict=True):
        for panel, name in zip(row, names, strict=True):
            levels = _evaluate_cells(axis["cells"][name], axis["errors"][name])
            image = panel.pcolormesh(
                _find_borders(axis["values"]),
                _find_borders(figures["steps"]),
                levels,
                cmap=colours,
                norm=norm,
            )
            panel.set_xscale("log")
            panel.set_yscale("log")
            panel.minorticks_off()
            if panel is row[0]:
                panel.set_ylabel("step [s]")
            else:
                panel.set_yticklabels([])
        row[len(names) // 2].set_xlabel(axis["label"])
    assert image is not None
    bar = figure.colorbar(image, ax=panels, shrink=0.7, ticks=[-10, -6, -3, -1, 1.5, 2.5])
    bar.ax.set_yticklabels(
        ["1e-10 rad", "1e-6 rad", "1e-3 rad: accurate below", "bounded above", "diverged, detected",
         "diverged, not detected"]
    )  # fmt: skip
    save_picture(figure, folder, "stability_map")


def _evaluate_cells(cells: list[list[int]], errors: list[list[float | None]]) -> Array:
    """Return (steps, values): the error's decade, or where divergence lies on the colour scale."""
    levels = np.empty((len(cells[0]), len(cells)))
    for i, (column, column_errors) in enumerate(zip(cells, errors, strict=True)):
        for j, (cell, error) in enumerate(zip(column, column_errors, strict=True)):
            if cell == DETECTED_CELL:
                levels[j, i] = 1.5
            elif cell == LOST_CELL or error is None:
                levels[j, i] = 2.5
            else:
                levels[j, i] = np.clip(np.log10(max(error, 1e-12)), -9.9, 0.9)
    return levels


def _find_borders(centres: Sequence[float]) -> Array:
    """Return the borders of cells about `centres` on a logarithmic scale."""
    log = np.log10(np.array(centres))
    middle = 0.5 * (log[1:] + log[:-1])
    return np.asarray(10.0 ** np.concatenate([[2 * log[0] - middle[0]], middle,
                                              [2 * log[-1] - middle[-1]]]))  # fmt: skip


def write_report(figures: dict[str, Any]) -> str:
    """Return the section in Markdown."""
    axes = figures["axes"]
    truth = max(max(axis["truth_differs"]) for axis in axes.values())
    lines = [
        f"{SCENE}, 1 s, sines of 12 V held for 10 ms, with one parameter varied and the step from "
        "50 us to 10 ms. The error is the largest over joints and servo periods within the second. "
        f"Accurate: at most {ACCURATE:g} rad. Bounded: within {BOUND:g} rad of a motion that spans "
        "less than 3 rad. Diverged: a plant that stopped at its last finite state "
        "and reported it, or a MuJoCo that warned of a bad state and reset itself. Not detected: "
        "unbounded, and not reported.",
        "",
        f"The truth is rosenbrock at 1 us; at 2 us it is the same to {truth:.0e} rad everywhere.",
        "",
        "![Stability of each scheme](stability_map.png)",
        "",
        "Cells that are accurate / bounded / diverged and detected / not detected:",
        "",
    ]
    names = list(next(iter(axes.values()))["cells"])
    rows = []
    for name in names:
        counts = []
        for axis in axes.values():
            cells = [cell for column in axis["cells"][name] for cell in column]
            counts.append(" / ".join(str(cells.count(kind)) for kind in range(len(MEANING))))
        rows.append((name, *counts))
    holding = [name for name in names if is_bounded_everywhere(figures, name)]
    lines += [
        format_table(("", *(axis["label"] for axis in axes.values())), rows),
        "",
        "Bounded everywhere on these maps: " + (", ".join(holding) or "none") + ". A grid is no "
        "proof: between its cells and beyond its borders nothing was tried.",
    ]
    return "\n".join(lines)
