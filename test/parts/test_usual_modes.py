"""If drives report that they are in their usual modes, their parts agree one by one."""

from pathlib import Path

import numpy as np
import pytest
from machines import DC, GANTRY, gantry_urdf, write_scene

from arm_emulator.machine.plant.compiler import load_machine_with
from arm_emulator.machine.scene.scene import load_scene
from arm_emulator.toolchain.c_header import Header, make_pointer

ELASTIC = {"ratio": 0.02, "stiffness": 2e4, "damping": 20.0}
STOPS = {"lower": -0.5, "upper": 0.7, "stiffness": 3e3, "damping": 5.0}
BRAKE = {"torque": 0.5, "close_delay": 5e-3, "release_delay": 5e-3}
JOINTS = [
    {"motor": {**DC, "current_limit": 4.0}, "gear": ELASTIC, "end_stops": STOPS, "brake": BRAKE},
    {"motor": {**DC, "friction": {"coulomb": 5e-3}}, "gear": ELASTIC, "brake": BRAKE},
    {"motor": DC, "gear": {**ELASTIC, "backlash": 0.01}, "end_stops": STOPS},
]
# Asks the drive of a joint in random states; `open`: whether its brake is. Counts the states that
# are usual at once, and those of them whose modes are others; then all whose modes are the usual.
ASK = """
extern "C" __attribute__((visibility("default")))  //
void ask(int joint, int open, int count, int* usual) {
  using namespace arm;
  double closed[kOwnNumbers<Scene> + 1] = {};
  Numbers<Scene> n(closed);
  for (int k = 0; k < Scene::brakes; ++k) n.set(Scene::parameters + k, open ? 0.0 : 1.0);
  unsigned long long random = 1 + joint;
  const auto draw = [&](double size) {
    random = random * 6364136223846793005ULL + 1442695040888963407ULL;
    const double share = static_cast<double>(random >> 11) / 9007199254740992.0;
    return share < 0.1 ? 0.0 : size * (2.0 * share - 1.0);
  };
  usual[0] = usual[1] = usual[2] = 0;
  n.for_each_drive([&](const auto& drive, int j) {
    if (j != joint) return;
    using Input = typename std::remove_cvref_t<decltype(drive)>::template Input<double>;
    for (int k = 0; k < count; ++k) {
      Input start = {}, end = {};
      for (Input* x : {&start, &end}) {
        x->z[0] = draw(6.0), x->z[1] = draw(50.0), x->z[2] = draw(100.0);
        x->q = draw(1.0), x->v = draw(2.0), x->u = draw(24.0);
      }
      const decltype(drive.modes_at(end)) none = {};
      const bool all = drive.modes_at(end) == none && drive.required_mode(start, end, none) == none;
      usual[2] += all;
      if (!drive.is_regular(end)) continue;
      usual[0] += 1;
      usual[1] += !all;
    }
  });
}
"""


@pytest.mark.slow
def test_drives_that_state_they_are_in_regular_modes_are(tmp_path: Path) -> None:
    joints = dict(zip(GANTRY, JOINTS, strict=True))
    scene = load_scene(write_scene(tmp_path, gantry_urdf(), joints))
    header = tmp_path / "c" / "ask.h"
    header.parent.mkdir()
    header.write_text("void ask(int joint, int brake_open, int count, int32_t* counted);\n")
    core = load_machine_with(scene, "ask", ASK, Header(header))

    def ask(joint: int, brake_open: bool) -> list[int]:
        counted = np.zeros(3, np.int32)
        core.ask(joint, brake_open, 20_000, make_pointer(counted))
        return counted.tolist()

    at_once, wrongly, in_regular_modes = ask(0, True)
    assert wrongly == 0, "a limit, a stop or a brake holds in a mode that is called usual"
    # The rest are links that leave their stop faster than it follows.
    assert 0.99 * in_regular_modes < at_once <= in_regular_modes, (
        "usual modes that the quick check misses"
    )
    for joint, brake_open in ((0, False), (1, True), (2, True)):
        assert ask(joint, brake_open)[0] == 0, "friction, teeth and closed brakes must be asked"
