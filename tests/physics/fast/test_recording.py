"""Recorded steps do what launched ones do, and every part that people run can be recorded."""

from collections.abc import Iterable, Sequence

import pytest
import torch
from torch import Tensor

from fishrl.physics import InPlaceSolver
from fishrl.physics.fast.part import Part, Repeater
from fishrl.physics.fast.recording import record
from fishrl.presets import GROUPS, list_names
from fishrl.programs.evaluate import main as evaluate
from tests.physics.fast.test_solver import CHANGES, make_solver
from tests.physics.flows import make_tank


def list_unrecorded(parts: Iterable[tuple[Part, Sequence[Tensor]]]) -> list[str]:
    """Return the parts whose recording is the part itself."""
    return [part.name for part, own in parts if part.record(own)[0].func == part.run]


@pytest.mark.compile
@pytest.mark.parametrize(
    ("name", "unrecorded"),
    [
        ("sharp skin", []),
        # its Cholesky factorisation allocates the result, so that the part runs as a whole
        pytest.param("direct solve", ["coupling"], marks=pytest.mark.slow),
    ],
)
def test_recorded_steps_equal_launched_ones_bit_for_bit(
    name: str, unrecorded: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    recorded, launched = (make_solver(make_tank(**CHANGES[name]), compile=True) for _ in range(2))
    recorded.advance_(20)
    launched.compile()
    (grid,) = launched._batch.grids
    for number in range(len(grid.arguments)):
        Repeater(grid.list_located(number)).launch(1)
        Repeater([*grid.list_step(number, 0), *grid.list_step(number, 1)]).launch(10)
    after = launched.state_dict()
    for key, value in recorded.state_dict().items():
        assert torch.equal(value, after[key]), key
    (grid,) = recorded._batch.grids
    assert list_unrecorded(grid.list_step(0, 0)) == unrecorded
    for part in grid.arguments[0]:
        monkeypatch.setattr(part, "run", None)
    recorded.advance_(20)  # calls none of them


@pytest.mark.slow
@pytest.mark.compile
def test_every_part_of_every_preset_and_task_is_recorded() -> None:
    words = [f"{group}={name}" for group in GROUPS for name in list_names(group)]
    configs = {evaluate.read(["policy=random", word]).task.flow_config(): word for word in words}
    known: set[str | None] = set()  # the number of markers does not change what code calls
    for config, word in configs.items():
        solver = InPlaceSolver(config=config, num_envs=1, num_workers=0)
        every = solver._batch._list_all(with_check=True)  # of all levels, also what moves patches
        new = [(part, own) for part, own in every if part.key not in known]
        known |= {part.key for part, _ in new}
        for part, own in new:
            part.compile(own)
        # these two are not compiled
        assert set(list_unrecorded(new)) <= {"crossing", "moving"}, word


def test_a_function_that_is_not_compiled_is_its_own_recording() -> None:
    def double(x: Tensor) -> None:
        x.mul_(2.0)

    x = torch.ones(3)
    (call,) = record(double, (x,), [])
    call()
    assert x.tolist() == [4.0, 4.0, 4.0]
