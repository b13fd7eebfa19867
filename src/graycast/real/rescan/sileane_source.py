"""Readers of the Siléane and the Fraunhofer IPA Bin-Picking datasets: one kind of part per folder.

In both, depth has 16 bits from the near to the far clipping plane, lengths are in metres, and the
mesh is `mesh.ply`. Files that contradict this are refused.

Siléane (`camera_params.txt`, `depth_gt` or `depth`, `gt/*.json`, `rgb`): the poses of parts and
camera are in one absolute frame; the camera's is given as position and quaternion w x y z, which is
assumed to rotate from camera to absolute frame, as in public readers. White means unknown depth.
Without `depth_gt`, depth has noise. Source: R. Brégier et al., "Symmetry aware evaluation of 3D
object detection and pose estimation in scenes of many parts in bulk", ICCVW 2017;
rbregier.github.io/dataset2017 and the sample in github.com/rbregier/pose_recovery_evaluation.

IPA (`parameter.json`, `p_depth/cycle_0000/001_depth_uint16.png`, `gt/cycle_0000/001.csv`, `p_rgb`):
a picture is cut from a larger square picture, whose centre is on the optical axis. Orthographic
pictures are refused. Poses refer to a frame with x left and y up. A row has id, class, translation,
the three columns of the rotation, and visible shares; id 0 is the bin, and image 0 shows the empty
bin. Source: K. Kleeberger et al., "Large-scale 6D object pose estimation dataset for industrial
bin-picking", IROS 2019. The format follows a public reader (PPR-Net), because no files were
available. It is not verified that 0 and 65535 mean unknown depth.
"""

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from ...base.errors import DatasetError
from ...base.folder import visible_entries
from ...base.frames import inverse, rigid, rotation_from_quaternion
from ...dataset.files.records import Count, Positive, Vector
from ...dataset.files.safe_reading import Unreadable, record_as
from .model_files import NO_MODELS, ModelFile, read_models
from .source import Source, SourceImage, SourceOptions
from .source_files import REPAIR, pose_of, record_of, source_image, stored_steps

SILEANE, IPA = "camera_params.txt", "parameter.json"
_IPA_DEPTH = "_depth_uint16.png"
_WHITE = 65535
_FROM_IPA = np.diag([-1.0, -1.0, 1.0, 1.0])  # converts x left, y up to x right, y down


class _Record(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)

    clip_start: Positive
    clip_end: Positive


class _CameraParams(_Record):
    width: Count
    height: Count
    fu: Positive
    fv: Positive
    cu: float
    cv: float
    location: Vector
    rotation: Annotated[list[float], Field(min_length=4, max_length=4)]


class _Parameter(_Record):
    perspectiveAngle: Annotated[float, Field(ge=0, lt=180)]  # [deg] field of view of the square
    resolutionX: Count
    resolutionY: Count
    resolution_big: Annotated[int, Field(ge=1)]
    pixelOffset_X_KoSyTopLeft: int
    pixelOffset_Y_KoSyTopLeft: int


class _Pose(BaseModel):
    R: Annotated[list[Vector], Field(min_length=3, max_length=3)]
    t: Vector


@dataclass(frozen=True, slots=True, kw_only=True)
class _Camera:
    """Data that all images of a folder share; `rgb_name` and `poses` take a depth file's path."""

    path: Path
    K: list[float]
    size_px: tuple[int, int]  # columns and rows
    record: _Record
    unknown: tuple[int, ...]
    rgb_name: Callable[[Path], Path]
    poses: Callable[[Path], list[np.ndarray]]


def open_sileane(folder: Path, options: SourceOptions) -> Source:
    """Open the images of one object of the Siléane dataset, numbered in the order of names.

    Raises:
        DatasetError: a file is missing, damaged or contradicts another.
    """
    path = folder / SILEANE
    try:
        rows = (line.split() for line in path.read_text(encoding="utf-8").splitlines())
        numbers = {key: [float(value) for value in values] for key, *values in filter(None, rows)
                   if key in _CameraParams.model_fields}  # fmt: skip
        content = {k: v[0] if len(v) == 1 else v for k, v in numbers.items()}
        camera = record_as(content, _CameraParams, str(path))
    except (OSError, ValueError, Unreadable) as error:
        raise DatasetError(f"{path}: cannot be read ({error}): {REPAIR}") from error
    w, *xyz = camera.rotation
    R = rotation_from_quaternion(np.array([*xyz, w]) / max(np.linalg.norm(camera.rotation), 1e-9))
    T_cam_world = inverse(rigid(R, np.array(camera.location)))
    common = _Camera(
        path=path,
        K=[camera.fu, 0.0, camera.cu, 0.0, camera.fv, camera.cv, 0.0, 0.0, 1.0],
        size_px=(camera.width, camera.height),
        record=camera,
        unknown=(_WHITE,),
        rgb_name=_rgb_of_sileane,
        poses=partial(_poses_of_sileane, T_cam_world),
    )
    name = "depth_gt" if (folder / "depth_gt").is_dir() else "depth"
    inside = visible_entries(folder / name) if (folder / name).is_dir() else []
    files = [path for path in inside if path.suffix.lower() == ".png"]
    return _source(folder, {(0, i): path for i, path in enumerate(files)}, common, options)


def _rgb_of_sileane(depth: Path) -> Path:
    return depth.parents[1] / "rgb" / depth.name


