"""Ground truth on disk: BOP and COCO, written scene by scene, and read back to be checked.

A public name is imported from its module when it is first asked for. So who only reads examples
for training (`dataset.stored`) need not have what writing and checking take.

Beside what is written and read there is what else is done with a dataset:

    detections       what a detector finds in a picture, and COCO's results files
    pose_results     estimated poses, and BOP's results files
    stats            statistics of a dataset
    card             the card of a dataset
    export           datasets in the formats of other programs
    training         training examples from datasets and from exports
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # for type checkers and editors; `_MODULE` says the same to Python
    from .bop import scene_files as scene_files
    from .checking import Problem as Problem
    from .checking import validate as validate
    from .claim import described_values as described_values
    from .compare import differing_files as differing_files
    from .picture_bytes import depth_scale_mm as depth_scale_mm
    from .raw import read_capture as read_capture
    from .raw import read_code_maps as read_code_maps
    from .sample import Raw as Raw
    from .sample import Sample as Sample
    from .sample import labelled as labelled
    from .store import SetAside as SetAside
    from .store import Store as Store
    from .store import open_store as open_store
    from .store import refuse_other_dataset as refuse_other_dataset

_MODULE = {
    "Problem": "checking",
    "Raw": "sample",
    "Sample": "sample",
    "SetAside": "store",
    "Store": "store",
    "depth_scale_mm": "picture_bytes",
    "described_values": "claim",
    "differing_files": "compare",
    "labelled": "sample",
    "open_store": "store",
    "read_capture": "raw",
    "read_code_maps": "raw",
    "refuse_other_dataset": "store",
    "scene_files": "bop",
    "validate": "checking",
}
__all__ = list(_MODULE)


def __getattr__(name: str) -> object:
    if name not in _MODULE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f".{_MODULE[name]}", __name__), name)
