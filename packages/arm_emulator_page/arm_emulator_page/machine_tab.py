"""Controls of the machine as a whole: power, reset, varied numbers, saved machines, gains."""

from typing import Any

from arm_emulator.extension.base import Refusal, escape_markdown
from arm_emulator.extension.machine import Scene
from arm_emulator_page.arm_scene import ArmScene

FAULTS = "faults."  # names of varied numbers that are faults begin so


def add_machine_tab(page: Any, gui: Any, scene: Scene) -> None:
    """Add the controls for what a page's hands can do, in the tab in whose context this is called.

    Args:
        page: a `LivePage`.
        gui: of its server.
        scene: the machine.
    """
    can = page.hands.can()
    if "power" in can:
        buttons = gui.add_button_group("Power", ("on", "off"))
        buttons.on_click(lambda event: page.request_action("power", event.target.value == "on"))
    if "reset" in can:
        gui.add_button("Reset").on_click(lambda _: page.request_action("reset"))
    if "set_varied" in can:
        _add_varied(page, gui, scene)
    if "save" in can:
        name = gui.add_text("Name of a machine", "here")
        both = gui.add_button_group("Machine", ("save", "restore"))
        both.on_click(lambda event: page.request_action(event.target.value, name.value))
    if "set_gain" in can:
        _add_gains(page, gui)
    if not can & {"power", "reset", "set_varied", "save", "set_gain"}:
        gui.add_markdown("This machine can only be watched.")


def _add_varied(page: Any, gui: Any, scene: Scene) -> None:
    """Add a field for each varied number, and for the magnitude of each fault."""
    for title, of_faults in (("Varied numbers", False), ("Faults (0: off)", True)):
        numbers = {k: v for k, v in page.varied.items() if k.startswith(FAULTS) == of_faults}
        if not numbers:
            continue
        with gui.add_folder(title):
            for name, value in numbers.items():
                label = name.removeprefix(FAULTS)
                box = gui.add_number(label, value, step=0.01 * abs(value) or 0.01)
                box.on_update(
                    lambda _, name=name, box=box: page.request_action("set_varied", name, box.value)
                )


def _add_gains(page: Any, gui: Any) -> None:
    with gui.add_folder("Gains of the servo"):
        read = gui.add_button("Read")
        choice = gui.add_dropdown("Gain", ("not read yet",))
        box = gui.add_number("Value", 0.0, step=0.1)
        gains: dict[str, float] = {}

        def show_gain() -> None:
            if choice.value in gains:
                box.value = gains[choice.value]

        def fill_gains() -> None:
            try:
                gains.update(page.hands.do_action("gains"))
            except Refusal as reason:
                page.answer.content = escape_markdown(str(reason))
                return
            if gains:
                names = tuple(sorted(gains))
                box.value = gains[names[0]]
                choice.options, choice.value = names, names[0]

        def put_gain() -> None:
            if choice.value in gains and page.request_action(
                "set_gain", choice.value, float(box.value)
            ):
                gains[choice.value] = float(box.value)

        read.on_click(lambda _: fill_gains())
        choice.on_update(lambda event: show_gain() if event.client is not None else None)
        box.on_update(lambda event: put_gain() if event.client is not None else None)


SIZE = 0.25  # m, of the handle


class TargetTab:
    """Controls in the tab in whose context this is made.

    Args:
        page: a `LivePage`.
        server: of viser.
        arm: that is shown.
    """

    def __init__(self, page: Any, server: Any, arm: ArmScene) -> None:
        gui, self._page, self._server, self._arm = server.gui, page, server, arm
        at = tuple(float(number) for number in arm.p_WT)
        self._place = gui.add_vector3("Position [m], world axes", at, step=0.01)
        gui.add_button("Copy the tool's pose").on_click(lambda _: self._take_pose())
        self._drags = gui.add_checkbox("Drag a handle in the picture", False)
        self._drags.on_update(lambda _: self._switch_handle())
        gui.add_button("Send the tool there").on_click(lambda _: self._send_target())
        self._handle: Any = None
        self._wxyz: tuple[float, ...] | None = None  # that was taken or dragged to

    def _take_pose(self) -> None:
        with self._page.exclusive:
            self._place.value = tuple(float(number) for number in self._arm.p_WT)
            self._wxyz = self._arm.wxyz_WT
            if self._handle is not None:
                self._handle.position, self._handle.wxyz = self._place.value, self._wxyz

    def _switch_handle(self) -> None:
        with self._page.exclusive:
            if not self._drags.value:
                if self._handle is not None:
                    self._handle.remove()
                self._handle = None
                return
            self._take_pose()
            self._handle = self._server.scene.add_transform_controls(
                "/target", SIZE, position=self._place.value, wxyz=self._wxyz, depth_test=False
            )
            self._handle.on_update(lambda _: self._handle_drag())

    def _handle_drag(self) -> None:
        self._place.value = tuple(float(number) for number in self._handle.position)
        self._wxyz = tuple(float(number) for number in self._handle.wxyz)

    def _send_target(self) -> None:
        if self._wxyz is None:
            self._wxyz = self._arm.wxyz_WT
        place = tuple(float(number) for number in self._place.value)
        self._page.request_action("aim", place, self._wxyz)
