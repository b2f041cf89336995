"""documentation/index.html of a unit: its variables, and how it is used."""

from collections.abc import Sequence

from arm_emulator.extension.base import escape_html
from arm_emulator.extension.machine import Scene
from arm_emulator_fmu.names import find_convention, write_name
from arm_emulator_fmu.variables import Variable


def write_page(scene: Scene, variables: Sequence[Variable], command: str) -> bytes:
    """Return the page.

    Args:
        scene: the machine.
        variables: of it.
        command: that compiles the sources.
    """
    naming = find_convention(variable.name for variable in variables)
    rows = "\n".join(
        "<tr>"
        + "".join(f"<td>{escape_html(text)}</td>" for text in _format_cells(variable, naming))
        + "</tr>"
        for variable in variables
    )
    name = escape_html(scene.name)
    joints = escape_html(", ".join(scene.joint_names))
    return f"""\
<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>{name}</title></head><body>
<h1>{name}</h1>
<p>A machine of arm_emulator for co-simulation: motors, gears, links, sensors. Joints, base to
tool: {joints}. Arrays have an entry per joint in this order.</p>
<p>Communication steps may be of any length. The drives have a servo period of
{scene.servo_period:g} s: inputs act from the beginning of the next period on and are held over
it, and outputs are those of the last period that has ended. A value that is not finite or beyond
its bounds is discarded together with the others of its call. A motion that diverges is an error;
the machine stays at its last sound state until it is reset or set to a state that was kept. Equal
steps and inputs give equal bits.</p>
<h2>Variables</h2>
<table border="1">
<tr><th>name</th><th>type</th><th>unit</th><th>kind</th><th>what it is</th></tr>
{rows}
</table>
<h2>Sources</h2>
<p>In the folder <code>sources</code>:</p>
<pre>{escape_html(command)}</pre>
<p>With these options every compiler and processor gives the same bits.</p>
<p>The emulator is under the Apache License 2.0, see <a href="licenses/license.txt">license.txt</a>.
The robot's description and its numbers are their author's.</p>
</body></html>
""".encode()


def _format_cells(variable: Variable, naming: str) -> tuple[str, ...]:
    size = "".join(f"[{count}]" for count in variable.shape)
    kind = {"fixed": "parameter, before the start", "tunable": "parameter, at any time"}
    return (
        write_name(variable.name, variable.element, naming),
        f"{variable.type}{size}",
        variable.unit or "",
        kind.get(variable.role, variable.role),
        variable.description,
    )
