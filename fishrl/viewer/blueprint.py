"""Layout of the viewer: a tab for each flow, with its legend and plots."""

from collections.abc import Mapping
from typing import Any

from fishrl.envs.scene import Choice, Panel, Scene
from fishrl.viewer.drawing import LEGEND, TIMELINE, make_flow_path, make_plot_path

#: Length of the time window of live plots.
LIVE_WINDOW_T = 20.0


def make_blueprint(scene: Scene, flows: Mapping[int, str], *, is_live: bool = False) -> Any:
    """Return the rerun blueprint of a scene; ``flows`` are the titles of its flows by index."""
    import rerun.blueprint as rrb

    tabs = [_lay_out(rrb, scene, flow, title, is_live) for flow, title in flows.items()]
    return rrb.Blueprint(
        tabs[0] if len(tabs) == 1 else rrb.Tabs(*tabs, active_tab=0),
        rrb.TimePanel(
            state="collapsed", timeline=TIMELINE, play_state="following" if is_live else None
        ),
        collapse_panels=True,
    )


def _lay_out(rrb: Any, scene: Scene, flow: int, title: str, is_live: bool) -> Any:
    root = make_flow_path(flow)
    margin = 0.06 * scene.width  # for the axes
    world = rrb.Spatial2DView(
        origin=f"{root}/world",
        name=title,
        visual_bounds=rrb.VisualBounds2D(
            x_range=[-margin, scene.width + 0.5 * margin], y_range=[-margin, scene.height + margin]
        ),
        background=rrb.Background(color=[255, 255, 255]),
    )
    legends = [(scene.field.key, f"{scene.field.name} [{scene.field.unit}]")]
    legends += [(marks.key, f"{marks.name} [{marks.unit}]") for marks in scene.marks if marks.value]
    bars = rrb.Horizontal(
        *(
            rrb.Spatial2DView(
                origin=f"{LEGEND}/{key}",
                name=name,
                visual_bounds=rrb.VisualBounds2D(x_range=[-8, 264], y_range=[-4, 34]),
                background=rrb.Background(color=[255, 255, 255]),
            )
            for key, name in legends
        )
    )
    about = rrb.TextDocumentView(origin=f"{root}/about", name="about")
    plots = [_make_plot(rrb, root, panel, is_live) for panel in scene.panels]
    num_columns = 1 if len(plots) < 5 else 2
    return rrb.Horizontal(
        rrb.Vertical(world, bars, about, row_shares=[5.5, 1, 2.1]),
        rrb.Grid(*plots, grid_columns=num_columns),
        column_shares=[3, 1 if num_columns == 1 else 2],
        name=title,
    )


def _make_plot(rrb: Any, root: str, panel: Panel | Choice, is_live: bool) -> Any:
    span = (-0.3, len(panel.names) - 0.7) if isinstance(panel, Choice) else panel.span
    window = rrb.VisibleTimeRange(
        TIMELINE,
        start=rrb.TimeRangeBoundary.cursor_relative(seconds=-LIVE_WINDOW_T),
        end=rrb.TimeRangeBoundary.cursor_relative(seconds=0.0),
    )
    return rrb.TimeSeriesView(
        origin=make_plot_path(root, panel),
        name=panel.name,
        axis_y=None if span is None else rrb.ScalarAxis(range=span),
        # the title of the plot names a single line
        plot_legend=rrb.PlotLegend(visible=isinstance(panel, Choice) or len(panel.series) > 1),
        time_ranges=window if is_live else None,
    )
