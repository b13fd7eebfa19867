"""Ground truth on disk: BOP and COCO, written scene by scene, and read back to be checked."""

from .bop import depth_scale_mm, scene_files
from .claim import described_values
from .compare import differing_files
from .sample import Sample
from .store import SetAside, Store, open_store, refuse_other_dataset
from .validate import Problem, validate

__all__ = [
    "Problem",
    "Sample",
    "SetAside",
    "Store",
    "depth_scale_mm",
    "described_values",
    "differing_files",
    "open_store",
    "refuse_other_dataset",
    "scene_files",
    "validate",
]
