"""The program that runs the benchmarks."""

import json
from pathlib import Path

import pytest

from experiments import benchmark
from experiments.benchmark import main
from experiments.benchmarks.machine import read_caches
from experiments.benchmarks.measuring import Benchmark, BenchmarkSettings
from experiments.benchmarks.step_clock import COLUMNS
from fishrl.physics import InPlaceSolver
from tests.physics.fast.test_solver import CHANGES, make_tank

TURNS: list[str] = []


def make_pair(settings: BenchmarkSettings) -> list[Benchmark]:
    def make(name: str) -> Benchmark:
        def advance(num_steps: int) -> dict[str, float]:
            TURNS.append(f"{name}{num_steps}")
            return {"share": 0.25}

        return Benchmark(
            label=f"{name}/walls", name=name, advance=advance, num_steps=3, num_nodes=10
        )

    return [make("a"), make("b")]


def make_number(settings: BenchmarkSettings) -> list[Benchmark]:
    return [Benchmark(label="compile/warm", name="kept", num_steps=0, measured={"seconds": [0.5]})]


def make_nothing(settings: BenchmarkSettings) -> list[Benchmark]:
    return []


@pytest.fixture(autouse=True)
def groups(monkeypatch: pytest.MonkeyPatch) -> None:
    """Replace the groups of benchmarks by toys."""
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    toys = {"solver": make_pair, "gpu": make_nothing, "compile": make_number}
    monkeypatch.setattr(benchmark, "GROUPS", toys)


def test_cases_alternate_and_are_stored(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    TURNS.clear()
    main([f"folder={tmp_path}", "threads=1", "rounds=2"])
    assert TURNS == ["a3", "b3"] * 3  # a warm-up and two rounds
    text = capsys.readouterr().out
    assert "| compile, warm | ≤ 1 s | 0.50 s | met |" in text
    assert "GPU, bulk / copy" not in text  # not measured
    kept = json.loads((tmp_path / "results.json").read_text())
    assert {"cpu", "cores", "torch", "versions", "caches", "load"} <= set(kept["machine"])
    assert [case["label"] for case in kept["cases"]] == ["a/walls", "b/walls", "compile/warm"]
    assert [len(case["measured"]["seconds"]) for case in kept["cases"]] == [2, 2, 1]
    assert kept["cases"][0]["measured"]["share"] == [0.25] * 2


def test_groups_are_selected_by_name() -> None:
    chosen = benchmark.run(main.read(["groups=[compile]", "threads=1"]))
    assert [case.group for case in chosen.cases] == ["compile"]
    with pytest.raises(ValueError, match="did you mean 'compile'"):
        benchmark.run(BenchmarkSettings(groups=("compil",)))


def test_cache_sizes_are_read_from_sysfs(tmp_path: Path) -> None:
    for i, (kind, level, size) in enumerate(
        [("Data", "1", "48K"), ("Instruction", "1", "32K"), ("Unified", "3", "32768K")]
    ):
        folder = tmp_path / f"index{i}"
        folder.mkdir()
        for name, value in (("type", kind), ("level", level), ("size", size)):
            (folder / name).write_text(value + "\n")
    assert read_caches(tmp_path) == {"L1": 48 * 1024, "L3": 32 * 2**20}


@pytest.mark.parametrize("name", ["sharp skin", "direct solve", "skin of one's own"])
def test_each_part_of_a_step_has_a_column(name: str) -> None:
    solver = InPlaceSolver(config=make_tank(**CHANGES[name]), num_envs=1, compile=False)
    assert all(part.name.startswith(tuple(COLUMNS)) for part, _ in solver.list_calls())
