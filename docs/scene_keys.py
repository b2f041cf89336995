"""Keys of a scene outside its joints, for the pages: numbers as they are declared, and the others.

What reads them is `scene.py`; `test_documents.py` compares the names.
"""

from collections.abc import Sequence

from arm_emulator.base.calibration.deviation import Deviation
from arm_emulator.base.io.config_files import BESIDE
from arm_emulator.base.name_rule import LONGEST_NAME, SCENE_MARKS
from arm_emulator.base.validation.number import Number, list_numbers
from arm_emulator.machine.parts.key import Key
from arm_emulator.machine.scene.integrator import EVENTS, EXCHANGES, Integrator
from arm_emulator.machine.scene.payload import COM, INERTIA, MASS
from arm_emulator.machine.scene.scene import CORES, GRAVITY, HOME_OFFSETS, Scene
from arm_emulator.machine.scene.scene_links import LOCKED, SHARE
from arm_emulator.machine.schemes.known import SCHEMES

Keys = dict[str, Key | Number]


def _make_choice(values: Sequence[str], text: str) -> Key:
    """Return a key whose value is one of several; the first holds without it."""
    choices = ", ".join(f"`{value}`" for value in values)
    return Key("", range=choices, absent=f"`{values[0]}`", text=text)


def _make_row(number: Number, size: int, absent: str, text: str) -> Key:
    """Return a key with several numbers."""
    ends = (
        f"each ±{number.most:g}" if number.in_size else f"each {number.least:g} to {number.most:g}"
    )
    return Key("", unit=number.unit, range=f"{size} numbers, {ends}", absent=absent, text=text)


def _make_flag(text: str) -> Key:
    return Key("", range="`true`, `false`", absent="`false`", text=text)


def _make_names(of: str, absent: str, text: str) -> Key:
    return Key("", range=f"a list of {of}", absent=absent, text=text)


_SCENE, _INTEGRATOR = list_numbers(Scene), list_numbers(Integrator)

