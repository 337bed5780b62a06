"""Pictures and films of a recorded flow, drawn with matplotlib."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from math import ceil
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
from pydantic import PositiveFloat
from torch import Tensor

from fishrl.envs.scene import Arrow, Curve, Frame, Marks, Scene
from fishrl.figure_style import STYLE
from fishrl.files import staged
from fishrl.settings import checked
from fishrl.viewer.colours import PURPLE_GREEN, RED_BLUE, WHITE_BLUE, round_limit, space_ticks
from fishrl.viewer.recording import Recording

FISH = "#20252b"
FOOD = "#f2b134"

_NUM_SNAPSHOTS = 6
_FILM_S = 10.0  # duration of a film, within 10 to 25 frames per second
_HOLD_S = 1.5  # duration of its last frame
_MAX_FPS = 50.0  # shorter frames of a GIF are shown for longer
_PALETTE = "split[a][b];[a]palettegen=max_colors=96[p];[b][p]paletteuse=dither=none"
_WIDTH_INCHES = 8.0
#: Dots per inch and ffmpeg options of a film, by file suffix. A GIF has one palette and no
#: dithering, so that constant parts need no space.
FILMS: Mapping[str, tuple[float, Mapping[str, Any]]] = {
    ".mp4": (100.0, {"quality": 7}),
    ".gif": (70.0, {"codec": "gif", "pix_fmt_out": "pal8", "output_params": ["-vf", _PALETTE]}),
}


def label_axes(axes: Axes, *, x: bool = True, y: bool = True) -> None:
    """Label the axes in body lengths; without ``x`` or ``y`` hide the tick labels of that axis."""
    axes.set(xlabel="x / L" if x else "", ylabel="y / L" if y else "")
    axes.tick_params(labelbottom=x, labelleft=y)


def choose_limit(recording: Recording) -> float:
    """Return the value at which the colours of the field saturate, a round number.

    It is a percentile (``Field.saturated``) of the non-negligible values in the second half of the
    episode, since the boundary layer of the fish is many times stronger than its wake; or the limit
    of the field if that was given.
    """
    field, frames = recording.scene.field, recording.frames
    if field.saturated is None:
        return field.limit
    late = torch.stack([f.values[field.key][::2, ::2] for f in frames[len(frames) // 2 :: 4]])
    late = late.float().abs().flatten()
    visible = late[late > 0.02 * late.max()]
    if visible.numel() == 0:
        return 1.0
    # torch.quantile takes at most 16 million values
    return round_limit(float(np.quantile(visible.numpy(), 1.0 - field.saturated)))


def fit_colours(recording: Recording) -> Scene:
    """Return the scene of a recording with the limit of ``choose_limit`` for its colours."""
    scene = recording.scene
    return scene.choose_field(scene.field.key, limit=choose_limit(recording))


class FlowAxes:
    """Axes in body lengths that show a scene frame by frame: field, bodies, senses, goal, paths."""

    def __init__(self, axes: Axes, scene: Scene) -> None:
        self.axes, self.scene = axes, scene
        length, x, y = scene.body_length, scene.width, scene.height
        edges = (-0.5 / length, (x - 0.5) / length, -0.5 / length, (y - 0.5) / length)
        self.image = axes.imshow(
            np.zeros((y, x)), extent=edges, origin="lower",
            cmap=RED_BLUE if scene.field.is_signed else WHITE_BLUE,
            vmin=scene.field.low, vmax=scene.field.limit, interpolation="bilinear",
        )  # fmt: skip
        line: dict[str, Any] = {"color": FISH, "linewidth": 0.9, "linestyle": (0, (4, 2))}
        self.paths = {}
        for trail in scene.trails:
            dots = {"color": _scale(trail.colour), "marker": ".", "ms": 3, "ls": ""}
            self.paths[trail.key] = axes.plot([], [], **(dots if trail.is_dotted else line))[0]
        for area in scene.areas:
            (x0, y0), (x1, y1) = (np.array(corner) / length for corner in (area.low, area.high))
            look: dict[str, Any] = {"fill": False, "edgecolor": _scale(area.colour), "lw": 0.7}
            axes.add_patch(Rectangle((x0, y0), x1 - x0, y1 - y0, ls=":", **look))
            name, colour = area.key.replace("_", " "), look["edgecolor"]
            text = {"ha": "right", "va": "bottom", "fontsize": 6, "color": colour}
            axes.text(x1, y0, name, clip_on=True, **text)
        self._updates: list[Callable[[Frame], None]] = [
            *(self._add_body(curve) for curve in scene.curves if curve.is_closed),
            *(self._add_goal(marks) for marks in scene.marks if marks.reach > 0.0),
            *(self._add_arrow(arrow) for arrow in scene.arrows if arrow.name),
            *(self._add_signals(marks) for marks in scene.marks if marks.value is not None),
        ]
        box = {"boxstyle": "round,pad=0.3", "facecolor": "white", "alpha": 0.85, "lw": 0}
        place: dict[str, Any] = {"transform": axes.transAxes, "va": "top", "bbox": box}
        self.corner = np.zeros(2, np.float32)  # lower left one of what is shown
        self.clock = axes.text(0.015, 0.955, "", ha="left", **place)
        self.ending = axes.text(0.5, 0.955, "", ha="center", weight="bold", **place)
        axes.set(xlim=edges[:2], ylim=edges[2:], aspect="equal")
        for ticks, nodes in ((axes.set_xticks, x), (axes.set_yticks, y)):
            step = space_ticks(nodes / length / scene.zoom)
            ticks(np.arange(0, nodes / length + 0.01, step))
        axes.tick_params(length=2.5)

    def add_colourbar(self, figure: Figure, axes: Any, **looks: Any) -> None:
        """Draw the colour bar of the field next to some axes."""
        field = self.scene.field
        label = f"{field.name}  [{field.unit}]" + f"   ({field.note})" * bool(field.note)
        extend = "both" if field.is_signed else "max"
        figure.colorbar(self.image, ax=axes, label=label, extend=extend, pad=0.015, **looks)

    def show(self, frames: Sequence[Frame]) -> None:
        """Show the last of some frames, and the path through all of them."""
        now = frames[-1]
        if self.scene.zoom > 1.0:
            self._follow(self._place(now.values[self.scene.curves[0].key]))
        self.image.set_data(now.values[self.scene.field.key].float().numpy())
        for update in self._updates:
            update(now)
        for key, path in self.paths.items():
            path.set_data(*np.stack([self._place(frame.values[key]) for frame in frames]).T)
        self.clock.set_text(f"t = {now.time:.1f} T")
        self.ending.set_text("" if now.ending is None else now.ending.words)

    def _follow(self, outline: NDArray[np.float32]) -> None:
        """Show the part of the flow around a body, within its edges."""
        scene = self.scene
        nodes = np.array([scene.width, scene.height], np.float32)
        size = nodes / scene.body_length / scene.zoom
        margin, middle = 0.5 / scene.body_length, outline.mean(0)
        last = nodes / scene.body_length - size - margin
        self.corner = np.clip(middle - 0.5 * size, -margin, last)
        (x0, y0), (x1, y1) = self.corner, self.corner + size
        self.axes.set(xlim=(x0, x1), ylim=(y0, y1))

    def _place(self, points: Tensor) -> NDArray[np.float32]:
        """Return points in body lengths."""
        placed: NDArray[np.float32] = (points.float() / self.scene.body_length).numpy()
        return placed

    def _add_body(self, curve: Curve) -> Callable[[Frame], None]:
        colour = _scale(curve.colour)
        looks: dict[str, Any] = {"facecolor": colour, "edgecolor": "white", "lw": 0.4, "zorder": 3}
        if not curve.is_filled:
            looks |= {"facecolor": "none", "edgecolor": colour, "ls": "--", "lw": 0.7}
        body = Polygon(np.zeros((3, 2)), closed=True, **looks)
        self.axes.add_patch(body)
        above: dict[str, Any] = {"ha": "center", "va": "bottom", "fontsize": 7, "clip_on": True}
        box = {"boxstyle": "round,pad=0.1", "facecolor": "white", "alpha": 0.7, "lw": 0}
        name = self.axes.text(0, 0, curve.name, color=FISH, zorder=5, bbox=box, **above)

        def update(now: Frame) -> None:
            outline = self._place(now.values[curve.key])
            body.set_xy(outline)
            name.set_position((float(outline[:, 0].mean()), float(outline[:, 1].max()) + 0.03))

        return update

    def _add_goal(self, goal: Marks) -> Callable[[Frame], None]:
        """Add a point with its name and the circle of its reach."""
        reach = goal.reach / self.scene.body_length
        circles = (
            Circle((0, 0), reach, fill=False, edgecolor=FISH, lw=0.8, ls=":"),
            Circle((0, 0), 0.07, facecolor=FOOD, edgecolor=FISH, lw=0.8, zorder=4),
        )
        below: dict[str, Any] = {"xytext": (0, -16), "textcoords": "offset points", "ha": "center"}
        name = self.axes.annotate(goal.name, (0, 0), **below)
        for circle in circles:
            self.axes.add_patch(circle)

        def update(now: Frame) -> None:
            place = tuple(self._place(now.values[goal.key]))
            for circle in circles:
                circle.center = place
            name.xy = place
            name.set_visible(now.ending is None)  # it would cover a fish that has arrived

        return update

    def _add_arrow(self, arrow: Arrow) -> Callable[[Frame], None]:
        """Add an arrow with its name and magnitude, hidden while it is zero."""
        shape = FancyArrowPatch(
            (0, 0), (0, 0), shrinkA=0, shrinkB=0, arrowstyle="-|>", mutation_scale=14, lw=2.0,
            color=FISH, zorder=5,
        )  # fmt: skip
        text = self.axes.text(0, 0, "", ha="left", va="bottom", zorder=5, clip_on=True)
        self.axes.add_patch(shape)

        def update(now: Frame) -> None:
            vector = now.values.get(arrow.key, torch.zeros(2)).float()
            if isinstance(arrow.at, str):
                x, y = self._place(now.values[arrow.at])
            else:  # of what is shown
                x, y = self.corner + self._place(torch.tensor(arrow.at)) / self.scene.zoom
            dx, dy = self._place(arrow.scale * vector)
            shape.set_positions((x, y), (x + dx, y + dy))
            text.set_position((x, y + 0.08 / self.scene.zoom))
            text.set_text(f"{arrow.name} {float(vector.norm()):.3g} {arrow.unit}")
            for artist in (shape, text):
                artist.set_visible(bool(vector.any()))

        return update

    def _add_signals(self, marks: Marks) -> Callable[[Frame], None]:
        """Add points coloured by their values, such as the pressure at neuromasts."""
        size = 2.0 * marks.radius / self.scene.body_length
        dots = EllipseCollection(
            [size], [size], [0.0], units="xy", offsets=np.zeros((0, 2)),
            offset_transform=self.axes.transData, cmap=PURPLE_GREEN,
            clim=(-marks.limit, marks.limit), edgecolors=FISH, linewidths=0.5, zorder=5,
        )  # fmt: skip
        self.axes.add_collection(dots, autolim=False)
        words = f"dots: {marks.name}, purple −{marks.limit:g} to green {marks.limit:g} {marks.unit}"
        self.axes.text(0.985, 0.03, words, ha="right", fontsize=8, transform=self.axes.transAxes)

        def update(now: Frame) -> None:
            dots.set_offsets(self._place(now.values[marks.key].reshape(-1, 2)))
            dots.set_array(now.values[str(marks.value)].float().reshape(-1).numpy())

        return update


def _scale(colour: tuple[int, int, int]) -> list[float]:
    """Return the colour of 0 to 255 for matplotlib."""
    return [part / 255.0 for part in colour]


class FramePainter:
    """Paint frames of one scene as pictures, one after another.

    Args:
        scene: what to draw.
        dpi: dots per inch; a picture is 8 inches wide.
    """

    def __init__(self, scene: Scene, *, dpi: float) -> None:
        self._trails = [trail.key for trail in scene.trails]
        self._path: list[Frame] = []  # without the fields, which are large
        with mpl.rc_context(STYLE):
            figure, self._flow = make_figure(scene)
            figure.set_dpi(dpi)
            self._canvas = FigureCanvasAgg(figure)
            self._canvas.draw()
            figure.set_layout_engine("none")
            axes = self._flow.image.axes
            parts = (part for part in axes.get_children() if not isinstance(part, Axis))
            self._changing = sorted(
                (part for part in parts if part is not axes.patch), key=methodcaller("get_zorder")
            )
            if scene.zoom > 1.0:  # ticks move, too: everything is drawn for each frame
                self._changing = []
            for artist in self._changing:  # all but ticks, their labels and the colour bar
                artist.set_animated(True)
            self._canvas.draw()
            self._rest = self._canvas.copy_from_bbox(figure.bbox)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of a picture in pixels."""
        width, height = self._canvas.get_width_height()
        return width, height

    def paint(self, frame: Frame) -> NDArray[np.uint8]:
        """Return a picture ``[height, width, 3]``; the path restarts with each episode."""
        if frame.begins:
            self._path.clear()
        self._flow.show([*self._path, frame])
        points = {key: frame.values[key].clone() for key in self._trails}
        self._path.append(replace(frame, values=points))
        with mpl.rc_context(STYLE):
            if self._changing:
                self._canvas.restore_region(self._rest)
            else:
                self._canvas.draw()
            for artist in self._changing:
                self._flow.image.axes.draw_artist(artist)
        return np.asarray(self._canvas.buffer_rgba())[..., :3].copy()


