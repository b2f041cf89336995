"""Time of one integration step, for arms of 3 to 24 joints, beside MuJoCo and Pinocchio."""

from __future__ import annotations

import hashlib
import os
import site
import subprocess
import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from arm_emulator import Plant, Scene, load_scene
from arm_emulator.analysis.reference import links_model
from arm_emulator.build.compiler_command import find_compiler
from arm_emulator.machine.schemes.known import SCHEMES
from bench.bare import BARE
from bench.chains import chain
from bench.measure import Task, Timing, compile_all, interleaved, progress, stepping, timing
from bench.mujoco_peer import INTEGRATORS, MujocoArm, joint_axis
from bench.pictures import COLOURS, PEERS, new_figure, save

TITLE = "Time per step"

ROBOTS = {"three_axis": 3, "ur5": 6, "panda": 7}
CHAINS = (12, 24)
STEPS = dict.fromkeys(SCHEMES, 20_000)  # in one measurement
MUJOCO_STEPS = 2_000
ABA_CALLS = 2_000
DT = 1e-5  # s; what a step costs does not depend on it
VOLTAGE = 3.0  # V, of changing sign from joint to joint: everything moves
CALLS = 1_000  # servo periods, for the cost of a call from Python

# As Pinocchio's own CMake files ask for.
PINOCCHIO_FLAGS = (
    "-std=c++17 -O3 -DNDEBUG -march=native -DBOOST_MPL_LIMIT_LIST_SIZE=30 "
    "-DBOOST_MPL_LIMIT_VECTOR_SIZE=30 -DBOOST_MPL_CFG_NO_PREPROCESSED_HEADERS "
    "-DBOOST_FUSION_INVOKE_MAX_ARITY=12"
).split()


def run(quick: bool) -> dict[str, Any]:
    """Measure every arm."""
    repetitions = 5 if quick else 15
    with tempfile.TemporaryDirectory() as folder:
        arms = {name: _schemes(name) for name in ROBOTS}
        for joints in () if quick else CHAINS:
            arms[f"chain_{joints}"] = {
                scheme: chain(Path(folder), joints, **{"integrator.scheme": scheme})
                for scheme in SCHEMES
            }
        compile_all(scene for schemes in arms.values() for scene in schemes.values())
        scenes = {name: schemes["rosenbrock"] for name, schemes in arms.items()}
        aba, why_not = _compiled_aba()
        figures: dict[str, Any] = {"aba_cpp_missing": why_not, "arms": {}}
        with progress("time per step", repetitions * len(arms)) as done:
            for name, schemes in arms.items():
                in_cpp: list[float] = []

                def turn(task: str, name: str = name, in_cpp: list[float] = in_cpp) -> None:
                    if task == "paper":
                        if aba is not None:
                            in_cpp.append(_time_aba(aba, scenes[name]))
                        done(name)

                timings = interleaved(_tasks(schemes), repetitions, turn)
                per_step = {task: asdict(_per_step(task, t)) for task, t in timings.items()}
                if in_cpp:
                    per_step["Pinocchio ABA, C++"] = asdict(timing(in_cpp))
                figures["arms"][name] = {"joints": len(scenes[name].joints), "times": per_step}
        figures["python_call"] = _calls(scenes["three_axis"], repetitions)
    return figures


def _schemes(name: str) -> dict[str, Scene]:
    return {
        scheme: load_scene(name, {**BARE, "integrator.scheme": scheme, "integrator.dt": DT})
        for scheme in SCHEMES
    }


def _tasks(schemes: dict[str, Scene]) -> dict[str, Task]:
    N = len(schemes["paper"].joints)
    voltage = VOLTAGE * (-1.0) ** np.arange(N)[None, :]
    tasks: dict[str, Task] = {}
    for scheme, steps in STEPS.items():
        tasks[scheme] = stepping(Plant(schemes[scheme]), voltage, steps, about=20e-9 * N * steps)
    for integrator in INTEGRATORS:
        arm = MujocoArm(schemes["paper"], integrator, DT)
        tasks[f"MuJoCo {integrator}"] = stepping(
            arm, voltage, MUJOCO_STEPS, about=0.7e-6 * N * MUJOCO_STEPS
        )
    tasks["Pinocchio ABA, Python"] = Task(_aba(schemes["paper"]))
    return tasks


