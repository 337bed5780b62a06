"""Tasks by name: what changes, what is refused, and that names are unique."""

import pytest

from fishrl.envs import Flows, Predation, make_env, make_task
from fishrl.envs.control import Bend
from fishrl.presets import GROUPS, list_names, list_tasks, merge
from tests.envs.conftest import SMALL


def test_no_name_is_in_both_groups() -> None:
    assert len(set(list_tasks())) == sum(len(list_names(group)) for group in GROUPS)


def test_changes_are_objects_or_plain_data() -> None:
    base = make_task("gait_bend")
    made = make_task("gait_bend", stream={"speeds_bl": [0.45]}, control=Bend(bend_bl=0.1))
    assert made.stream.speeds_bl == (0.45,) and made.stream.face_bl == base.stream.face_bl
    whole = {"_target_": "fishrl.envs.control.Bend", "bend_bl": 0.1}
    assert made.control == make_task("gait_bend", control=whole).control == Bend(bend_bl=0.1)
    changed = make_task("gait_bend", control={"bend_bl": 0.1}).control
    assert changed.beat == base.control.beat != made.control.beat


def test_what_is_read_may_be_changed() -> None:
    merge(node := {"a": {"b": 1}}, {"a": {"c": 2}})
    assert node == {"a": {"b": 1, "c": 2}}
    make_task("gait_bend", stream={"face_bl": 1.6})
    assert make_task("gait_bend").stream.face_bl == 1.5


@pytest.mark.parametrize(
    ("name", "changes", "error"),
    [
        ("gait_ben", {}, "there is no 'gait_ben'; did you mean 'gait_bend'"),
        ("zz", {}, "There is: follower"),
        ("gait_bend", {"body_lenght": 48}, "there is no 'body_lenght'; did you mean 'body_length'"),
        ("gait_bend", {"stream": {"sped_bl": [1.0]}}, "did you mean 'stream.speeds_bl'"),
        ("gait_bend", {"body_length": 3}, "body_length = 3: must be greater than"),
    ],
)
def test_mistakes_are_named(name: str, changes: dict[str, object], error: str) -> None:
    with pytest.raises(ValueError, match=error):
        make_task(name, **changes)


@pytest.mark.usefixtures("kinematic")
def test_environment_takes_name() -> None:
    env = make_env(task="predation", flows=Flows(num_envs=1, compile=False))
    assert env.base_env.task == Predation() != make_task("predation", **SMALL)
    env.close()
