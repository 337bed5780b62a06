"""Private parts of other packages, which their new versions may move."""

import inspect
from importlib import import_module
from typing import Any

from tests.test_architecture import OWN, list_attributes, list_imports

#: Private names, and the file that uses each.
PRIVATE = {
    "torch._functorch.compile_utils.fx_graph_cse": "training/tracing.py",
    "torch._guards.TracingContext": "physics/fast/compiled.py",
    "torch._guards.tracing": "physics/fast/compiled.py",
    "torch._inductor.standalone_compile": "physics/fast/compiled.py",
    "torch._inductor.cpu_vec_isa": "physics/fast/inductor.py",
    "torch._inductor.compile_fx.compile_fx": "physics/fast/compiled.py",
    "torch._inductor.codecache.CppPythonBindingsCodeCache": "physics/fast/compiled.py",
    "torch._subclasses.FakeTensorMode": "physics/fast/compiled.py",
    "torch.utils._pytree": "envs/streams.py, physics",
    "torch._C._functorch.peek_interpreter_stack": "physics/rollout.py",
    "torch._functorch.config": "physics/fast/compiled.py",
    "torch._inductor.config": "physics/fast",
}
#: Private attributes of TorchRL's classes, by class, that their subclasses or callers here use.
ATTRIBUTES = {
    # training/collector.py
    "torchrl.collectors.Collector": ("_carrier", "_exclude_private_keys", "_traj_pool"),
    "torchrl.envs.ActionMask": ("_call",),
}


def _find(name: str) -> Any:
    module, _, attribute = name.rpartition(".")
    return getattr(import_module(module), attribute)


def test_private_names_are_listed_and_exist() -> None:
    foreign = {name for name in list_imports(*OWN) if name.partition(".")[0] not in OWN}
    used = foreign | {name for name in list_attributes(*OWN) if name.startswith("torch.")}
    private = {name for name in used if name.replace(".__", "").startswith("torch._")}
    private |= {name for name in foreign if "._" in name.replace(".__", "")}
    listed = {
        own: {name for name in private if f"{name}.".startswith(f"{own}.")} for own in PRIVATE
    }
    assert private == set().union(*listed.values())
    assert all(listed.values()), "a name that is not used is listed"
    assert len(PRIVATE) <= 12
    for name in PRIVATE:
        assert _find(name), f"{name} (used in {PRIVATE[name]})"
    for name, attributes in ATTRIBUTES.items():
        source = inspect.getsource(_find(name))
        missing = [attribute for attribute in attributes if attribute not in source]
        assert not missing, f"{name} has no {missing}"
