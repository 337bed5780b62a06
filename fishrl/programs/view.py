"""Show what a policy does, in the rerun viewer: ``fishrl view policy=runs/<name>``.

``policy=pid preset=gait_small`` shows a baseline, ``live=true`` streams while it runs, ``save=``
writes a recording, a film or a picture, ``screenshot=`` one of the viewer; a path alone opens a
recording that exists.
"""

import time as clock
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp
from typing import Annotated, Any

from pydantic import Field, NonNegativeFloat, PositiveFloat, PositiveInt

from fishrl.envs.episodes import count_decisions
from fishrl.envs.scene import Frame
from fishrl.files import claim_file
from fishrl.programs.program import ending_in, program, take
from fishrl.programs.statistics import find_share
from fishrl.programs.stored_task import POLICY, read_result, read_typical
from fishrl.training.callback import Callback
from fishrl.training.evaluation import fixed_starts
from fishrl.training.policies import evaluate, prepare
from fishrl.training.progress import Progress
from fishrl.viewer import (
    Recording,
    Server,
    ViewerSettings,
    find_recording,
    has_screen,
    make_env_scene,
    name_flows,
    open_recording,
    record_episodes,
    start_drawing,
    write_screenshot,
)
from fishrl.viewer.film import FILMS, write_film, write_flow

#: Endings of what is drawn of one flow: its last moment, or all as a film.
DRAWN = (".png", *FILMS)
_FRAMES_PER_S = 20  # least number in a film of a given speed


def record(
    save: Path,
    *,
    view: ViewerSettings,
    episodes: int,
    periods: float | None,
    url: str | None,
    zoom: float,
    seconds_per_T: float | None,
    callback: Callback,
    **given: Any,
) -> list[str]:
    """Run a policy from fixed starts; write its flows to a file and stream them to a URL.

    ``given`` are arguments of ``prepare``.

    Returns:
        How each episode ended that was not cut.
    """
    shown, endings = view.choose_flows(episodes, default=episodes), list[str]()
    given["flows"] = replace(given["flows"], num_envs=len(shown))
    with ExitStack() as stack:
        env, policy = prepare(**given, callback=callback)
        stack.callback(env.close)
        task, seed = env.base_env.task, given["seed"]
        starts = fixed_starts(task, episodes, seed=seed)
        max_decisions = min(task.time_limit, count_decisions(task, periods))
        scene = make_env_scene(env, view, policy="/".join(Path(given["policy"]).parts[-2:]))
        film, drawing = Recording(scene=replace(scene, zoom=zoom)), None
        if save.suffix not in DRAWN:
            drawing = start_drawing(
                scene,
                flows=name_flows(task, shown, starts),
                save=save,
                url=url,
                field_format=view.field_format,
            )
            stack.callback(drawing.close)

        def draw(start: int, frame: Frame) -> None:
            if frame.ending is not None:
                remedy = f" (seed={seed + 1}: from another start)"
                words = f"{frame.ending.words}{'' if frame.ending.is_success else remedy}"
                endings.append(f"flow {shown[start]}, after {frame.time:.1f} T: {words}")
            if drawing is None:
                film.frames.append(frame)
            else:
                drawing.draw(shown[start], frame)

        callback.on_phase("recording", total=max_decisions)
        record_episodes(
            env,
            policy,
            starts[shown],
            scene=scene,
            give=draw,
            frames_per_T=max(view.frames_per_T, round(_FRAMES_PER_S * (seconds_per_T or 0))),
            max_decisions=max_decisions,
            on_step=lambda running, step: callback.on_progress(1),
        )
    if save.suffix in FILMS:
        write_film(film, save, seconds_per_T=seconds_per_T)
    elif drawing is None:
        write_flow(film, save)
    return endings


@contextmanager
def keep_after_errors() -> Iterator[Path]:
    """Yield a temporary recording, which stays, named by the error, if one comes after it."""
    path = Path(mkdtemp(prefix="fishrl-")) / "view.rrd"
    with ExitStack() as stack:
        stack.callback(rmtree, path.parent)
        try:
            yield path
        except Exception as error:
            if path.is_file():
                error.add_note(f"the recording is kept: {path}")
                stack.pop_all()
            raise


def wait_for_interrupt() -> None:
    """Return on Ctrl-C."""
    print("the episodes are over; the live view stays until you press Ctrl-C")
    with suppress(KeyboardInterrupt):
        while True:
            clock.sleep(1.0)


