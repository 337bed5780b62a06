"""Pictures and films of a recorded flow: field, bodies, senses, goal and path (matplotlib)."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from operator import methodcaller
from os import PathLike
from pathlib import Path
from typing import Any

import imageio_ffmpeg
import matplotlib as mpl
import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import EllipseCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyArrowPatch, Polygon, Rectangle
from numpy.typing import NDArray

from fishrl.envs.scene import Arrow, Frame, Marks, Scene
from fishrl.figure_style import STYLE
from fishrl.files import staged
from fishrl.viewer.colours import PURPLE_GREEN, RED_BLUE, WHITE_BLUE, round_up, space_ticks
from fishrl.viewer.recording import Recording

FISH = "#20252b"
FOOD = "#f2b134"

_NUM_SNAPSHOTS = 6
_FILM_S = 10.0  # duration of a film, as far as 10 to 25 frames per second allow
_HOLD_S = 1.5  # for which the last frame stands
_PALETTE = "split[a][b];[a]palettegen=max_colors=96[p];[b][p]paletteuse=dither=none"
_WIDTH_INCHES = 8.0
#: Dots per inch and ffmpeg's options of a film, by file suffix. A GIF has one palette and no
#: dithering, so that parts at rest cost nothing.
FILMS: Mapping[str, tuple[float, Mapping[str, Any]]] = {
    ".mp4": (100.0, {"quality": 7}),
    ".gif": (70.0, {"codec": "gif", "pix_fmt_out": "pal8", "output_params": ["-vf", _PALETTE]}),
}


def label_axes(axes: Axes, *, x: bool = True, y: bool = True) -> None:
    """Name the axes in body lengths, or hide the tick labels of one that a neighbour names."""
    axes.set(xlabel="x / L" if x else "", ylabel="y / L" if y else "")
    axes.tick_params(labelbottom=x, labelleft=y)


def choose_limit(recording: Recording) -> float:
    """Return the value of the field at which the colours saturate: a round number.

    The boundary layer on the fish is many times stronger than the wake, so the limit is a
    percentile (``Field.saturated``) of what is not negligible, in the later half of the episode;
    or the limit of the field, if that was given.
    """
    field, frames = recording.scene.field, recording.frames
    if field.saturated is None:
        return field.limit
    late = torch.stack([f.values[field.key][::2, ::2] for f in frames[len(frames) // 2 :: 4]])
    late = late.float().abs().flatten()
    visible = late[late > 0.02 * late.max()]
    if visible.numel() == 0:
        return 1.0
    # torch.quantile is limited to 16 million values; numpy is not
    return round_up(float(np.quantile(visible.numpy(), 1.0 - field.saturated)))


def fit_colours(recording: Recording) -> Scene:
    """Return the scene of a recording with colours that saturate at ``choose_limit``."""
    scene = recording.scene
    return scene.choose_field(scene.field.key, limit=choose_limit(recording))


class FlowAxes:
    """One set of axes that shows a scene's field, bodies, signals, goal and paths, frame by frame.

    Args:
        axes: to draw on.
        scene: what to draw.
    """

    def __init__(self, axes: Axes, scene: Scene) -> None:
        self.scene = scene
        length, x, y = scene.body_length, scene.width, scene.height
        edges = (-0.5 / length, (x - 0.5) / length, -0.5 / length, (y - 0.5) / length)
        self.image = axes.imshow(
            np.zeros((y, x)), extent=edges, origin="lower",
            cmap=RED_BLUE if scene.field.is_signed else WHITE_BLUE,
            vmin=scene.field.low, vmax=scene.field.limit, interpolation="bilinear",
        )  # fmt: skip
        self.paths = {
            trail.key: axes.plot([], [], color=FISH, linewidth=0.9, linestyle=(0, (4, 2)))[0]
            for trail in scene.trails
        }
        for area in scene.areas:
            (x0, y0), (x1, y1) = (np.array(corner) / length for corner in (area.low, area.high))
            colour = [c / 255.0 for c in area.colour]
            axes.add_patch(
                Rectangle((x0, y0), x1 - x0, y1 - y0, fill=False, edgecolor=colour, lw=0.7, ls=":")
            )
        self.bodies = {
            curve.key: Polygon(
                np.zeros((3, 2)),
                closed=True,
                facecolor=[c / 255.0 for c in curve.colour],
                edgecolor="white",
                lw=0.4,
                zorder=3,
            )
            for curve in scene.curves
            if curve.is_closed
        }
        self.arrows = [_NamedArrow(axes, arrow, length) for arrow in scene.arrows if arrow.name]
        self.signals = [
            _Signals(axes, marks, length) for marks in scene.marks if marks.value is not None
        ]
        self.circles = [
            (goal.key, circle)
            for goal in scene.marks
            if goal.reach > 0.0
            for circle in (
                Circle((0, 0), goal.reach / length, fill=False, edgecolor=FISH, lw=0.8, ls=":"),
                Circle((0, 0), 0.07, facecolor=FOOD, edgecolor=FISH, lw=0.8, zorder=4),
            )
        ]
        below: dict[str, Any] = {"xytext": (0, -16), "textcoords": "offset points", "ha": "center"}
        self.names = [
            (goal.key, axes.annotate(goal.name, (0, 0), **below))
            for goal in scene.marks
            if goal.reach > 0.0
        ]
        for patch in (*self.bodies.values(), *(circle for _, circle in self.circles)):
            axes.add_patch(patch)
        box = {"boxstyle": "round,pad=0.3", "facecolor": "white", "alpha": 0.85, "lw": 0}
        place: dict[str, Any] = {"transform": axes.transAxes, "va": "top", "bbox": box}
        self.clock = axes.text(0.015, 0.955, "", ha="left", **place)
        self.ending = axes.text(0.5, 0.955, "", ha="center", weight="bold", **place)
        axes.set(xlim=edges[:2], ylim=edges[2:], aspect="equal")
        axes.set_xticks(np.arange(0, x / length + 0.01, space_ticks(x / length)))
        axes.set_yticks(np.arange(0, y / length + 0.01, space_ticks(y / length)))
        axes.tick_params(length=2.5)

    def add_colourbar(self, figure: Figure, axes: Any, **looks: Any) -> None:
        """Draw the colour bar of the field next to some axes."""
        field = self.scene.field
        label = f"{field.name}  [{field.unit}]" + f"   ({field.note})" * bool(field.note)
        extend = "both" if field.is_signed else "max"
        figure.colorbar(self.image, ax=axes, label=label, extend=extend, pad=0.015, **looks)

    def show(self, frames: Sequence[Frame]) -> None:
        """Move everything to the last of some frames; the others give the path to it."""
        now = frames[-1]
        self.image.set_data(now.values[self.scene.field.key].float().numpy())
        for key, body in self.bodies.items():
            body.set_xy(self._place(now, key))
        for key, circle in self.circles:
            circle.center = tuple(self._place(now, key))
        for key, name in self.names:
            name.xy = tuple(self._place(now, key))
            name.set_visible(now.ending is None)  # a fish that has reached it would be covered
        for key, path in self.paths.items():
            path.set_data(*np.stack([self._place(frame, key) for frame in frames]).T)
        for arrow in self.arrows:
            arrow.show(now)
        for signals in self.signals:
            signals.show(now)
        self.clock.set_text(f"t = {now.time:.1f} T")
        self.ending.set_text("" if now.ending is None else now.ending.words)

    def _place(self, frame: Frame, key: str) -> NDArray[np.float32]:
        """Return places in body lengths."""
        place: NDArray[np.float32] = (frame.values[key].float() / self.scene.body_length).numpy()
        return place


class _NamedArrow:
    """An arrow with its name and magnitude, hidden while it is zero."""

    def __init__(self, axes: Axes, arrow: Arrow, body_length: float) -> None:
        self._arrow, self._length = arrow, body_length
        self._shape = FancyArrowPatch(
            (0, 0), (0, 0), shrinkA=0, shrinkB=0, arrowstyle="-|>", mutation_scale=14, lw=2.0,
            color=FISH, zorder=5,
        )  # fmt: skip
        self._text = axes.text(0, 0, "", ha="left", va="bottom", zorder=5)
        axes.add_patch(self._shape)

    def show(self, frame: Frame) -> None:
        arrow = self._arrow
        vector = frame.values.get(arrow.key, torch.zeros(2)).float()
        start = frame.values[arrow.at] if isinstance(arrow.at, str) else torch.tensor(arrow.at)
        x, y = (start / self._length).tolist()
        dx, dy = (arrow.scale * vector / self._length).tolist()
        size = float(vector.norm())
        self._shape.set_positions((x, y), (x + dx, y + dy))
        self._text.set_position((x, y + 0.08))
        self._text.set_text(f"{arrow.name} {size:.3g} {arrow.unit}")
        for artist in (self._shape, self._text):
            artist.set_visible(size > 0.0)


class _Signals:
    """Points coloured by a value each, such as neuromasts by what they sense."""

    def __init__(self, axes: Axes, marks: Marks, body_length: float) -> None:
        self._marks, self._length, size = marks, body_length, 2.0 * marks.radius / body_length
        self._dots = EllipseCollection(
            [size], [size], [0.0], units="xy", offsets=np.zeros((0, 2)),
            offset_transform=axes.transData, cmap=PURPLE_GREEN, clim=(-marks.limit, marks.limit),
            edgecolors=FISH, linewidths=0.5, zorder=5,
        )  # fmt: skip
        axes.add_collection(self._dots, autolim=False)
        words = f"dots: {marks.name}, purple −{marks.limit:g} to green {marks.limit:g} {marks.unit}"
        axes.text(0.985, 0.03, words, ha="right", fontsize=8, transform=axes.transAxes)

    def show(self, frame: Frame) -> None:
        places, values = (
            frame.values[str(key)].float() for key in (self._marks.key, self._marks.value)
        )
        self._dots.set_offsets((places.reshape(-1, 2) / self._length).numpy())
        self._dots.set_array(values.reshape(-1).numpy())


class FramePainter:
    """Paint frames of one scene as pictures, one after the other.

    Args:
        scene: what to draw.
        dpi: dots per inch; a picture is 8 inches wide.
    """

    def __init__(self, scene: Scene, *, dpi: float) -> None:
        self._trails = [trail.key for trail in scene.trails]
        self._path: list[Frame] = []  # without fields, which are large
        with mpl.rc_context(STYLE):
            figure, self._flow = make_single(scene)
            figure.set_dpi(dpi)
            self._canvas = FigureCanvasAgg(figure)
            self._canvas.draw()
            figure.set_layout_engine("none")
            axes = self._flow.image.axes
            parts = (part for part in axes.get_children() if not isinstance(part, Axis))
            self._changing = sorted(
                (part for part in parts if part is not axes.patch), key=methodcaller("get_zorder")
            )
            for artist in self._changing:  # all but ticks, their labels and the colour bar
                artist.set_animated(True)
            self._canvas.draw()
            self._rest = self._canvas.copy_from_bbox(figure.bbox)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of a picture, pixels."""
        width, height = self._canvas.get_width_height()
        return width, height

    def paint(self, frame: Frame) -> NDArray[np.uint8]:
        """Return a picture ``[height, width, 3]``; the path restarts with each episode."""
        if frame.begins:
            self._path.clear()
        self._flow.show([*self._path, frame])
        points = {key: frame.values[key].clone() for key in self._trails}
        self._path.append(replace(frame, values=points))
        self._canvas.restore_region(self._rest)
        with mpl.rc_context(STYLE):
            for artist in self._changing:
                self._flow.image.axes.draw_artist(artist)
        return np.asarray(self._canvas.buffer_rgba())[..., :3].copy()


