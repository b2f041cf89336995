"""Gains written into a servo's parameter file, its comments kept."""

from pathlib import Path

import yaml

from arm_emulator.base.io.config_files import check_own
from arm_emulator.base.io.text_file import read_text
from arm_emulator.base.io.yaml_file import MAX_BYTES, edit_yaml, read_nodes
from arm_emulator.base.refusal import Refusal
from arm_emulator.servo.servo_config import ServoConfig, load_servo_config

GAINS = ("position_gain", "velocity_gain", "integral_time", "observer_bandwidth")
RIGID = "link_inertia"  # which a file may leave out


def write_gains(file: Path, servo: ServoConfig) -> None:
    """Put the gains of `servo` into its parameter file, in place of those that are there.

    Raises:
        Refusal: a file that is shipped, not writable, or that has one text for several
            joints at once, as with anchors. Nothing is written then.
    """
    check_own("tune", file)
    new = _replace_gains(read_text(file, MAX_BYTES), servo)
    trial = file.with_name(f".{file.name}")
    try:
        trial.write_text(new, encoding="utf-8")
        if load_servo_config(trial) != servo:
            rule = "have values of its own for each joint, to be written into"
            raise Refusal("tune", f"file {file}", rule, "values that joints share")
        trial.replace(file)
    except OSError as error:
        raise Refusal("tune", f"file {file}", "be writable", error.strerror) from None
    finally:
        trial.unlink(missing_ok=True)


def _replace_gains(text: str, servo: ServoConfig) -> str:
    nodes = read_nodes(text)

    def find_nodes(path: str) -> tuple[yaml.Node, yaml.Node] | None:
        return next((pair for name, pair in nodes.items() if name.endswith(f".{path}")), None)

    edits: list[tuple[int, int, str]] = []
    for joint in servo.joints:
        for key in (*GAINS, RIGID):
            nodes_at = find_nodes(f"joints.{joint.name}.{key}")
            value = repr(float(getattr(joint, key)))
            if nodes_at is not None:
                _, node = nodes_at
                edits.append((node.start_mark.index, node.end_mark.index, value))
            elif key == RIGID and joint.link_inertia:
                nodes_at = find_nodes(f"joints.{joint.name}.{GAINS[-1]}")
                if nodes_at is not None:  # a line of its own behind the last gain's
                    name, node = nodes_at
                    line_end = text.find("\n", node.end_mark.index)
                    line_end = len(text) if line_end < 0 else line_end
                    key_text = text[name.start_mark.index : name.end_mark.index]
                    new_key = key_text.replace(GAINS[-1], RIGID)
                    indent = " " * name.start_mark.column
                    edits.append((line_end, line_end, f"\n{indent}{new_key}: {value}"))
    return edit_yaml(text, edits)