@program(evaluate, ViewerSettings, **POLICY | {"stored": read_typical}, positional="recording")
def main(
    *,
    recording: str | None = None,
    policy: str | None = None,
    episodes: PositiveInt = 1,
    periods: PositiveFloat | None = 20.0,
    save: Annotated[str, ending_in(".rrd", *DRAWN)] | None = None,
    zoom: Annotated[float, Field(ge=1)] = 1.0,
    seconds_per_T: PositiveFloat | None = None,
    screenshot: Annotated[str, ending_in(".png")] | None = None,
    time: NonNegativeFloat | None = None,
    preset: str | None = None,
    **given: Any,
) -> None:
    """Open, record, stream or take a screenshot, as the settings say.

    Args:
        recording: a ``.rrd`` file, or a run folder with one, to open as it is.
        policy: see ``evaluate``; not needed for a recording.
        episodes: fixed starts, one flow each, of which ``shown_flows`` are shown; by default one
            with a fate typical of a learned policy, else the first.
        periods: T after which an episode is cut; ``null`` runs it to its end.
        save: file to write: a recording ``.rrd``, by default a temporary one, which stays only
            if the viewer fails, or of one flow a film, ``.mp4`` or ``.gif``, or a picture of the
            last moment, ``.png``.
        zoom: magnification of a film or picture; above 1 it follows the fish.
        seconds_per_T: duration of a period T in a film, 2 for slow motion; by default a film takes
            some ten seconds.
        screenshot: PNG to write instead of opening a window.
        time: time of the picture, in T; by default the middle of the recording.
        preset: name of a preset; only its task is used.
        **given: arguments of ``evaluate`` and ``ViewerSettings``.
    """
    if (recording is None) == (policy is None):
        raise ValueError("give either the path of a .rrd file or policy=<run folder or name>")
    given |= {"policy": policy, "episodes": episodes, "periods": periods}
    given |= {"zoom": zoom, "seconds_per_T": seconds_per_T}
    if recording is not None:
        plain, chosen = main.list_defaults(), given | {"save": save}
        if names := [name for name in chosen if chosen[name] != plain[name]]:
            raise ValueError(
                f"{', '.join(names)}: a recording is only opened; give policy=<run folder>"
            )
    if time is not None and screenshot is None:
        raise ValueError(
            f"time = {time:g}: of screenshot=<file.png>; save=<file.png> shows the last moment, "
            f"periods={time:g}"
        )
    view = take(ViewerSettings, given)
    opens = not (view.live or save or screenshot)
    num_shown = len(view.choose_flows(episodes, default=episodes))
    if save is not None and save.endswith(DRAWN):
        if num_shown > 1 or screenshot or view.live:
            raise ValueError(
                f"save = {save}: a film is of one flow, without screenshot and live: give "
                "episodes=1, or the flow to be filmed, shown_flows=[0]"
            )
    elif zoom > 1.0 or seconds_per_T is not None:
        raise ValueError("zoom, seconds_per_T: of a film or picture, save=<file.mp4 or file.png>")
    with ExitStack() as stack:
        given_path = recording or save
        path = Path(given_path or stack.enter_context(keep_after_errors())).expanduser()
        if recording is not None:
            find_recording(path)
        for file in {save, screenshot}:
            stack.enter_context(claim_file(file))
        if opens and not has_screen():
            raise ValueError(
                "no screen to open a window on: give save=<file.rrd>, screenshot=<file.png>, or "
                "live=true for a browser"
            )
        if policy is not None:
            url = None
            if view.live:
                url = stack.enter_context(closing(Server(port=view.port))).url
            with Progress() as progress:
                endings = record(path, view=view, url=url, callback=progress, **given)
            for ending in endings:
                print(ending)
            if result := read_result(policy):
                num = result["episodes"]
                share = find_share(round(result["success_rate"] * num), num).show(".0%")
                word = result.get("success") or "succeeded"
                print(f"{word} in {share} of {num} episodes, its final evaluation")
            if save is not None:
                print(f"written: {path}, {path.stat().st_size / 1e6:.2f} MB")
            if view.live:
                wait_for_interrupt()
        if screenshot is not None:
            write_screenshot(path, screenshot, time_T=time)
            print(f"written: {screenshot}")
        elif opens:
            open_recording(path)
