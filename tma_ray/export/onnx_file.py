"""A policy as an ONNX file: one graph from raw observations to actions, checked before it is kept."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from tma_ray import __version__
from tma_ray.students import Policy

if TYPE_CHECKING:
    import onnx
    from torch import nn

OPSET: Final = 20
"""Version of ONNX's operators: the first with GELU."""

IR_VERSION: Final = 9
"""Of the file format: the one that came with these operators."""

INPUT, OUTPUT = "observations", "actions"
"""Names in the graph."""

TOLERANCE: Final = 1e-4
"""How far actions of the file may be from the policy's, as a share of the range of each."""


class NotExpressibleError(ValueError):
    """A policy that cannot be said in ONNX, or not well enough."""


def require_onnx() -> None:
    """Refuses to go on without the package.

    Raises:
        ValueError: it is not installed.
    """
    try:
        import onnx  # noqa: F401
    except ImportError as error:
        raise ValueError(
            "an ONNX file needs the package onnx: pip install 'tma_ray[onnx]', or leave it out with --no-onnx"
        ) from error


def onnx_model(
    layers: nn.Sequential, sizes: tuple[int, int], properties: Mapping[str, str]
) -> onnx.ModelProto:
    """Returns `layers` as a model; the same ones give the same bytes.

    Args:
        layers: as `tma_ray.students.policy_layers` returns them.
        sizes: of an observation and of an action.
        properties: what the file says of itself.

    Raises:
        NotExpressibleError: a layer has no counterpart here.
    """
    from onnx import TensorProto, checker, helper

    graph = _Graph()
    value = INPUT
    for layer in layers:
        value = graph.append(layer, value)
    graph.node("Identity", value, name=OUTPUT)
    ends = [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, ["n", size])
        for name, size in zip((INPUT, OUTPUT), sizes, strict=True)
    ]
    model = helper.make_model(
        helper.make_graph(graph.nodes, "policy", ends[:1], ends[1:], graph.tensors),
        opset_imports=[helper.make_opsetid("", OPSET)],
        ir_version=IR_VERSION,
        producer_name="tma_ray",
        producer_version=__version__,
    )
    helper.set_model_props(model, dict(properties))
    checker.check_model(model, full_check=True)
    return model


def largest_difference(
    model: onnx.ModelProto, policy: Policy, observations: NDArray[np.float32], widths: NDArray[np.float32]
) -> float:
    """Returns the largest absolute difference between actions of `model` and of `policy`.

    It is computed by ONNX's reference implementation, and by onnxruntime where that is installed.

    Args:
        model: the policy as ONNX.
        policy: the policy.
        observations: what both act on (n, o), together and one by one.
        widths: range of each action (a,).

    Raises:
        NotExpressibleError: it is over `TOLERANCE` of the range of an action.
    """
    largest = 0.0
    for run in _runtimes(model):
        for batch in (observations, observations[:1]):
            difference = np.abs(run(batch) - policy(batch))
            if not (difference <= TOLERANCE * np.maximum(widths, 1.0)).all():
                raise NotExpressibleError(
                    f"actions of the ONNX file differ by up to {difference.max():.3g} from the policy's: it "
                    f"computes something else than its layers say; leave it out with --no-onnx"
                )
            largest = max(largest, float(difference.max()))
    return largest


