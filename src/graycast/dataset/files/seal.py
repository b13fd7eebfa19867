"""Reveal changes of stored files by their SHA-256, in each scene's manifest and in the claim.

A manifest also holds its own SHA-256, computed without its timings, which differ between equal
runs. These digests guard against accidents, not against forgery: whoever changes a file can also
compute its digest again. A scene that is made again is compared file by file.
"""

import hashlib
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ...base.file_limits import parse_json
from ...base.folder import leads_out
from ...rig.former_names import with_current_names
from .json_text import json_bytes
from .safe_reading import png_pixels

MANIFEST = "manifest.json"
SUMS, OWN = "sha256", "manifest_sha256"  # A manifest has both keys; `graycast.json` has the first.
# These keys list the facts of later images; the first image's facts are keys of the manifest.
FURTHER, FURTHER_TIMINGS = "further_images", "further_timings"
OWN_FACTS = (
    "exposure_s",
    "exposures_s",
    "reasons",
    "part_reasons",
    "frames",
    "code_maps",
    "motion",
    "flow",
)
_UNSEALED = ("timings", FURTHER_TIMINGS, OWN)
_NOT_COMPARED = {*_UNSEALED, SUMS}  # The files themselves are compared, so their digests are not.


def facts_of(manifest: Mapping[str, Any], sensor: str, image: int) -> dict[str, Any]:
    """Return the manifest as it applies to one image of the scene.

    The keys OWN_FACTS of a manifest describe the first image. They are replaced by the values of
    the given image; for the first image, the manifest is returned as it is.
    """
    for further in manifest.get(FURTHER, ()):
        if (further.get("sensor", ""), further["image"]) == (sensor, image):
            own = {key: further[key] for key in OWN_FACTS if key in further}
            shared = {key: value for key, value in manifest.items() if key not in OWN_FACTS}
            return shared | own | {"seeds": {**manifest["seeds"], **further["seeds"]}}
    return dict(manifest)


def sealed(
    files: Iterable[tuple[str, bytes]], manifest: Mapping[str, Any]
) -> Iterator[tuple[str, bytes]]:
    """Yield a scene's files, then the scene's manifest, which holds the SHA-256 of each file."""
    sums = {}
    for name, content in files:
        sums[name] = sha256(content)
        yield name, content
    listed = {**manifest, SUMS: sums}
    yield MANIFEST, json_bytes({**listed, OWN: _own(listed)})


def sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _own(manifest: Mapping[str, Any]) -> str:
    return sha256(json_bytes({k: v for k, v in manifest.items() if k not in _UNSEALED}))


def seal_problems(folder: Path, manifest: Mapping[str, Any]) -> Iterator[str]:
    """Yield all differences from a scene's manifest, one line for each kind of difference."""
    if SUMS not in manifest or OWN not in manifest:
        yield (
            f"{MANIFEST}: {SUMS} or {OWN} is missing: whether a file of the scene was changed, "
            "removed or added was not checked"
        )
        return
    if manifest[OWN] != _own(manifest):
        yield f"{MANIFEST} was changed after it was written: its own SHA-256 differs"
    there = (str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())
    # Hidden files, such as .DS_Store of a file browser, are not data.
    visible = {name for name in there if not Path(name).name.startswith(".")} - {MANIFEST}
    yield from sum_problems(folder, manifest[SUMS], listed_in=MANIFEST)
    if odd := sorted(visible - set(manifest[SUMS])):
        yield f"{_named(odd)} was not written with the scene: {MANIFEST} does not tell of it"


def sum_problems(folder: Path, sums: Mapping[str, str], *, listed_in: str) -> Iterator[str]:
    """Yield the files that are missing, have another SHA-256, or are outside the folder."""
    if outside := sorted(name for name in sums if leads_out(name)):
        yield f"{_named(outside)} leads out of the folder, and {listed_in} tells of it"
        sums = {name: digest for name, digest in sums.items() if name not in outside}
    if missing := sorted(name for name in sums if not (folder / name).is_file()):
        yield f"{_named(missing)} is missing, {listed_in} tells of it"
    changed = [n for n in sorted(set(sums) - set(missing)) if _sum_of(folder / n) != sums[n]]
    if changed:
        yield f"{_named(changed)} is not as it was written: its SHA-256 is another"


def _sum_of(path: Path) -> str | None:
    """Return a file's SHA-256; None if the file cannot be read, which its reader reports."""
    try:
        with open(path, "rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return None


def _named(names: list[str]) -> str:
    more = f" (and {len(names) - 1} more)" if len(names) > 1 else ""
    return f"{names[0]}{more}"


def differing_files(scene: Path, files: Iterable[tuple[str, bytes]]) -> dict[str, str]:
    """Return the differing files of a stored scene and their differences, ignoring timings."""
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


def _renamed(content: bytes) -> str:
    """Return a file's text with the current names of rigs; invalid bytes are preserved."""
    return with_current_names(content.decode("utf-8", "surrogateescape"))


def _difference(name: str, stored: bytes, new: bytes) -> str | None:
    if name == "manifest.json":
        one, other = (parse_json(_renamed(text)) for text in (stored, new))
        keys = [k for k in sorted({*one, *other} - _NOT_COMPARED) if one.get(k) != other.get(k)]
        return f"differs in {', '.join(keys)}" if keys else None
    if name.endswith(".yaml") and _renamed(stored) == _renamed(new):
        return None  # A rig file was written under a former name of its rig.
    if not name.endswith(".png"):
        return "differs"
    pictures = [png_pixels(content, name).astype(np.int64) for content in (stored, new)]
    if pictures[0].shape != pictures[1].shape:
        return "has another size"
    gap = np.abs(pictures[0] - pictures[1])
    changed = gap if gap.ndim == 2 else gap.max(axis=2)
    return f"differs in {np.count_nonzero(changed)} of {changed.size} pixels, by up to {gap.max()}"
