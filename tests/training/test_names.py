"""Names of runs and of baselines."""

import pytest

from fishrl.envs import Predation
from fishrl.settings import FieldErrors
from fishrl.training import RunSettings, baseline


@pytest.mark.parametrize("name", ["", ".", "..", "../other", "/other", "a/b", "a\\b"])
def test_name_of_a_run_stays_in_its_folder(name: str) -> None:
    with pytest.raises(FieldErrors, match=r"^name = "):
        RunSettings(name=name)


@pytest.mark.parametrize(("name", "tasks"), [("mine", ()), ("a/b", (Predation,))])
def test_baseline_that_nobody_could_call_is_refused(name: str, tasks: tuple[type, ...]) -> None:
    with pytest.raises(ValueError, match="give a name without a slash"):
        baseline(name, *tasks)
