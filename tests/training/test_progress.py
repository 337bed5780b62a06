"""The progress of a run, on a terminal and in a log."""

import io

from fishrl.training.progress import Progress


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def run(progress: Progress) -> None:
    """Go through the phases of a training with one evaluation."""
    with progress:
        progress.on_phase("compilation")
        progress.on_phase("training", total=200)
        for _ in range(100):
            progress.on_progress(1, {"speed": 3.0})
        progress.on_phase("evaluation")
        progress.on_phase("training")
        for _ in range(100):
            progress.on_progress(1, {"speed": 4.0})


def test_log_gets_one_line_per_phase_and_no_bar() -> None:
    log = io.StringIO()
    run(Progress(stream=log))
    lines = log.getvalue().splitlines()
    assert [line.split()[:2] for line in lines] == [
        ["training", "50%"],
        ["evaluation", "50%"],
        ["training", "100%"],
    ]
    assert "speed 3" in lines[0] and "speed 4" in lines[2] and "\r" not in log.getvalue()


def test_terminal_shows_bar_with_phase_and_numbers() -> None:
    terminal = Terminal()
    run(Progress(stream=terminal))
    assert terminal.getvalue().count("\r") >= 5 and terminal.getvalue().count("\n") == 1
    with Progress(stream=(terminal := Terminal())) as progress:
        assert "set-up" in terminal.getvalue()  # at once
        progress.on_phase("training", total=100, done=40)
        progress.on_progress(60, {"frames per s": 12.5, "captured": 0.75})
    for shown in ("training", "100/100", "frames per s 12.5", "captured 0.75"):
        assert shown in terminal.getvalue()


def test_run_that_ends_some_frames_later_shows_their_number() -> None:
    with Progress(stream=(log := io.StringIO())) as progress:
        progress.on_phase("warm-up", total=200)
        progress.on_progress(192)
        progress.on_progress(16)
    assert log.getvalue().splitlines()[-1].startswith("warm-up      100% 208/208")
