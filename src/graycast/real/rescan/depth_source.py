"""Reader of datasets with only perfect depth in `depth`, and optional colours in `rgb` or `gray`.

Integers need a scale; floats in NPY or TIFF are metres. All pictures must be from one camera. In
the order of their names, they become the images 0, 1 ... of scene 0.
"""

from functools import partial
from pathlib import Path

import numpy as np

from ...base.errors import DatasetError
from ...base.folder import visible_entries
from ...dataset.files.records import MM_PER_M
from ..depth_file import FileOptions, read_intrinsics
from ..picture_pairs import RealPicture, find_shots, is_whole, read_shot
from .model_files import read_models
from .source import Source, SourceImage, SourceOptions
from .source_files import camera_of


def open_depth(folder: Path, options: SourceOptions) -> Source:
    """Open a folder of depth pictures, which are read on demand.

    Raises:
        DatasetError: there are no pictures, or the intrinsics are not given.
    """
    if options.intrinsics is None:
        raise DatasetError(
            f"{folder}: depth alone does not state its camera: give --intrinsics K.json, or "
            "fx,fy,cx,cy"
        )
    read_models({}, (), options.materials)  # It refuses materials of objects, as there are none.
    if any(path.suffix.lower() == ".exr" for path in visible_entries(folder / "depth")):
        raise DatasetError(f"{folder / 'depth'}: has EXR files: save them as NPY or TIFF of floats")
    shots = find_shots(folder)
    scale_m = None if options.depth_scale_mm is None else options.depth_scale_mm / MM_PER_M
    files = FileOptions(
        K=read_intrinsics(options.intrinsics), scale_m=scale_m, ray_length=options.ray_length
    )
    return Source(
        folder=folder,
        split="depth",
        images=tuple((0, i) for i in range(len(shots))),
        parts={},
        plain=frozenset(),
        image_of=partial(_image, tuple(shots), files),
    )


def _image(
    shots: tuple[RealPicture, ...], files: FileOptions, scene_id: int, image_id: int
) -> SourceImage:
    shot = shots[image_id]
    if shot.depth is None:
        raise DatasetError(f"{shot.stem}: has no depth: put it into the folder depth")
    whole = is_whole(shot.depth)
    if files.scale_m is None and whole:
        raise DatasetError(
            f"{shot.depth}: has whole numbers: give the millimetres of one step, such as "
            "--depth-scale 0.1"
        )
    data = read_shot(shot, files)
    assert data.depth_m is not None  # The shot has a depth file, so its depth was read.
    rgb = data.rgb
    if rgb is None and data.gray is not None:
        rgb = np.repeat(data.gray[..., None], 3, axis=2)
    return SourceImage(
        camera=camera_of(data.K, "intrinsics", data.size_px),
        depth_m=data.depth_m,
        rgb=rgb,
        obj_id=np.zeros(0, np.int64),
        T_cam_part=np.zeros((0, 4, 4)),
        step_m=(files.scale_m or 0.0) if whole else 0.0,
    )
