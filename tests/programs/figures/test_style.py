"""What all figures share."""

from pathlib import Path

import pytest

from fishrl.programs.figures.style import panels


@pytest.mark.parametrize("scale", ["log", "symlog", "linear"])
def test_ticks_carry_no_markup(tmp_path: Path, scale: str) -> None:
    """Labels are words, not parsed: the markup of 10^-7 would be shown as it is."""
    with panels(tmp_path / "figure.png", size=(4, 3)) as [[axes]]:
        axes.plot([1e-7, 3.0], [-0.02, 40.0])
        axes.set(xscale="log", yscale=scale)
    labels = [*axes.get_xticklabels(which="both"), *axes.get_yticklabels(which="both")]
    texts = [label.get_text() for label in labels]
    assert any(texts)
    assert not [text for text in texts if "$" in text]
