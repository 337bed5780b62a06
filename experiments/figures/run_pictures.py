"""Every picture of a run."""

from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path

from experiments.figures.learning_curve import write_learning_curve
from experiments.figures.trajectories import write_trajectories
from experiments.figures.vorticity import write_animation, write_flow, write_snapshots
from experiments.recording import Recording


def write_run_pictures(
    run_dir: str | PathLike[str],
    recordings: Sequence[Recording],
    *,
    baselines: Mapping[str, float] | None = None,
) -> list[Path]:
    """Write every picture of a run.

    Args:
        run_dir: run folder; ``metrics.csv`` in it becomes the learning curve, if it is there.
        recordings: episodes; all go into ``trajectories.png``, and the first one that ended with a
            capture (else the first one) into the flow pictures and the animation.
        baselines: rates of success of swimmers that do not learn, by name, drawn as lines.

    Returns:
        The files, in the order written.
    """
    if not recordings:
        raise ValueError("recordings is empty: record at least one episode")
    folder = Path(run_dir)
    if not folder.is_dir():
        raise FileNotFoundError(f"no run folder {folder}: give one that exists")
    shown = next((r for r in recordings if r.captured), recordings[0])
    written = []
    if (folder / "metrics.csv").is_file():
        written.append(folder / "learning_curve.png")
        write_learning_curve(folder / "metrics.csv", written[-1], baselines=baselines)
    written.append(folder / "trajectories.png")
    write_trajectories(recordings, written[-1])
    written.append(folder / "vorticity_sequence.png")
    write_snapshots(shown, written[-1])
    written.append(folder / "vorticity_last.png")
    write_flow(shown, written[-1])
    written.append(folder / "capture.gif")
    write_animation(shown, written[-1])
    return written
