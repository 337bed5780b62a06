"""The in-place step itself: half precision, memory, and its compiled code."""

import sys
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from torch._inductor import config as inductor_config
from torch._inductor.graph import GraphLowering

from fishrl.physics import Fish, FlowConfig, InPlaceSolver, Storage
from fishrl.physics.boundaries import Boundaries, NoSlip
from fishrl.physics.fast.compiled import compile_inplace, is_own
from fishrl.physics.lattice import Q
from tests.physics.fast.test_solver import CHANGES, TANK, make_solver
from tests.physics.flows import make_tank

OUTFLOW = CHANGES["pinned outflow"]


def test_half_precision_stays_near_single_precision_and_is_restored_exactly() -> None:
    """Eleven bits of the deviation: a hundredth of the fastest water is ample."""
    single, half = (
        make_solver(make_tank(**OUTFLOW, storage=each), flows_per_launch=3) for each in Storage
    )
    for solver in (single, half):
        solver.advance_(200)
    assert half.state_dict()["f0"].dtype == torch.float16
    u, exact = half.macroscopic()[1], single.macroscopic()[1]
    assert 0.0 < float((u - exact).abs().max()) < 0.01 * float(exact.abs().max())
    assert float((half.body.position - single.body.position).abs().max()) < 0.01
    other = make_solver(half.config, flows_per_launch=3)
    other.set_populations_(half.populations())
    assert torch.equal(other.populations(), half.populations())
    other.load_state_dict(half.state_dict())
    for each in (half, other):
        each.advance_(2)
    assert torch.equal(other.populations(), half.populations())
    assert torch.equal(other.body.position, half.body.position)


@pytest.mark.compile
@pytest.mark.parametrize("storage", Storage)
def test_the_bulk_pass_is_one_loop_of_nine_loads_and_nine_stores(
    storage: Storage, monkeypatch: pytest.MonkeyPatch
) -> None:
    written: list[str] = []
    monkeypatch.setattr(GraphLowering, "save_output_code", written.append)
    solver = make_solver(make_tank(**OUTFLOW, storage=storage), slice(1))
    with inductor_config.patch(force_disable_caches=True):
        part, (even, _) = solver.list_calls()[0]
        compile_inplace(part.run, even)
    (code,) = written  # one graph
    assert code.count("for(int64_t ") == 1
    assert code.count("::loadu(") == code.count(".store(") == Q
    assert "= empty_strided_cpu(" not in code, "the pass takes memory"


def test_memory_per_node_and_flow_is_within_45_bytes() -> None:
    solver = InPlaceSolver(
        config=FlowConfig(width=1000, height=500, tau=0.6, bodies=(Fish(body_length=100),)),
        num_envs=1,
        compile=False,
    )
    tensors = [t for _, (even, _) in solver.list_calls() for t in even]
    storages = {t.untyped_storage().data_ptr(): t.untyped_storage().nbytes() for t in tensors}
    assert sum(storages.values()) / (1000 * 500) < 45.5


def count_python_calls(function: Callable[..., object], *arguments: object) -> int:
    events: list[str] = []
    sys.setprofile(lambda frame, event, argument: events.append(event))
    function(*arguments)
    sys.setprofile(None)
    return events.count("call")


@pytest.mark.compile
def test_compiled_code_is_cached_for_its_number_of_threads_and_loaded_without_tracing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TORCHINDUCTOR_CACHE_DIR", str(tmp_path))
    traced = []

    def double(x: torch.Tensor) -> None:
        traced.append(x)
        x.mul_(2.0)

    x = torch.ones(8)
    for _ in range(2):
        compiled = compile_inplace(double, (x,), name="double")
        x.fill_(1.0)
        assert count_python_calls(compiled, x) < 6  # about 25 with the layers around the code
        assert x.tolist() == [2.0] * 8
    assert len(traced) == 1
    for kept in tmp_path.glob("fishrl/*.bin"):
        kept.write_bytes(b"damaged")
    compile_inplace(double, (x,), name="double")
    assert len(traced) == 2
    torch.set_num_threads(2)  # one_thread sets it back
    compile_inplace(double, (x,), name="double")
    assert len(traced) == 3 and len(list(tmp_path.glob("fishrl/*.bin"))) == 2


def test_a_class_from_outside_the_package_is_not_cached_by_name() -> None:
    class Magnetic(NoSlip):
        """An edge whose source this package does not hold."""

    assert is_own(TANK.get_structure())
    assert not is_own(make_tank(boundaries=Boundaries(top=Magnetic())).get_structure())
