"""Write down what a PyTorch network computes: it runs once on tensors without data, and each operation becomes a node.

Everything that depends on weights alone is computed on the spot. Shapes are fixed, but see `export.graph.any_size`.
"""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from torch import Tensor
from torch.utils import _pytree
from torch.utils._python_dispatch import TorchDispatchMode

from export.graph.graph import Graph
from runtime.errors import SettingError

Emitter = Callable[..., str]  # of the tracer, the output's shape and the operation's arguments: name of the output

# Evaluation mode and fixed shapes leave these without effect.
ALIASES = ("detach", "alias", "clone", "lift_fresh")


class Tracer(TorchDispatchMode):  # type: ignore[no-untyped-call]
    """Records every operation on the values of one forward pass; `emitters` by the name of the ATen operation."""

    def __init__(self, emitters: Mapping[str, Emitter]) -> None:
        super().__init__()  # type: ignore[no-untyped-call]
        self.emitters = emitters
        self.graph = Graph()
        self.constants: dict[int, tuple[str, Tensor]] = {}  # name and data, by the id of the tensor without data
        self._names: dict[int, str] = {}
        self._alive: list[Any] = []  # an id stands for a tensor only while the tensor lives

    @classmethod
    def _should_skip_dynamo(cls) -> bool:
        """Spare the import of torch's compiler, which takes seconds and has nothing to do here."""
        return False

    def __torch_dispatch__(
        self, function: Any, types: Any, args: tuple[Any, ...] = (), kwargs: dict[str, Any] | None = None
    ) -> Any:
        kwargs = kwargs or {}
        result = function(*args, **kwargs)
        self._alive.append((args, result))
        op = str(function.overloadpacket).removeprefix("aten.")
        given = [x for x in _pytree.tree_leaves((args, kwargs)) if isinstance(x, Tensor)]
        first = result[0] if isinstance(result, tuple) else result
        if all(id(x) in self.constants for x in given):
            if given:
                values = function(*self._data(args), **self._data(kwargs))
                source = self.constants[id(given[0])][0]
                for part, value in zip(_pytree.tree_leaves(result), _pytree.tree_leaves(values), strict=True):
                    self.constants[id(part)] = (source, value)
        elif op in ALIASES:
            self._names[id(first)] = self.name(given[0])
        elif op in self.emitters:
            self._names[id(first)] = self.emitters[op](self, tuple(first.shape), *args, **kwargs)
        else:
            raise SettingError(f"the network uses {function}, which export/graph/emitters.py has no emitter for yet")
        return result

    def input(self, tensor: Tensor, name: str) -> None:
        """Let a tensor be an input of the graph."""
        self._names[id(tensor)] = self.graph.input(name, tuple(tensor.shape))
        self._alive.append(tensor)

    def name(self, tensor: Tensor) -> str:
        """The name of a value; a constant is stored in the graph when it is first named."""
        if id(tensor) not in self._names:
            key, data = self.constants[id(tensor)]
            self._names[id(tensor)] = self.graph.weight(key, data.float().numpy())
            self._alive.append(tensor)
        return self._names[id(tensor)]

    def rename(self, tensor: Tensor, name: str) -> None:
        """Give a value its final name and make it an output."""
        self.graph.finish(self.name(tensor), name)
        self._names[id(tensor)] = name

    def data(self, tensor: Tensor) -> np.ndarray:
        """The values of a constant in float64."""
        return self.constants[id(tensor)][1].double().numpy()

    def _data(self, values: Any) -> Any:
        return _pytree.tree_map(lambda x: self.constants[id(x)][1] if isinstance(x, Tensor) else x, values)
