"""A function whose tensor operations are traced once and then run without the Python around them.

A gradient step of a small network spends most of its time in Python: modules with exchanged
weights, tensordicts, distributions, autograd. Its tensor operations are the same at each step.
"""

from collections.abc import Callable, Sequence

import torch
from tensordict.nn import CudaGraphModule
from torch import Tensor
from torch._functorch.compile_utils import fx_graph_cse
from torch.fx import Graph, GraphModule, Node
from torch.fx.experimental.proxy_tensor import make_fx

Function = Callable[..., Sequence[Tensor]]

# Without autograd and profiler they do nothing.
_IDLE = (
    torch.ops.aten.detach.default,
    torch.ops.profiler._record_function_enter_new.default,
    torch.ops.profiler._record_function_exit._RecordFunction,
)
_TRANSPOSE = torch.ops.aten.t.default


class Traced:
    """Call ``function``, and once traced run its tensor operations alone.

    These are the same operations in the same order, backward passes included, on the arguments and
    on the tensors that ``function`` reads or changes beside them, such as parameters. Whatever else
    changes from call to call must therefore be an argument. What would be computed twice, such as
    the values of the same critics in two losses, is computed once.

    On a GPU they are launched as one CUDA graph.

    The second call in a row with arguments of the same number and shapes is traced: the first may
    have created something. Later calls with others go to ``function`` itself.

    Args:
        function: of tensors, which it may change in place; returns tensors. What it does must not
            depend on their values: torch raises a RuntimeError while it is traced otherwise.
    """

    def __init__(self, function: Function) -> None:
        self._function = function
        self._operations: Function | None = None
        self._form: list[torch.Size] = []

    def __call__(self, *tensors: Tensor) -> Sequence[Tensor]:
        """Return what the function returns."""
        form = [tensor.shape for tensor in tensors]
        if form != self._form:
            if self._operations is None:
                self._form = form
            return self._function(*tensors)
        if self._operations is not None:
            return self._operations(*tensors)
        results: Sequence[Tensor] = ()

        def run(*given: Tensor) -> Sequence[Tensor]:
            nonlocal results
            results = self._function(*given)
            return results

        operations = _strip(make_fx(run)(*tensors))
        if tensors[0].is_cuda:
            operations = torch.no_grad()(operations)
            self._operations = CudaGraphModule(operations, device=tensors[0].device)
        else:
            self._operations = torch.inference_mode()(operations)
        return results


def _strip(traced: GraphModule) -> GraphModule:
    """Return the operations of a graph that do something, each once."""
    graph = Graph()  # flat arguments and results, which cost less than those of any structure
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
    graph = fx_graph_cse(graph)
    graph.eliminate_dead_code()
    return GraphModule(traced, graph)