MACHINE: Keys = {
    "name": Key(
        "",
        range=f"letters, digits, blanks and `{SCENE_MARKS}`, at most {LONGEST_NAME} bytes",
        absent="refused",
        text="what the scene is called",
    ),
    "urdf": Key(
        "",
        range="file",
        absent="refused",
        text="the links. A path relative to the scene file, or `example-robot-data:PATH`"
        " for a file below `robots/` of that package",
    ),
    **{
        folder: Key(
            "",
            range="file",
            absent=f"`{folder}/NAME.yaml` beside `NAME.yaml`",
            text="what belongs to the scene, see [A new scene](#a-new-scene)",
        )
        for folder in BESIDE
    },
    "tool": Key(
        "",
        range="a link of the URDF",
        absent="refused",
        text="carries the payload; its path is drawn",
    ),
    "gravity": _make_row(
        GRAVITY,
        3,
        "none",
        "acceleration of free fall in the world, `[0, 0, -9.81]` on earth with z up",
    ),
    "locked": Key(
        "",
        unit="rad (m)",
        range=f"{LOCKED.least:g} to {LOCKED.most:g}",
        text="`{joint: position}`: joints of the URDF that are held there, as if fixed:"
        " fingers or a second arm that shall not move",
    ),
    "couplings": Key(
        "",
        unit="rad/rad (m/rad, ...)",
        absent="by `mimic` alone",
        range=f"factors from {SHARE.least:g} to {SHARE.most:g}",
        text="`{joint: {shaft: factor}}`: joints that do not go each with a drive, see"
        " [Couplings](#couplings)",
    ),
    "payload": Key("", range="section, or its mass alone", text="what the tool carries"),
    "payload.mass": MASS,
    "payload.com": _make_row(COM, 3, "`[0, 0, 0]`", "its centre of mass in the tool's frame"),
    "payload.inertia": _make_row(
        INERTIA,
        6,
        "0",
        "`[ixx, iyy, izz, ixy, ixz, iyz]`, positive"
        " definite, about its centre of mass, along the tool's axes",
    ),
    "calibration": Key(
        "",
        range="section",
        text="how the machine's kinematics differs from the"
        " URDF, see [Nominal and true kinematics](../how_to/calibrate.md)",
    ),
    "calibration.file": Key(
        "",
        range="file beside the scene",
        text="deviations in a file: ours, or one of Universal Robots or KUKA",
    ),
    "calibration.nominal": Key(
        "", range="file beside the scene", text="of a `.dat` of KUKA: the machine data of its type"
    ),
    "calibration.base": Key(
        "",
        range="a link fixed to the root",
        absent="`base`, else the root",
        text="in whose frame makers state their numbers",
    ),
    "calibration.flange": Key(
        "", range="a link of the URDF", absent="`tool0`, else the tool", text="up to which they do"
    ),
    "calibration.joints": Key(
        "",
        range="a section per joint of the URDF, fixed ones too",
        text="deviations, each in the place of the file's:",
    ),
    **{
        f"calibration.joints.JOINT.{key}": number for key, number in list_numbers(Deviation).items()
    },
    "external_wrench": _make_flag(
        "whether forces and moments may act on the links from outside, see"
        " [External wrenches](parts/external_wrench.md)"
    ),
    "supply_voltage": _SCENE["supply_voltage"],
    "assumed": _make_names(
        "links of the URDF", "none", "links without measured bodies: `check-scene` names them"
    ),
    "trusted_inertias": _make_names(
        "links of the URDF",
        "none",
        "links whose inertia `check-scene` takes as it is: regrouped or"
        " identified parameters, or a body that its shape does not show",
    ),
    "imus": Key(
        "", range="a section per unit", text="[inertial measurement units](parts/imu.md) on links"
    ),
    "seed": _SCENE["seed"],
    "home_offset": _make_choice(
        HOME_OFFSETS,
        "meaning of object 0x607C of drives on field buses: by CiA"
        " 402 the zero position is the home position plus the offset; with"
        " `zero_to_home`, as some makers have it, the home gets the position"
        " 0x607C",
    ),
}

TIME: Keys = {
    "servo_period": _SCENE["servo_period"],
    "integrator.dt": _INTEGRATOR["dt"],
    "integrator.scheme": _make_choice(
        SCHEMES, "how a step is taken, see [Schemes](../concepts/physics.md#schemes)"
    ),
    "integrator.events": _make_choice(
        EVENTS,
        "`located`: a step is cut where a joint comes to rest or"
        " breaks away, or a current reaches or leaves its limit, so that"
        " order 2 survives; costs up to some 0.1 ms per such event. Not"
        " with every scheme, and in one thread",
    ),
    "threads": _SCENE["threads"],
    "integrator.exchange": _make_choice(
        EXCHANGES,
        "with two threads: how a step takes what the other"
        " thread knows from an earlier sample; `lag` is the paper's, see"
        " [Two threads](../concepts/physics.md#two-threads)",
    ),
    "integrator.exchange_depth": _INTEGRATOR["exchange_depth"],
    "cores": Key(
        "",
        range="2 core numbers of this machine",
        absent="any",
        text="the first for the thread of the real-time clock, which runs the motors, the"
        f" second for the Newton-Euler thread of `threads: 2`; at most {CORES.most:g}",
    ),
    "energy_flow": _make_flag(
        "whether `Plant.powers` and `Plant.advance_metered` report what the supply"
        " gives each joint, and what it dissipates; without it the scene compiles"
        " faster"
    ),
    "varied": _make_names(
        "names or patterns",
        "`[]`",
        "[numbers](#varied-numbers) that are data of each"
        " machine, not constants of the compiled core",
    ),
    "faults": _make_names(
        "names or patterns",
        "`[]`",
        "[what may fail](faults.md): data of each machine, off in the beginning",
    ),
}