def write_snapshots(recording: Recording, path: str | PathLike[str]) -> None:
    """Write the field at several times on one sheet, as the paper shows its predation."""
    times, num = recording.time, _NUM_SNAPSHOTS
    wanted = torch.linspace(float(times[-1]) / num, float(times[-1]), num)
    nearest = (times[None] - wanted[:, None]).abs().argmin(1)
    frames = list(dict.fromkeys(nearest.tolist()))  # each once
    columns = min(2, len(frames))
    rows = -(-len(frames) // columns)
    ratio = recording.scene.height / recording.scene.width
    with mpl.rc_context(STYLE):
        size = (1.2 + 4.6 * columns, 0.9 + 4.6 * ratio * rows)
        figure = Figure(figsize=size, layout="constrained")
        grid = figure.subplots(rows, columns, squeeze=False)
        scene = fit_colours(recording)
        for i, axes in enumerate(grid.flat):
            if i >= len(frames):
                axes.set_visible(False)
                continue
            flow = FlowAxes(axes, scene)
            flow.show(recording.frames[: frames[i] + 1])
            label_axes(axes, x=i + columns >= len(frames), y=i % columns == 0)
        flow.add_colourbar(figure, grid, aspect=40)
        with staged(Path(path)) as stage:
            figure.savefig(stage)


def write_flow(recording: Recording, path: str | PathLike[str]) -> None:
    """Write one large picture of the flow in the last frame."""
    with mpl.rc_context(STYLE):
        figure, flow = make_single(fit_colours(recording))
        flow.show(recording.frames)
        with staged(Path(path)) as stage:
            figure.savefig(stage)


def write_film(recording: Recording, path: str | PathLike[str]) -> None:
    """Write the episode as an MP4 (H.264) or a GIF, with the ffmpeg that imageio-ffmpeg brings.

    Raises:
        ValueError: for a suffix that is not in ``FILMS``.
        OSError: if it cannot be written.
    """
    suffix = Path(path).suffix
    if suffix not in FILMS:
        raise ValueError(f"{path}: must end in one of {', '.join(FILMS)}")
    dpi, options = FILMS[suffix]
    painter = FramePainter(fit_colours(recording), dpi=dpi)
    width, height = (2 * (side // 2) for side in painter.size)  # H.264 wants even sides
    fps = round(min(25.0, max(10.0, len(recording.frames) / _FILM_S)))
    with staged(Path(path)) as stage:
        writer = imageio_ffmpeg.write_frames(
            str(stage), (width, height), fps=fps, macro_block_size=2, **options
        )
        writer.send(None)
        try:
            for frame in recording.frames:
                picture = np.ascontiguousarray(painter.paint(frame)[:height, :width])
                writer.send(picture)
            for _ in range(round(_HOLD_S * fps)):
                writer.send(picture)
        finally:
            writer.close()


def make_single(scene: Scene) -> tuple[Figure, FlowAxes]:
    """Return a figure with one set of axes, see ``FlowAxes``."""
    size = (_WIDTH_INCHES, 0.86 * _WIDTH_INCHES * scene.height / scene.width + 0.85)
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots()
    flow = FlowAxes(axes, scene)
    label_axes(axes)
    axes.set_title(scene.title, loc="left")
    flow.add_colourbar(figure, axes)
    return figure, flow
