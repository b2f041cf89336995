"""A force and a moment on a link: by their numbers, or by a handle that is dragged away."""

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from arm_emulator.extension.machine import Scene
from arm_emulator.extension.page import Vector
from arm_emulator_page.arm_scene import ArmScene

SIZE = 0.2  # m, of the handle
PAUSE = 0.1  # s, wall, between two forces of a drag: each is an event of the run
RED = (214, 39, 40)
NONE = (0.0, 0.0, 0.0)


class PushTab:
    """Controls in the tab in whose context this is made.

    Args:
        exclusive: lock of all that changes the page.
        push: gets link, force [N] and moment [N m].
        server: of viser.
        arm: that is shown.
        scene: the machine.
    """

    def __init__(
        self, exclusive: Any, push: Callable[[str, Vector, Vector], object], server: Any,
        arm: ArmScene, scene: Scene,
    ) -> None:  # fmt: skip
        gui, self._exclusive, self._push_with = server.gui, exclusive, push
        self._server, self._arm = server, arm
        if not scene.external_wrench:
            gui.add_markdown("Links cannot be pushed: the scene has no `external_wrench: true`.")
            return
        links = tuple(link.link for link in scene.chain.bodies.values())
        self._link = gui.add_dropdown("Link", links, initial_value=links[-1])
        self._link.on_update(lambda _: self._switch_handle())
        self._force = gui.add_vector3("Force [N], world axes", NONE, step=1.0)
        self._moment = gui.add_vector3("Moment [N m], world axes", NONE, step=0.1)
        gui.add_button("Push").on_click(lambda _: self._push_link())
        gui.add_button("Let go").on_click(lambda _: self._let_go())
        self._drags = gui.add_checkbox("Drag a handle in the picture", False)
        self._drags.on_update(lambda _: self._switch_handle())
        self._stiffness = gui.add_number("Stiffness [N/m]", 100.0, min=0.0, step=10.0)
        self._handle: Any = None
        self._arrow: Any = None
        self._sent = 0.0

    def _push_link(self) -> None:
        force, moment = self._force.value, self._moment.value
        self._push_with(self._link.value, _read_vector(force), _read_vector(moment))

    def _let_go(self) -> None:
        with self._exclusive:
            self._force.value = self._moment.value = NONE
            self._push_with(self._link.value, NONE, NONE)
            if self._handle is not None:
                self._handle.position = tuple(self._arm.locate_link(self._link.value))
            self._show_arrow()

    def _switch_handle(self) -> None:
        with self._exclusive:
            if self._handle is not None:
                self._handle.remove()
                self._handle = None
            if self._drags.value:
                self._handle = self._server.scene.add_transform_controls(
                    "/push",
                    SIZE,
                    position=tuple(self._arm.locate_link(self._link.value)),
                    disable_rotations=True,
                    depth_test=False,
                )
                self._handle.on_update(lambda event: self._handle_drag(event.phase == "end"))
            self._show_arrow()

    def _handle_drag(self, over: bool) -> None:
        """Pull at the link as a spring between it and the handle; the last pull is always made."""
        with self._exclusive:
            pull = np.array(self._handle.position) - self._arm.locate_link(self._link.value)
            self._force.value = _read_vector(float(self._stiffness.value) * pull)
            self._show_arrow()
            now = time.monotonic()
            if over or now - self._sent >= PAUSE:
                self._sent = now
                self._push_link()

    def _show_arrow(self) -> None:
        if self._arrow is not None:
            self._arrow.remove()
            self._arrow = None
        if self._handle is not None:
            ends = np.stack(
                [self._arm.locate_link(self._link.value), np.array(self._handle.position)]
            )
            if np.linalg.norm(ends[1] - ends[0]) > 1e-3:
                self._arrow = self._server.scene.add_arrows(
                    "/pull", ends[None], RED, shaft_radius=0.008, head_radius=0.02, head_length=0.05
                )


def _read_vector(values: Any) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in values)
    return x, y, z
