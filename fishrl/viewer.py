"""Episodes as rerun files, and the window that shows them. The only importer of rerun, and on use.

The y axis points down on a screen and up in the flow: rows are flipped here and nowhere else.
Everything stands on one timeline, ``sim_time``, on which one second is one tail-beat period T.
"""

import os
import subprocess
import sys
import time
from enum import StrEnum
from math import pi
from pathlib import Path
from types import ModuleType
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

TIMELINE = "sim_time"
_FISH = (32, 37, 43)
_FOOD = (242, 177, 52)
_PATH = (90, 90, 90)
# ColorBrewer RdBu, from -1 (blue) over 0 (white) to 1 (red).
_RED_BLUE = (
    (5, 48, 97), (33, 102, 172), (67, 147, 195), (146, 197, 222), (209, 229, 240), (247, 247, 247),
    (253, 219, 199), (244, 165, 130), (214, 96, 77), (178, 24, 43), (103, 0, 31),
)  # fmt: skip


class FieldFormat(StrEnum):
    """How vorticity is stored: what it costs, and what one can still change in the viewer.

    ``JPEG``: red to blue, small, colours fixed. ``U8``: 255 levels, four times larger, values under
    the mouse and the colour map chosen in the viewer.
    """

    JPEG = "jpeg"
    U8 = "u8"


class Episode(Protocol):
    """What the viewer needs to know of an episode of F frames, in lattice units."""

    @property
    def body_length(self) -> float:
        """L, nodes."""

    @property
    def time(self) -> Tensor:
        """``[F]`` in T."""

    @property
    def outline(self) -> Tensor:
        """``[F, N, 2]`` closed outline (x, y)."""

    @property
    def vorticity(self) -> Tensor:
        """``[F, Y, X]`` in 1/T."""

    @property
    def food(self) -> Tensor:
        """``[F, 2]``."""

    @property
    def head(self) -> Tensor:
        """``[F, 2]``."""

    @property
    def action(self) -> Tensor:
        """``[F]``."""

    @property
    def reward(self) -> Tensor:
        """``[F]``."""

    @property
    def capture_radius(self) -> float:
        """Nodes."""


def import_rerun() -> ModuleType:
    """Return rerun, or say what to install."""
    try:
        import rerun
    except ImportError as error:
        raise ImportError(
            "rerun is not installed: `pip install 'rerun-sdk>=0.41,<0.42'` brings the viewer"
        ) from error
    return rerun


def write_recording(
    recording: Episode,
    path: str | os.PathLike[str],
    *,
    vorticity_limit: float,
    field_format: FieldFormat | str = FieldFormat.JPEG,
) -> None:
    """Write an episode as a ``.rrd`` file that rerun opens with a layout of its own.

    Args:
        recording: the episode.
        path: of the file.
        vorticity_limit: vorticity at which the colours saturate, 1/T.
        field_format: ``jpeg`` or ``u8``.
    """
    known = [str(f) for f in FieldFormat]
    if field_format not in known:
        raise ValueError(f"field_format = '{field_format}': allowed are {known}")
    if not vorticity_limit > 0:
        raise ValueError(f"vorticity_limit = {vorticity_limit}: must be positive")
    target = Path(path)
    if not target.parent.is_dir():
        raise FileNotFoundError(f"no folder {target.parent}: make it first")
    rr = import_rerun()
    stream = rr.RecordingStream("fishrl", recording_id=f"fishrl-{target.parent.name}-{target.stem}")
    stream.save(target, default_blueprint=_make_blueprint(recording))
    _log_constants(rr, stream, recording, vorticity_limit, FieldFormat(field_format))
    for frame in range(recording.time.numel()):
        stream.set_time(TIMELINE, duration=float(recording.time[frame]))
        field = recording.vorticity[frame].float().flip(-2) / vorticity_limit
        stream.log("world/vorticity", _encode_field(rr, field, FieldFormat(field_format)))
        _log_frame(rr, stream, recording, frame)
    stream.flush()
    stream.disconnect()


def _make_blueprint(recording: Episode) -> Any:
    rerun = import_rerun()
    import rerun.blueprint as rrb

    height, width = recording.vorticity.shape[-2:]
    bounds = rrb.VisualBounds2D(x_range=[0, width], y_range=[0, height])
    plots = [
        rrb.TimeSeriesView(origin=f"episode/{name}", name=name)
        for name in ("reward", "action", "distance")
    ]
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Spatial2DView(
                origin="world", name="vorticity, fish and food", visual_bounds=bounds,
                background=rerun.blueprint.Background(color=[255, 255, 255]),
            ),
            rrb.Vertical(*plots, rrb.TextDocumentView(origin="about", name="about")),
            column_shares=[3, 1],
        ),
        rrb.TimePanel(timeline=TIMELINE),
        collapse_panels=True,
    )  # fmt: skip