def _poses_of_sileane(T_cam_world: np.ndarray, depth: Path) -> list[np.ndarray]:
    file = depth.parents[1] / "gt" / f"{depth.stem}.json"
    stored = enumerate(record_of(file, list[_Pose]))
    return [T_cam_world @ pose_of(one.R, one.t, f"{file}, instance {i}") for i, one in stored]


def open_ipa(folder: Path, options: SourceOptions) -> Source:
    """Open the images in a folder of the IPA dataset; each cycle is a scene.

    Raises:
        DatasetError: depth is orthographic, or a file is missing, damaged or contradicts another.
    """
    path = folder / IPA
    camera = record_of(path, _Parameter)
    if camera.perspectiveAngle == 0 or not (folder / "p_depth").is_dir():
        raise DatasetError(
            f"{path}: of orthographic depth, which no camera takes: give a folder with p_depth and "
            "a perspectiveAngle greater than 0"
        )
    big = camera.resolution_big
    f = big / 2 / math.tan(math.radians(camera.perspectiveAngle) / 2)
    cx, cy = (
        (big - 1) / 2 - offset
        for offset in (camera.pixelOffset_X_KoSyTopLeft, camera.pixelOffset_Y_KoSyTopLeft)
    )
    common = _Camera(
        path=path,
        K=[f, 0.0, cx, 0.0, f, cy, 0.0, 0.0, 1.0],
        size_px=(camera.resolutionX, camera.resolutionY),
        record=camera,
        unknown=(0, _WHITE),
        rgb_name=partial(_beside, "p_rgb", "_rgb.png"),
        poses=_poses_of_ipa,
    )
    images = {}
    for file in sorted((folder / "p_depth").glob(f"cycle_*/*{_IPA_DEPTH}")):
        place = f"{file.parent.name}/{file.name}"
        if match := re.fullmatch(rf"cycle_(\d+)/(\d+){_IPA_DEPTH}", place):
            images[int(match[1]), int(match[2])] = file
    return _source(folder, images, common, options)


def _beside(kind: str, end: str, depth: Path) -> Path:
    """Return the path of another file that belongs to the same image as a depth file."""
    name = depth.name.removesuffix(_IPA_DEPTH) + end
    return depth.parents[2] / kind / depth.parent.name / name


def _poses_of_ipa(depth: Path) -> list[np.ndarray]:
    path = _beside("gt", ".csv", depth)
    if int(path.stem) == 0 and not path.exists():  # Image 0 of a cycle shows the empty bin.
        return []
    try:
        lines = path.read_text(encoding="utf-8").splitlines()[1:]
        rows = [[float(word) for word in line.split(",")] for line in lines if line.strip()]
        if any(len(row) < 14 for row in rows):
            raise ValueError("a row has less than 14 numbers")
    except (OSError, ValueError) as error:
        raise DatasetError(f"{path}: cannot be read ({error}): {REPAIR}") from error
    return [
        _FROM_IPA @ pose_of(np.reshape(row[5:14], (3, 3)).T, row[2:5], f"{path}, id {row[0]:g}")
        for row in rows
        if row[0] > 0
    ]


def _source(
    folder: Path, files: Mapping[tuple[int, int], Path], camera: _Camera, options: SourceOptions
) -> Source:
    if not files:
        raise DatasetError(f"{folder}: has no depth pictures: download it again")
    models = NO_MODELS
    if not options.depth_only:
        mesh = options.models or folder
        mesh = mesh / "mesh.ply" if mesh.is_dir() else mesh
        if not mesh.is_file():
            raise DatasetError(
                f"{mesh}: no such mesh: give --models FILE, or leave objects out with --depth-only"
            )
        unit, stated = options.unit or "m", options.unit is not None
        model = ModelFile(path=mesh, name=folder.name, unit=unit, unit_stated=stated)
        models = read_models({1: model}, {1}, options.materials)
    return Source(
        folder=folder,
        split=folder.name,
        images=tuple(files),
        parts=models.parts,
        plain=models.plain,
        notes=models.notes,
        image_of=partial(_image, files, camera, options.depth_only),
    )


def _image(
    files: Mapping[tuple[int, int], Path],
    camera: _Camera,
    depth_only: bool,
    scene_id: int,
    image_id: int,
) -> SourceImage:
    depth = files[scene_id, image_id]
    steps: Any = stored_steps(depth)
    rows, columns = steps.shape
    if steps.dtype != np.uint16 or (columns, rows) != camera.size_px:
        w, h = camera.size_px
        raise DatasetError(
            f"{depth}: is {steps.dtype}, {columns} x {rows} pixels, and {camera.path.name} says "
            f"{w} x {h} with 16 bits: download both again"
        )
    start_m, end_m = camera.record.clip_start, camera.record.clip_end
    if start_m >= end_m:
        raise DatasetError(f"{camera.path}: clip_start {start_m} is not before clip_end: {REPAIR}")
    depth_m = start_m + (end_m - start_m) * steps / float(_WHITE)
    rgb = camera.rgb_name(depth)
    return source_image(
        np.where(np.isin(steps, camera.unknown), np.nan, depth_m),
        rgb if rgb.is_file() else None,
        (camera.K, str(camera.path)),
        () if depth_only else [(1, T) for T in camera.poses(depth)],
        step_m=(end_m - start_m) / _WHITE,
    )