@checked
def write_snapshots(recording: Recording, path: str | PathLike[str]) -> None:
    """Write one picture of the field at six equidistant times."""
    times, num = recording.time, _NUM_SNAPSHOTS
    wanted = torch.linspace(float(times[-1]) / num, float(times[-1]), num)
    nearest = (times[None] - wanted[:, None]).abs().argmin(1)
    frames = list(dict.fromkeys(nearest.tolist()))  # without repetitions
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


@checked
def write_flow(recording: Recording, path: str | PathLike[str]) -> None:
    """Write a picture of the last frame."""
    with mpl.rc_context(STYLE):
        figure, flow = make_figure(fit_colours(recording))
        flow.show(recording.frames)
        with staged(Path(path)) as stage:
            figure.savefig(stage)


@checked
def write_film(
    recording: Recording, path: str | PathLike[str], *, seconds_per_T: PositiveFloat | None = None
) -> None:
    """Write the episode as an MP4 (H.264) or a GIF, using the ffmpeg of imageio-ffmpeg.

    Args:
        recording: the episode.
        path: file to write.
        seconds_per_T: duration of a period in the film; by default the film takes some ten seconds.

    Raises:
        ValueError: for a suffix that is not in ``FILMS``.
        OSError: if the file cannot be written.
    """
    suffix = Path(path).suffix
    if suffix not in FILMS:
        raise ValueError(f"{path}: must end in one of {', '.join(FILMS)}")
    dpi, options = FILMS[suffix]
    painter = FramePainter(fit_colours(recording), dpi=dpi)
    width, height = (2 * (side // 2) for side in painter.size)  # H.264 wants even sides
    fps: float = round(min(25.0, max(10.0, len(recording.frames) / _FILM_S)))
    if seconds_per_T is not None and (lasts_T := float(recording.time[-1])):
        fps = (len(recording.frames) - 1) / (lasts_T * seconds_per_T)
    step = max(1, ceil(fps / _MAX_FPS))
    fps /= step
    with staged(Path(path)) as stage:
        writer = imageio_ffmpeg.write_frames(
            str(stage), (width, height), fps=fps, macro_block_size=2, **options
        )
        writer.send(None)
        try:
            for frame in recording.frames[::-step][::-1]:
                picture = np.ascontiguousarray(painter.paint(frame)[:height, :width])
                writer.send(picture)
            for _ in range(round(_HOLD_S * fps)):
                writer.send(picture)
        finally:
            writer.close()


def make_figure(scene: Scene) -> tuple[Figure, FlowAxes]:
    """Return a figure of one flow with title and colour bar."""
    size = (_WIDTH_INCHES, 0.86 * _WIDTH_INCHES * scene.height / scene.width + 0.85)
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots()
    flow = FlowAxes(axes, scene)
    label_axes(axes)
    axes.set_title(scene.title, loc="left")
    flow.add_colourbar(figure, axes)
    return figure, flow
