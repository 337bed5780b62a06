"""Every program twice, with settings that its results tell, and what reads these."""

import csv
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import yaml
from PIL import Image

from fishrl.training.checkpoint import SUMS, Checkpoint
from fishrl.training.logger import read_rows
from tests.smoke.test_programs import EAGER, FEW, KINEMATIC, REAL, set_task
from tests.viewer.test_files import run_rerun

POLICY = ["policy=random", *EAGER, "flows.num_envs=1"]
REAL_TASK, GLIDING = set_task(REAL["predation"]), set_task(KINEMATIC)
TRAINING = ["folder={}", *FEW, *GLIDING, "picture_episodes=0", "baselines=[]"]
LINE = ["num_samples=96", "max_decisions=2", "flows.num_envs=6", "num_epochs=2", "hidden=[8]"]


def read_trainings(folder: Path) -> list[str]:
    """Return the seeds of the whole runs."""
    found = []
    for config in sorted(folder.glob("*/config.yaml")):
        seed = yaml.safe_load(config.read_text(encoding="utf-8"))["seed"]
        summary = json.loads((config.parent / "summary.json").read_text(encoding="utf-8"))
        rows = read_rows(config.parent / "metrics.csv")
        saved = Checkpoint.read(config.parent / "checkpoints/last")
        assert summary["seed"] == saved.config["seed"] == seed and saved.files
        assert [row["frames"] for row in rows] == ["2", "4"]
        found.append(f"seed={seed}")
    return found


def read_classifiers(folder: Path) -> list[str]:
    configs = sorted(folder.glob("*/config.yaml"))
    assert all((config.parent / "confusion.png").is_file() for config in configs)
    found = [yaml.safe_load(config.read_text(encoding="utf-8"))["seed"] for config in configs]
    return [f"seed={seed}" for seed in found]


def read_json(show: Callable[[Any], str], name: str = "*.json") -> Callable[[Path], list[str]]:
    """Return what reads all results of a name and shows each."""
    return lambda folder: [
        show(json.loads(path.read_text(encoding="utf-8"))) for path in folder.glob(name)
    ]


def read_fields(folder: Path) -> list[str]:
    """Return the seed of a data set, all of whose values are there."""
    import xarray as xr

    found = []
    for path in folder.glob("flow.*"):
        engine = "zarr" if path.suffix == ".zarr" else "h5netcdf"
        with xr.open_dataset(path, engine=engine) as flow:
            flow.load()
            assert not flow["outline_0"].isnull().any()
            found.append(f"seed={flow.attrs['seed']}")
    return found


def read_vtk(folder: Path) -> list[str]:
    """Return the duration of a series, whose files are there."""
    import pyvista as pv

    found = []
    for path in folder.glob("*.pvd"):
        series = pv.get_reader(str(path))
        for moment in series.time_values:
            series.set_active_time_value(moment)
            assert all(block.n_points for block in series.read())
        found.append(f"periods={series.time_values[-1]:g}")
    return found


def read_table(folder: Path) -> list[str]:
    found = []
    for path in folder.glob("*.csv"):
        with path.open(newline="", encoding="utf-8") as file:
            head, *rows = csv.reader(file)
        assert all(len(row) == len(head) for row in rows)
        found.append(f"periods={float(rows[-1][0]):g}")
    return found


def read_recording(folder: Path) -> list[str]:
    found = []
    for path in folder.glob("*.rrd"):
        run_rerun("rrd", "verify", str(path))
        shown = run_rerun("rrd", "print", "-vvv", str(path))
        found.append(f"episodes={2 if '/flow_1/' in shown else 1}")
    return found


def read_film(folder: Path) -> list[str]:
    """Return nothing to tell two films of one episode apart by."""
    for path in folder.glob("*.gif"):
        with Image.open(path) as film:
            for frame in range(film.n_frames):
                film.seek(frame)
                film.load()
    return []


def read_dataset(folder: Path) -> list[str]:
    import minari

    found = []
    for path in folder.glob("*-v0"):
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("MINARI_DATASETS_PATH", str(folder))
            data = minari.load_dataset(path.name)
            episodes = list(data.iterate_episodes())
        assert len(episodes) == data.total_episodes
        assert sum(len(one.rewards) for one in episodes) == data.total_steps
        found.append(f"episodes={len(episodes)}")
    return found


def read_policy(folder: Path) -> list[str]:
    found = []
    for path in folder.glob("policy"):
        assert Checkpoint.read(path).files
        assert len((path / SUMS).read_text().splitlines()) == 4
        found.append(f"title={(path / 'README.md').read_text().partition('# ')[2].split()[0]}")
    return found


def read_tables(folder: Path) -> list[str]:
    """Return nothing to tell two summaries of the same runs apart by."""
    assert "2 of 2 runs finished" in (folder / "summary.md").read_text(encoding="utf-8")
    with (folder / "runs.csv").open(newline="", encoding="utf-8") as file:
        assert len(list(csv.reader(file))) == 3
    with Image.open(folder / "curves.png") as picture:
        picture.load()
    return []


def read_report(folder: Path) -> list[str]:
    """Return the case of a validation whose page and results agree."""
    page = (folder / "validation.md").read_text(encoding="utf-8")
    names = [path.stem for path in folder.glob("validation/*.json")]
    found = [name for name in names if f"validation/{name}.json" in page]
    assert len(found) == 1
    return [f"cases=[{found[0]}]"]


