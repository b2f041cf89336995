"""The torques on every link and every rotor at an instant, term by term, as the core computes them.

The terms sum up to 0, inertia included: they are the equations of motion that were solved.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from arm_emulator.base.array_equality import ArrayEquality
from arm_emulator.base.arrays import Array
from arm_emulator.machine.plant.plant import Plant
from arm_emulator.machine.scene.scene import Scene
from arm_emulator.toolchain.c_header import NULL, make_pointer

# Rows of arm_torque_terms before those of extras.
_OF_LINK = (
    "inertia",
    "Coriolis and centrifugal",
    "gravity",
    "external wrench",
    "gear",
    "viscous friction",
    "dry friction",
    "rotor behind a rigid gear",
)
_OF_ROTOR = ("inertia", "motor", "gear", "friction")


@dataclass(frozen=True, eq=False)
class TermsNow(ArrayEquality):
    """Torques by the names of their terms, (N,) each; NaN: the joint has no such part.

    Attributes:
        link: on the links [N m, N at prismatic joints].
        rotor: on the rotors behind elastic gears, where a rotor turns with its link those of motor
            and friction alone [N m].
    """

    link: dict[str, Array]
    rotor: dict[str, Array]


class TorqueTerms:
    """Computes the torques of machines of a scene; compiles its equations at its first use.

    Args:
        scene: the scene.
    """

    def __init__(self, scene: Scene) -> None:
        self._scene = scene

    @cached_property
    def _plant(self) -> Plant:
        return Plant(self._scene)

    def evaluate_torques(self, saved: bytes, command: Array) -> TermsNow:
        """Return the torques of a machine under commands that begin now.

        Args:
            saved: the machine, by `Plant.save`.
            command: (N,) [V, N m or A].

        Raises:
            Refusal: see `Plant.restore`.
        """
        plant, scene = self._plant, self._scene
        plant.restore(saved)
        N, joints, places = len(scene.joints), scene.machine_joints, scene.joint_places
        of_machine = np.zeros((plant.call_equation("arm_torque_terms", NULL, NULL), len(joints)))
        powered_command = np.zeros(len(joints))
        powered_command[places] = np.asarray(command) * plant.powered
        plant.call_equation(
            "arm_torque_terms", make_pointer(powered_command), make_pointer(of_machine)
        )
        out = of_machine[:, places]
        k, n = len(_OF_LINK), len(_OF_LINK) + len(_OF_ROTOR)
        link, rotor = (
            dict(zip(_OF_LINK, out, strict=False)),
            dict(zip(_OF_ROTOR, out[k:], strict=False)),
        )
        extras = (len(out) - n) // 2
        for e in range(extras):
            for j, joint in enumerate(joints[name] for name in scene.joint_names):
                if e < len(joint.extras):
                    side = rotor if out[n + extras + e, j] else link
                    section = type(joint.extras[e]).section.replace("_", " ")
                    side.setdefault(section, np.full(N, np.nan))[j] = out[n + e, j]
        return TermsNow(_select_present(link), _select_present(rotor))


def _select_present(terms: dict[str, Array]) -> dict[str, Array]:
    """Return the terms that at least one joint has."""
    return {name: torque for name, torque in terms.items() if not np.isnan(torque).all()}
