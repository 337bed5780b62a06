"""Recordings, films and live views of flows; rerun is imported on use."""

from fishrl.viewer.blueprint import make_blueprint
from fishrl.viewer.drawing import TIMELINE, Drawing
from fishrl.viewer.files import (
    find_recording,
    open_recording,
    start_drawing,
    write_screenshot,
)
from fishrl.viewer.process import Server, has_screen
from fishrl.viewer.recording import Recording, make_env_scene, name_flows, record_episodes
from fishrl.viewer.settings import ViewerSettings

__all__ = [
    "TIMELINE",
    "Drawing",
    "Recording",
    "Server",
    "ViewerSettings",
    "find_recording",
    "has_screen",
    "make_blueprint",
    "make_env_scene",
    "name_flows",
    "open_recording",
    "record_episodes",
    "start_drawing",
    "write_screenshot",
]
