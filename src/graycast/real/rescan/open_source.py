"""The one place that knows which layouts of datasets there are."""

import os
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

from ...base.errors import DatasetError
from ...dataset.scene_folder import scene_folders
from .bop_source import CAMERAS, open_bop
from .depth_source import open_depth
from .model_files import read_background
from .sileane_source import IPA, SILEANE, open_ipa, open_sileane
from .source import Source, SourceOptions

_Opener = Callable[[Path, SourceOptions], Source]
_LAYOUTS: Mapping[str, tuple[_Opener, set[str]]] = {
    "BOP": (open_bop, {"sensor", "models", "materials", "depth_scale_mm"}),
    "Siléane": (open_sileane, {"models", "materials"}),
    "Fraunhofer IPA": (open_ipa, {"models", "materials"}),
    "depth alone": (open_depth, {"materials", "depth_scale_mm", "intrinsics"}),
}


def open_source(path: Path | str, options: SourceOptions | None = None) -> Source:
    """A dataset of others, by what its folder has; images are read when they are asked for.

    Args:
        path: a split in BOP's form, such as `lm/train_pbr`; a folder of Siléane or of Fraunhofer
            IPA, with `camera_params.txt` or `parameter.json`; or a folder with `depth`.
        options: what its files do not say.

    Raises:
        DatasetError: it is none of these, an option does not belong to it, or a file is missing,
            damaged or contradicts another.
        ConfigError: the materials file is not what it should be.
    """
    options = options or SourceOptions()
    folder = Path(os.path.abspath(path))  # models lie beside a link, not beside what it links to
    if not folder.is_dir():
        problem = "is no folder" if folder.exists() else "no such folder"
        raise DatasetError(f"{path}: {problem}: give a split such as lm/train_pbr")
    if folder.name == "depth" and not (folder / "depth").is_dir():
        folder = folder.parent
    layout = _layout(folder)
    opener, fitting = _LAYOUTS[layout]
    for name in ("sensor", "models", "materials", "depth_scale_mm", "intrinsics"):
        if getattr(options, name) and name not in fitting:
            option = name.removesuffix("_mm").replace("_", "-")
            raise DatasetError(f"{path}: is of the layout {layout}: leave out --{option}")
    source = opener(folder, options)
    if options.materials is None:
        return source
    return replace(source, background=read_background(options.materials))


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
