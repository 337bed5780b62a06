"""A run goes on on another device."""

from pathlib import Path

import pytest
import torch

from fishrl.envs import Predation
from fishrl.training import LearningSettings, RunSettings, resume, train
from tests.envs.test_real_flow import TINY

pytestmark = [
    pytest.mark.gpu,
    pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no CUDA"),
]


@pytest.mark.parametrize(("first", "second"), [("cuda", "cpu"), ("cpu", "cuda")])
def test_a_run_goes_on_on_another_device(first: str, second: str, tmp_path: Path) -> None:
    summary = train(
        task=Predation(**TINY | {"time_limit": 2}),
        learning=LearningSettings(num_envs=2, warmup_frames=2, batch_size=2, hidden=(8,)),
        run=RunSettings(
            total_frames=4, compile=False, device=first, folder=str(tmp_path), name="run",
            eval_episodes=1, final_episodes=1, baselines=(),
        ),
    )  # fmt: skip
    longer = resume(tmp_path / "run", total_frames=8, device=second)
    assert (summary["frames"], longer["frames"]) == (4, 8)
