"""Flows on a screen, by rerun; the only importer of it, and on use."""

from fishrl.viewer.blueprint import make_blueprint
from fishrl.viewer.drawing import TIMELINE, Drawing
from fishrl.viewer.files import (
    Picture,
    check_folder,
    find_recording,
    open_recording,
    photograph_views,
    start_drawing,
    write_screenshot,
)
from fishrl.viewer.live import Server, has_screen
from fishrl.viewer.scene import (
    Area,
    Choice,
    Field,
    FieldFormat,
    Frame,
    Marks,
    Outline,
    Panel,
    Scene,
    Series,
    Trail,
)

__all__ = [
    "TIMELINE",
    "Area",
    "Choice",
    "Drawing",
    "Field",
    "FieldFormat",
    "Frame",
    "Marks",
    "Outline",
    "Panel",
    "Picture",
    "Scene",
    "Series",
    "Server",
    "Trail",
    "check_folder",
    "find_recording",
    "has_screen",
    "make_blueprint",
    "open_recording",
    "photograph_views",
    "start_drawing",
    "write_screenshot",
]
