"""What the benchmark times: flows, parts of a step, environments, training, memory, other codes."""

import sys
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
import torch

from experiments.benchmarks import coupled, profile
from experiments.benchmarks.alone import run_alone
from experiments.benchmarks.entry import FISH, KERNEL, WALLS, Entry
from experiments.benchmarks.environment import NUM_ACTIONS, Stage
from experiments.benchmarks.flows import make_entry, make_kernel_entry, make_solver
from experiments.benchmarks.memory import count_tensor_bytes, measure_bytes
from experiments.benchmarks.parts import get_stepper, record_calls, replace_parts
from experiments.benchmarks.peers import lbmpy_kernels, lettuce_step, numba_kernel, xlb_step
from experiments.benchmarks.probes import make_probes
from experiments.benchmarks.profile import Stopwatch, profile_task
from experiments.benchmarks.shear_wave import ShearWave
from experiments.benchmarks.solver import make_periodic
from experiments.benchmarks.training import Loop
from experiments.config import load_config
from fishrl.envs import Predation
from fishrl.physics import InPlaceSolver
from tests.envs.test_real_flow import TINY
from tests.experiments import toy_teams

WIDTH, HEIGHT = 32, 100


@pytest.fixture(scope="module")
def solver() -> InPlaceSolver:
    """Return two small flows with a fish in each, eager."""
    return make_solver(body_length=16, has_fish=True, num_envs=2, compile=False)


def test_a_step_of_a_batch_updates_all_nodes_of_all_flows(solver: InPlaceSolver) -> None:
    entry = make_entry(solver, label="x", how="one core", note="n")
    assert (entry.scope, entry.num_nodes, entry.facts) == (FISH, 2 * 160 * 80, {"note": "n"})
    assert entry.working_set / entry.num_nodes == pytest.approx(36, rel=0.3)


def test_the_first_flows_of_a_batch_may_advance_alone(solver: InPlaceSolver) -> None:
    entry = make_entry(solver, label="x", how="one core", num_flows=1)
    before = solver.body.age.clone()
    entry.advance(4)
    assert (solver.body.age - before).tolist() == [4.0, 0.0]
    assert entry.num_nodes == 160 * 80


def test_a_flow_without_fish_is_a_flow_with_walls() -> None:
    empty = make_solver(body_length=16, has_fish=False, compile=False)
    assert make_entry(empty, label="x", how="one core").scope == WALLS


def test_the_parts_of_a_step_are_found_by_their_names(solver: InPlaceSolver) -> None:
    seen: list[str] = []

    def wrap(name: str, part: Callable[..., object]) -> Callable[..., object]:
        seen.append(name)
        return part

    names = replace_parts(solver, wrap)
    assert {"collide", "set edges"} <= set(names) == set(seen)


def list_parts(solver: InPlaceSolver) -> list[Callable[..., object]]:
    parts: list[Callable[..., object]] = []

    def note(name: str, part: Callable[..., object]) -> Callable[..., object]:
        parts.append(part)
        return part

    replace_parts(solver, note)
    return parts


def test_recorded_calls_are_those_of_a_real_step_which_stays_as_it_was(
    solver: InPlaceSolver,
) -> None:
    before = list_parts(solver)
    age = solver.body.age[0].clone()
    calls = record_calls(solver, "collide")
    assert solver.body.age[0] == age + 2.0
    assert len(calls) == 4  # two steps of two flows
    assert {function for function, _ in calls} <= set(before)
    assert list_parts(solver) == before


def test_a_part_that_is_not_there_is_named_beside_those_that_are(solver: InPlaceSolver) -> None:
    with pytest.raises(RuntimeError, match=r"no part 'collapse'; its parts are: .*collide"):
        record_calls(solver, "collapse")


def test_what_is_no_solver_has_no_stepper() -> None:
    with pytest.raises(RuntimeError, match=r"keeps no Stepper: bring .*parts\.py to date"):
        get_stepper(Stopwatch())  # type: ignore[arg-type]


def test_the_kernel_alone_collides_and_moves_no_fish() -> None:
    flow = make_solver(body_length=16, has_fish=True, compile=False)
    entry = make_kernel_entry(flow, label="x", how="one core")
    age, before = flow.body.age.clone(), flow.populations()
    entry.advance(2)
    assert entry.scope == KERNEL
    assert torch.equal(flow.body.age, age)
    assert not torch.equal(flow.populations(), before)


def test_probes_leave_finite_numbers_however_long_they_run() -> None:
    for entry in make_probes(num_nodes=100, threads=1):
        assert entry.advance(200) is None
    assert entry.working_set == 3600


def test_less_slip_takes_more_iterations_and_the_direct_solve_has_least() -> None:
    slips = []
    for solve in coupled.SOLVES.values():
        flow = make_solver(
            body_length=16, has_fish=True, width=64, height=40, force_solve=solve, compile=False
        )
        slips.append(coupled.measure_slip(flow, tail_speed=0.07, num_steps=40))
    assert all(more > less > 0.0 for more, less in pairwise(slips))
    assert slips[-1] < 1e-5


def test_this_flow_damps_a_shear_wave_as_it_should() -> None:
    flow = make_periodic(16, HEIGHT, compile=False)  # raises otherwise
    assert float(flow.macroscopic()[1].abs().max()) < 0.02


def test_a_wave_that_decays_otherwise_is_refused() -> None:
    wave = ShearWave(4, HEIGHT)
    u = wave.velocity()
    with pytest.raises(RuntimeError, match=r"as if the viscosity were -100\.0 % off"):
        wave.check(lambda num_steps: None, lambda: u)


