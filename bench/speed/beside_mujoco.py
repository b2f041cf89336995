"""Programs that use the library, beside those that do the same with MuJoCo: lines and time.

Both drive the same machine through the same servo periods. MuJoCo takes the integrator and the
largest step with which its links stay within `TARGET` of the solution, and of these the quickest.
"""

from __future__ import annotations

import ast
import contextlib
import io
import re
import runpy
import shlex
import subprocess
import tempfile
import time
import tokenize
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from arm_emulator import Refusal, Scene, load_scene
from arm_emulator.base.arrays import Array
from arm_emulator.runs.table_run import load_table_run
from bench.measure import show_progress
from bench.tables import format_table

TITLE = "Programs beside MuJoCo's"


ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "examples"
TARGET = 1e-4  # rad, the largest error of a link on the way
FINE = 1e-5  # s, step of the solution; its error is some 1e-4 of ours
STEPS = (1e-3, 5e-4, 2e-4, 1e-4, 5e-5, 2e-5)  # s, of MuJoCo, the largest first
FEW = 8  # arms, whose error is looked at
TICKS = 200  # of the environment
TIMES = (0.3, 0.8, 1.3, 3.0)  # s, at which the program in C is looked at

Run = tuple[Array, float]  # link positions on the way, and how long it took [s]


@dataclass(frozen=True)
class PeerProgram:
    """A job that both do, with all arms or with `FEW`.

    Attributes:
        name: of the file, without its suffix.
        what: it does, in a few words.
        ours: runs it at the scene's own step, or at a finer one [s].
        theirs: runs MuJoCo's with an integrator at a step [s].
    """

    name: str
    what: str
    ours: Callable[[float | None, bool], Run]
    theirs: Callable[[str, float, bool], Run]

    @property
    def files(self) -> tuple[Path, Path]:
        """The programs, ours and MuJoCo's."""
        (own,) = EXAMPLES.glob(f"{self.name}.*")
        return own, own.with_stem(f"{self.name}_mujoco")


def count_code_lines(file: Path) -> int:
    """Return how many lines have code: no comments, docstrings, blank lines."""
    text = file.read_text(encoding="utf-8")
    if file.suffix == ".c":
        bare = re.sub(r"/\*.*?\*/", lambda match: "\n" * match[0].count("\n"), text, flags=re.S)
        return sum(1 for line in bare.splitlines() if line.strip())
    lines: set[int] = set()
    skipped = (tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT)
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in (*skipped, tokenize.ENDMARKER):
            lines |= set(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Module | ast.FunctionDef | ast.ClassDef):
            first = node.body[0]
            if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant):
                lines -= set(range(first.lineno, (first.end_lineno or 0) + 1))
    return len(lines)


def _load_scene(machine: dict[str, Any], dt: float | None) -> Scene:
    return load_scene("three_axis", machine | ({} if dt is None else {"integrator.dt": dt}))


def _load_model(name: str, integrator: str, dt: float) -> Any:
    import mujoco  # of requirements-bench.txt, which tests do without

    model = mujoco.MjModel.from_xml_path(str(EXAMPLES / f"{name}_mujoco.xml"))
    model.opt.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{integrator.upper()}")
    model.opt.timestep = dt
    return model


def _load_both(name: str) -> Iterator[dict[str, Any]]:
    return (runpy.run_path(str(EXAMPLES / f"{name}{suffix}.py")) for suffix in ("", "_mujoco"))


def _measure_work(work: Callable[[], Array]) -> Run:
    begin = time.perf_counter()
    q = work()
    return q, time.perf_counter() - begin


def _make_computed_torque() -> PeerProgram:
    ours, theirs = _load_both("computed_torque")

    def run_own(dt: float | None, few: bool) -> Run:
        scene = _load_scene(ours["MACHINE"], dt)
        return _measure_work(lambda: ours["follow"](scene)[1])

    def run_peer(integrator: str, dt: float, few: bool) -> Run:
        model = _load_model("three_axis_torque", integrator, dt)
        return _measure_work(lambda: theirs["follow"](model)[1])

    return PeerProgram("computed_torque", "computed torque, 2 s", run_own, run_peer)


