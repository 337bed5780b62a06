"""The in-place step itself: memory, and its compiled code."""

import gzip
import importlib
import logging
import os
import random
import shutil
import subprocess
import sys
import zlib
from collections.abc import Sequence
from dataclasses import fields
from itertools import chain
from pathlib import Path
from typing import Any

import pytest
import torch
from torch._functorch import config as functorch_config
from torch._inductor import config as inductor_config

from fishrl.physics import Fish, FlowConfig, InPlaceSolver
from fishrl.physics.boundaries import Boundaries
from fishrl.physics.cache_key import make_key
from fishrl.physics.collision import Rates
from fishrl.physics.fast import compiled as compiled_module
from fishrl.physics.fast import inductor as inductor_module
from fishrl.physics.fast.compiled import compile_inplace, is_stored
from fishrl.physics.fast.identity import identify
from fishrl.physics.fast.part import Part
from fishrl.physics.lattice import Q
from fishrl.physics.skins import ImmersedBoundary, IterativeForcing
from tests.physics.fast.test_solver import CHANGES, TANK, make_solver
from tests.physics.flows import make_tank


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Let Inductor store its code in a fresh folder with a name of every kind of character."""
    folder = tmp_path / "é#$&;(){}[]*?!~%@=,:|<>^+-"
    monkeypatch.setenv("TORCHINDUCTOR_CACHE_DIR", str(folder))
    return folder


@pytest.mark.compile
def test_bulk_pass_is_one_loop_of_nine_loads_and_stores(monkeypatch: pytest.MonkeyPatch) -> None:
    written: list[str] = []
    lowering = "torch._inductor.graph.GraphLowering"
    monkeypatch.setattr(f"{lowering}.save_output_code", written.append)
    solver = make_solver(make_tank(**CHANGES["pinned outflow"]), slice(1))
    with inductor_config.patch(force_disable_caches=True):
        part, (even, _) = solver.list_calls()[0]
        compile_inplace(part.run, even)
    (code,) = written  # one graph
    assert code.count("for(int64_t ") == 1
    assert code.count("::loadu(") == code.count(".store(") == Q
    assert "= empty_strided_cpu(" not in code, "the pass takes memory"


def test_memory_per_node_and_flow_is_within_45_bytes() -> None:
    config = FlowConfig(width=1000, height=500, tau=0.6, bodies=(Fish(body_length=100),))
    solver = InPlaceSolver(config=config, num_envs=1, compile=False)
    tensors = [t for _, (even, _) in solver.list_calls() for t in even]
    storages = {t.untyped_storage().data_ptr(): t.untyped_storage().nbytes() for t in tensors}
    assert sum(storages.values()) / (1000 * 500) < 45.5


def square(x: torch.Tensor) -> tuple[torch.Tensor]:
    """Return the squares of matrices: for this Inductor writes no C++, so it compiles at once."""
    return (torch.bmm(x, x),)


@pytest.mark.compile
def test_code_is_stored_by_width_and_threads(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    traced, x = list[torch.Tensor](), 2 * torch.eye(3)[None]

    def trace(x: torch.Tensor) -> tuple[torch.Tensor]:
        traced.append(x)
        return square(x)

    for capability, num_threads in (("", 1), ("avx2", 1), ("default", 1), ("", 2)):
        monkeypatch.setenv("ATEN_CPU_CAPABILITY", capability)
        torch.set_num_threads(num_threads)  # one_thread sets it back
        for _ in range(2):
            assert torch.equal(compile_inplace(trace, (x,), name="square")(x)[0], x @ x)
        assert len(traced) == len(list(cache.glob("fishrl/*/*.bin")))
    assert len(traced) > 2  # "" is "avx2" on many machines
    assert os.environ["TORCHINDUCTOR_CACHE_DIR"] == str(cache)


@pytest.mark.compile
def test_inductor_switches_change_no_result(cache: Path, caplog: pytest.LogCaptureFixture) -> None:
    x = 2 * torch.eye(3)[None]
    networks = ("freezing", "max_autotune", "max_autotune_gemm")
    switches = {name: inductor_config.patch({name: True}) for name in networks}
    switches["no cache"] = inductor_config.patch(force_disable_caches=True)
    switches["no graph cache"] = inductor_config.patch(fx_graph_cache=False)
    switches["no autograd cache"] = functorch_config.patch(enable_autograd_cache=False)
    for name, switch in switches.items():
        caplog.clear()
        with switch, caplog.at_level(logging.INFO, "fishrl"):
            compiled = compile_inplace(square, (x,), name=name)
        assert torch.equal(compiled(x)[0], x @ x)
        said = [r.levelname for r in caplog.records if r.name.startswith("fishrl")]
        assert said == ([] if name in networks else ["INFO"])
    assert len(list(cache.glob("fishrl/*/*.bin"))) == len(networks)


def is_padding(damaged: bytes, content: bytes) -> bool:
    """Return whether both hold the same: between its blocks a file has bits that nobody reads."""
    try:
        return gzip.decompress(damaged) == gzip.decompress(content)
    except (OSError, EOFError, zlib.error):
        return False


@pytest.mark.compile
def test_flipped_bit_in_stored_code_is_noticed(cache: Path) -> None:
    example = (torch.eye(3)[None],)
    assert not is_stored(example, name="square")
    compile_inplace(square, example, name="square")
    assert is_stored(example, name="square")
    (stored,) = cache.glob("fishrl/*/*.bin")
    content, generator = stored.read_bytes(), random.Random(0)
    for place in generator.sample(range(80, 8 * len(content)), 50):  # after the header
        damaged = bytearray(content)
        damaged[place // 8] ^= 1 << place % 8
        stored.write_bytes(damaged)
        if not is_padding(bytes(damaged), content):
            assert compiled_module._load(stored) is None, place
    compile_inplace(square, example, name="square")
    assert compiled_module._load(stored) is not None


TWO_STEPS = """
import time, torch
from fishrl.physics.fast.compiled import compile_inplace
torch.set_num_threads(1)
x = torch.ones(3)
def make(factor, waits):
    def trace(x):
        print("traced", flush=True)
        time.sleep(1.0)
        return (factor * x,)
    return compile_inplace(trace, (x,), name=str(factor), waits=waits)
