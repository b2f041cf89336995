"""Tools for test suites of users: a machine for each test, and assertions about its motion."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml
from numpy.typing import ArrayLike

from arm_emulator.base.arrays import Array
from arm_emulator.base.io.config_files import find_beside, find_scene
from arm_emulator.base.io.yaml_file import read_yaml
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.validation.coerce import coerce_array, coerce_kind
from arm_emulator.base.validation.count import check_count
from arm_emulator.base.validation.number import Number
from arm_emulator.machine.plant.measured import Measured
from arm_emulator.machine.plant.plant import Plant
from arm_emulator.machine.scene.scene import Scene, load_scene

if TYPE_CHECKING:
    from arm_emulator.ros.node.network_under_test import NetworkUnderTest

Law = Callable[[int, Measured], ArrayLike]


def plant_of(scene: Scene | str | Path, overrides: Mapping[str, Any] | None = None) -> Plant:
    """Return a new plant of a scene, by name or file with overrides as `load_scene` takes them.

    Raises:
        Refusal: as `load_scene` and `Plant`.
    """
    return Plant(scene if isinstance(scene, Scene) else load_scene(scene, overrides))


def drive(plant: Plant, law: Law, ticks: int) -> Array:
    """Run a plant under a control law for a number of servo periods.

    Args:
        plant: the machine.
        law: returns the commands (N,) for a tick, from the tick and its measurement.
        ticks: number of servo periods.

    Returns:
        True link positions after each period, (ticks, N) [rad or m].

    Raises:
        Refusal: commands are refused.
        Diverged: see `Plant.exchange`.
    """
    where = "testing.drive"
    coerce_kind(plant, Plant, where, "plant", "be a Plant")
    if not callable(law):
        raise Refusal(where, "law", "be a function of tick and measurement", law)
    ticks = check_count(where, "ticks", ticks)
    q = np.zeros((ticks, len(plant.scene.joints)))
    for tick in range(ticks):
        plant.exchange(np.asarray(law(tick, plant.measured)), tick)
        q[tick] = plant.state.q
    return q


@contextlib.contextmanager
def network(
    scene: str | Path = "three_axis",
    *,
    without: Sequence[str] = (),
    faults: Sequence[str] = (),
    log: Path | None = None,
    keep: Path | None = None,
    **emulator: object,
) -> Iterator[NetworkUnderTest]:
    """Run the nodes of a scene in lock-step in an unused ROS domain for a block.

    Processes started in the block are in that domain, too. Requires ROS and the messages.

    Args:
        scene: a scene by name or file, with its gains beside it.
        without: nodes that the test starts itself: "emulator", "servo", "motion_controller".
        faults: names or patterns of faults that the machine may have beside those of its scene, for
            `set_fault`; a scene file with them is written into `log` or beside `keep`.
        log: folder for the output of the nodes; None: that of the test.
        keep: folder of a bag, which stays only if the block fails; the error then has the line that
            drives the machine through it again.
        emulator: parameters of the emulator, such as ``start="paused"`` or ``record=folder``.

    Returns:
        The network, for targets, waits and statuses, see `NetworkUnderTest`.

    Raises:
        Refusal: no such node, or a configuration file is missing.
        AssertionError: a node ended within the block, or abnormally at its end.
    """
    from arm_emulator.ros.process.bringup import NODES, Bringup
    from arm_emulator.ros.process.ros_domain import own_domain

    for name in (wrong for wrong in without if wrong not in NODES):
        raise Refusal("testing.network", "without", "name nodes", name, ", ".join(NODES))
    if keep is not None and "record" in emulator:
        raise Refusal("testing.network", "keep", "be given without record", keep)
    only = tuple(name for name in NODES if name not in without)
    parameters = dict(emulator) if keep is None else {**emulator, "record": keep}
    again = f"arm_emulator check-bag {keep}"
    if faults:
        folder = log or (keep.parent if keep is not None else None)
        if folder is None:
            raise Refusal("testing.network", "faults", "come with log or keep", ", ".join(faults))
        scene = _write_scene(faults, find_scene(str(scene)), folder)
        again += f" --scene {scene}"
    try:
        with (
            own_domain(),
            Bringup(str(scene), emulator=parameters, log=log, only=only, forked=True) as nodes,
        ):
            with joined(only, nodes.find_ended) as user:
                yield user
            assert (ended := nodes.find_ended()) is None, f"{ended} ended within the test"
            codes = nodes.stop_nodes()
            assert set(codes.values()) <= {0}, f"exit codes {codes}"
    except BaseException as error:
        if keep is not None:
            error.add_note(f"driven again by: {again}")
        raise
    if keep is not None:
        shutil.rmtree(keep)


@contextlib.contextmanager
def joined(
    ours: Sequence[str] = ("emulator", "servo", "motion_controller"),
    ended: Callable[[], object] = lambda: None,
) -> Iterator[NetworkUnderTest]:
    """Use a network in this process's ROS domain for a block, such as one of launch_testing.

    Args:
        ours: names of its nodes that are not the user's own.
        ended: names a node that has ended; None while all run.

    Returns:
        The network, for targets, waits and statuses, see `NetworkUnderTest`.
    """
    from rclpy import Context

    from arm_emulator.ros.node.network_under_test import NetworkUnderTest

    context = Context()
    context.init()
    try:
        user = NetworkUnderTest(context, ended, ours)
        yield user
        user.close()
    finally:
        context.try_shutdown()


def _write_scene(faults: Sequence[str], file: Path, folder: Path) -> Path:
    """Write a copy of a scene file that lists more faults; return it."""
    scene = dict(read_yaml(file))
    scene["faults"] = [*scene.get("faults", ()), *faults]
    if isinstance(scene.get("urdf"), str) and (file.parent / scene["urdf"]).exists():
        scene["urdf"] = str((file.parent / scene["urdf"]).resolve())
    for kind in ("servo", "motion"):
        scene[kind] = str(find_beside(file, kind))
    folder.mkdir(parents=True, exist_ok=True)
    copy = folder / file.name
    copy.write_text(yaml.safe_dump(scene, sort_keys=False), encoding="utf-8")
    return copy


def assert_settles(q: ArrayLike, target: ArrayLike, within: float, last: int) -> None:
    """Assert that a run ends at a target, and that it stays there.

    Args:
        q: positions, a row each [rad or m].
        target: target positions (N,).
        within: tolerance [rad or m].
        last: number of final rows that must be at the target.

    Raises:
        Refusal: shapes differ, or there are fewer rows.
        AssertionError: names the joint, its error and the time.
    """
    where, rows, expected = "testing.assert_settles", coerce_array(q), coerce_array(target)
    if rows is None or expected is None:
        raise Refusal(where, "q and target", "be numbers", q if rows is None else target)
    within = Number("within", at_least=0.0).check_value(where, within)
    if rows.ndim != 2 or expected.shape != rows.shape[1:]:
        rule = "have shapes (K, N) and (N,)"
        raise Refusal(where, "q and target", rule, f"{rows.shape} and {expected.shape}")
    last = check_count(where, "last", last, 1, len(rows))
    off = np.abs(rows[-last:] - expected)
    row, joint = np.unravel_index(int(np.argmax(off)), off.shape)
    worst = float(off[row, joint])
    assert worst <= within, (
        f"joint {joint} is {worst:.3g} off {last - int(row)} rows before the end, not {within:g}"
    )
