"""Whether the views of a recording drew, and what is in their pictures."""

import io
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from PIL import Image

from fishrl.envs.scene import Scene
from fishrl.viewer.files import open_headless

#: Where the Vulkan loader looks for drivers, unless a variable names their files or folders.
FOLDERS = [f"{root}/vulkan/icd.d" for root in ("/etc", "/usr/share", "/usr/local/share")]


def list_drivers(folders: Sequence[str] = FOLDERS) -> list[Path]:
    """Return the files that describe the Vulkan drivers of this machine."""
    named = os.environ.get("VK_DRIVER_FILES") or os.environ.get("VK_ICD_FILENAMES")
    paths = [Path(name) for name in (named.split(os.pathsep) if named else folders)]
    files = [file for path in paths for file in (path.glob("*.json") if path.is_dir() else [path])]
    return [file for file in files if file.is_file()]


needs_vulkan = pytest.mark.skipif(
    not list_drivers(),
    reason="the viewer needs a Vulkan driver: apt install mesa-vulkan-drivers",
)


def read(png: bytes) -> np.ndarray:
    """Return the pixels ``[Y, X, 3]`` as whole numbers from 0 to 255."""
    with Image.open(io.BytesIO(png)) as picture:
        return np.asarray(picture.convert("RGB")).astype(int)


def count_colours(pixels: np.ndarray) -> int:
    return len(np.unique(pixels.reshape(-1, 3), axis=0))


class Picture(NamedTuple):
    """What one view shows: its name, the entity, the picture, and errors of the viewer."""

    name: str
    origin: str
    png: bytes
    reports: list[str]


def photograph_views(path: Path, *, time_T: float) -> list[Picture]:
    """Return a picture of each view in the tab on top."""
    pictures = []
    with open_headless(path, time_T) as viewer:
        viewer.settle()
        for view in viewer.ask(lambda client: client.get_state()).views:

            def take(client: Any, view_id: str = view.view_id) -> bytes | None:
                try:
                    return client.take_screenshot(view_id)
                except ConnectionError as error:
                    if "not found" in str(error):  # in a tab behind
                        return None
                    raise

            reports = [f"{report.severity}: {report.summary}" for report in view.reports]
            if (png := viewer.ask(take)) is not None:
                pictures.append(Picture(view.name, view.origin, png, reports))
    return pictures


def check_views(pictures: Sequence[Picture], scene: Scene, *, title: str, least: float) -> None:
    """Fail unless each view of the first flow is there and shows something.

    Args:
        pictures: of the views.
        scene: what was drawn.
        title: of the flow.
        least: share of the flow's picture that is red, and that is blue.
    """
    views = {picture.name: picture for picture in pictures}
    legends = {f"{marks.name} [{marks.unit}]" for marks in scene.marks if marks.value}
    legends.add(f"{scene.field.name} [{scene.field.unit}]")
    assert set(views) == {title, "about", *legends, *(panel.name for panel in scene.panels)}
    for name, picture in views.items():
        assert picture.reports == [], name
        assert picture.origin.startswith(("/flow_0", "/legend"))
        assert count_colours(read(picture.png)) >= 8, f"{name} is empty"
    flow = read(views[title].png)
    warm, cold = flow[..., 0] - flow[..., 2] > 80, flow[..., 2] - flow[..., 0] > 80
    assert warm.mean() > least
    assert cold.mean() > least
    for panel in scene.panels:
        pixels = read(views[panel.name].png)
        colourful = pixels.max(-1) - pixels.min(-1) > 60  # grids and letters are grey
        assert colourful.sum() > 100, f"{panel.name} has no line"
