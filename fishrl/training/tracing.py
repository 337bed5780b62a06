"""Trace the tensor operations of a function once, then run them without the Python around them.

A gradient step of a small network spends most of its time in Python: modules with exchanged
weights, tensordicts, distributions, autograd. Its tensor operations are the same at each step.
"""

import operator
from collections.abc import Callable, Sequence

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torch._functorch.compile_utils import fx_graph_cse
from torch.fx import Graph, GraphModule, Node
from torch.fx.experimental.proxy_tensor import make_fx

from fishrl.envs.repeating import Repeated

Operations = Callable[..., Sequence[Tensor]]

#: Calls before one is traced, which takes as long as tracing them saves. The first may create
#: something.
EAGER_CALLS = 50

# Without autograd and profiler they do nothing.
_IDLE = (
    torch.ops.aten.detach.default,
    torch.ops.profiler._record_function_enter_new.default,
    torch.ops.profiler._record_function_exit._RecordFunction,
)
_TRANSPOSE = torch.ops.aten.t.default
_EMPTY = torch.ops.aten.empty.memory_format  # never merged
# They give other views of the same memory.
_VIEWS = {_TRANSPOSE, torch.ops.aten.unbind.int, torch.ops.aten.view.default, operator.getitem}


class Traced:
    """Call ``function`` on batches, and once traced run its tensor operations alone.

    These are the same operations in the same order, backward passes included, on the entries of the
    batch and on the other tensors that ``function`` reads or changes, such as parameters. All else
    that changes from call to call must therefore be an entry of the batch. Repeated
    computations, such as the values of the same critics in two losses, are merged unless that
    would merge random numbers.

    On a GPU they are launched as one CUDA graph.

    After ``EAGER_CALLS`` in a row with entries of the same names and shapes the next is traced.
    Later calls with others go to ``function`` itself.

    Args:
        function: takes a batch, whose entries it may change in place, and returns tensors. Its
            operations must not depend on their values; otherwise tracing raises a RuntimeError.
    """

    def __init__(self, function: Callable[[TensorDictBase], Sequence[Tensor]]) -> None:
        self._function = function
        self._operations: Operations | None = None
        self._form: list[object] = []
        self._num_calls = 0  # in a row, of this form

    def __call__(self, batch: TensorDictBase) -> Sequence[Tensor]:
        """Return the function's result."""
        names, tensors = zip(*batch.items(True, True), strict=True)
        form = [names, *(tensor.shape for tensor in tensors)]
        if form != self._form:
            if self._operations is None:
                self._form, self._num_calls = form, 1
            return self._function(batch)
        if self._operations is not None:
            return self._operations(*tensors)
        self._num_calls += 1
        if self._num_calls <= EAGER_CALLS:
            return self._function(batch)
        results: Sequence[Tensor] = ()

        def run(*given: Tensor) -> Sequence[Tensor]:
            nonlocal results
            entries = TensorDict(dict(zip(names, given, strict=True)), batch.batch_size)
            results = self._function(entries)
            return results

        operations: Operations = _strip(make_fx(run)(*tensors))
        if tensors[0].is_cuda:
            operations = torch.no_grad()(operations)
            repeated = Repeated(lambda given: (operations(*given), None), "a gradient step")
            self._operations = lambda *given: repeated(given)[0]
        else:
            self._operations = torch.inference_mode()(operations)
        return results


def _strip(traced: GraphModule) -> GraphModule:
    """Return the operations of a graph that have an effect, each once."""
    graph = Graph()  # flat arguments and results cost less than nested ones
    graph.output(graph.graph_copy(traced.graph, {}))
    first: dict[tuple[object, ...], Node] = {}
    for node in graph.find_nodes(op="get_attr"):
        tensor = getattr(traced, str(node.target))  # a parameter, or a detached view of it
        memory = (tensor.data_ptr(), tensor.dtype, tensor.shape, tensor.stride())
        node.replace_all_uses_with(first.setdefault(memory, node))
    for node in reversed(graph.nodes):
        if node.target in _IDLE:
            if node.users:
                node.replace_all_uses_with(node.args[0])
            graph.erase_node(node)
    for node in graph.find_nodes(op="call_function", target=_TRANSPOSE):
        if node.args[0].target is _TRANSPOSE:
            node.replace_all_uses_with(node.args[0].args[0])
    graph.eliminate_dead_code()
    graph = _merge(graph)
    graph.eliminate_dead_code()
    return _keep_views(GraphModule(traced, graph))


def _merge(graph: Graph) -> Graph:
    """Return a graph with repeated computations merged, or the same one if that changes results.

    Random numbers that look alike must stay apart, and equal tensors that change in place later.
    """
    merged = fx_graph_cse(graph)
    effects, left = (
        [node for node in each.nodes if node.op == "call_function" and node.is_impure()]
        for each in (graph, merged)
    )
    firsts = [node.args[0] for node in effects if node.args]  # what changes in place, is one
    own = [each.target for each in firsts if isinstance(each, Node) and each.op == "call_function"]
    return merged if len(left) == len(effects) and set(own) <= {_EMPTY} else graph


def _keep_views(traced: GraphModule) -> GraphModule:
    """Return a graph in which views of kept tensors, such as transposed weights, are kept too."""
    graph = traced.graph
    kept = {node: getattr(traced, str(node.target)) for node in graph.find_nodes(op="get_attr")}
    for node in list(graph.nodes):
        if node.target not in _VIEWS or not set(node.all_input_nodes) <= kept.keys():
            continue
        source, *others = node.args
        kept[node] = view = node.target(kept[source], *others)
        if isinstance(view, Tensor):
            traced.register_buffer(node.name, view)
            with graph.inserting_before(node):
                kept[replaced := graph.get_attr(node.name)] = view
            node.replace_all_uses_with(replaced)
    graph.eliminate_dead_code()
    return GraphModule(traced, graph)
