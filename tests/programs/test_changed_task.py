"""A trained policy in a changed task: settings of the task override those of its own run."""

import json
from pathlib import Path

import pytest
import torch

from fishrl.programs import evaluate, view
from fishrl.programs.train_settings import TRAINING
from fishrl.settings import describe
from fishrl.training import Classifier
from fishrl.training.checkpoint import save_checkpoint
from fishrl.training.policy_spec import PolicySpec
from fishrl.training.run_folder import write_yaml
from tests.experiments.test_gait import SETTINGS

pytestmark = pytest.mark.usefixtures("kinematic")

OWN = [*SETTINGS, "task.stream.speeds_bl=[1.0,1.2,1.4]", "task.observes=[place,flow_label]"]


def store(folder: Path, *left_out: str) -> str:
    """Write the checkpoint of an untrained policy of the gait, but some settings of its task."""
    plan = TRAINING.read(OWN)
    config = plan.to_config()
    for name in left_out:
        del config["task"][name]
    write_yaml(folder / "config.yaml", config)
    save_checkpoint(
        folder / "checkpoints" / "last",
        {"net": torch.nn.Linear(1, 1)},
        spec=PolicySpec.for_task(plan.task),
        frames=0,
        config=config,
    )
    return f"policy={folder}"


CHANGES = [
    "task.stream.has_disc=false",
    "task.safe_area.far_bl=3.75",
    "task.safe_area={near_bl:0.1}",
    "task.control.rows=[[0.1,2.1],[0.1,2.1],[0.1,2.1]]",
    "task.start_flows=[2]",
    "task.time_limit=7",
]


def test_task_settings_not_given_are_those_of_the_run(tmp_path: Path) -> None:
    checkpoint = store(tmp_path)
    own = describe(evaluate.main.read([checkpoint]).task)
    assert own["stream"]["speeds_bl"] == [1.0, 1.2, 1.4]
    changed = evaluate.main.read([checkpoint, *CHANGES]).task
    assert view.main.read([checkpoint, *CHANGES]).task == changed
    for program in (evaluate, view):
        assert isinstance(program.main.read(["policy=zoo/gait_sharp"]).recognition, Classifier)
    chosen = evaluate.main.read([checkpoint, "preset=gait_small"]).task
    assert chosen.body_length == 32  # another task replaces that of the run
    own["stream"]["has_disc"] = False
    own["safe_area"] |= {"far_bl": 3.75, "near_bl": 0.1}
    own["control"]["rows"] = [[0.1, 2.1]] * 3
    own["start_flows"], own["time_limit"] = [2], 7
    assert describe(changed) == own


@pytest.mark.parametrize(
    ("argument", "said"),
    [
        ("task=predation task.stream.has_disc=false", "there is no 'task.stream'"),
        ("task.num_stacked=3", "num_inputs = 8, the current one is 6"),
        ("task._target_=fishrl.envs.Predation", "the current one is 'Predation'"),
        (
            "task.control={_target_:fishrl.envs.control.DirectFrequencies,"
            "frequencies:[1,1.5,2,2.5]}",
            "num_actions",
        ),
    ],
)
def test_task_that_policy_does_not_fit_is_refused(tmp_path: Path, argument: str, said: str) -> None:
    with pytest.raises(SystemExit) as error:
        evaluate.main(["flows.compile=false", store(tmp_path), *argument.split()])
    assert said in str(error.value)


def test_policy_swims_in_changed_task(tmp_path: Path) -> None:
    saved = tmp_path / "result.json"
    arguments = ["policy=zoo/gait_bend", "episodes=2", "flows.compile=false"]
    arguments += ["task.stream.has_disc=false", "task.time_limit=1", f"save={saved}"]
    evaluate.main(arguments)
    result = json.loads(saved.read_text())
    interval = evaluate.main.read(arguments).task.interval_T
    assert result["mean_length_T"] == pytest.approx(interval)
    swum = result["settings"]["task"]
    assert (swum["stream"]["has_disc"], swum["time_limit"], swum["body_length"]) == (False, 1, 32)