made = {factor: make(factor, False) for factor in (2.0, 3.0)}
left = [factor for factor, function in made.items() if function is None]
made |= {factor: make(factor, True) for factor in left}
print("left", left)
for factor in (2.0, 3.0):
    print(made[factor](x)[0].tolist())
"""


@pytest.mark.compile
def test_processes_share_code_and_remake_what_a_killed_compiler_left(
    cache: Path, capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    """Killed after the linker wrote nothing or the header of it, before all else was stored."""
    results = ["[2.0, 2.0, 2.0]", "[3.0, 3.0, 3.0]"]
    command = [sys.executable, "-c", TWO_STEPS]
    started = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    said = [process.communicate(timeout=300)[0].splitlines() for process in started]
    left = [line for line in chain(*said) if line.startswith("left")]
    assert "left [2.0]" in left  # what the process that came first was at
    assert sorted(chain(*said)) == sorted([*2 * results, "traced", "traced", *left])
    libraries = [*cache.glob("fishrl/*/*/*.so")]
    for library, size in zip(libraries, (0, 100), strict=True):
        library.write_bytes(library.read_bytes()[:size])
    (folder,) = cache.glob("fishrl/*")
    for stored in folder.glob("*.bin"):
        stored.unlink()
    for name in ("fxgraph", "aotautograd"):
        shutil.rmtree(folder / name, ignore_errors=True)
    exec(TWO_STEPS, {})
    said_here = capsys.readouterr().out.splitlines()
    assert said_here == ["traced", "traced", "left []", *results]
    assert caplog.text.count("is damaged") == 2


def test_key_has_instructions_and_compiler(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    gcc, compiler, keys = shutil.which("g++"), tmp_path / "g++", []
    monkeypatch.setenv("CXX", str(compiler))
    for flags in ("", "-march=bonnell", "-D__VERSION__='13'", ""):
        compiler.write_text(f'#!/bin/sh\nexec {gcc} "$@" {flags}\n')
        compiler.chmod(0o755)
        inductor_module.describe_target.cache_clear()
        keys.append(inductor_module.identify_machine(torch.device("cpu")))
    inductor_module.describe_target.cache_clear()
    assert keys[0] == keys[-1] and len(set(keys)) == 3


@pytest.mark.parametrize(("target", "bits"), [("#define __AVX2__ 1", 256), ("", None)])
def test_gathering_parts_have_shorter_vectors_where_there_are_any(
    target: str, bits: int | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(inductor_module, "describe_target", lambda _: target)
    with inductor_module.set_up_inductor(torch.device("cpu"), {**inductor_module.GATHERING}):
        assert inductor_config.cpp.simdlen == bits


def find_problem() -> str | None:
    return inductor_module.find_compiler_problem.__wrapped__("cpu")


def test_compiler_is_named_or_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "clang++").symlink_to(shutil.which("g++") or "")
    monkeypatch.setenv("PATH", str(tmp_path))
    assert find_problem() is None
    for wrong in ("nope", "ccache clang++", "", str(tmp_path)):
        monkeypatch.setenv("CXX", wrong)
        assert str(find_problem()).startswith(f"CXX={wrong!r} is no C++ compiler")


@pytest.mark.parametrize("character", " \t\r\n\"'\\")
def test_unquotable_paths_are_refused(
    character: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = f"{tmp_path}/a{character}b"
    with monkeypatch.context() as patch:
        patch.setenv("TORCHINDUCTOR_CACHE_DIR", path)
        assert f"{path!r} is not supported (set TORCHINDUCTOR_CACHE_DIR)" in str(find_problem())
    monkeypatch.setattr(torch, "__path__", [path])
    assert f"{path!r} is not supported (install torch elsewhere)" in str(find_problem())


def list_parts(config: FlowConfig) -> list[tuple[Part, Sequence[torch.Tensor]]]:
    return make_solver(config, slice(1))._batch.grids[0].list_all(True)


#: Flows of one batch may differ in these.
ALIKE: dict[str, Any] = {"tau": 0.6, "stream_speed": 0.03, "ramp_steps": 50}
ALIKE["bodies"] = (Fish(body_length=26, num_markers=TANK.bodies[0].num_markers),)
#: Of ``CHANGES``: the same code with other numbers, and a class of a test, whose code is not known.
LEFT_OUT = ("commanded", "in a sponge", "skin of one's own")
#: Settings that ``CHANGES`` leaves alone.
OTHERS: list[dict[str, Any]] = [
    {"width": 112},
    {"height": 80},
    *({"rates": Rates(**{name: 1.2})} for name in ("energy", "flux")),
    {"skin": ImmersedBoundary(force_solve=IterativeForcing(relaxation=1.1))},
]


def test_flows_share_compiled_parts_exactly_where_they_are_equal() -> None:
    changes = [*OTHERS, *(CHANGES[n] for n in CHANGES if n not in LEFT_OUT)]
    known = {*ALIKE, *chain(*changes)} | {"levels", "patches"}  # more grids, each as one alone
    assert {each.name for each in fields(FlowConfig)} | {"motion"} == known
    first, *others = (list_parts(make_tank(**change)) for change in ({}, ALIKE, *changes))
    names = []
    for parts in (first, *others):
        keys = [part.key for part, _ in parts]
        assert None not in keys
        shapes = [(t.shape, t.stride(), t.dtype) for _, example in parts for t in example]
        names.append(make_key(keys, shapes))
    assert names[0] == names[1] and len(set(names[1:])) == len(others)
    for (part, example), (other, _) in zip(first, others[0], strict=True):
        codes = [compiled_module._trace(each.run, example).code for each in (part, other)]
        assert codes[0] == codes[1], part.name


@pytest.mark.compile
def test_flows_on_other_grids_share_all_code_but_the_collision() -> None:
    small, large = (
        list_parts(make_tank(**CHANGES["sharp skin"], **size))
        for size in ({}, {"width": 150, "height": 110})
    )
    for (part, example), (other, larger) in zip(small, large, strict=True):
        names = [
            compiled_module._make_name(str(each.key), tensors, each._num_varying)
            for each, tensors in ((part, example), (other, larger))
        ]
        assert (names[0] == names[1]) == (part.name != "collision"), part.name
        if part.name == "collision":
            continue
        run: Any = compiled_module._trace(part.run, example, "symbolic")
        if part.name.startswith("edges ['LEFT"):  # the others would take a minute to compile
            part.compile(example)
            run = part.run
        eager, shared = ([compiled_module._make_twin(t) for t in larger] for _ in range(2))
        for one, copy in zip(eager, shared, strict=True):
            if one.dtype == torch.float32:
                one.add_(0.01 * torch.randn_like(one))
            copy.copy_(one)
        other.run(*eager)
        run(*shared)
        torch.testing.assert_close(shared, eager, rtol=0.0, atol=1e-7, msg=part.name)


OWN_EDGE = """
from fishrl.physics.boundaries import NoSlip
from own_numbers import NUMBER
class Magnetic(NoSlip):
    pull: float = 1.0
