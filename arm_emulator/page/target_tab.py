"""A target for the tool: by its numbers, or dragged in the picture."""

from __future__ import annotations

from typing import Any

from arm_emulator.page.arm_scene import ArmScene

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
        at = tuple(float(one) for one in arm.p_WT)
        self._place = gui.add_vector3("Position [m], world axes", at, step=0.01)
        gui.add_button("Copy the tool's pose").on_click(lambda _: self._take())
        self._drags = gui.add_checkbox("Drag a handle in the picture", False)
        self._drags.on_update(lambda _: self._switch())
        gui.add_button("Send the tool there").on_click(lambda _: self._send())
        self._handle: Any = None
        self._wxyz: tuple[float, ...] | None = None  # that was taken or dragged to

    def _take(self) -> None:
        with self._page.exclusive:
            self._place.value = tuple(float(one) for one in self._arm.p_WT)
            self._wxyz = self._arm.wxyz_WT
            if self._handle is not None:
                self._handle.position, self._handle.wxyz = self._place.value, self._wxyz

    def _switch(self) -> None:
        with self._page.exclusive:
            if not self._drags.value:
                if self._handle is not None:
                    self._handle.remove()
                self._handle = None
                return
            self._take()
            self._handle = self._server.scene.add_transform_controls(
                "/target", SIZE, position=self._place.value, wxyz=self._wxyz, depth_test=False
            )
            self._handle.on_update(lambda _: self._dragged())

    def _dragged(self) -> None:
        self._place.value = tuple(float(one) for one in self._handle.position)
        self._wxyz = tuple(float(one) for one in self._handle.wxyz)

    def _send(self) -> None:
        if self._wxyz is None:
            self._wxyz = self._arm.wxyz_WT
        place = tuple(float(one) for one in self._place.value)
        self._page.ask("aim", place, self._wxyz)
