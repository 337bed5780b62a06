"""Show what fish do, in the rerun viewer: ``python -m experiments.view run=runs/<name>``.

``policy=pid preset=gait_small`` shows a hand-written fish, ``live=true`` streams while it swims,
``save=`` and ``screenshot=`` write files; a path alone opens a recording that is there.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fishrl.training.progress import Progress

if TYPE_CHECKING:
    from collections.abc import Iterator

    from experiments.settings import ViewConfig
    from experiments.watching import Drawn

#: A flow is recorded for so many T, at least, before the size of longer ones is told from it.
_LEAST_T = 10.0


def record(
    config: ViewConfig,
    *,
    save: str | Path | None,
    url: str | None = None,
    make_env: Any = None,
    progress: Progress | None = None,
) -> Drawn:
    """Let fish swim from fixed starts and draw them.

    Args:
        config: the settings.
        save: ``.rrd`` file to write, or None.
        url: of a viewer's server to stream to, or None.
        make_env: makes the env of a task; by default ``fishrl.envs.flow_env.make_env``.
        progress: the bar, if there is one already.

    Returns:
        How much was drawn.

    Raises:
        ValueError: for settings that cannot be, and checkpoints that do not fit.
    """
    from experiments.config import build
    from experiments.live import choose_flows
    from experiments.scenes import TaskView
    from experiments.settings import check_device
    from experiments.watching import draw_episodes
    from fishrl.training.baselines import load_policy, make_policy
    from fishrl.training.evaluation import fixed_starts
    from fishrl.training.loop import make_flow_env
    from fishrl.training.recognition import Recognition
    from fishrl.viewer import start_drawing

    progress = progress or Progress(is_shown=False)
    check_device(config.device)
    recognition = Recognition(build(config.task), config.recognition)
    task, source = recognition.task, config.run or config.checkpoint
    flows = choose_flows(config.flows, config.episodes, default=list(range(config.episodes)))
    if source is not None:
        policy = load_policy(source, task=task, num_told=recognition.num_told, device=config.device)
    else:
        policy = make_policy(str(config.policy), task=task, seed=config.seed)
    view = TaskView(task, is_told=recognition.is_told, vorticity_limit=config.vorticity_limit)
    starts = fixed_starts(task, config.episodes, seed=config.seed)
    max_T = task.time_limit * task.interval_T
    if config.periods is not None:
        max_T = min(max_T, config.periods)
    with ExitStack() as stack:
        drawing = stack.enter_context(
            start_drawing(
                view.scene,
                flows=view.name_flows(starts, flows),
                save=save,
                url=url,
                field_format=config.field_format,
            )
        )
        progress.rename("compilation" if config.compile else "set-up")
        env = recognition.equip(make_env or make_flow_env())(
            task=task,
            num_envs=len(flows),
            seed=config.seed,
            device=config.device,
            compile=config.compile,
            frames_per_action=task.checks_per_action,
        )
        stack.callback(env.close)
        progress.start("recording", total=-int(-max_T // task.interval_T))
        return draw_episodes(
            env,
            policy,
            starts[flows],
            view=view,
            drawing=drawing,
            flows=flows,
            frames_per_T=config.frames_per_T,
            max_T=max_T,
            on_step=lambda step, ended: progress.advance(1),
        )


def describe_size(num_bytes: int, drawn: Drawn, *, field_format: str) -> str:
    """Say in one line how large a recording is, and how large one of 100 T of a flow would be.

    Each holds some tenths of a MB once, most of a short one, which says nothing of a long one.
    """
    size, periods, flows = num_bytes / 1e6, drawn.periods, drawn.flows
    rate = drawn.frames / periods if periods > 0 else 0.0
    words = f"{size:.2f} MB for {flows} flow{'s' * (flows != 1)}, {periods:.1f} T of them together"
    if periods >= _LEAST_T * flows:
        words += f"; about {100.0 * size / periods:.0f} MB per 100 T of a flow"
    return f"{words} ({field_format}, {rate:.1f} frames per T)"


def view(
    config: ViewConfig,
    *,
    make_env: Any = None,
    progress: Progress | None = None,
    wait: Callable[[], None] | None = None,
) -> None:
    """Open, record, stream or photograph, as the settings say.

    Args:
        config: the settings.
        make_env: see ``record``.
        progress: the bar, if there is one already.
        wait: called when a live view is over, and returns when nobody looks any more; by default
            on an interrupt.

    Raises:
        ValueError: for settings that cannot be.
        FileNotFoundError: if there is no such recording, or no folder for a file.
    """
    from experiments.live import announce
    from experiments.settings import ConfigError
    from fishrl.viewer import (
        Server,
        check_folder,
        find_recording,
        has_screen,
        open_recording,
        write_screenshot,
    )

    progress = progress or Progress(is_shown=False)
    opens = not (config.live or config.save or config.screenshot)
    with _target(config) as path:
        if config.recording is not None:
            find_recording(path)
        if config.screenshot:
            check_folder(config.screenshot)
        if opens and not has_screen():
            raise ConfigError(
                "there is no screen here to open a window on: give save=<file.rrd>, "
                "screenshot=<file.png>, or live=true, which a browser may look at"
            )
        if config.recording is None:
            with ExitStack() as stack:
                server = stack.enter_context(Server(port=config.port)) if config.live else None
                if server is not None:
                    announce(server)
                drawn = record(
                    config,
                    save=path,
                    url=None if server is None else server.url,
                    make_env=make_env,
                    progress=progress,
                )
                progress.close()
                said = describe_size(path.stat().st_size, drawn, field_format=config.field_format)
                print(f"{config.save}: {said}" if config.save else said)
                if server is not None:
                    (wait or _wait_for_interrupt)()
        progress.close()
        if config.screenshot:
            write_screenshot(path, config.screenshot, time_T=config.time)
            print(f"written: {config.screenshot}")
        elif opens:
            open_recording(path)


@contextmanager
def _target(config: ViewConfig) -> Iterator[Path]:
    """Give the recording's path: that of a file which is there, will be, or goes afterwards."""
    if config.recording is not None:
        yield Path(config.recording)
    elif config.save is not None:
        yield Path(config.save)
    else:
        with tempfile.TemporaryDirectory(prefix="fishrl-") as folder:
            yield Path(folder) / "view.rrd"


def _wait_for_interrupt() -> None:
    print("the flows are at their end; the live view stays until you press Ctrl-C")
    try:
        while True:
            time.sleep(1.0)
    except KeyboardInterrupt:
        return


def main(arguments: Sequence[str] | None = None) -> None:
    """Read the command line; show the bar before the slow imports."""
    with Progress() as progress:
        from experiments.command_line import (
            plain_errors,
            set_up_logging,
            show_help,
            view_settings,
        )

        set_up_logging()
        with plain_errors():
            given = sys.argv[1:] if arguments is None else arguments
            show_help("view", given)
            try:
                view(view_settings(given), progress=progress)
            except KeyboardInterrupt:
                sys.exit("interrupted")


if __name__ == "__main__":
    main()
