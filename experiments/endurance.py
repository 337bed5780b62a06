"""Watch memory and open files of a long training: ``python -m experiments.endurance``.

Trains with the settings of ``fishrl train``. Every ``eval_frames``, after an evaluation and a
checkpoint, it films an episode and notes memory and open files of the process and its children in
``endurance.json``: what each holds alone (what they share would count several times), once cycles
of unused objects are collected. It fails if they grow.
"""

import gc
from pathlib import Path
from statistics import mean
from typing import Any

import psutil

from fishrl.programs.figures.run_pictures import record_run
from fishrl.programs.program import program
from fishrl.programs.train_settings import TRAINING, TrainConfig
from fishrl.training.callback import Callback
from fishrl.training.evaluation import FINAL_SEED, fixed_starts
from fishrl.training.loop import Training
from fishrl.training.opening import open_run
from fishrl.training.progress import Progress
from fishrl.training.run_folder import write_json

CONF = Path(__file__).parent / "conf"
#: Share by which memory may grow from the first third of the notes, but for the first, to the last.
GROWTH = 0.02


class Watch(Callback):
    """Films an episode and notes memory and open files whenever ``eval_frames`` have passed."""

    def __init__(self) -> None:
        self.notes: list[dict[str, Any]] = []
        self.training: Training | None = None

    def on_progress(self, amount: int, shown: Any = ()) -> None:
        """Film and note if due; ``shown`` is empty in evaluations."""
        if not shown or self.training is None:
            return
        training, every = self.training, self.training.plan.eval_frames
        frames = training.counters.frames
        if frames // every == (frames - amount) // every:
            return
        folder: Path = training.folder.path
        with training.collector.lend_env() as env:
            record_run(
                folder,
                env,
                training.learner.actor,
                fixed_starts(training.task, 1, seed=FINAL_SEED),
                settings=training.plan,  # type: ignore[arg-type]
                baselines={},
                on_episodes=lambda num: None,
            )
        gc.collect()
        own = psutil.Process()
        processes = [own, *own.children(recursive=True)]
        self.notes.append(
            {
                "frames": frames,
                "memory_mb": round(sum(one.memory_full_info().uss for one in processes) / 1e6, 1),
                "processes": len(processes),
                "open_files": sum(one.num_fds() for one in processes),
                "wall_seconds": round(training.counters.wall_seconds),
            }
        )
        write_json(folder / "endurance.json", self.notes)


def find_growth(notes: list[dict[str, Any]]) -> list[str]:
    """Say which numbers have grown; fewer than four notes say nothing."""
    if len(notes) < 4:
        return []
    third = max(1, (len(notes) - 1) // 3)
    first, last = (
        {name: mean(note[name] for note in some) for name in ("memory_mb", "open_files")}
        for some in (notes[1 : 1 + third], notes[-third:])
    )
    limits = {"memory_mb": (1.0 + GROWTH) * first["memory_mb"], "open_files": first["open_files"]}
    return [
        f"{name}: {first[name]:g} became {last[name]:g}"
        for name in limits
        if last[name] > limits[name]
    ]


@program(groups={**TRAINING.groups, "preset": "quick", "experiment": "endurance"}, conf=CONF)
def main(settings: TrainConfig) -> None:
    """Train, print the notes, and fail if memory or open files have grown."""
    watch = Watch()
    with Progress() as progress:
        watch.training = Training(open_run(settings), callbacks=[progress, watch])
        try:
            watch.training.run()
        finally:
            watch.training.close()
    for note in watch.notes:
        print(*(f"{name} {value}" for name, value in note.items()), sep=", ")
    if grown := find_growth(watch.notes):
        raise ValueError("; ".join(grown))


if __name__ == "__main__":
    main()
