"""Units of FMI 2.0 in the hands of libcosim, which loads them by Modelon's FMI Library."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("libcosimpy", reason="libcosimpy is not installed: make test-peers")

from fmu_client import plant_for
from libcosimpy.CosimExecution import CosimExecution
from libcosimpy.CosimObserver import CosimObserver
from libcosimpy.CosimSlave import CosimLocalSlave

from arm_emulator.machine.scene.scene import load_scene
from arm_emulator_fmu.export import export

PERIODS = 500
NANOSECONDS = 1_000_000  # of a servo period


def test_two_arms_side_by_side_move_as_plants_do(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """The waist of one is commanded by the angle of the other's, step by step."""
    scene = load_scene("three_axis")
    export(scene, tmp_path / "arm.fmu", "native", "2")
    run = CosimExecution.from_step_size(step_size=NANOSECONDS)
    first_slave, second = (
        run.add_local_slave(local_slave=CosimLocalSlave(str(tmp_path / "arm.fmu"), name))
        for name in ("one", "other")
    )
    at = {v.name.decode(): v.reference for v in run.slave_variables(first_slave)}
    observer = CosimObserver.create_last_value()
    run.add_observer(observer=observer)
    run.real_initial_value(first_slave, at["command.waist"], 5.0)
    run.connect_real_variables(first_slave, at["truth.q.waist"], second, at["command.waist"])
    assert run.step(step_count=PERIODS), "all steps are taken"
    plants = plant_for(scene, "native"), plant_for(scene, "native")
    waist = np.array([1.0, 0.0, 0.0])
    reported = np.zeros(3)
    for _ in range(PERIODS):
        plants[0].exchange(5.0 * waist)
        plants[1].exchange(reported * waist)
        reported = plants[0].state.q
    references = [at[f"{group}.waist"] for group in ("truth.q", "truth.v", "encoder_counts")]
    for slave, plant in zip((first_slave, second), plants, strict=True):
        state = plant.state
        expected = [state.q[0], state.v[0], float(plant.measured.encoder_counts[0])]
        assert list(observer.last_real_values(slave, references)) == expected, "equal bits"
    printed = capfd.readouterr()
    assert "[error]" not in printed.out + printed.err, "nothing is wrong with the description"
