"""Arguments of calls of a compiled core, and the reasons of its refusals."""

from collections.abc import Mapping
from typing import Any

from numpy.typing import ArrayLike, NDArray

from arm_emulator.base.arrays import Array
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.validation.joint_order import check_joint_names
from arm_emulator.machine.plant.core_calls import ARM, PLACES
from arm_emulator.machine.plant.inputs import list_modes
from arm_emulator.machine.scene.scene import Scene
from arm_emulator.toolchain.c_header import CData, Library, read_text

LARGEST_STEPS = 10**15  # of one call
PIECE = 2**20  # steps after which a long call checks for Ctrl-C

Commands = ArrayLike | Mapping[str, ArrayLike]


def order_by_joint(values: object, scene: Scene, where: str) -> object:
    """Return values given by joint names as columns, base to tool; all else unchanged.

    Raises:
        Refusal: other names than those of all joints.
    """
    if not isinstance(values, Mapping):
        return values
    check_joint_names(where, values, scene.joint_names)
    return [values[name] for name in scene.joint_names]


def build_refusal(
    core: Library, machine: CData, scene: Scene, where: str, otherwise: str
) -> Refusal:
    """Return the refusal of the newest call on a machine.

    Args:
        core: of the machine.
        machine: its handle.
        scene: of the machine.
        where: name of the refusal.
        otherwise: what was got, where no number of a joint was.
    """
    why = ARM.make_struct("arm_refusal")
    core.arm_why(machine, why)
    joint = f" of {scene.joint_names[why.joint]}" if why.joint >= 0 else ""
    actual = why.got if why.joint >= 0 else otherwise
    return Refusal(where, f"{read_text(why.quantity)}{joint}", read_text(why.rule), actual)


def make_truth(**places: NDArray[Any]) -> CData:
    """Return an ``arm_truth`` whose numbers go to arrays, by their names in `PlantState`."""
    return ARM.make_struct(
        "arm_truth", **{PLACES.get(name, name): at for name, at in places.items()}
    )


def make_commands(scene: Scene) -> NDArray[Any]:
    """Return commands of 0, as the joints' motors take them."""
    commands = ARM.make_rows("arm_joint_command", len(scene.joints))
    commands["mode"] = list_modes(scene)
    commands["enable"] = 1
    return commands


def make_options(scene: Scene, values: Array) -> CData:
    """Return the options of a machine; `values` of the varied numbers must outlive them."""
    return ARM.make_struct(
        "arm_options",
        core=scene.cores[1],
        step=scene.integrator.dt,
        steps_per_period=scene.steps_per_period,
        parameters=values,
    )