def read_transfer(folder: Path) -> list[str]:
    results = json.loads((folder / "transfer.json").read_text(encoding="utf-8"))
    (arm,) = results["arms"]
    assert arm in (folder / "transfer.md").read_text(encoding="utf-8")
    return [f"baselines=[{arm}]"]


#: What a refused program advises.
REMEDIES = "wait|(take|choose|give) another|name a new|increase|repeat the|make it first"


@dataclass(frozen=True, kw_only=True)
class Pair:
    """A program twice, with two values of a setting.

    Attributes:
        words: its settings, with ``{}`` for the folder.
        values: the setting in which the two differ, which the results tell.
        read: returns the values of all results in the folder; fails if any is not whole.
        touches: how often it touches a file there, about.
        glides: whether fish move at constant speed.
        can_refuse: whether the second may be refused.
    """

    program: str
    words: list[str]
    values: tuple[str, str] = ("seed=0", "seed=1")
    read: Callable[[Path], list[str]]
    touches: int = 8
    glides: bool = True
    can_refuse: bool = True


def export(ending: str, read: Callable[[Path], list[str]], **given: Any) -> Pair:
    words = [*POLICY, *REAL_TASK, "frames_per_T=4", f"save={{}}/flow.{ending}"]
    words += [] if "values" in given else ["periods=0.5"]
    return Pair(program="export", words=words, read=read, glides=False, **given)


#: Until this touch a program has written nothing; its lock is made and opened.
FIRST = 3
DURATIONS = {"values": ("periods=0.5", "periods=0.75")}
FEW_EPISODES = {"values": ("episodes=1", "episodes=2")}
#: Run by ``make test``, at one phase each.
PAIRS = {
    "training": Pair(
        program="train", words=[*TRAINING, "name=run"], read=read_trainings, touches=180
    ),
    "unnamed trainings": Pair(
        program="train",
        words=TRAINING,
        values=("seed=0", "seed=0"),  # of one name
        read=read_trainings,
        touches=180,
        can_refuse=False,
    ),
    "evaluation": Pair(
        program="evaluate",
        words=[*POLICY, *GLIDING, "task.time_limit=2", "episodes=1", "save={}/row.json"],
        read=read_json(lambda row: f"seed={row['seed']}"),
    ),
    "zarr": export("zarr", read_fields, touches=250),
    "recording": Pair(
        program="view",
        words=[*POLICY, *GLIDING, "periods=0.5", "save={}/flow.rrd"],
        values=FEW_EPISODES["values"],
        read=read_recording,
        touches=4,
    ),
    "dataset": Pair(
        program="export-data",
        words=[*POLICY, *GLIDING, "task.time_limit=2", "name=x-v0", "folder={}"],
        values=FEW_EPISODES["values"],
        read=read_dataset,
        touches=17,
    ),
    "exported policy": Pair(
        program="export-policy",
        words=["run={}/../run", "folder={}/policy"],
        values=("title=a", "title=b"),
        read=read_policy,
        touches=70,
    ),
}
OTHERS = {
    "resumed training": Pair(
        program="train",
        words=[*TRAINING, "name=run", "seed=0"],
        values=("seed=0", "seed=0"),
        read=read_trainings,
        touches=180,
    ),
    "classifier": Pair(
        program="train-lateral-line",
        words=[*LINE, *GLIDING, *EAGER, "folder={}", "name=line", "data_folder={}/../data"],
        read=read_classifiers,
        touches=74,
    ),
    "summary": Pair(
        program="summarize", words=["{}"], values=("", ""), read=read_tables, touches=39
    ),
    "score": Pair(
        program="score",
        words=[
            *("policy=random", "task=predation-quick-v1", "split=validation", *EAGER),
            *("flows.num_envs=32", "save={}/row.json"),
        ],
        values=("trained=1", "trained=2"),
        read=read_json(lambda row: f"trained={row['trained_decisions']}"),
    ),
    "netcdf": export("nc", read_fields),
    "vtk": export("pvd", read_vtk, **DURATIONS),
    "table": export("csv", read_table, **DURATIONS),
    "film": Pair(
        program="view",
        words=[*POLICY, *GLIDING, "periods=3", "save={}/flow.gif"],
        values=("", ""),
        read=read_film,
    ),
    "benchmark": Pair(
        program="benchmark",
        words=["groups=[probe]", "body_length=80", "burst=0.01", "threads=1", "folder={}"],
        values=("rounds=2", "rounds=3"),
        read=read_json(lambda found: f"rounds={found['settings']['rounds']}", "results.json"),
        glides=False,
    ),
    "validation": Pair(
        program="validate",
        words=["quick=true", "folder={}", "jobs=1"],
        values=("cases=[taylor-green]", "cases=[poiseuille]"),
        read=read_report,
        touches=59,
        glides=False,
    ),
    "transfer": Pair(
        program="transfer",
        words=["runs=[]", "episodes=1", "periods=0.2", EAGER[0], *GLIDING, "folder={}"],
        values=("baselines=[pid]", "baselines=[bang_bang]"),
        read=read_transfer,
        touches=39,
    ),
    "endurance": Pair(
        program="endurance",
        words=[*TRAINING, "name=run", "buffer_size=9"],
        read=read_trainings,
        touches=200,
    ),
}
