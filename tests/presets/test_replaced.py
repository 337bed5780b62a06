"""Presets of earlier versions: errors name what replaces each, which can be composed."""

import pytest

from fishrl.envs import make_task
from fishrl.presets import REPLACED, list_names
from fishrl.programs.train_settings import TRAINING


@pytest.mark.parametrize("name", REPLACED)
def test_former_name_is_refused_with_a_command_line_in_its_place(name: str) -> None:
    assert name not in list_names("preset")
    assert TRAINING.read(words := REPLACED[name].split()) != TRAINING.read(words[:-1])
    for read in (lambda: TRAINING.read([f"preset={name}"]), lambda: make_task(name)):
        with pytest.raises(ValueError, match="any more; give ") as error:
            read()
        assert str(error.value).split("; give ")[1].startswith(REPLACED[name])
