"""Export of trained policies as folders with safetensors, ONNX and a model card."""

from tma_ray.export.exporting import Export, export

__all__ = ["Export", "export"]
