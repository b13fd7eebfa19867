"""Merge a dataset: a cloud for each scene, and the share of the surface that each view adds."""

from collections.abc import Iterator, Mapping
from itertools import groupby
from pathlib import Path
from typing import Any

from ...base.errors import DatasetError, GraycastError
from ...base.folder import new_folder
from ...base.ply import WORLD_FRAME, cloud_bytes
from ...base.progress import UNWATCHED, ProgressMeter
from ...dataset.files.json_text import json_bytes
from ...dataset.files.places import CLAIM
from ...dataset.read.stored import StoredDataset, StoredScene, open_dataset
from ...dataset.write.models import read_models
from .fuse import FusedCloud, fuse
from .stored_views import read_surface, read_view
from .view_figures import SurfaceCoverage, cloud_figures, joined, surface_coverage, surface_figures

RECORD = "merge.json"
_MOST_REASONS = 2


def merge(source: Path, out: Path, *, progress: ProgressMeter = UNWATCHED) -> dict[str, Any]:
    """Write a cloud and its figures for each scene (such as `train-000000.ply` and `.json`).

    Args:
        source: folder of a dataset, or of one scene in a dataset.
        out: folder to write, new or empty.
        progress: counter of finished scenes.

    Returns:
        The content of `merge.json` in `out`: figures of the surface over all scenes, and doubts
        about the poses of views.

    Raises:
        GraycastError: `out` cannot be written; the dataset holds real pictures, or is damaged.
    """
    stored, scenes = _scenes(source)
    if out.absolute().is_relative_to(stored.folder.absolute()):
        raise GraycastError(f"{out}: lies in the dataset: choose a folder outside of it")
    models = read_models(stored.folder)
    of_views: dict[tuple[str, ...], list[SurfaceCoverage]] = {}
    reason_name: dict[int, str] = {}
    doubts: list[str] = []
    with new_folder(out) as folder:
        for done, shots in enumerate(scenes, start=1):
            names = tuple(shot.image_name for shot in shots)
            views = [read_view(stored, shot) for shot in shots]
            reason_name |= views[0].reason_name
            fused = fuse([view.view for view in views])
            surface = surface_coverage(read_surface(models, shots[0]), views)
            figures = {
                "scene": shots[0].scene_key,
                "surface": surface_figures(surface, names, reason_name),
                "cloud": cloud_figures(fused, views, reason_name),
                "doubts": fused.doubts,
            }
            doubts += [f"scene {shots[0].scene_key}: {doubt}" for doubt in fused.doubts]
            (folder / f"{shots[0].scene_key}.json").write_bytes(json_bytes(figures))
            (folder / f"{shots[0].scene_key}.ply").write_bytes(merged_ply(fused.cloud))
            of_views.setdefault(names, []).append(surface)
            progress.count("scenes", done, len(scenes))
        record = {
            "dataset": str(stored.folder),
            "fingerprint": stored.claim.get("fingerprint", ""),
            "scenes": [shots[0].scene_key for shots in scenes],
            "doubts": doubts,
            "reasons": {str(k): name for k, name in sorted(reason_name.items())},
            "surfaces": [
                {"scenes": len(surfaces)} | surface_figures(joined(surfaces), names, reason_name)
                for names, surfaces in of_views.items()
            ],
        }
        (folder / RECORD).write_bytes(json_bytes(record))
    return record


def described(surface: Mapping[str, Any]) -> Iterator[str]:
    """Yield lines of text that describe an entry of `surfaces` in `merge.json`."""
    views = surface["views"]
    yield (
        f"of the parts' surface {_share(surface['visible'])} is visible to a camera, and of that "
        f"{_share(surface['measured'])} is measured by the views together:"
    )
    wide = max(len(view["view"]) for view in views)
    yield f"  {'view':{max(wide, 4)}}  measures  only it  others fill, and why it has none"
    for view in views:
        filled = view["filled_by_others"]
        why = sorted(filled.items(), key=lambda item: -item[1])[:_MOST_REASONS]
        reasons = ", ".join(f"{name.replace('_', ' ')} {_share(share)}" for name, share in why)
        yield (
            f"  {view['view']:{max(wide, 4)}}  {_share(view['measured']):>8}  "
            f"{_share(view['only_this_view']):>7}  {_share(sum(filled.values(), 0.0)):>6}"
            + (f" ({reasons})" if reasons else "")
        )
    if len(views) > 1:
        steps = [
            f"{step['view']} {'+' if k else ''}{_share(step['adds'])}"
            for k, step in enumerate(surface["best_order"])
        ]
        yield f"the order in which they add most: {', '.join(steps)}"


def merged_ply(cloud: FusedCloud) -> bytes:
    """Return a cloud as a binary PLY in the world frame, with all attributes of each point."""
    more = {
        "nx": cloud.normal[:, 0],
        "ny": cloud.normal[:, 1],
        "nz": cloud.normal[:, 2],
        "sigma": cloud.sigma_m,
        "views": cloud.views,
        "view": cloud.view,
        "against": cloud.against,
        "first_reason": cloud.first_reason,
    }
    return cloud_bytes(cloud.point_m, cloud.color, more=more, frame=WORLD_FRAME)


def _scenes(source: Path) -> tuple[StoredDataset, list[list[StoredScene]]]:
    """Return the dataset and the pictures of each scene, or only of the scene `source`."""
    one = source.name.isdecimal() and not (source / CLAIM).exists()
    stored = open_dataset(source.parent.parent if one else source)
    shots = [
        shot for shot in stored.pictures if not one or shot.folder.absolute() == source.absolute()
    ]
    if not shots:
        raise DatasetError(f"{source}: is no finished scene of {stored.folder}: give one of them")
    return stored, [list(view) for _, view in groupby(shots, key=lambda shot: shot.folder)]


def _share(share: float) -> str:
    return f"{100 * share:.1f} %"
