"""Choice of the reader for a dataset by its layout; only this module knows all layouts."""

import os
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from ...base.errors import DatasetError
from ...dataset.files.scene_folder import scene_folders
from ...rig.optics import picture_rays
from ..depth_sense import depth_kind_note, plane_shares
from .bop_source import CAMERAS, open_bop
from .depth_source import open_depth
from .model_files import read_background
from .sileane_source import IPA, SILEANE, open_ipa, open_sileane
from .source import Source, SourceOptions

_FOR_KIND = 3  # number of images tested for z or ray length
_Opener = Callable[[Path, SourceOptions], Source]
_LAYOUTS: Mapping[str, tuple[_Opener, set[str]]] = {
    "BOP": (open_bop, {"sensor", "models", "materials", "depth_scale_mm", "unit", "ray_length"}),
    "Siléane": (open_sileane, {"models", "materials", "unit"}),
    "Fraunhofer IPA": (open_ipa, {"models", "materials", "unit"}),
    "depth alone": (open_depth, {"materials", "depth_scale_mm", "intrinsics", "ray_length"}),
}


def open_source(path: Path | str, options: SourceOptions | None = None) -> Source:
    """Open a third-party dataset in any known layout; images are read on demand.

    Args:
        path: a split in BOP's form, such as `lm/train_pbr`; a folder of the Siléane or Fraunhofer
            IPA dataset, with `camera_params.txt` or `parameter.json`; or one with a folder `depth`.
        options: facts that the dataset's files do not state.

    Raises:
        DatasetError: the layout is not known, an option does not apply to it, or a file is
            missing, damaged or contradicts another.
        ConfigError: the materials file is not valid.
    """
    options = options or SourceOptions()
    # A link is not resolved, because models are next to the link and not next to its target.
    folder = Path(os.path.abspath(path))
    if not folder.is_dir():
        problem = "is no folder" if folder.exists() else "no such folder"
        raise DatasetError(f"{path}: {problem}: give a split such as lm/train_pbr")
    if folder.name == "depth" and not (folder / "depth").is_dir():
        folder = folder.parent
    layout = _layout(folder)
    opener, fitting = _LAYOUTS[layout]
    for name in sorted(set().union(*(options_ for _, options_ in _LAYOUTS.values()))):
        if getattr(options, name) and name not in fitting:
            option = name.removesuffix("_mm").replace("_", "-")
            raise DatasetError(f"{path}: is of the layout {layout}: leave out --{option}")
    materials = options.materials
    background = None if materials is None else read_background(materials)
    source = replace(opener(folder, options), background=background, options=options)
    return replace(source, notes=(*source.notes, *_depth_notes(source, options.ray_length)))


def _depth_notes(source: Source, ray_length: bool) -> list[str]:
    """Return a note if the first images seem to have ray length instead of z, or the reverse."""
    images = []
    for place in source.images[:_FOR_KIND]:
        with suppress(DatasetError):  # The same error is raised when the image is scanned.
            images.append(source.read(*place))
    images = [image for image in images if image.camera == images[0].camera]
    if not images:
        return []
    optics = images[0].camera
    # --ray-length has converted the depth to z, but the test needs the values of the files.
    per_z = np.linalg.norm(picture_rays(optics), axis=-1) if ray_length else 1.0
    shares = plane_shares([image.depth_m * per_z for image in images], optics)
    note = depth_kind_note(shares, ray_length=ray_length)
    return [] if note is None else [note]


def _layout(folder: Path) -> str:
    if scene_folders(folder, CAMERAS):
        return "BOP"
    if any(folder.glob(CAMERAS)):
        raise DatasetError(f"{folder}: is one scene: give the split that it is in, {folder.parent}")
    if (folder / SILEANE).is_file():
        return "Siléane"
    if (folder / IPA).is_file():
        return "Fraunhofer IPA"
    if (folder / "depth").is_dir():
        return "depth alone"
    splits = sorted({path.parent.parent.name for path in folder.glob(f"*/[0-9]*/{CAMERAS}")})
    if splits:
        raise DatasetError(
            f"{folder}: is a whole dataset: give one of its splits, {', '.join(splits)}"
        )
    raise DatasetError(
        f"{folder}: has no scenes of BOP's form (000000/scene_camera.json), no {SILEANE}, no {IPA} "
        "and no folder depth: give a split such as lm/train_pbr"
    )