def _make_sweep() -> PeerProgram:
    ours, theirs = _load_both("sweep")

    def select_arms(few: bool) -> list[Array]:
        return [values[:FEW] if few else values for values in ours["drawn"](200)]

    def run_own(dt: float | None, few: bool) -> Run:
        scene = _load_scene(ours["MACHINE"], dt)
        return _measure_work(lambda: ours["sweep"](scene, *select_arms(few)))

    def run_peer(integrator: str, dt: float, few: bool) -> Run:
        model = _load_model("three_axis", integrator, dt)
        return _measure_work(lambda: theirs["sweep"](model, *select_arms(few)))

    return PeerProgram("sweep", "sweep of 200 arms, 1 s each", run_own, run_peer)


def _make_environment() -> PeerProgram:
    ours, theirs = _load_both("vector_env")

    def drive_environment(env: Any, q: Callable[[], Array]) -> Run:
        env.reset(seed=1)
        rng = np.random.default_rng(2)
        zoh = rng.uniform(-0.3, 0.3, (TICKS // 50, 64, 3)).astype(np.float32)[:, : env.num_envs]
        tool_path = np.empty((TICKS, env.num_envs, 3))

        def drive_arms() -> Array:
            for tick in range(TICKS):
                env.step(zoh[tick // 50])
                tool_path[tick] = q()
            return tool_path

        return _measure_work(drive_arms)

    def run_own(dt: float | None, few: bool) -> Run:
        env = ours["ReachEnv"](_load_scene({}, dt), FEW if few else 64)
        return drive_environment(env, lambda: env.fleet.state.q)

    def run_peer(integrator: str, dt: float, few: bool) -> Run:
        env = theirs["ReachEnv"](_load_model("three_axis", integrator, dt), FEW if few else 64)
        return drive_environment(env, lambda: env.state[:, 4:7])

    return PeerProgram(
        "vector_env", f"64 arms in gymnasium's API, {TICKS} steps", run_own, run_peer
    )


def _make_observer(folder: Path) -> PeerProgram:
    """Return the servo in C; both are compiled into the folder."""
    table = ROOT / "arm_emulator/servo/c/template/targets.csv"
    source, library, twin = EXAMPLES / "my_observer.c", folder / "libobserver.so", folder / "twin"
    import mujoco

    wheel = Path(mujoco.__file__).parent
    (shared,) = wheel.glob("libmujoco.so*")
    header = ROOT / "arm_emulator/core/boundary"
    _compile_program(f"-fPIC -shared -I{header} {source} -o {library}")
    main = source.with_stem("my_observer_mujoco")
    _compile_program(f"-I{wheel / 'include'} {main} {shared} -Wl,-rpath,{wheel} -lm -o {twin}")

    def run_own(dt: float | None, few: bool) -> Run:
        table_run, _ = load_table_run(_write_scene(folder, dt), table, library)

        def run_table() -> Array:
            q = []
            for end in TIMES if few else TIMES[-1:]:
                table_run.advance(
                    round(end / table_run.session.scene.servo_period) - table_run.session.tick
                )
                q.append(table_run.session.state.q)
            return np.array(q)

        with contextlib.closing(table_run):
            return _measure_work(run_table)

    def run_peer(integrator: str, dt: float, few: bool) -> Run:
        model = folder / f"{integrator}.xml"
        text = (EXAMPLES / "three_axis_mujoco.xml").read_text(encoding="utf-8")
        model.write_text(re.sub(r'integrator="\w+"', f'integrator="{integrator}"', text))
        q = []
        for end in TIMES if few else TIMES[-1:]:
            words = [str(twin), str(model), str(table), str(end), repr(dt)]
            done = subprocess.run(words, check=True, capture_output=True, text=True)
            factor, *last = re.findall(r"-?[\d.]+", done.stdout)
            q.append(last)
        return np.array(q, float), TIMES[-1] / float(factor)

    return PeerProgram("my_observer", "servo with an observer in C, 3 s", run_own, run_peer)


def _write_scene(folder: Path, dt: float | None) -> str:
    """Return a scene's name, or the file of one with a finer step."""
    if dt is None:
        return "three_axis"
    file = folder / "fine.yaml"
    text = (ROOT / "config/three_axis.yaml").read_text(encoding="utf-8")
    text = text.replace("urdf/", f"{ROOT / 'config/urdf'}/")
    file.write_text(re.sub(r"\bdt: [\d.e-]+", f"dt: {dt!r}", text), encoding="utf-8")
    return str(file)


def _compile_program(words: str) -> None:
    command = ["cc", "-std=gnu99", "-O2", *shlex.split(words)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise Refusal("beside_mujoco", "a program in C", "compile", done.stderr.strip()[-200:])


@dataclass(frozen=True)
class StepChoice:
    """An integrator of MuJoCo and a step, with the error and the time of few arms there."""

    integrator: str
    dt: float  # s
    error: float  # rad
    seconds: float


def _choose_step(program: PeerProgram, solution: Array) -> StepChoice:
    """Return the quickest way of MuJoCo to `TARGET`; the most exact one if none gets there."""
    from bench.speed.mujoco_peer import INTEGRATORS

    tried: list[StepChoice] = []
    for integrator in INTEGRATORS:
        for dt in STEPS:
            q, seconds = program.theirs(integrator, dt, True)
            off = float(np.nan_to_num(np.abs(q - solution), nan=np.inf).max())
            tried.append(StepChoice(integrator, dt, off, seconds))
            if off <= TARGET:
                break
    good = [trial for trial in tried if trial.error <= TARGET]
    return min(good or tried, key=lambda trial: trial.seconds if good else trial.error)


def run_bench(quick: bool) -> dict[str, Any]:
    """Measure lines, errors and times of every program; all arms in turns, medians."""
    repetitions = 1 if quick else 5
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        programs = [
            _make_computed_torque(),
            _make_sweep(),
            _make_environment(),
            _make_observer(Path(folder)),
        ]
        with show_progress("programs", len(programs)) as done:
            for program in programs:
                solution, _ = program.ours(FINE, True)
                own, _ = program.ours(None, True)
                choice = _choose_step(program, solution)
                walls = [
                    (program.ours(None, False)[1],
                     program.theirs(choice.integrator, choice.dt, False)[1])
                    for _ in range(repetitions)
                ]  # fmt: skip
                ours, theirs = np.median(walls, axis=0)
                rows.append({
                    "what": program.what, "name": program.name,
                    "lines": [count_code_lines(file) for file in program.files],
                    "seconds": [float(ours), float(theirs)],
                    "ratio": float(np.median([b / a for a, b in walls])),
                    "errors": [float(np.abs(own - solution).max()), choice.error],
                    "integrator": choice.integrator, "dt": choice.dt,
                })  # fmt: skip
                done(program.name)
    return {"rows": rows, "target": TARGET}


def write_report(figures: dict[str, Any]) -> str:
    """Return the table."""
    rows = []
    for row in figures["rows"]:
        error, second = (f"{value:.1g} rad" for value in row["errors"])
        at = f"{second}, {row['integrator']} at {row['dt'] * 1e3:g} ms"
        times = map(_format_time, row["seconds"])
        rows.append((row["what"], *row["lines"], *times, f"{row['ratio']:.3g}", error, at))
    heads = ("program", "lines of code", "MuJoCo", "time", "MuJoCo", "ratio", "error", "MuJoCo, at")
    return format_table(heads, rows)


def _format_time(seconds: float) -> str:
    return f"{seconds:.2g} s" if seconds >= 0.1 else f"{seconds * 1e3:.2g} ms"
