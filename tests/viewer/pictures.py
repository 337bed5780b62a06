"""Pictures that rerun takes of the views of a recording."""

import io
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from fishrl.envs.scene import Scene
from fishrl.viewer.files import open_headless

#: Folders in which the Vulkan loader looks for drivers.
FOLDERS = [f"{root}/vulkan/icd.d" for root in ("/etc", "/usr/share", "/usr/local/share")]
has_driver = any(name in os.environ for name in ("VK_DRIVER_FILES", "VK_ICD_FILENAMES")) or any(
    path for folder in FOLDERS for path in Path(folder).glob("*.json")
)
needs_vulkan = pytest.mark.skipif(
    not has_driver, reason="the viewer needs a Vulkan driver: apt install mesa-vulkan-drivers"
)


def photograph_views(path: Path, *, time_T: float) -> dict[str, np.ndarray]:
    """Return the pixels ``[Y, X, 3]`` of each view in the front tab, by the name of the view."""
    pictures = {}
    with open_headless(path, time_T) as viewer:
        viewer.settle()
        for view in viewer.ask(lambda client: client.get_state()).views:

            def take(client: Any, view_id: str = view.view_id) -> bytes | None:
                try:
                    return client.take_screenshot(view_id)
                except ConnectionError as error:
                    if "not found" in str(error):  # a view of another tab
                        return None
                    raise

            if (png := viewer.ask(take)) is not None:
                assert not view.reports, view.name
                assert view.origin.startswith(("/flow_0", "/legend"))
                with Image.open(io.BytesIO(png)) as picture:
                    pictures[view.name] = np.asarray(picture.convert("RGB")).astype(int)
    return pictures


def check_views(views: dict[str, np.ndarray], scene: Scene, *, title: str, least: float) -> None:
    """Fail unless each view of the flow called ``title`` has content.

    ``least`` is the least share of its picture that is red, and that is blue.
    """
    legends = {f"{marks.name} [{marks.unit}]" for marks in scene.marks if marks.value}
    legends.add(f"{scene.field.name} [{scene.field.unit}]")
    assert set(views) == {title, "about", *legends, *(panel.name for panel in scene.panels)}
    for name, pixels in views.items():
        assert len(np.unique(pixels.reshape(-1, 3), axis=0)) >= 8, f"{name} is empty"
    red_minus_blue = views[title][..., 0] - views[title][..., 2]
    assert (red_minus_blue > 80).mean() > least
    assert (red_minus_blue < -80).mean() > least
    for panel in scene.panels:
        pixels = views[panel.name]
        colourful = pixels.max(-1) - pixels.min(-1) > 60  # grids and letters are grey
        assert colourful.sum() > 100, f"{panel.name} has no line"
