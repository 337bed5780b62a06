"""Parts of other packages that are not public, and that a new version of theirs may move."""

import ast
import inspect
from importlib import import_module
from pathlib import Path

ROOT = Path(__file__).parents[1]
#: Where each is used, and what has to be looked at when it moves.
PRIVATE = {
    "torch._functorch.compile_utils.fx_graph_cse": "training/tracing.py",
    "torch._inductor.standalone_compile": "physics/fast/compiled.py",
    "torch._inductor.output_code.CompiledFxGraph": "physics/fast/compiled.py",
    "torch._inductor.runtime.cache_dir_utils.cache_dir": "physics/fast/compiled.py",
    "torch._inductor.standalone_compile.AOTCompiledArtifact": "physics/fast/compiled.py",
    "torch.utils._pytree": "envs/streams.py, physics",
}


#: Private attributes of TorchRL's classes, by class, that their subclasses or callers here use.
ATTRIBUTES = {
    "torchrl.collectors.Collector": ("_carrier", "_traj_pool"),  # training/collector.py
    "torchrl.envs.ActionMask": ("_call",),  # training/collector.py
}


def _is_private(name: str) -> bool:
    package, *parts = name.split(".")
    return package not in ("fishrl", "experiments") and any(
        part.startswith("_") and not part.startswith("__") for part in parts
    )


def _find_imported() -> set[str]:
    found: set[str] = set()
    for path in (p for f in ("fishrl", "experiments") for p in (ROOT / f).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.module:
                found |= {f"{node.module}.{alias.name}" for alias in node.names}
            elif isinstance(node, ast.Import):
                found |= {alias.name for alias in node.names}
    return {name for name in found if _is_private(name)}


def test_private_imports_are_listed_and_exist_in_the_installed_versions() -> None:
    assert _find_imported() == set(PRIVATE)
    for name in PRIVATE:
        module, _, attribute = name.rpartition(".")
        assert hasattr(import_module(module), attribute), f"{name} (used in {PRIVATE[name]})"


def test_private_attributes_of_torchrl_are_still_used_there() -> None:
    for name, attributes in ATTRIBUTES.items():
        module, _, kind = name.rpartition(".")
        source = inspect.getsource(getattr(import_module(module), kind))
        missing = [attribute for attribute in attributes if attribute not in source]
        assert not missing, f"{name} has no {missing}"
