"""Benchmarks of presets' steps: the parts, and ratios to an earlier commit."""

from experiments.benchmarks.flows import make_solver
from experiments.benchmarks.report import COLUMNS
from experiments.benchmarks.step_clock import time_parts
from tests.experiments.benchmarks.test_report import Results, make_case

PARTS = {"collision": 2e-5, "exchange": 1e-5, "skin": 5e-6, "uncovering": 5e-6, "edges": 5e-6}


def test_clock_tells_all_parts_of_a_step() -> None:
    parts, whole = time_parts(make_solver(16, has_fish=True, compile=False), num_steps=20)
    assert parts.keys() == PARTS.keys()
    assert whole.keys() == {"seconds"}


def test_least_times_of_a_preset_are_related_to_those_before() -> None:
    measured = {name: [value, 2.0 * value] for name, value in PARTS.items()}
    cases = [
        make_case(f"small/{when}", [], group="steps", facts={"period": 100}, measured=each)
        for when, each in (
            ("before", {name: [4.0 * v for v in values] for name, values in measured.items()}),
            ("now", measured),
        )
    ]
    for case, seconds in zip(cases, (2e-4, 5e-5), strict=True):
        case.measured["seconds"] = [seconds, 3.0 * seconds]
    results = Results(machine={}, settings={}, cases=cases)
    expected = {
        "step / before": "0.25",
        "bodies / before": "0.25",
        "step / collision": "2.50",
        "step, µs": "50",
        "s / T": "0.005",
    }
    assert {name: COLUMNS[name](cases[1], results) for name in expected} == expected
