"""Export of a policy as an ONNX graph from raw observations to actions."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Mapping
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from tma_ray import __version__
from tma_ray.students import Policy

if TYPE_CHECKING:
    import onnx
    from torch import nn

ONNX_FILE: Final = "policy.onnx"

COMPARED: Final = 256  # number of random observations on which model and policy are compared
OPSET: Final = 20  # version of ONNX's operator set (opset): the first with GELU
INPUT, OUTPUT = "observations", "actions"  # names of the graph's input and output
TOLERANCE: Final = 1e-4  # largest accepted difference between actions, as a share of their ranges


class NotExpressibleError(ValueError):
    """Error raised if ONNX cannot express a policy, or not accurately enough."""


def require_onnx() -> None:
    """Check that the packages needed for ONNX files are installed.

    Raises:
        ValueError: if onnx or onnxscript is not installed.
    """
    try:
        import onnx  # noqa: F401
        import onnxscript  # noqa: F401  (torch's exporter imports it)
    except ImportError as error:
        raise ValueError(
            f"an ONNX file needs the package {error.name}: pip install 'tma_ray[onnx]', or leave it out with "
            f"--no-onnx"
        ) from error


def onnx_model(
    layers: nn.Sequential, sizes: tuple[int, int], properties: Mapping[str, str]
) -> onnx.ModelProto:
    """Convert `layers` to an ONNX model, reproducibly.

    Args:
        layers: result of `tma_ray.students.policy_layers`.
        sizes: lengths of an observation and of an action.
        properties: metadata of the file.

    Raises:
        NotExpressibleError: if torch cannot export a layer.
    """
    import torch
    from onnx import checker, helper

    logger = logging.getLogger("torch.onnx")  # silenced, since it warns of packages that are not installed
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            program = torch.onnx.export(
                layers,
                (torch.zeros(2, sizes[0], dtype=torch.float32),),
                dynamo=True,
                verbose=False,
                opset_version=OPSET,
                input_names=[INPUT],
                output_names=[OUTPUT],
                dynamic_shapes=({0: torch.export.Dim("n")},),
            )
    except torch.onnx.OnnxExporterError as error:
        reason = str(error.__cause__ or error).strip().partition("\n")[0]
        raise NotExpressibleError(
            f"torch cannot export the policy to ONNX: {reason}; leave it out with --no-onnx"
        ) from error
    finally:
        logger.setLevel(level)
    assert program is not None
    model: onnx.ModelProto = program.model_proto
    graph = model.graph
    for part in (graph, *graph.node, *graph.input, *graph.output, *graph.value_info, *graph.initializer):
        del part.metadata_props[:]  # cleared, since it may contain local paths
    model.producer_name, model.producer_version = "tma_ray", __version__
    helper.set_model_props(model, dict(properties))
    checker.check_model(model, full_check=True)
    return model


def largest_difference(
    model: onnx.ModelProto, policy: Policy, observations: NDArray[np.float32], widths: NDArray[np.float32]
) -> float:
    """Return the largest absolute difference between the actions of `model` and those of `policy`.

    The model is run by ONNX's reference implementation and, if installed, by onnxruntime, on all
    `observations` (n, o) and on the first one. `widths` (a,) are the ranges of actions.

    Raises:
        NotExpressibleError: if the difference is over `TOLERANCE` of the range of an action.
    """
    from onnx.reference import ReferenceEvaluator

    sessions: list[Any] = [ReferenceEvaluator(model)]
    with suppress(ImportError):
        import onnxruntime

        content = model.SerializeToString()
        sessions.append(onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"]))
    largest = 0.0
    for session in sessions:
        for batch in (observations, observations[:1]):
            difference = np.abs(session.run([OUTPUT], {INPUT: batch})[0] - policy(batch))
            if not (difference <= TOLERANCE * np.maximum(widths, 1.0)).all():
                raise NotExpressibleError(
                    f"actions of the ONNX file differ by up to {difference.max():.3g} from the policy's: it "
                    f"computes something else than its layers say; leave it out with --no-onnx"
                )
            largest = max(largest, float(difference.max()))
    return largest
