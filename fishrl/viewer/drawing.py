"""Frames drawn into a rerun stream.

The y axis points down on a screen and up in the flow: rows are flipped here and nowhere else.
The only timeline is ``sim_time``, on which one second is one period T.
"""

import io
import logging
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from types import ModuleType
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image
from torch import Tensor

from fishrl.envs.scene import Arrow, Choice, Curve, Field, Frame, Marks, Panel, Scene, Trail
from fishrl.viewer.colours import (
    LINES,
    PURPLE_GREEN,
    RED_BLUE,
    WHITE_BLUE,
    paint,
    quantise,
    space_ticks,
)
from fishrl.viewer.settings import FieldFormat

logger = logging.getLogger(__name__)

TIMELINE = "sim_time"
#: Entity path of the legends, which all flows share.
LEGEND = "legend"
_LEGEND_SIZE = (256, 12)
_LEGAL, _CHOSEN = (120, 170, 130), (230, 159, 0)
_RIM = (20, 20, 20)
_THIN = -0.5
Points = NDArray[np.float32]


def make_flow_path(flow: int) -> str:
    """Return the rerun entity path of a flow."""
    return f"flow_{flow}"


def make_plot_path(root: str, panel: Panel | Choice) -> str:
    """Return the rerun entity path of a plot of the flow at ``root``."""
    words = "".join(letter if letter.isalnum() else " " for letter in panel.name).split()
    return f"{root}/plots/{'_'.join(words)}"


