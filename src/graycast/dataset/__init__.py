"""Ground truth on disk: BOP and COCO, written scene by scene, and read back to be checked."""

from .bop import depth_scale_mm
from .claim import described_values
from .sample import Sample
from .store import Store, open_store, write_scene
from .validate import Problem, validate

__all__ = [
    "Problem",
    "Sample",
    "Store",
    "depth_scale_mm",
    "described_values",
    "open_store",
    "validate",
    "write_scene",
]
