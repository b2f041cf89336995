"""The line between a controller and a joint's drive, in C++ as core/parts/line.hpp has it."""

from collections.abc import Iterable, Mapping

from arm_emulator.base.validation.number import Number
from arm_emulator.machine.parts.fault import HOLDS, RISES, Fault, bound_share
from arm_emulator.machine.parts.part import Part, number
from arm_emulator.machine.parts.registry import register_part

LATEST = 16.0  # servo periods
COMMANDED = ("command_", "silent")  # numbers that change no joint without a motor begin so


def _declare_probability(symbol: str) -> float | None:
    declared: float | None = number(symbol, "1", ends=(0.0, 1.0), default=None)
    return declared


def _declare_lateness(symbol: str) -> float | None:
    declared: float | None = number(symbol, "servo periods", ends=(0.0, LATEST), default=None)
    return declared


@register_part
class Line(Part):
    """A perfect line, whose numbers faults change. No scene states it."""

    section = "line"
    header = "line.hpp"
    cxx = "Line"

    command_late: float | None = _declare_lateness("command.late")
    command_lost: float | None = _declare_probability("command.lost")
    command_repeated: float | None = _declare_probability("command.repeated")
    command_overtaken: float | None = _declare_probability("command.overtaken")
    command_corrupted: float | None = _declare_probability("command.corrupted")
    measurement_late: float | None = _declare_lateness("measurement.late")
    measurement_lost: float | None = _declare_probability("measurement.lost")
    measurement_repeated: float | None = _declare_probability("measurement.repeated")
    measurement_overtaken: float | None = _declare_probability("measurement.overtaken")
    measurement_corrupted: float | None = _declare_probability("measurement.corrupted")
    silent: float | None = _declare_probability("silent")
    swapped: float | None = _declare_probability("swapped")

    @classmethod
    def list_faults(cls) -> tuple[Fault, ...]:
        """Faults of the line, and of the controller at its end."""

        def make_kind(name: str, text: str, key: str, size: Number, to: str = HOLDS) -> Fault:
            sets = {f"line.{key}": to}
            return Fault(name, text, sets=sets, magnitude=size, absent=0.0)

        late = Number("magnitude", "servo periods", at_least=0.0, at_most=LATEST, default=3.0)
        faults = (
            fault
            for flow, receiver in (("command", "the drive"), ("measurement", "the controller"))
            for fault in (
                make_kind(
                    f"{flow}_late",
                    f"{receiver} receives each {flow} whole periods late",
                    f"{flow}_late",
                    late,
                    RISES,
                ),
                make_kind(
                    f"{flow}_lost",
                    f"{flow}s are lost with a probability, and the one before stands",
                    f"{flow}_lost",
                    bound_share(0.3),
                ),
                make_kind(
                    f"{flow}_repeated",
                    f"the {flow} before comes once more, behind the newest",
                    f"{flow}_repeated",
                    bound_share(0.3),
                ),
                make_kind(
                    f"{flow}_overtaken",
                    f"{flow}s come a period later, behind the one that follows",
                    f"{flow}_overtaken",
                    bound_share(0.3),
                ),
                make_kind(
                    f"{flow}_corrupted",
                    f"a bit of a {flow} is received wrong",
                    f"{flow}_corrupted",
                    bound_share(0.1),
                ),
            )
        )
        return (
            *faults,
            make_kind(
                "controller_frozen",
                "the controller stops, and its last command stands",
                "command_lost",
                bound_share(),
            ),
            make_kind(
                "controller_restarts",
                "no command comes, and the drive is disabled",
                "silent",
                bound_share(),
            ),
            make_kind(
                "encoders_swapped",
                "the plugs of its encoders and the next joint's are swapped",
                "swapped",
                bound_share(),
            ),
        )


def list_line_numbers(joints: Mapping[str, bool]) -> dict[str, None]:
    """Return the numbers of joints' lines that faults can change.

    Args:
        joints: whether each has a motor, which takes commands, by its name, base to tool.
    """
    *_, last = joints  # has no next joint
    return {
        f"joints.{name}.{Line.section}.{key}": None
        for name, driven in joints.items()
        for key in Line.list_numbers()
        if (driven or not key.startswith(COMMANDED)) and (name != last or key != "swapped")
    }


def write_lines(seed: str, joints: Iterable[str], places: Mapping[str, str]) -> str:
    """Return the function that makes the lines of a scene, empty where no fault is of them.

    Args:
        seed: of their draws, in C++.
        joints: names, base to tool.
        places: where the values of varied numbers stand, by their name.
    """
    set_here = [
        f"    all.at[{j}].{member} = {value};"
        for j, name in enumerate(joints)
        for member, value in Line().list_members(name, places)
    ]
    if not set_here:
        return ""
    body = "\n".join(["    arm::LineSuite<N> all;", f"    all.seed = {seed};", *set_here])
    return f"""\
  static constexpr auto lines([[maybe_unused]] const double* p) {{
{body}
    return all;
  }}
"""
