"""Pictures of the flow around one fish: vorticity snapshots and the animation of a capture."""

import io
from collections.abc import Sequence
from math import floor, log10
from os import PathLike
from pathlib import Path

import matplotlib as mpl
import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import Colormap, to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon
from PIL import Image

from experiments.figures.style import FISH, FOOD, STYLE, VORTICITY_LABEL, label_axes
from experiments.recording import Recording

_NICE_STEPS = (1.0, 1.5, 2.0, 3.0, 5.0, 7.5, 10.0)
_NUM_SNAPSHOTS = 6
_GIF_LEVELS = 49
_GIF_WIDTH_INCHES = 8.0


def choose_vorticity_limit(recording: Recording) -> float:
    """Return the vorticity, in 1/T, at which the colours saturate: a round number.

    The boundary layer on the fish is many times stronger than the wake, which is what one wants to
    see; so the limit is a percentile of what rotates at all, in the later half of the episode.
    """
    late = recording.vorticity[recording.num_frames // 2 :: 4, ::2, ::2].float().abs().flatten()
    rotating = late[late > 0.02 * late.max()]
    if rotating.numel() == 0:
        return 1.0
    # torch.quantile is limited to 16 million values; numpy is not
    wanted = float(np.quantile(rotating.numpy(), 0.8))
    scale = 10.0 ** floor(log10(wanted))
    return next(step * scale for step in _NICE_STEPS if step * scale >= wanted * (1 - 1e-9))


class FlowScene:
    """One set of axes that shows a recording's flow, fish, food and path, frame by frame.

    Args:
        axes: to draw on.
        recording: what to draw.
        limit: vorticity at which the colours saturate, 1/T.
        cmap: colours of the vorticity.
    """

    def __init__(
        self, axes: Axes, recording: Recording, *, limit: float, cmap: str | Colormap = "RdBu_r"
    ) -> None:
        self.recording = recording
        length, (x, y) = recording.body_length, recording.domain
        edges = (-0.5 / length, (x - 0.5) / length, -0.5 / length, (y - 0.5) / length)
        self.image = axes.imshow(
            recording.vorticity[0].float().numpy(), extent=edges, origin="lower", cmap=cmap,
            vmin=-limit, vmax=limit, interpolation="bilinear",
        )  # fmt: skip
        (self.path,) = axes.plot([], [], color=FISH, linewidth=0.9, linestyle=(0, (4, 2)))
        self.fish = Polygon(
            np.zeros((3, 2)), closed=True, facecolor=FISH, edgecolor="white", lw=0.4
        )
        self.fish.set_zorder(3)
        self.reach = Circle(
            (0, 0), recording.capture_radius / length,
            fill=False, edgecolor=FISH, linewidth=0.8, linestyle=":",
        )  # fmt: skip
        self.food = Circle((0, 0), 0.07, facecolor=FOOD, edgecolor=FISH, linewidth=0.8, zorder=4)
        for patch in (self.fish, self.reach, self.food):
            axes.add_patch(patch)
        self.clock = axes.text(
            0.015, 0.955, "", transform=axes.transAxes, ha="left", va="top",
            bbox={"boxstyle": "round,pad=0.3", "facecolor": "white", "alpha": 0.85, "lw": 0},
        )  # fmt: skip
        axes.set(xlim=edges[:2], ylim=edges[2:], aspect="equal")
        axes.set_xticks(np.arange(0, x / length + 0.01, 2))
        axes.set_yticks(np.arange(0, y / length + 0.01, 1))
        axes.tick_params(length=2.5)

    def show(self, frame: int) -> None:
        """Move everything to a frame."""
        recording, length = self.recording, self.recording.body_length
        self.image.set_data(recording.vorticity[frame].float().numpy())
        self.fish.set_xy((recording.outline[frame] / length).numpy())
        head = (recording.head[: frame + 1] / length).numpy()
        self.path.set_data(head[:, 0], head[:, 1])
        food_x, food_y = (recording.food[frame] / length).tolist()
        self.food.center = self.reach.center = (food_x, food_y)
        self.clock.set_text(f"t = {recording.time[frame]:.1f} T")


def find_frames(recording: Recording, times: Sequence[float] | None = None) -> list[int]:
    """Return the frames nearest to ``times`` in T; six spread over the episode if not given."""
    end = float(recording.time[-1])
    if times is None:
        times = np.linspace(end / _NUM_SNAPSHOTS, end, _NUM_SNAPSHOTS).tolist()
    wrong = [t for t in times if not 0.0 <= t <= end + 0.5 / recording.frames_per_T]
    if wrong or not times:
        raise ValueError(f"times = {list(times)}: give at least one, each within 0 and {end:.1f} T")
    nearest = (recording.time[None] - torch.tensor(times)[:, None]).abs().argmin(1)
    return list(dict.fromkeys(nearest.tolist()))


def write_snapshots(
    recording: Recording, path: str | PathLike[str], *, times: Sequence[float] | None = None
) -> None:
    """Write vorticity at several times on one sheet, as the paper shows its predation.

    Args:
        recording: the episode.
        path: of the PNG.
        times: in T; evenly spread over the episode if not given.
    """
    frames = find_frames(recording, times)
    columns = min(2, len(frames))
    rows = -(-len(frames) // columns)
    ratio = recording.domain[1] / recording.domain[0]
    with mpl.rc_context(STYLE):
        size = (1.2 + 4.6 * columns, 0.9 + 4.6 * ratio * rows)
        figure = Figure(figsize=size, layout="constrained")
        grid = figure.subplots(rows, columns, squeeze=False)
        limit = choose_vorticity_limit(recording)
        for i, axes in enumerate(grid.flat):
            if i >= len(frames):
                axes.set_visible(False)
                continue
            scene = FlowScene(axes, recording, limit=limit)
            scene.show(frames[i])
            label_axes(axes, x=i + columns >= len(frames), y=i % columns == 0)
        figure.colorbar(
            scene.image, ax=grid, label=VORTICITY_LABEL, extend="both", aspect=40, pad=0.015
        )
        figure.savefig(path)


def write_flow(recording: Recording, path: str | PathLike[str], *, frame: int = -1) -> None:
    """Write one large picture of the flow, the last frame unless said otherwise."""
    num_frames = recording.num_frames
    if not -num_frames <= frame < num_frames:
        raise ValueError(f"frame = {frame}: the recording has {num_frames} frames")
    with mpl.rc_context(STYLE):
        figure, scene = _make_single(recording)
        scene.show(frame % num_frames)
        figure.savefig(path)


def write_animation(
    recording: Recording,
    path: str | PathLike[str],
    *,
    frames_per_second: int = 14,
    max_bytes: int = 6_000_000,
) -> None:
    """Write the episode as a GIF; it shrinks until it fits into ``max_bytes``."""
    if frames_per_second < 1:
        raise ValueError(f"frames_per_second = {frames_per_second}: at least 1 is needed")
    dpi = 100.0
    while True:
        data = _encode_gif(_render(recording, dpi), frames_per_second)
        if len(data) <= max_bytes:
            Path(path).write_bytes(data)
            return
        if dpi < 30:
            raise ValueError(
                f"max_bytes = {max_bytes}: {recording.num_frames} frames take {len(data)} bytes "
                "even at the smallest size: raise it, or record fewer frames per period"
            )
        dpi *= min(0.9, max(0.5, 0.95 * (max_bytes / len(data)) ** 0.5))


def _make_single(recording: Recording, cmap: str | Colormap = "RdBu_r") -> tuple[Figure, FlowScene]:
    ratio = recording.domain[1] / recording.domain[0]
    width = _GIF_WIDTH_INCHES
    figure = Figure(figsize=(width, 0.86 * width * ratio + 0.6), layout="constrained")
    axes = figure.subplots()
    scene = FlowScene(axes, recording, limit=choose_vorticity_limit(recording), cmap=cmap)
    label_axes(axes)
    figure.colorbar(scene.image, ax=axes, label=VORTICITY_LABEL, extend="both", pad=0.015)
    return figure, scene


def _render(recording: Recording, dpi: float) -> list[Image.Image]:
    """Draw every frame; few colour levels, so that the GIF compresses."""
    pictures = []
    with mpl.rc_context(STYLE):
        figure, scene = _make_single(recording, mpl.colormaps["RdBu_r"].resampled(_GIF_LEVELS))
        figure.set_dpi(dpi)
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        figure.set_layout_engine("none")
        for frame in range(recording.num_frames):
            scene.show(frame)
            canvas.draw()
            pictures.append(Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB"))
    return pictures


def _encode_gif(pictures: list[Image.Image], frames_per_second: int) -> bytes:
    """Encode all frames with one palette and no dithering, so that what rests costs nothing."""
    palette = _make_palette()
    first, *rest = (p.quantize(palette=palette, dither=Image.Dither.NONE) for p in pictures)
    period = round(1000 / frames_per_second)
    buffer = io.BytesIO()
    first.save(
        buffer, format="GIF", save_all=True, append_images=rest, loop=0,
        duration=[period] * len(rest) + [1500],
    )  # fmt: skip
    return buffer.getvalue()


def _make_palette() -> Image.Image:
    """Return the vorticity's colours, greys, and the food's from dark to white."""
    field = mpl.colormaps["RdBu_r"].resampled(_GIF_LEVELS)(np.arange(_GIF_LEVELS))[:, :3]
    greys = np.linspace(to_rgb(FISH), (1.0, 1.0, 1.0), 48)
    food = [np.linspace(to_rgb(end), to_rgb(FOOD), 8) for end in (FISH, "white")]
    colours = np.concatenate((field, np.linspace(0.0, 1.0, 32)[:, None] * np.ones(3), greys, *food))
    palette = Image.new("P", (1, 1))
    palette.putpalette((255 * colours).round().astype(np.uint8).tobytes())
    return palette
