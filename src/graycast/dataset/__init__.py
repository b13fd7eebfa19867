"""Ground truth on disk: BOP and COCO, written scene by scene, and read back to be checked.

A public name is imported from its module when it is first asked for. So who only reads examples
for training (`dataset.stored`) need not have what writing and checking take.
"""

from importlib import import_module

_MODULE = {
    "Problem": "checking",
    "Raw": "sample",
    "Sample": "sample",
    "SetAside": "store",
    "Store": "store",
    "depth_scale_mm": "bop",
    "described_values": "claim",
    "differing_files": "compare",
    "has_sums": "checking",
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
