"""Measure what this machine holds in real time: lateness, lost periods, old commands, by rate."""

from __future__ import annotations

import math
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import yaml
from cyclopts import Parameter
from numpy.typing import NDArray

from arm_emulator.base.cpu_load import load_processors
from arm_emulator.base.io.config_files import find_beside, find_scene
from arm_emulator.base.io.yaml_file import read_yaml
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.validation.count import check_count
from arm_emulator.base.validation.number import Number
from arm_emulator.cli.command import command
from arm_emulator.cli.options import SceneName
from arm_emulator.cli.output import output
from arm_emulator.machine.plant.plant import Plant
from arm_emulator.machine.scene.scene import Scene, load_scene
from arm_emulator.machine.session.real_time import RealTimeLoop
from arm_emulator.ros.node.network_client import join_network
from arm_emulator.ros.node.node_shell import STATE_SUB_QOS
from arm_emulator.ros.process.bringup import Bringup
from arm_emulator.ros.process.ros_domain import own_domain
from arm_emulator_msgs.msg import EmulatorStatus

RATE = Number("--rates", "Hz", at_least=1.0, at_most=20e3)
SECONDS = Number("--seconds", "s", at_least=0.1, at_most=3600.0)
MAX_BUSY = 1000
FEWEST = 10  # periods
MAX_LOST, MAX_OLD = 1e-3, 1e-2  # shares of periods below which a rate is held


@command(
    keys="`rates`: by Hz, `late` (quantiles 0.5, 0.99, 0.999, 1 [s]), `spent` (median [s]), "
    "`periods`, `lost`, `fifo`, `held`, and of the network `answers` (`periods`, `lost`, `old`, "
    "`p99_lateness`, `worst_lateness`)"
)
def measure_latency(
    scene: SceneName = "three_axis",
    /,
    *,
    rates: Annotated[tuple[float, ...], Parameter(metavar="HZ", consume_multiple=True)] = (
        500.0,
        1000.0,
        2000.0,
    ),
    seconds: Annotated[float, Parameter(metavar="S")] = 5.0,
    busy: Annotated[int, Parameter(metavar="N")] = 0,
    alone: bool = False,
    picture: Annotated[Path | None, Parameter(metavar="PNG")] = None,
) -> int:
    """Measure what this machine holds in real time.

    First the real-time thread alone, with the scene's steps in each period; then emulator and servo
    as two processes. The exit code is 1 if a rate is not held: more than 0.1 % of its periods are
    lost, or more than 1 % pass under an old command.

    Args:
        rates: servo periods per second.
        seconds: of each measurement.
        busy: processes that keep processors busy meanwhile.
        alone: the thread alone, without ROS.
        picture: histograms of its lateness.
    """
    for rate in rates:
        RATE.check_value("latency", rate)
    SECONDS.check_value("latency", seconds)
    if seconds * min(rates) < FEWEST:
        raise Refusal("latency", "--seconds", f"last {FEWEST} periods of each rate [s]", seconds)
    check_count("latency", "--busy", busy, 0, MAX_BUSY)
    machine, measured = load_scene(scene), list[WakeUps]()
    facts: dict[str, Any] = {}
    head = "late by: median      99 %    99.9 %     worst      lost   with nodes: lost        old"
    output.print_line(f"{'rate':>8}   {head if not alone else head[:54]}")
    with load_processors(busy):
        for rate in rates:
            woken = measure_wake_up_latency(machine, 1.0 / rate, seconds)
            measured.append(woken)
            facts[f"{rate:g}"] = fact = _list_facts(woken)
            words = "".join(f"{late * 1e6:7.0f} us" for late in woken.quantiles)
            words = f"{rate:5g} Hz         {words} {woken.lost:9d}"
            if not alone:
                probe = probe_latency(scene, 1.0 / rate, seconds)
                fact["answers"] = probe._asdict()
                share = probe.old / max(1, probe.periods)
                fact["held"] = fact["held"] and share < MAX_OLD
                fact["held"] = fact["held"] and probe.lost < MAX_LOST * probe.periods
                words += f"   {probe.lost:16d} {100 * share:8.2f} %"
            output.print_line(f"{words}   {'held' if fact['held'] else 'not held'}")
    fifo = all(woken.fifo for woken in measured)
    output.print_line(
        f"the thread ran {'under SCHED_FIFO' if fifo else 'without real-time priority'}"
    )
    if picture is not None:
        _draw_histograms(measured, picture)
        output.print_line(str(picture))
    output.add_facts({"rates": facts})
    return int(not all(value["held"] for value in facts.values()))


