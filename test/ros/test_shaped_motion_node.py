"""The shaper of the motion controller's node: the bits of an offline run, set at run time."""

import dataclasses
from pathlib import Path

import numpy as np
from ideal_arm import SECOND
from in_process import in_process
from rclpy.parameter import Parameter
from test_motion_node import trajectory

from arm_emulator import load_gains, load_scene
from arm_emulator.motion.model.config import load_motion_config
from arm_emulator.motion.model.input_shaper import InputShaper
from arm_emulator.motion.trajectory.joint_trajectory import TrajectoryPoint
from arm_emulator.runs.offline import OfflineRun

SHAPED = """
/**/motion_controller:
  ros__parameters:
    tool: tool
    task: position
    period: 0.05
    shaper: zvd
    modes:
      first: {frequency: 9.0, damping: 0.2}
      second: {frequency: 25.0}
"""


def test_a_shaped_motion_has_the_same_bits_over_topics_and_its_shaper_is_set_at_run_time(
    tmp_path: Path,
) -> None:
    file = tmp_path / "motion.yaml"
    file.write_text(SHAPED)
    config = load_motion_config(file)
    scene, servo = load_scene("three_axis"), load_gains("three_axis").servo
    run = OfflineRun(scene, servo, config)
    names = list(run.controller.kinematics.joint_names)
    goal = (scene.start + 0.2).tolist()
    with in_process(motion=file) as nodes:
        nodes.run_to(20)
        nodes.send("joint_trajectory", trajectory(SECOND // 10, names, (0.5, goal)))
        nodes.run_to(1500)
        run.instructor.add_trajectory(
            run.controller, names, [TrajectoryPoint(SECOND // 2, goal)], SECOND // 10
        )
        for tick in range(1500):
            state = run.session.measured
            counts = np.asarray(state.encoder_counts, dtype=np.int64)
            assert nodes.states[tick] == counts.tobytes() + state.current.tobytes(), tick
            run.advance(1)
        node = nodes.nodes["motion_controller"]

        def put(name: str, value: object) -> str:
            [answer] = node.set_parameters([Parameter(name, value=value)])
            return "" if answer.successful else answer.reason

        assert "shaper must be known" in put("shaper", "zvdd")
        assert "must be set while the node is unconfigured" in put("modes.first.frequency", 12.0)
        assert node._config == dataclasses.replace(config, where=node._config.where)
        assert put("shaper", "zv") == ""
        nodes.run_to(1600)
        expected = InputShaper.compute_shaper("zv", config.modes)
        assert node._motion._controllers.shaped.delay == expected.delay
