"""Programs: their help, their errors, and the commands that they advise."""

import os
import signal
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from textwrap import dedent

import pytest
import yaml

from fishrl.programs import evaluate, summarize, train
from fishrl.programs.program import Program, plain_errors, show_command

ROOT = Path(__file__).parents[2]


def test_help_explains_choices_and_settings(capsys: pytest.CaptureFixture[str]) -> None:
    train.main(["--help", "preset=gait_small"])
    said = capsys.readouterr().out
    assert "preset: one of gait_bend, gait_small, paper, quick, quick_bend" in said
    assert "  flows.num_envs=16  flows that advance together." in said
    assert "  flows.compile=true  " in said
    assert "  recognition=null  " in said
    assert "  hidden=[256,256]  " in said
    assert "  task.body_length=32  " in said
    assert "  task.wall_margin_bl=0.25  " in said  # a default of the task, which no YAML names
    assert "  task.stream.has_disc=true  " in said
    summarize.main(["-h"])
    assert "  folder=???  folder of a sweep" in capsys.readouterr().out


def test_cfg_prints_settings(capsys: pytest.CaptureFixture[str]) -> None:
    train.main(["--cfg", "job", "seed=3"])
    assert yaml.safe_load(capsys.readouterr().out)["seed"] == 3
    with pytest.raises(SystemExit, match="error: unrecognized arguments: --info"):
        train.main(["--info"])
    with pytest.raises(SystemExit, match=r"only fishrl train runs sweeps"):
        evaluate.main(["--multirun", "seed=0,1"])


def test_traceback_is_shown_on_request(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FISHRL_DEBUG", "1")
    with pytest.raises(ValueError, match="there is no 'totl_frames'"):
        train.main(["totl_frames=3"])


@pytest.mark.usefixtures("heeds_ctrl_c")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signal_ends_program_as_interrupt(number: signal.Signals) -> None:
    before = signal.getsignal(number)
    with pytest.raises(SystemExit) as ended:
        Program(lambda _: signal.raise_signal(number), summarize.main.command_line)(["folder=x"])
    assert ended.value.code == 128 + number
    assert signal.getsignal(number) is before


@pytest.mark.usefixtures("heeds_ctrl_c")
def test_ctrl_c_during_import_leaves_no_traceback(tmp_path: Path) -> None:
    (tmp_path / "torch.py").write_text("import signal\nsignal.raise_signal(signal.SIGINT)")
    done = subprocess.run(
        [sys.executable, "-m", "fishrl", "train"],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
        check=False,
        capture_output=True,
    )
    assert (done.returncode, done.stderr) == (-signal.SIGINT, b"")


def test_error_in_user_file_names_its_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    code = """
    from pathlib import Path
    from fishrl.envs import Predation
    def observe():
        one, two = 3 * [0.0]
    def read():
        return Path("x.json").read_text()
    def make():
        return Predation(body_length=3)
    """
    (tmp_path / "buggy.py").write_text(dedent(code))
    monkeypatch.syspath_prepend(str(tmp_path))
    buggy = import_module("buggy")
    place = f"({tmp_path / 'buggy.py'}"
    for function, end in ((buggy.observe, ":5, in observe)"), (buggy.read, ":7, in read)")):
        with pytest.raises(SystemExit) as stop, plain_errors():
            function()
        assert str(stop.value).startswith("error: ")
        assert str(stop.value).endswith(place + end)
    with pytest.raises(SystemExit) as stop, plain_errors():
        buggy.make()  # our own message needs no place
    assert place not in str(stop.value)


@pytest.mark.parametrize("num_lines", [1, 100_000])
def test_program_whose_output_nobody_reads_any_more_ends_quietly(num_lines: int) -> None:
    script = (
        "from fishrl.programs.program import plain_errors\n"
        "with plain_errors():\n"
        f"    for line in range({num_lines}): print(line)\n"
    )
    command = [sys.executable, "-c", script]
    done = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert done.stdout is not None and done.stderr is not None
    done.stdout.close()
    assert done.stderr.read() == b""
    assert done.wait() == 141  # as of a program that SIGPIPE ends


def test_advised_commands_run_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    place = tmp_path / "my clone" / ".venv" / "bin"
    place.mkdir(parents=True)
    for name in ("python", "python3"):
        (place / name).symlink_to(sys.executable)
    monkeypatch.setattr(sys, "executable", str(place / "python3"))
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.chdir(tmp_path / "my clone")
    assert show_command("view", "a b") == (".venv/bin/fishrl view 'a b'")
    monkeypatch.setenv("PATH", f"{place}:{tmp_path}")
    assert show_command("experiments.validate") == "python -m experiments.validate"


@pytest.mark.parametrize(
    ("policy", "said"),
    [("gait_bend", r"did you mean zoo/gait_bend\?"), ("pursiut", "did you mean 'pursuit'")],
)
def test_unknown_baseline_suggests_policy(policy: str, said: str) -> None:
    with pytest.raises(SystemExit, match=f"{policy}.* {said}"):
        evaluate.main([f"policy={policy}"])
