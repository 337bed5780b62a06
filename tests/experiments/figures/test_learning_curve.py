"""The learning curve: which cells of metrics.csv are drawn, and what is refused."""

from pathlib import Path

import pytest

from experiments.figures import read_metrics, write_learning_curve

METRICS = """frames,train/return,eval/mean_return,train/success_rate,train/loss_qvalue,note
64,-5.0,,0.0,2.0,warm-up
128,-3.0,-4.0,0.1,nan,
192,2.0,,0.5,1.0,
"""


def test_blank_cells_words_and_nan_are_left_out(tmp_path: Path) -> None:
    (tmp_path / "metrics.csv").write_text(METRICS)
    series = read_metrics(tmp_path / "metrics.csv")
    assert series["eval/mean_return"][0].tolist() == [128.0]
    assert series["train/loss_qvalue"][1].tolist() == [2.0, 1.0]
    assert "note" not in series


@pytest.mark.parametrize("text", ["", "a,b\n1,2\n", "frames,b\n1,2\n"])
def test_metrics_without_a_known_column_are_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "metrics.csv").write_text(text)
    with pytest.raises(ValueError, match="needs"):
        write_learning_curve(tmp_path / "metrics.csv", tmp_path / "x.png")