def _aba(scene: Scene) -> Any:
    model = links_model(scene)
    data, zero = model.createData(), np.zeros(model.nv)
    q, aba = scene.start, pin.aba

    def work(_: int) -> None:
        for _ in range(ABA_CALLS):
            aba(model, data, q, zero, zero)

    return work


def _per_step(task: str, measured: Timing) -> Timing:
    if task in STEPS:
        return measured.per(STEPS[task])
    return measured.per(ABA_CALLS if "Pinocchio" in task else MUJOCO_STEPS)


def _calls(scene: Scene, repetitions: int) -> dict[str, Any]:
    """Measure what a call from Python costs, with the voltages handed over and no step taken."""
    plant = Plant(scene)
    arm = MujocoArm(scene, "implicitfast", DT)
    row = np.full(len(scene.joints), VOLTAGE)
    rows = np.tile(row, (CALLS, 1))

    def call_plant(_: int) -> None:
        for _ in range(CALLS):
            plant.advance(row, 0)

    timings = interleaved(
        {"Plant.advance": Task(call_plant), "MuJoCo mj_step": stepping(arm, rows, 0)}, repetitions
    )
    return {name: time.per(CALLS).median for name, time in timings.items()}


# Pinocchio in C++


def _time_aba(program: Path, scene: Scene) -> float:
    """Return the time of a call of Pinocchio's ABA from C++ [s]."""
    run = subprocess.run(
        [program], input=_numbers(scene), capture_output=True, text=True, check=True
    )
    return float(run.stdout.split()[0])


def _compiled_aba() -> tuple[Path | None, str]:
    """Compile pinocchio_aba.cpp, once; None and a reason if its headers are not there."""
    source = Path(__file__).with_name("pinocchio_aba.cpp")
    prefix = Path(site.getsitepackages()[0]) / "cmeel.prefix" / "include"
    folders = [prefix, prefix / "eigen3", Path("/usr/include/eigen3")]
    command = [*find_compiler(), *PINOCCHIO_FLAGS, *(f"-isystem{f}" for f in folders), str(source)]
    digest = hashlib.sha256(" ".join([*command, pin.__version__]).encode() + source.read_bytes())
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "arm_emulator"
    cache.mkdir(parents=True, exist_ok=True)
    program = cache / f"pinocchio_aba-{digest.hexdigest()[:20]}"
    if not program.is_file():
        with progress("Pinocchio in C++", 1) as done:
            built = program.with_suffix(f".{os.getpid()}")
            compiler = subprocess.run(
                [*command, "-o", str(built)], capture_output=True, text=True, check=False
            )
            if compiler.returncode != 0:
                errors = [line for line in compiler.stderr.splitlines() if "error" in line]
                return None, (errors or ["the compiler failed"])[0].rsplit("error: ", 1)[-1]
            os.replace(built, program)
            done("")
    return program, ""


def _numbers(scene: Scene) -> str:
    """Return a scene's links as pinocchio_aba.cpp reads them."""
    model = links_model(scene)
    values: list[float] = []
    for k in range(1, model.njoints):
        placement, inertia = model.jointPlacements[k], model.inertias[k]
        I = inertia.inertia  # noqa: E741
        values += [*joint_axis(model, k)[1], *placement.rotation.ravel(), *placement.translation]
        values += [inertia.mass, *inertia.lever]
        values += [I[0, 0], I[0, 1], I[1, 1], I[0, 2], I[1, 2], I[2, 2]]
    return " ".join([str(model.nv), *map(repr, map(float, values))])


# The report


