"""A process has loaded a library that defines the names of ours, for all to see.

An FMU that its importer loads so is one. Ours call their own functions all the same.
"""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from arm_emulator.machine.plant.compiler import (
    build_equations_unit,
    build_machine_unit,
    build_real_time_unit,
)
from arm_emulator.machine.plant.formula_rows import build_formula_unit
from arm_emulator.machine.scene.scene import load_scene
from arm_emulator.machine.session.record_ring import build_record_ring_unit
from arm_emulator.runs.servo_step import make_servo_step_unit
from arm_emulator.servo.servo_law import make_servo_unit
from arm_emulator.tick.c import tick_unit
from arm_emulator.toolchain.compiler_command import find_compiler
from arm_emulator.toolchain.unit import Unit
from arm_emulator_campaign.judging.program import judges_unit
from arm_emulator_campaign.judging.signals import sampler_unit
from arm_emulator_fieldbus.drives_unit import drives_unit
from arm_emulator_fleet.unit import build_fleet_unit
from emulator_node.c import make_answered_ticks_unit, make_real_time_ticks_unit
from servo_node.c import make_answered_states_unit

ROOT = Path(__file__).resolve().parents[2]
RUN = """
import ctypes, hashlib, sys
sys.path += sys.argv[1:3]
if sys.argv[3:]:
    ctypes.CDLL(sys.argv[3], mode=ctypes.RTLD_GLOBAL)
from arm_emulator.runs.offline import OfflineRun
from arm_emulator_fleet.fleet import Fleet
from arm_emulator.machine.scene.scene import load_scene
from arm_emulator.motion.model.config import load_motion_config
from arm_emulator.servo.servo_config import load_servo_config
from torque_modes import enabled
from arm_emulator.base.io.config_files import find_beside, find_scene
scene, file = load_scene("three_axis"), find_scene("three_axis")
servo = load_servo_config(find_beside(file, "servo"))
offline = OfflineRun(scene, servo, load_motion_config(find_beside(file, "motion")))
offline.advance(50)
fleet = Fleet(scene, 3)
fleet.advance([5.0, -5.0, 3.0], 50)
drives = enabled(scene, servo)
print(hashlib.sha256(offline.session.plant.save()).hexdigest(), fleet.state.q.tobytes().hex(),
      [drives.read(j, 0x6077) for j in range(3)])
"""


def names_of(unit: Unit) -> set[str]:
    """Return the functions that a library may show: those declared, and more of their prefix."""
    names = set(unit.functions)
    prefixes = "|".join({name.split("_")[0] for name in names})
    for folder in unit.folders:
        for file in folder.glob("*.[hc]*"):
            names |= set(re.findall(rf"\b((?:{prefixes})_\w+)\(", file.read_text()))
    return names


def printed(*words: str) -> str:
    folders = (str(ROOT), str(ROOT / "packages/arm_emulator_fieldbus/test"))
    command = [sys.executable, "-c", RUN, *folders, *words]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
def test_our_libraries_call_their_own_functions(tmp_path: Path) -> None:
    scene = load_scene("three_axis")
    units = (
        build_machine_unit(scene),
        build_equations_unit(scene),
        build_fleet_unit(scene),
        drives_unit("drives"),
        make_servo_unit(),
    )
    units += make_servo_step_unit(), tick_unit(), build_real_time_unit(), build_record_ring_unit()
    units += (
        build_formula_unit(),
        judges_unit(),
        sampler_unit(),
        make_answered_ticks_unit(),
        make_real_time_ticks_unit(),
        make_answered_states_unit(),
    )
    names = sorted(set().union(*map(names_of, units)))
    assert {"arm_advance", "servo_measure", "firmware_controller_step"} < set(names)
    source, others = tmp_path / "others.c", tmp_path / "others.so"
    lines = [f"void {name}(void) {{ abort(); }}\n" for name in names]
    source.write_text("#include <stdlib.h>\n" + "".join(lines))
    command = [*find_compiler(), "-xc", "-shared", "-fPIC", str(source), "-o", str(others)]
    subprocess.run(command, check=True)
    assert printed(str(others)) == printed()