"""


def test_own_class_is_known_by_its_sources(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of its module, and of those that it imports; none without a file."""
    monkeypatch.syspath_prepend(str(tmp_path))
    keys, first = [], (1, "", 1.0)
    for number, extra, pull in (first, first, (1, "", 2.0), (2, "", 1.0), (1, "X = 2", 1.0)):
        (tmp_path / "own_numbers.py").write_text(f"def find():\n    return {number}\nNUMBER = find")
        (tmp_path / "own_edge.py").write_text(f"{OWN_EDGE}\n{extra}\n")
        for name in ("own_edge", "own_numbers"):
            monkeypatch.delitem(sys.modules, name, raising=False)
        importlib.invalidate_caches()
        edge = importlib.import_module("own_edge").Magnetic(pull=pull)
        parts = list_parts(make_tank(boundaries=Boundaries(top=edge)))
        assert all(part.key for part, _ in parts)
        keys.append([part.key for part, _ in parts])
    assert keys[0] == keys[1] and len(set(map(tuple, keys))) == 4
    (tmp_path / "own_numbers.py").unlink()
    parts = list_parts(make_tank(boundaries=Boundaries(top=edge)))
    assert [part.name for part, _ in parts if part.key is None] == ["edges ['TOP']"]


OWN_GAIN = """
from fishrl.physics.boundaries import NoSlip
GAIN, _SEEN = 1.0, []
class Magnetic(NoSlip):
    def pull(self):
        return GAIN
def make():
    class Local(Magnetic):
        pass
    return Local
"""


@pytest.mark.parametrize("folder", ["", "site-packages"])
def test_own_class_is_known_by_the_numbers_that_it_reads(
    folder: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where it is installed; none of a function, which may hold others."""
    (tmp_path / folder).mkdir(exist_ok=True)
    monkeypatch.syspath_prepend(str(tmp_path / folder))
    (tmp_path / folder / "own_gain.py").write_text(OWN_GAIN)
    monkeypatch.delitem(sys.modules, "own_gain", raising=False)
    own, keys = importlib.import_module("own_gain"), []
    for gain, source in (
        (1.0, OWN_GAIN),
        (1.0, OWN_GAIN),
        (2.0, OWN_GAIN),
        (2.0, OWN_GAIN + "X = 1"),
    ):
        own.GAIN = gain
        (tmp_path / folder / "own_gain.py").write_text(source)
        keys.append(str(identify(own.Magnetic())))
    assert keys[0] == keys[1] and len(set(keys)) == 3
    with pytest.raises(LookupError, match="variables of the function"):
        identify(own.make()())
