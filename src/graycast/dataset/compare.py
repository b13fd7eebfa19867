"""Comparison of a stored scene with the same scene made again."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from ..base.file_limits import parse_json
from .safe_reading import png_pixels
from .seal import FURTHER_TIMINGS, OWN, SUMS

# Sums of files that differ would say the same twice.
_NOT_COMPARED = {"timings", FURTHER_TIMINGS, SUMS, OWN}


def differing_files(scene: Path, files: Iterable[tuple[str, bytes]]) -> dict[str, str]:
    """The files of a stored scene that differ, and how; timings in manifests are ignored."""
    new = dict(files)
    stored = {str(p.relative_to(scene)): p for p in scene.rglob("*") if p.is_file()}
    differing = dict.fromkeys(new.keys() - stored.keys(), "is not stored")
    differing |= dict.fromkeys(
        stored.keys() - new.keys(), "is stored, but the new scene does not have it"
    )
    for name in new.keys() & stored.keys():
        content = stored[name].read_bytes()
        if content != new[name] and (how := _difference(name, content, new[name])):
            differing[name] = how
    return dict(sorted(differing.items()))


def _difference(name: str, stored: bytes, new: bytes) -> str | None:
    if name == "manifest.json":
        one, other = parse_json(stored), parse_json(new)
        keys = [k for k in sorted({*one, *other} - _NOT_COMPARED) if one.get(k) != other.get(k)]
        return f"differs in {', '.join(keys)}" if keys else None
    if not name.endswith(".png"):
        return "differs"
    pictures = [png_pixels(content, name).astype(np.int64) for content in (stored, new)]
    if pictures[0].shape != pictures[1].shape:
        return "has another size"
    gap = np.abs(pictures[0] - pictures[1])
    changed = gap if gap.ndim == 2 else gap.max(axis=2)
    return f"differs in {np.count_nonzero(changed)} of {changed.size} pixels, by up to {gap.max()}"