def _log_constants(
    rr: ModuleType, stream: Any, recording: Episode, limit: float, field_format: FieldFormat
) -> None:
    """Log what holds for the whole episode."""
    field = (
        "red turns counter-clockwise"
        if field_format is FieldFormat.JPEG
        else f"value v means (v - 128) / 127 × {limit:g} /T, so above 128 turns counter-clockwise"
    )
    about = (
        f"One second of `{TIMELINE}` is one tail-beat period T.\n\n"
        f"Body length L = {recording.body_length:g} nodes; the picture is in nodes.\n\n"
        f"Vorticity: colours saturate at ±{limit:g} /T; {field}.\n\n"
        "Distance: head to food, in L. Action: the index that the fish chose."
    )
    stream.log("about", rr.TextDocument(about, media_type="text/markdown"), static=True)
    names = {"reward": "reward", "action": "action", "distance": "head to food / L"}
    for name, label in names.items():
        mode = "Linear" if name == "distance" else "StepBefore"
        style = rr.SeriesLines(names=label, widths=2, interpolation_mode=mode)
        stream.log(f"episode/{name}", style, static=True)


def _log_frame(rr: ModuleType, stream: Any, recording: Episode, frame: int) -> None:
    """Log one frame but for the flow."""
    height = recording.vorticity.shape[-2]
    thickness = recording.body_length / 50.0
    outline = _place(recording.outline[frame], height)
    half = len(outline) // 2
    # lines from side to side fill the body: rerun has no filled polygon in two dimensions
    ribs = np.stack((outline[1:half], outline[: len(outline) - half : -1]), 1)
    fish = [np.concatenate((outline, outline[:1])), *ribs]
    path = _place(recording.head[: frame + 1], height)
    food = _place(recording.food[frame], height)
    angle = np.linspace(0.0, 2.0 * pi, 49)
    circle = np.stack((np.cos(angle), np.sin(angle)), 1).astype(np.float32)
    reach = food + np.float32(recording.capture_radius) * circle
    stream.log("world/trajectory", _make_lines(rr, [path], _PATH, 0.6 * thickness, 1.0))
    stream.log("world/capture_radius", _make_lines(rr, [reach], _FOOD, 0.6 * thickness, 2.0))
    stream.log("world/fish", _make_lines(rr, fish, _FISH, 0.6 * thickness, 4.0))
    stream.log(
        "world/food",
        rr.Points2D([food], radii=3.0 * thickness, colors=[_FOOD], draw_order=3.0),
    )
    distance = (recording.food[frame] - recording.head[frame]).norm() / recording.body_length
    values = {
        "reward": recording.reward[frame], "action": recording.action[frame], "distance": distance
    }  # fmt: skip
    for name, value in values.items():
        stream.log(f"episode/{name}", rr.Scalars(float(value)))


def _make_lines(
    rr: ModuleType,
    strips: list[NDArray[np.float32]],
    colour: tuple[int, ...],
    radius: float,
    order: float,
) -> Any:
    return rr.LineStrips2D(strips, colors=[colour], radii=radius, draw_order=order)


def _place(points: Tensor, height: int) -> NDArray[np.float32]:
    """Turn node coordinates (y up) into picture coordinates (y down, pixel centres at one half)."""
    x, y = points.float().unbind(-1)
    return torch.stack((x + 0.5, height - 0.5 - y), -1).cpu().numpy()


def _encode_field(rr: ModuleType, field: Tensor, field_format: FieldFormat) -> Any:
    """Encode ``[Y, X]`` of values in -1 to 1, top row first."""
    levels = (field.clamp(-1.0, 1.0) * 127.0 + 128.0).round().to(torch.uint8).cpu().numpy()
    if field_format is FieldFormat.JPEG:
        position = np.linspace(0.0, 1.0, len(_RED_BLUE))
        at = np.clip((np.arange(256) - 1) / 254.0, 0.0, 1.0)
        table = np.stack([np.interp(at, position, c) for c in zip(*_RED_BLUE, strict=True)], 1)
        return rr.Image(table.astype(np.uint8)[levels], opacity=1.0, draw_order=0.0).compress(85)
    return rr.DepthImage(levels, colormap="Spectral", depth_range=(1, 255), draw_order=0.0)


def open_recording(path: str | os.PathLike[str]) -> None:
    """Open a ``.rrd`` file in a window and wait until it is closed."""
    import_rerun()
    subprocess.run([sys.executable, "-m", "rerun", str(_find(path))], check=True)


def write_screenshot(
    path: str | os.PathLike[str], picture: str | os.PathLike[str], *, time_T: float
) -> None:
    """Write what the viewer shows at a time as a PNG, without a window (needs a Vulkan driver).

    Args:
        path: of the ``.rrd`` file.
        picture: of the PNG.
        time_T: when, in T.
    """
    recording = _find(path)
    import_rerun()
    from rerun.experimental import ViewerClient

    # the viewer of this environment, whatever PATH says
    viewer_path = str(Path(sys.executable).with_name("rerun"))
    with ViewerClient.spawn(headless=True, port=29877, executable_path=viewer_path) as viewer:
        viewer.open(str(recording.resolve()))
        viewer.set_time(TIMELINE, duration=time_T, play_state="paused")
        time.sleep(4.0)  # the viewer draws while it reads, and says nothing when it is done
        Path(picture).write_bytes(viewer.take_screenshot(max_size=1600))


def _find(path: str | os.PathLike[str]) -> Path:
    file = Path(path)
    file = file / "capture.rrd" if file.is_dir() else file
    if not file.is_file() or file.suffix != ".rrd":
        raise FileNotFoundError(f"no .rrd file at {file}: give one, or a run folder that has one")
    return file
