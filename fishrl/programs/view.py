"""Show what a policy does, in the rerun viewer: ``fishrl view checkpoint=runs/<name>``.

``policy=pid preset=gait_small`` shows a baseline, ``live=true`` streams while it runs, ``save=``
writes a recording or a film, ``screenshot=`` a picture; a path alone opens a recording that exists.
"""

import time
from contextlib import ExitStack, closing, suppress
from pathlib import Path
from tempfile import TemporaryDirectory

from pydantic import NonNegativeFloat, PositiveFloat, PositiveInt

from fishrl.envs.episodes import count_decisions
from fishrl.envs.scene import Frame
from fishrl.programs.policy_settings import PolicySettings, read_task
from fishrl.programs.program import program
from fishrl.training.callback import Callback
from fishrl.training.evaluation import fixed_starts
from fishrl.training.progress import Progress
from fishrl.viewer import (
    Recording,
    Server,
    ViewerSettings,
    check_folder,
    find_recording,
    has_screen,
    make_env_scene,
    name_flows,
    open_recording,
    record_episodes,
    start_drawing,
    write_screenshot,
)
from fishrl.viewer.film import FILMS, write_film


class ViewConfig(PolicySettings, ViewerSettings):
    """Settings of the viewer program.

    Args:
        recording: a ``.rrd`` file, or a run folder with one, to open as it is.
        episodes: fixed starts, one flow each, of which ``shown_flows`` are shown; all by default.
        periods: T after which an episode is cut; ``null`` runs it to its end.
        save: file to write: a recording ``.rrd``, by default one in the temporary folder, or a film
            of one flow, ``.mp4`` or ``.gif``.
        screenshot: PNG to write instead of opening a window.
        time: time of the picture, in T; by default the middle of the recording.
    """

    recording: str | None = None
    episodes: PositiveInt = 1
    periods: PositiveFloat | None = 20.0
    save: str | None = None
    screenshot: str | None = None
    time: NonNegativeFloat | None = None

    def __post_init__(self) -> None:
        """Check both kinds of settings."""
        super().__post_init__()
        if self.recording is not None and (self.save or self.live):
            raise ValueError(
                "save and live: are for policies; a recording is only opened. For the policy of a "
                "run give checkpoint=<its folder>"
            )
        endings = (".rrd", *FILMS)
        if self.save is not None and Path(self.save).suffix not in endings:
            raise ValueError(f"save = {self.save}: must end in one of {', '.join(endings)}")
        if self.is_film and len(self.shown) > 1:
            raise ValueError(
                f"save = {self.save}: a film is of one flow, not {len(self.shown)}: give "
                "episodes=1, or the flow to be filmed, shown_flows=[0]"
            )
        if self.is_film and (self.screenshot or self.live):
            raise ValueError(f"save = {self.save}: screenshot and live do not go with a film")

    @property
    def shown(self) -> list[int]:
        """The flows that are shown."""
        return self.choose_flows(self.episodes, default=self.episodes)

    @property
    def is_film(self) -> bool:
        """Whether a film is written instead of a recording."""
        return self.save is not None and Path(self.save).suffix in FILMS

    @property
    def sources(self) -> dict[str, str | None]:
        """Add ``recording``."""
        return {"the path of a .rrd file": self.recording} | super().sources


def record(settings: ViewConfig, *, save: Path, url: str | None, progress: Callback) -> list[str]:
    """Run a policy from fixed starts; its flows go to a file, and to a viewer's server at a URL.

    Returns: how each episode ended that was not cut.
    """
    check_folder(save)
    flows, endings = settings.shown, list[str]()
    task, recognition, policy = settings.make_policy()
    starts = fixed_starts(task, settings.episodes, seed=settings.seed)
    max_decisions = min(task.time_limit, count_decisions(task, settings.periods))
    with ExitStack() as stack:
        env = settings.make_env(task, recognition, num_envs=len(flows), progress=progress)
        stack.callback(env.close)
        scene = make_env_scene(
            env,
            field=settings.field,
            field_limit=settings.field_limit,
            policy="/".join(Path(settings.source).parts[-2:]),
        )
        names = name_flows(task, flows, starts)
        film, drawing = Recording(scene=scene), None
        if not settings.is_film:
            drawing = start_drawing(
                scene, flows=names, save=save, url=url, field_format=settings.field_format
            )
            stack.callback(drawing.close)

        def draw(start: int, frame: Frame) -> None:
            if frame.ending is not None:
                remedy = f" (seed={settings.seed + 1}: from another start)"
                words = f"{frame.ending.words}{'' if frame.ending.is_success else remedy}"
                endings.append(f"flow {flows[start]}, after {frame.time:.1f} T: {words}")
            if drawing is None:
                film.frames.append(frame)
            else:
                drawing.draw(flows[start], frame)

        progress.on_phase("recording", total=max_decisions)
        record_episodes(
            env,
            policy,
            starts[flows],
            scene=scene,
            give=draw,
            frames_per_T=settings.frames_per_T,
            max_decisions=max_decisions,
            on_step=lambda running, step: progress.on_progress(1),
        )
    if settings.is_film:
        write_film(film, save)
    return endings


def wait_for_interrupt() -> None:
    """Return on Ctrl-C."""
    print("the episodes are over; the live view stays until you press Ctrl-C")
    with suppress(KeyboardInterrupt):
        while True:
            time.sleep(1.0)


@program(
    ViewConfig,
    groups={"task": "predation", "preset": None},
    stored=read_task,
    positional="recording",
)
def main(settings: ViewConfig) -> None:
    """Open, record, stream or take a screenshot, as the settings say."""
    opens = not (settings.live or settings.save or settings.screenshot)
    with ExitStack() as stack:
        folder = stack.enter_context(TemporaryDirectory(prefix="fishrl-"))
        path = Path(settings.recording or settings.save or f"{folder}/view.rrd")
        if settings.recording is not None:
            find_recording(path)
        if settings.screenshot is not None:
            check_folder(settings.screenshot)
        if opens and not has_screen():
            raise ValueError(
                "no screen to open a window on: give save=<file.rrd>, screenshot=<file.png>, or "
                "live=true for a browser"
            )
        if settings.recording is None:
            url = None
            if settings.live:
                server = stack.enter_context(closing(Server(port=settings.port)))
                url = server.url
            with Progress() as progress:
                endings = record(settings, save=path, url=url, progress=progress)
            for ending in endings:
                print(ending)
            if settings.save is not None:
                print(f"written: {path}, {path.stat().st_size / 1e6:.2f} MB")
            if settings.live:
                wait_for_interrupt()
        if settings.screenshot is not None:
            write_screenshot(path, settings.screenshot, time_T=settings.time)
            print(f"written: {settings.screenshot}")
        elif opens:
            open_recording(path)