@pytest.mark.parametrize("value", [0.0, float("nan")])
def test_a_wave_that_is_gone_is_refused(value: float) -> None:
    wave = ShearWave(4, HEIGHT)
    fields = iter((wave.velocity(), np.full((HEIGHT, 4), value)))
    with pytest.raises(RuntimeError, match="inf % off"):
        wave.check(lambda num_steps: None, lambda: next(fields))


PEERS = [
    ("lbmpy", lbmpy_kernels.make_large, {"threads": 1}, 6),
    ("lbmpy", lbmpy_kernels.make_batch, {"threads": 1, "num_flows": 2}, 1),
    ("numba", numba_kernel.make_entries, {"threads": 1}, 2),
    ("lettuce", lettuce_step.make_entries, {"threads": 1}, 2),
    ("xlb", xlb_step.make_entries, {}, 1),
]


@pytest.mark.slow
@pytest.mark.parametrize(("package", "make", "arguments", "num_entries"), PEERS)
def test_an_installed_peer_damps_a_shear_wave_as_it_should(
    package: str, make: Callable[..., list[Entry]], arguments: dict[str, int], num_entries: int
) -> None:
    pytest.importorskip(package)
    entries = make(width=WIDTH, height=HEIGHT, **arguments)  # checks its own viscosity
    assert len(entries) == num_entries
    for entry in entries:
        entry.advance(2)
        assert abs(entry.facts.get("viscosity_error", 0.0)) < 0.03
        assert entry.working_set > 36 * entry.num_nodes


@pytest.mark.parametrize(("package", "make", "arguments", "num_entries"), PEERS)
def test_an_absent_peer_is_missed_as_a_module(
    package: str,
    make: Callable[..., list[Entry]],
    arguments: dict[str, int],
    num_entries: int,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, package, None)  # as if it were not installed
    with pytest.raises(ModuleNotFoundError, match=r"No module named|halted"):
        make(width=WIDTH, height=HEIGHT, **arguments)


@pytest.fixture(scope="module")
def stage() -> Stage:
    """Return an environment of two tiny eager flows."""
    return Stage(task=Predation(**TINY), num_envs=2, compile=False)


def test_solver_environment_and_policy_advance_the_same_steps(stage: Stage) -> None:
    for run in (stage.run_solver, stage.run_env, stage.run_policy):
        stage.base.reset()
        stage.state = stage.env.reset()
        extras = run(1)
        assert stage.base.solver.body.age.tolist() == [stage.task.n_substeps] * 2
        assert extras is None or 0.0 < extras["share_outside_flow"] < 1.0


def test_flows_begin_anew_before_an_episode_can_end(stage: Stage) -> None:
    stage.prepare()
    stage._num_actions = NUM_ACTIONS
    stage.base.solver.advance_(2)
    stage.prepare()
    assert stage.base.solver.body.age.tolist() == [0.0, 0.0]


def test_a_training_loop_collects_and_learns() -> None:
    overrides = ["num_envs=2", "compile=false", "batch_size=2", "updates_per_frame=2"]
    loop = Loop(config=load_config("train", overrides), task=Predation(**TINY))
    before = [p.clone() for p in loop.learner.actor.parameters()]
    assert 0.0 < loop.run(1)["share_learning"] < 1.0
    assert len(loop.learner.buffer) == 4
    after = list(loop.learner.actor.parameters())
    assert not all(torch.equal(a, b) for a, b in zip(after, before, strict=True))


def test_a_stopwatch_counts_every_second_once(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr(profile.time, "perf_counter", lambda: now[0])
    watch = Stopwatch()

    def inner() -> None:
        now[0] += 2.0

    wrapped = watch.wrap("flow", "inner", inner)

    def outer() -> None:
        now[0] += 1.0
        wrapped()
        wrapped()

    watch.wrap("env", "outer", outer)()
    assert watch.seconds == {("flow", "inner"): 4.0, ("env", "outer"): 1.0}


def test_a_profile_has_the_parts_of_the_flow_and_of_the_environment() -> None:
    found = profile_task(Predation(**TINY), num_envs=1, num_actions=1, compile=False)
    parts = {row["where"]: [] for row in found["rows"]}
    for row in found["rows"]:
        parts[row["where"]].append(row["part"])
        assert row["seconds"] >= 0.0
    assert list(parts) == [profile.FLOW, profile.ENV, profile.BRAIN]
    assert {"collision", "edges", profile.REST} <= set(parts[profile.FLOW])
    assert "sensors and measurement" in parts[profile.ENV]
    assert "policy" in parts[profile.BRAIN]


def test_a_storage_counts_once_however_many_tensors_see_it() -> None:
    before = count_tensor_bytes()
    tensor = torch.zeros(1000)
    views = [tensor[i:] for i in range(10)]
    assert count_tensor_bytes() - before == 4000
    del views


def test_a_flow_in_place_takes_little_more_than_its_populations() -> None:
    found = measure_bytes(body_length=16, has_fish=False, num_flows=2)
    assert 36.0 < found["state_bytes_per_node"] <= found["bytes_per_node"] < 45.0


def test_what_is_run_alone_returns_its_result_and_raises_its_error() -> None:
    assert run_alone(toy_teams.halve, number=6) == 3
    with pytest.raises(ValueError, match="5 is odd"):
        run_alone(toy_teams.halve, number=5)