def _list_facts(woken: WakeUps) -> dict[str, Any]:
    return {
        "late": dict(zip(map(str, QUANTILES), woken.quantiles, strict=True)),
        "spent": float(sorted(woken.spent)[len(woken.spent) // 2]),
        "periods": len(woken.late),
        "lost": woken.lost,
        "fifo": woken.fifo,
        "held": woken.lost < MAX_LOST * len(woken.late),
    }


def _draw_histograms(measured: list[WakeUps], picture: Path) -> None:
    """Draw histograms of lateness, a colour per rate."""
    from matplotlib.figure import Figure  # not pyplot: no screen, no global state

    figure = Figure(figsize=(7.0, 4.0), layout="constrained")
    axes = figure.subplots()
    edges = np.geomspace(1e-6, max(1e-3, *(woken.late.max() for woken in measured)), 60)
    for woken in measured:
        label = f"{1.0 / woken.period:g} Hz: {woken.lost} of {len(woken.late) + woken.lost} lost"
        axes.hist(
            np.maximum(woken.late, edges[0]),
            edges.tolist(),
            histtype="step",
            lw=1.8,
            label=label,
        )
        axes.axvline(woken.period, color=axes.patches[-1].get_edgecolor(), lw=0.8, ls=":")
    axes.set(xscale="log", yscale="log", xlabel="wake-up late by [s]; dotted: the period",
             ylabel="periods")  # fmt: skip
    axes.legend(frameon=False)
    try:
        figure.savefig(picture, dpi=140)
    except (OSError, ValueError) as error:
        raise Refusal("latency", f"picture {picture}", "be writable", error) from None


QUANTILES = (0.5, 0.99, 0.999, 1.0)


@dataclass(frozen=True)
class WakeUps:
    """Wake-ups at the ends of periods.

    Attributes:
        period: between them [s].
        late: by how much each was late [s].
        spent: on each period's steps [s].
        lost: periods that were over before their wake-up.
        fifo: whether the thread ran under SCHED_FIFO.
    """

    period: float
    late: NDArray[np.float64]
    spent: NDArray[np.float64]
    lost: int
    fifo: bool

    @property
    def quantiles(self) -> list[float]:
        """Lateness at `QUANTILES` [s]."""
        return [float(np.quantile(self.late, part, method="higher")) for part in QUANTILES]


def measure_wake_up_latency(scene: Scene, period: float, seconds: float) -> WakeUps:
    """Run the real-time loop of a scene, its motors at 0.

    Args:
        scene: the machine, of which each period computes the steps of one servo period.
        period: wall time between wake-ups [s].
        seconds: how long, or until the first wake-up [s].

    Raises:
        Refusal: see `RealTimeLoop`; or no wake-up comes.
    """
    plant = Plant(scene)
    loop = RealTimeLoop(plant, round(period * 1e9), scene.cores[0])
    late, spent = list[int](), list[int]()

    def take_sample() -> None:
        while (reached := loop.take_tick()) is not None:
            late.append(reached.lateness)
            spent.append(reached.spent)

    loop.start_time(0)
    begun = time.monotonic()
    try:
        while (passed := time.monotonic() - begun) < seconds or not late:
            if passed > seconds + PATIENCE:
                thread_name, rule = (
                    f"the thread of {1.0 / period:g} Hz",
                    f"wake up within {PATIENCE:g} s",
                )
                raise Refusal("latency", thread_name, rule, "no wake-up")
            loop.wait_for_tick(0.1)
            take_sample()
    finally:
        loop.stop_time()
    take_sample()  # wake-ups between the last look and the stop, which have lost periods, too
    figures = loop.figures
    late_s, spent_s = (np.array(times, np.float64) * 1e-9 for times in (late, spent))
    return WakeUps(period, late_s, spent_s, figures.lost_periods, bool(figures.fifo))


PATIENCE = 60.0  # s, wall: for two processes to begin, a compilation included
SETTLED = 0.5  # s of logical time, before which nodes still find each other


class ProbeResult(NamedTuple):
    """Figures of a network in real time.

    Attributes:
        periods: servo periods that passed.
        lost: periods that were over before the machine's wake-up.
        old: periods under a command that answers a state more than two periods old.
        p99_lateness, worst_lateness: of wake-ups, since the start [s].
    """

    periods: int
    lost: int
    old: int
    p99_lateness: float
    worst_lateness: float


def probe_latency(scene: str, period: float, seconds: float) -> ProbeResult:
    """Run emulator and servo of a scene with another servo period, in a ROS domain of their own.

    Args:
        scene: a scene file, or the name of one that comes with the emulator.
        period: servo period [s].
        seconds: how long [s].

    Raises:
        Refusal: the network does not begin.
    """
    with tempfile.TemporaryDirectory() as folder, own_domain():
        file = _write_with_period(find_scene(scene), period, Path(folder))
        log = Path(folder) / "log"
        with (
            Bringup(str(file), clock="realtime", log=log, only=("emulator", "servo")) as network,
            join_network("latency", "") as node,
        ):
            node.listen_to("emulator/status", EmulatorStatus, STATE_SUB_QOS)

            def get_newest() -> Any:
                return node.newest.get("emulator/status")

            def has_settled() -> bool:
                if network.find_ended() is not None:
                    rule, actual = "run in real time", _read_last_line(log)
                    raise Refusal("latency", f"nodes of {scene} at {period:g} s", rule, actual)
                status = get_newest()
                moving = status is not None and status.phase == EmulatorStatus.PHASE_RUNNING
                return moving and bool(status.logical_time >= SETTLED)

            if not node.spin_until(has_settled, PATIENCE):
                actual = f"no answer within {PATIENCE:g} s"
                raise Refusal("latency", "the servo", "answer the emulator", actual)
            begin = get_newest()
            node.spin_until(lambda: get_newest().logical_time >= begin.logical_time + seconds,
                            2.0 * seconds + PATIENCE)  # fmt: skip
            end = get_newest()
    return ProbeResult(
        end.tick - begin.tick,
        end.overruns - begin.overruns,
        end.old_commands - begin.old_commands,
        end.p99_lateness,
        end.worst_lateness,
    )


def _write_with_period(scene: Path, period: float, folder: Path) -> Path:
    """Write a scene and its servo with another servo period; return the scene's file."""
    machine = dict(read_yaml(scene))
    step = machine["integrator"]["dt"]
    machine["integrator"] = {**machine["integrator"], "dt": period / math.ceil(period / step)}
    machine["servo_period"] = period
    machine["urdf"] = _resolve_urdf(scene, machine["urdf"])
    file = folder / f"{scene.stem}.yaml"
    gains = dict(read_yaml(find_beside(scene, "servo")))
    for node in gains.values():
        node["ros__parameters"]["period"] = period
    path = folder / "servo" / file.name
    path.parent.mkdir()
    path.write_text(yaml.safe_dump(gains), encoding="utf-8")
    machine.pop("servo", None)
    file.write_text(yaml.safe_dump(machine), encoding="utf-8")
    return file


def _resolve_urdf(scene: Path, urdf: str) -> str:
    beside = scene.parent / urdf
    return str(beside.resolve()) if beside.is_file() else urdf


def _read_last_line(log: Path) -> str:
    lines = [line for file in log.glob("*.log") for line in file.read_text().splitlines() if line]
    return lines[-1] if lines else "no reason"
