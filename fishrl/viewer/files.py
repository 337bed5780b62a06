"""Recordings as ``.rrd`` files: writing, opening in a window, screenshots."""

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

from fishrl.children import make_environment
from fishrl.envs.scene import Scene
from fishrl.files import check_folder, staged
from fishrl.settings import checked
from fishrl.viewer.blueprint import make_blueprint
from fishrl.viewer.drawing import TIMELINE, Drawing
from fishrl.viewer.process import Viewer
from fishrl.viewer.settings import FieldFormat

_APPLICATION = "fishrl"
_PATIENCE_S = 900.0
_IDLE_S = 5.0  # a viewer that has loaded nothing for so long has read the whole file
_PORT = 29870
_GREETING_S = 4.5  # duration of the viewer's welcome message
_MAX_SIZE = 1920
_FLUSH_S, _FLUSH_BYTES = 60.0, 2**21


@checked
def start_drawing(
    scene: Scene,
    *,
    flows: Mapping[int, str],
    save: str | os.PathLike[str] | None = None,
    url: str | None = None,
    field_format: FieldFormat = "jpeg",
) -> Drawing:
    """Open a drawing of flows in a file, a viewer, or both.

    Args:
        scene: what to draw.
        flows: titles of the flows, by index.
        save: path of the ``.rrd`` file, which is replaced if it exists.
        url: address of a viewer, see ``Server``.
        field_format: see ``ViewerSettings``.

    Raises:
        ValueError: if neither file nor viewer is given.
        OSError: if the file cannot be written.
    """
    import rerun as rr

    if save is None and url is None:
        raise ValueError("neither save nor url is given: give one of them")
    is_live, sinks, name = url is not None, list[Any](), "live"
    if save is not None:
        target = check_folder(save)
        name = f"{target.absolute().parent.name}-{target.stem}"
        target.unlink(missing_ok=True)
        sinks.append(rr.FileSink(str(target)))
    if url is not None:
        sinks.append(rr.GrpcSink(url))
        name = f"{name}-{time.time_ns()}"
    # a chunk takes kilobytes: only a live viewer needs many small ones
    batches = rr.ChunkBatcherConfig(flush_tick=_FLUSH_S, flush_num_bytes=_FLUSH_BYTES)
    stream = rr.RecordingStream(
        _APPLICATION,
        recording_id=f"{_APPLICATION}-{name}",
        batcher_config=None if is_live else batches,
    )
    stream.set_sinks(*sinks, default_blueprint=make_blueprint(scene, flows, is_live=is_live))
    return Drawing(stream, scene, flows=flows, field_format=field_format, is_live=is_live)


@checked
def open_recording(path: str | os.PathLike[str]) -> None:
    """Open a ``.rrd`` file in a window and wait until it is closed.

    Raises:
        FileNotFoundError: if there is no recording.
        ValueError: if the viewer fails.
    """
    words = ["-m", "rerun", "--bind", "127.0.0.1", "--port", "auto", str(find_recording(path))]
    command = [sys.executable, *words]
    status = subprocess.run(command, check=False, env=make_environment()).returncode
    if status:
        raise ValueError(
            f"the viewer ended with status {status}: its window needs a screen and a graphics "
            "driver; screenshot=<file.png> needs no window"
        )


@checked
def write_screenshot(
    path: str | os.PathLike[str], picture: str | os.PathLike[str], *, time_T: float | None = None
) -> None:
    """Write the viewer's picture of a ``.rrd`` file as a PNG, without a window.

    ``time_T`` is by default the middle of the recording. Waits until the viewer has read and drawn
    the file.

    Raises:
        OSError: if there is no recording, or the picture cannot be written.
        ValueError: if the viewer fails (it needs a Vulkan driver), or the recording is empty.
    """
    target = check_folder(picture)
    with open_headless(path, time_T) as viewer, staged(target) as stage:
        stage.write_bytes(viewer.settle())


class HeadlessViewer:
    """Client of a viewer without a window; calls are repeated while the viewer is busy.

    Raises:
        ValueError: if the viewer ends, or does not answer for a quarter of an hour.
    """

    def __init__(self, process: Viewer) -> None:
        self._process = process
        self._client: Any = None

    def ask(self, call: Callable[[Any], Any]) -> Any:
        """Return the result of ``call(client)``."""
        from rerun.experimental import ViewerClient

        deadline = time.monotonic() + _PATIENCE_S
        while True:
            try:
                self._client = self._client or ViewerClient.connect(self._process.url)
                return call(self._client)
            except (OSError, RuntimeError) as error:  # refused or timed out
                # without a Vulkan driver the program listens before it ends
                if not self._process.is_running or time.monotonic() > deadline:
                    raise ValueError(self._process.explain_failure()) from error
                time.sleep(0.5)

    def load(self, recording: Path) -> tuple[float, float]:
        """Open a file and return its first and last time in T."""
        self.ask(lambda client: client.open(str(recording.resolve())))
        idle_since = time.monotonic()
        while time.monotonic() < idle_since + _IDLE_S:
            state = self.ask(lambda client: client.get_state())
            lines = [line for loaded in state.recordings for line in loaded.timelines]
            ends = [1e-9 * end for x in lines if x.name == TIMELINE for end in (x.start, x.end)]
            if ends and not state.loading:
                return min(ends), max(ends)
            if state.loading:
                idle_since = time.monotonic()
            time.sleep(0.2)
        raise ValueError(f"{recording} has no timeline {TIMELINE}: record it again")

    def settle(self) -> bytes:
        """Return the first screenshot that equals its predecessor: all data have been drawn."""
        before, deadline = b"", time.monotonic() + _PATIENCE_S
        time.sleep(_GREETING_S)
        while True:
            time.sleep(0.5)
            shot: bytes = self.ask(lambda client: client.take_screenshot(max_size=_MAX_SIZE))
            if shot == before or time.monotonic() > deadline:
                return shot
            before = shot


@contextmanager
def open_headless(path: str | os.PathLike[str], time_T: float | None) -> Iterator[HeadlessViewer]:
    """Show a moment of a recording, by default its middle, without a window."""
    recording = find_recording(path)
    with closing(Viewer("--headless", "--hide-welcome-screen", port=_PORT)) as process:
        viewer = HeadlessViewer(process)
        middle = 0.5 * sum(viewer.load(recording))
        moment = middle if time_T is None else time_T
        viewer.ask(lambda client: client.set_time(TIMELINE, duration=moment, play_state="paused"))
        yield viewer


@checked
def find_recording(path: str | os.PathLike[str]) -> Path:
    """Return the ``.rrd`` file at a path or in a run folder, or raise FileNotFoundError."""
    file = Path(path).expanduser()
    file = file / "episode.rrd" if file.is_dir() else file
    if not file.is_file() or file.suffix != ".rrd":
        raise FileNotFoundError(f"no .rrd file at {file}: give one, or a run folder that has one")
    return file