def _runtimes(model: onnx.ModelProto) -> list[Callable[[NDArray[np.float32]], NDArray[np.float32]]]:
    from onnx.reference import ReferenceEvaluator

    sessions: list[Any] = [ReferenceEvaluator(model)]
    try:
        import onnxruntime
    except ImportError:
        pass
    else:
        content = model.SerializeToString()
        sessions.append(onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"]))
    return [partial(_run, session) for session in sessions]


def _run(session: Any, batch: NDArray[np.float32]) -> NDArray[np.float32]:
    actions: NDArray[np.float32] = session.run([OUTPUT], {INPUT: batch})[0]
    return actions


@dataclass
class _Graph:
    """Operators in a row, and the numbers that they hold."""

    nodes: list[Any] = field(default_factory=list)
    tensors: list[Any] = field(default_factory=list)

    def node(self, operator: str, *inputs: str, name: str = "", **attributes: Any) -> str:
        """Appends an operator; returns the name of what it computes."""
        from onnx import helper

        output = name or f"{operator.lower()}_{len(self.nodes)}"
        self.nodes.append(helper.make_node(operator, list(inputs), [output], **attributes))
        return output

    def tensor(self, values: Any) -> str:
        """Stores numbers; returns their name."""
        from onnx import numpy_helper

        name = f"tensor_{len(self.tensors)}"
        array = values.numpy(force=True) if hasattr(values, "numpy") else np.asarray(values, np.float32)
        self.tensors.append(numpy_helper.from_array(array, name))
        return name

    def append(self, layer: nn.Module, value: str) -> str:
        """Appends a layer that takes `value`; returns the name of what it computes."""
        write = _writers().get(type(layer))
        if write is None:
            raise NotExpressibleError(
                f"a layer {type(layer).__name__} of the policy is not known in ONNX; "
                f"leave it out with --no-onnx"
            )
        return write(self, layer, value)


def _writers() -> dict[type, Callable[[_Graph, Any, str], str]]:
    """Returns how each kind of layer is written."""
    from torch import nn

    from tma_ray.students.layers import Affine, Clamp, Standardise

    return {
        Standardise: _standardise,
        Affine: lambda g, layer, x: g.node(
            "Add", g.node("Mul", x, g.tensor(layer.weight)), g.tensor(layer.bias)
        ),
        Clamp: lambda g, layer, x: g.node("Min", g.node("Max", x, g.tensor(layer.low)), g.tensor(layer.high)),
        nn.Linear: _linear,
        nn.Identity: lambda _, __, x: x,
        nn.Dropout: lambda _, __, x: x,  # at rest in a policy that does not learn
        nn.ReLU: lambda g, _, x: g.node("Relu", x),
        nn.Tanh: lambda g, _, x: g.node("Tanh", x),
        nn.Sigmoid: lambda g, _, x: g.node("Sigmoid", x),
        nn.SiLU: lambda g, _, x: g.node("Mul", x, g.node("Sigmoid", x)),
        nn.GELU: lambda g, layer, x: g.node("Gelu", x, approximate=layer.approximate),
        nn.Mish: lambda g, _, x: g.node("Mish", x),
        nn.Softsign: lambda g, _, x: g.node("Softsign", x),
        nn.ELU: lambda g, layer, x: g.node("Elu", x, alpha=float(layer.alpha)),
        nn.SELU: lambda g, _, x: g.node("Selu", x),
        nn.LeakyReLU: lambda g, layer, x: g.node("LeakyRelu", x, alpha=float(layer.negative_slope)),
        nn.Hardtanh: lambda g, layer, x: g.node("Clip", x, g.tensor(layer.min_val), g.tensor(layer.max_val)),
        nn.ReLU6: lambda g, layer, x: g.node("Clip", x, g.tensor(layer.min_val), g.tensor(layer.max_val)),
    }


def _linear(graph: _Graph, layer: Any, value: str) -> str:
    inputs = [value, graph.tensor(layer.weight)]
    if layer.bias is not None:
        inputs.append(graph.tensor(layer.bias))
    return graph.node("Gemm", *inputs, transB=1)


def _standardise(graph: _Graph, layer: Any, value: str) -> str:
    from onnx import TensorProto

    double = graph.node("Cast", value, to=TensorProto.DOUBLE)
    centred = graph.node("Sub", double, graph.tensor(layer.mean))
    scaled = graph.node("Div", centred, graph.tensor(layer.deviation))
    bounds = [graph.tensor(layer.mean.new_tensor(side * layer.clip)) for side in (-1, 1)]
    return graph.node("Cast", graph.node("Clip", scaled, *bounds), to=TensorProto.FLOAT)
