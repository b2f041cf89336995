"""Layout of the Rerun viewer."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import rerun.blueprint as rrb

TIMELINE = "t"
TRANSFORMS = "transforms"
WORLD_AXES = "world_axes"
TOOL_PATH = "tool/path"
TOOL_TARGET = "tool/target"
DEVIATION = "signals/tool_deviation"
EVENTS = "events"

# Seconds of tool path that stay visible behind the tool.
PATH_SECONDS = 10.0

# One colour per joint, the same in every plot; more joints start over.
COLOURS = (
    (86, 156, 214),
    (240, 140, 50),
    (110, 190, 100),
    (214, 90, 90),
    (170, 130, 210),
    (80, 195, 195),
    (220, 190, 80),
    (220, 130, 180),
)


# Direction of view: 3/4 view, slightly from above.
EYE = np.array([0.72, -0.58, 0.38])


def make_blueprint(
    robot: str,
    root: str,
    links: NDArray[np.float64],
    tool: NDArray[np.float64] | None,
    further: Mapping[str, str],
    *,
    targets: bool = True,
) -> rrb.Blueprint:
    """Lay out the arm at the left and its signals over time at the right.

    Args:
        robot: the URDF's name, under which its geometry stands.
        root: the URDF's root link, the frame of the 3D views.
        links: origins of all links at the start (L, 3) [m]; the eye is set so that they are seen.
        tool: origin of the tool at the start (3,) [m]; if given, its path is shown too.
        further: quantities beside the usual ones, with their units.
        targets: whether the tool's target, and the deviation from it, are shown beside its path.
    """
    import rerun.blueprint as rrb

    left: rrb.Container | rrb.View = _make_arm_view(robot, root, links)
    if tool is not None:
        deviation = [_make_plot("Target minus tool [m]", DEVIATION)] if targets else []
        beside = rrb.Horizontal(_make_tool_view(root, tool), *deviation)
        left = rrb.Vertical(left, beside, row_shares=[2, 1])
    signals = rrb.Vertical(
        rrb.Tabs(
            _make_plot("Joint angle [rad]", "signals/q"),
            _make_plot("Measured by encoders [rad]", "signals/q_measured"),
            _make_plot("Joint speed [rad/s]", "signals/v"),
            *(
                _make_plot(f"{name} [{unit}]" if unit else name, f"signals/{name}")
                for name, unit in further.items()
            ),
        ),
        rrb.Tabs(
            _make_plot("Motor current [A]", "signals/current"),
            _make_plot("Motor command [V, A or N m]", "signals/applied"),
        ),
        rrb.Tabs(
            _make_plot("Gear torque [N m]", "signals/gear_torque"),
            rrb.TextLogView(name="Events", origin=f"/{EVENTS}"),
        ),
        # A third of the height each has room for seven names, and for ticks.
        row_shares=[1, 1, 1],
    )
    return rrb.Blueprint(
        rrb.Horizontal(left, signals, column_shares=[5, 4]),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="following"),
        auto_views=False,
    )


def _make_arm_view(robot: str, root: str, links: NDArray[np.float64]) -> rrb.Spatial3DView:
    """Return the view of the whole arm."""
    import rerun as rr
    import rerun.blueprint as rrb

    low, high = links.min(axis=0), links.max(axis=0)
    middle = (low + high) / 2.0
    # The eye's opening is about 55 degrees; the factor leaves room for the thickness of the links
    # and for motion.
    distance = 1.35 * max(float(np.linalg.norm(high - low)), 0.1)
    solid = [
        shape.from_fields(fill_mode=rr.components.FillMode.Solid)
        for shape in (rr.Cylinders3D, rr.Boxes3D, rr.Ellipsoids3D, rr.Capsules3D)
    ]
    return rrb.Spatial3DView(
        name="Arm",
        origin="/",
        contents=[
            "+ /**",
            f"- /{robot}/collision_geometries/**",
            "- /signals/**",
            "- /events",
        ],
        spatial_information=_make_frame_axes(root),
        eye_controls=rrb.EyeControls3D(position=middle + distance * EYE, look_target=middle),
        defaults=solid,
        overrides={TOOL_PATH: _show_past_path()},
    )


def _make_tool_view(root: str, tool: NDArray[np.float64]) -> rrb.Spatial3DView:
    """Return the view of the tool, from nearby."""
    import rerun as rr
    import rerun.blueprint as rrb

    level = rr.components.Plane3D((0.0, 0.0, 1.0), float(tool[2]))
    return rrb.Spatial3DView(
        name="Tool, grid 10 mm",
        origin="/tool",
        contents=["+ /tool/**"],
        spatial_information=_make_frame_axes(root),
        eye_controls=rrb.EyeControls3D(position=tool + 0.08 * EYE, look_target=tool),
        line_grid=rrb.LineGrid3D(spacing=0.01, plane=level),
        overrides={TOOL_PATH: _show_past_path()},
    )


def _make_frame_axes(root: str) -> rrb.SpatialInformation:
    import rerun as rr
    import rerun.blueprint as rrb

    return rrb.SpatialInformation(target_frame=root, axes=rr.ViewCoordinates.RIGHT_HAND_Z_UP)


def _show_past_path() -> rrb.VisibleTimeRanges:
    """Return the part of the tool's path that stays visible."""
    import rerun.blueprint as rrb

    return rrb.VisibleTimeRanges(
        timeline=TIMELINE,
        start=rrb.TimeRangeBoundary.cursor_relative(seconds=-PATH_SECONDS),
        end=rrb.TimeRangeBoundary.cursor_relative(),
    )


def _make_plot(name: str, path: str) -> rrb.TimeSeriesView:
    import rerun.blueprint as rrb

    return rrb.TimeSeriesView(
        name=name,
        origin=f"/{path}",
        axis_x=rrb.TimeAxis(link="LinkToGlobal"),
        plot_legend=rrb.PlotLegend(rrb.Corner2D.RightTop),
    )