def fastest_mujoco(times: dict[str, Any]) -> tuple[str, float]:
    """Return name and time per step [s] of MuJoCo's fastest integrator."""
    medians = {name: t["median"] for name, t in times.items() if name.startswith("MuJoCo")}
    name = min(medians, key=medians.__getitem__)
    return name, medians[name]


def draw(figures: dict[str, Any], folder: Path) -> None:
    """Draw the time of a step over the number of joints."""
    arms = list(figures["arms"].values())
    joints = [arm["joints"] for arm in arms]
    figure = new_figure(7.5, 5.5)
    axes = figure.subplots()
    styles = {**{name: (colour, "o") for name, colour in COLOURS.items()}, **PEERS}
    styles["Pinocchio ABA, Python"] = ("#a9853b", "x")
    styles["Pinocchio ABA, C++"] = ("#6b5523", "+")
    for name in arms[0]["times"]:
        colour, marker = styles[name]
        times = [arm["times"][name]["median"] * 1e9 for arm in arms]
        axes.loglog(joints, times, color=colour, marker=marker, label=name)
    axes.set_xticks(joints, [str(n) for n in joints])
    axes.minorticks_off()
    axes.set_xlabel("joints")
    axes.set_ylabel("time per step [ns]")
    axes.grid(True, color="0.9", linewidth=0.8)
    figure.legend(loc="outside right upper", frameon=False)
    save(figure, folder, "ns_per_step")


def report(figures: dict[str, Any]) -> str:
    """Return the section in Markdown."""
    arms = figures["arms"]
    names = list(next(iter(arms.values()))["times"])
    lines = [
        "One integration step of each machine stripped to what the peers have, too (motors, gears, "
        "links under gravity; three_axis has none): no brakes, end stops, current loops, sticking "
        "friction (bench/bare.py). README.md has a step of each scene as shipped. Voltages held, "
        "medians of interleaved repetitions with half the distance of the quartiles. "
        "Ours is timed in `Plant.run` over 20 000 steps, MuJoCo in one "
        "`mj_step(model, data, nstep=2000)` on the same machine. Beyond 12 joints our recursions "
        "are loops and no longer unrolled. The chains of 12 and 24 links carry the motors and "
        "gears of three_axis (bench/chains.py).",
        "",
        "Pinocchio's articulated-body algorithm is no simulator: it is the links' accelerations "
        "alone, no motors, no gears, no integration. It stands here as a measure of what the "
        "links cost. In C++ it is compiled for this processor, from headers alone.",
        "",
        "| [ns] | " + " | ".join(f"{n}, N = {a['joints']}" for n, a in arms.items()) + " |",
        "|---" * (len(arms) + 1) + "|",
    ]
    for name in names:
        cells = []
        for arm in arms.values():
            time = Timing(**arm["times"][name])
            cells.append(f"{time.median * 1e9:.4g} ± {100 * time.spread:.0f} %")
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    ratios: dict[str, list[str]] = {name: [] for name in names if name in STEPS}
    for arm in arms.values():
        _, mujoco = fastest_mujoco(arm["times"])
        for scheme, row in ratios.items():
            row.append(f"{mujoco / arm['times'][scheme]['median']:.1f}")
    for scheme, row in ratios.items():
        lines.append(f"| MuJoCo's fastest / {scheme} | " + " | ".join(row) + " |")
    if figures["aba_cpp_missing"]:
        lines += ["", f"Pinocchio in C++ was not measured: {figures['aba_cpp_missing']}"]
    calls = {name: f"{seconds * 1e6:.1f} us" for name, seconds in figures["python_call"].items()}
    lines += [
        "",
        "A call from Python per servo period costs beside its steps: "
        + ", ".join(f"`{name}` {cost}" for name, cost in calls.items())
        + " (three_axis; of `Plant.advance` most is the check of the voltages).",
        "",
        "![Time per step over the number of joints](ns_per_step.png)",
    ]
    return "\n".join(lines)
