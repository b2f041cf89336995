"""Scheme, events and step written into a scene file, the rest of it as it was."""

import dataclasses
from pathlib import Path

import numpy as np
import yaml

from arm_emulator.extension.base import (
    LARGEST_YAML_FILE,
    Refusal,
    check_own,
    edited_yaml,
    read_bytes,
    yaml_nodes,
)
from arm_emulator.extension.machine import (
    INTEGRATOR_EVENTS,
    SCHEMES,
    Scene,
    load_scene,
    write_scene_unit,
)
from arm_emulator_analysis.true_motion import IntegrationMethod

SECTION = "integrator"


def write_integrator(file: Path, method: IntegrationMethod, dt: float) -> None:
    """Put a method and its step into a scene file, where everything else stays as it is written.

    Raises:
        Refusal: a file that is shipped, that cannot be read or written, or that is built so that
            the change would reach further; the file is as before then.
    """
    check_own("advise", file)
    before = load_scene(file)
    # Bytes, so that line ends stay what they are.
    text = read_bytes(file, LARGEST_YAML_FILE).decode("utf-8")
    number = np.format_float_scientific(dt, trim="0", exp_digits=1)
    values = {"scheme": method.scheme, "dt": number}
    if method.events != before.integrator.events:
        values["events"] = method.events
    text = _replace_values(text, SECTION, values)
    if method.threads != before.threads:
        text = _replace_values(text, "", {"threads": str(method.threads)})
    new = text.encode("utf-8")
    # Tried in a file beside the scene first: the URDF is named relative to it.
    trial = file.with_name(f".{file.stem}.advised.yaml")
    try:
        try:
            trial.write_bytes(new)
            after = load_scene(trial)
        finally:
            trial.unlink(missing_ok=True)
        expected = dataclasses.replace(
            before.integrator, scheme=method.scheme, events=method.events, dt=dt
        )
        as_expected = after.integrator == expected and after.threads == method.threads
        if not as_expected or _select_rest(after) != _select_rest(before):
            raise Refusal(
                file.name,
                SECTION,
                "not be shared by an anchor in the file",
                "a section that others use too",
                "change it by hand: "
                + ", ".join(f"{key}: {value}" for key, value in values.items()),
            )
        file.write_bytes(new)
    except OSError as reason:
        raise Refusal(file.name, "file", "be writable", reason.strerror or reason) from None


def _select_rest(scene: Scene) -> tuple[object, ...]:
    """Return what of a scene has nothing to do with how it is integrated."""
    plain = dataclasses.replace(scene.integrator, scheme=SCHEMES[0], events=INTEGRATOR_EVENTS[0])
    return (
        scene.name, scene.urdf, scene.true_urdf, scene.tool, scene.servo_period, scene.cores,
        scene.varied,
        write_scene_unit(dataclasses.replace(scene, integrator=plain, threads=1)),
    )  # fmt: skip


def _replace_values(text: str, section: str, values: dict[str, str]) -> str:
    """Return YAML text with values of a section, or at its top, replaced or added at its begin."""
    nodes, prefix = yaml_nodes(text), f"{section}." if section else ""
    edits = []
    for key, value in values.items():
        if (node := nodes.get(f"{prefix}{key}")) is not None:
            edits.append((node[1].start_mark.index, node[1].end_mark.index, value))
        else:
            first = next(start for path, (start, _) in nodes.items() if path.startswith(prefix))
            root = nodes[section][1] if section else None
            in_braces = isinstance(root, yaml.MappingNode) and root.flow_style
            gap = ", " if in_braces else "\n" + " " * first.start_mark.column
            edits.append((first.start_mark.index, first.start_mark.index, f"{key}: {value}{gap}"))
    return edited_yaml(text, edits)