class Drawing:
    """Draw flows of one task, frame by frame, into a rerun stream.

    Args:
        stream: a ``rerun.RecordingStream`` with its sinks; others are those of ``start_drawing``.
        is_live: the stream also goes to a viewer, which may close before the stream does.
    """

    def __init__(
        self,
        stream: Any,
        scene: Scene,
        *,
        flows: Mapping[int, str],
        field_format: FieldFormat = "jpeg",
        is_live: bool = False,
    ) -> None:
        import rerun

        self.stream, self.scene, self.field_format = stream, scene, field_format
        self._rerun, self._is_live, self._log = rerun, is_live, stream.log
        self._trails: dict[str, deque[tuple[float, Points]]] = {}
        self._before: dict[int, Frame] = {}
        self._draw_legends()
        for flow, title in flows.items():
            self._draw_constants(make_flow_path(flow), title)

    def close(self) -> None:
        """Flush and end the stream, and the threads that rerun would keep for it."""
        try:
            self.stream.flush(timeout_sec=30.0)
        except RuntimeError as error:
            if not self._is_live:
                raise
            logger.warning("the live viewer has not received everything: %s", error)
        self.stream.disconnect()
        del self.stream, self._log
        self._rerun.bindings.flush_and_cleanup_orphaned_recordings()

    def draw(self, flow: int, frame: Frame) -> None:
        """Draw a moment of a flow, given its index."""
        rr, scene, root = self._rerun, self.scene, make_flow_path(flow)
        world = f"{root}/world"
        self.stream.set_time(TIMELINE, duration=frame.time)
        place, text = (0.5 * scene.width, -0.03 * scene.width), f"t = {frame.time:.2f} T"
        if frame.ending is not None:
            text = f"{text}: {frame.ending.words}"
        clock = rr.Points2D([place], radii=0.0, colors=[_RIM], labels=[text])
        self._log(f"{world}/clock", clock)
        drawn: tuple[tuple[Sequence[Any], Callable[[str, Any, Frame], None]], ...] = (
            ([scene.field], self._draw_field),
            (scene.trails, self._draw_trail),
            (scene.curves, self._draw_curve),
            (scene.marks, self._draw_marks),
            (scene.arrows, self._draw_arrow),
        )
        for parts, draw in drawn:
            for part in parts:
                if part.key in frame.values:
                    draw(world, part, frame)
        for panel in scene.panels:
            path = make_plot_path(root, panel)
            if isinstance(panel, Choice):
                self._draw_choice(path, panel, frame)
            else:
                self._draw_panel(path, panel, frame, self._before.get(flow))
        self._before[flow] = frame

    def _place(self, points: Tensor) -> Points:
        """Return picture coordinates (y down) of node coordinates ``[..., 2]`` (y up).

        Pixel centres lie at half-integers.
        """
        x, y = points.float().unbind(-1)
        return torch.stack((x + 0.5, self.scene.height - 0.5 - y), -1).cpu().numpy()

    def _draw_field(self, world: str, field: Field, frame: Frame) -> None:
        values = _to_numpy(frame.values[field.key].flip(-2))
        levels = quantise(values, field.low, field.limit)
        self._log(f"{world}/{field.key}", _encode(self._rerun, levels, field, self.field_format))

    def _draw_curve(self, world: str, curve: Curve, frame: Frame) -> None:
        placed = self._place(frame.values[curve.key])
        lines, width = [placed], 0.35
        if curve.is_closed and not curve.is_filled:
            lines = [np.concatenate((placed, placed[:1]))]
        elif curve.is_closed:
            # lines from side to side fill the body: rerun has no filled 2-D polygon
            half = len(placed) // 2
            ribs = np.stack((placed[1:half], placed[: len(placed) - half : -1]), 1)
            lines = [np.concatenate((placed, placed[:1])), *ribs]
            # wide enough for neighbouring ribs to touch
            gaps = np.linalg.norm(np.diff(placed, axis=0), axis=1)
            width = max(width, 30.0 * float(np.median(gaps)) / self.scene.body_length)
        shape = self._make_lines(lines, curve.colour, width, curve.order)
        self._log(f"{world}/{curve.key}", shape)

    def _draw_marks(self, world: str, marks: Marks, frame: Frame) -> None:
        points = self._place(frame.values[marks.key].reshape(-1, 2))
        colours = np.tile(np.array(marks.colour, np.uint8), (len(points), 1))
        if marks.value is not None:
            signals = _to_numpy(frame.values[marks.value].reshape(-1))
            colours = paint(quantise(signals, -marks.limit, marks.limit), PURPLE_GREEN)
        rims = np.tile(np.array(_RIM, np.uint8), (len(points), 1))
        discs = self._rerun.Points2D(
            np.concatenate((points, points)),
            radii=[1.25 * marks.radius] * len(points) + [marks.radius] * len(points),
            colors=np.concatenate((rims, colours)),
            draw_order=6.0,
        )
        self._log(f"{world}/{marks.key}", discs)
        if marks.reach > 0.0:
            angle = np.linspace(0.0, 2.0 * np.pi, 49)
            circle = marks.reach * np.stack((np.cos(angle), np.sin(angle)), 1)
            circles = [(point + circle).astype(np.float32) for point in points]
            shape = self._make_lines(circles, marks.colour, 0.6, 2.0)
            self._log(f"{world}/{marks.key}_reach", shape)

    def _draw_arrow(self, world: str, arrow: Arrow, frame: Frame) -> None:
        values, vector = frame.values, frame.values[arrow.key]
        start = values[arrow.at] if isinstance(arrow.at, str) else torch.tensor(arrow.at)
        x, y = (arrow.scale * vector).tolist()
        label = f"{arrow.name} {float(vector.norm()):.3g} {arrow.unit}"
        shape = self._rerun.Arrows2D(
            origins=[self._place(start)],
            vectors=[(x, -y)],
            colors=[arrow.colour],
            radii=0.6 * self.scene.body_length / 50.0,
            draw_order=7.0,
            labels=[label] if arrow.name and vector.any() else None,
        )
        self._log(f"{world}/{arrow.key}", shape)

    def _draw_trail(self, world: str, trail: Trail, frame: Frame) -> None:
        path = f"{world}/trajectory_{trail.key}"
        points = self._trails.setdefault(path, deque())
        if frame.begins:
            points.clear()
        points.append((frame.time, self._place(frame.values[trail.key])))
        while points[0][0] < frame.time - trail.length_T:
            points.popleft()
        strip = np.stack([point for _, point in points])
        shape = self._make_lines([strip], trail.colour, 0.5, 1.0)
        if trail.is_dotted:
            radius = 0.5 * self.scene.body_length / 50.0
            shape = self._rerun.Points2D(strip, radii=radius, colors=[trail.colour], draw_order=1.0)
        self._log(path, shape)

    def _draw_choice(self, path: str, choice: Choice, frame: Frame) -> None:
        fish = ... if choice.fish is None else choice.fish
        if "action" in frame.values:
            action = frame.values["action"][fish]
            chosen = action.int().argmax() if action.dim() else action  # one-hot or integer
            self._plot(f"{path}/chosen", float(chosen))
        if "action_mask" in frame.values:
            mask = frame.values["action_mask"][fish]
            for index, is_legal in enumerate(mask.reshape(-1).tolist()):
                if is_legal:
                    self._plot(f"{path}/legal_{index}", float(index))

    def _draw_panel(self, path: str, panel: Panel, frame: Frame, before: Frame | None) -> None:
        for number, series in enumerate(panel.series):
            value = _pick(frame, series.key, series.column)
            if series.is_rate:
                if frame.begins or before is None or frame.time <= before.time:
                    continue
                change = value - _pick(before, series.key, series.column)
                value = change / (frame.time - before.time)
            if panel.is_log:
                value = float(np.copysign(np.log2(1.0 + abs(value)), value))
            if np.isfinite(value):
                self._plot(f"{path}/{number}", value)

    def _plot(self, path: str, value: float) -> None:
        self._log(path, self._rerun.Scalars(value))

    def _draw_constants(self, root: str, title: str) -> None:
        """Log static entities: axes, areas, styles of the plots, the description."""
        scene = self.scene
        self._draw_axes(f"{root}/world/axes")
        for area in scene.areas:
            (x0, y0), (x1, y1) = area.low, area.high
            border = torch.tensor([(x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0)])
            shape = self._make_lines([self._place(border)], area.colour, 0.5, 1.5)
            self._log(f"{root}/world/{area.key}", shape, static=True)
        for panel in scene.panels:
            self._style_plot(make_plot_path(root, panel), panel)
        field = scene.field
        levels = (
            f"A stored value v means {field.low:g} + (v - 1) / 254 × {field.limit - field.low:g}."
        )
        if self.field_format == "jpeg":
            levels = "The colours are stored."
        name = ", ".join(filter(None, (field.name, field.note)))
        about = (
            f"**{scene.title}**\n\n{title}\n\n"
            f"One second of `{TIMELINE}` is one period T. Body length L = {scene.body_length:g} "
            f"nodes; coordinates are in nodes.\n\n"
            f"{name}; colours from {field.low:g} to {field.limit:g} {field.unit}. {levels}\n\n"
            f"{scene.note}"
        )
        document = self._rerun.TextDocument(about, media_type="text/markdown")
        self._log(f"{root}/about", document, static=True)

    def _style_plot(self, path: str, panel: Panel | Choice) -> None:
        """Log names, colours and markers of the lines of a plot."""
        rr = self._rerun
        if isinstance(panel, Choice):
            chosen = rr.SeriesLines(
                names="chosen", widths=2, colors=[_CHOSEN], interpolation_mode="StepBefore"
            )
            self._log(f"{path}/chosen", chosen, static=True)
            for index, name in enumerate(panel.names):
                dots = rr.SeriesPoints(
                    names=f"{index}: {name}", colors=[_LEGAL], markers="circle", marker_sizes=2
                )
                self._log(f"{path}/legal_{index}", dots, static=True)
            return
        mode = "StepBefore" if panel.is_step else "Linear"
        for number, series in enumerate(panel.series):
            colour = series.colour or LINES[number % len(LINES)]
            style = rr.SeriesLines(
                names=series.label, widths=1.6, colors=[colour], interpolation_mode=mode
            )
            self._log(f"{path}/{number}", style, static=True)

    def _draw_axes(self, path: str) -> None:
        """Draw the frame of the picture, and ticks in body lengths outside it."""
        length, width, height = self.scene.body_length, self.scene.width, self.scene.height
        step, out = space_ticks(max(width, height) / length) * length, 0.012 * width
        corner = torch.tensor([-0.5, -0.5])
        sides = torch.tensor([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.0, 0.0]])
        frame = corner + sides * torch.tensor([width, height])
        xs, ys = (torch.arange(0.0, size, step) for size in (width, height))
        below = [torch.tensor([[x, -0.5], [x, -0.5 - out]]) for x in xs]
        lateral = [torch.tensor([[-0.5, y], [-0.5 - out, y]]) for y in ys]
        lines = [self._place(line) for line in (frame, *below, *lateral)]
        self._log(f"{path}/lines", self._make_lines(lines, _RIM, _THIN, 1.2), static=True)
        labels = self._rerun.Points2D(
            [self._place(line)[1] for line in below]
            + [self._place(line)[1] - np.array([out, out]) for line in lateral],
            radii=0.0,
            colors=[_RIM],
            labels=[f"{float(value) / length:g} L" for value in (*xs, *ys)],
            show_labels=True,
        )
        self._log(f"{path}/labels", labels, static=True)

    def _draw_legends(self) -> None:
        """Draw a colour bar with ticks for the field, and for each coloured set of points."""
        rr, (width, height) = self._rerun, _LEGEND_SIZE
        ramp = np.tile(quantise(np.linspace(0.0, 1.0, width, dtype=np.float32), 0, 1), (height, 1))
        field = self.scene.field
        image = _encode(rr, ramp, field, self.field_format)
        bars = [(field.key, (field.low, field.limit), image)]
        for marks in self.scene.marks:
            if marks.value is not None:
                image = rr.Image(paint(ramp, PURPLE_GREEN), opacity=1.0, draw_order=0.0)
                bars.append((marks.key, (-marks.limit, marks.limit), image))
        for key, (low, high), image in bars:
            self._log(f"{LEGEND}/{key}/ramp", image, static=True)
            ticks = [0.0, 0.25, 0.5, 0.75, 1.0]
            places = [(tick * width, height + 1.0) for tick in ticks]
            labels = [f"{low + tick * (high - low):.3g}" for tick in ticks]
            points = rr.Points2D(
                places, radii=0.6, colors=[_RIM], labels=labels, show_labels=True, draw_order=1.0
            )
            self._log(f"{LEGEND}/{key}/ticks", points, static=True)

    def _make_lines(
        self, strips: list[Points], colour: tuple[int, ...], width: float, order: float
    ) -> Any:
        """Return lines of ``width`` L / 50, or of ``-width`` pixels if it is negative."""
        radius = width if width < 0.0 else width * self.scene.body_length / 50.0
        return self._rerun.LineStrips2D(strips, colors=[colour], radii=radius, draw_order=order)


def _encode(
    rr: ModuleType, levels: NDArray[np.uint8], field: Field, field_format: FieldFormat
) -> Any:
    """Encode quantised values ``[Y, X]`` of a field, top row first."""
    looks: dict[str, Any] = {"draw_order": 0.0, "magnification_filter": "Linear"}
    if field_format == "jpeg":
        buffer = io.BytesIO()
        colours = paint(levels, RED_BLUE if field.is_signed else WHITE_BLUE)
        # no chroma subsampling: a vortex of a few nodes would become blocks
        Image.fromarray(colours).save(buffer, format="JPEG", quality=90, subsampling=0)
        return rr.EncodedImage(contents=buffer.getvalue(), media_type="image/jpeg", **looks)
    colormap = "Spectral" if field.is_signed else "Viridis"
    return rr.DepthImage(levels, colormap=colormap, depth_range=(1, 255), **looks)


def _to_numpy(values: Tensor) -> NDArray[np.float32]:
    return values.detach().float().cpu().numpy()


def _pick(frame: Frame, key: str, column: int | None) -> float:
    """Return one number of a frame; NaN if the frame lacks ``key``."""
    if key not in frame.values:
        return float("nan")
    return float(frame.values[key].reshape(-1)[0 if column is None else column])
