"""Ground truth on disk: BOP and COCO, written scene by scene, and read back to be checked."""

from .bop import depth_scale_mm, scene_files
from .claim import described_values
from .compare import differing_files
from .raw import read_capture, read_code_maps
from .sample import Raw, Sample, labelled
from .store import SetAside, Store, open_store, refuse_other_dataset
from .validate import Problem, has_sums, validate

__all__ = [
    "Problem",
    "Raw",
    "Sample",
    "SetAside",
    "Store",
    "depth_scale_mm",
    "described_values",
    "differing_files",
    "has_sums",
    "labelled",
    "open_store",
    "read_capture",
    "read_code_maps",
    "refuse_other_dataset",
    "scene_files",
    "validate",
]
