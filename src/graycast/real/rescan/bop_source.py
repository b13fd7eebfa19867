"""Reader of datasets in BOP's form: the images of one camera in a split such as `lm/train_pbr`.

A scene has `scene_camera.json`, `scene_gt.json`, `rgb` or `gray`, and `depth`. With several
cameras, names end in the camera's name, like `depth_photoneo` and `scene_gt_photoneo.json` in IPD.
Only the pictures in `rgb`, or else in `gray`, are read, not `aolp` or `dolp`. Graycast's datasets
have this form, too: their perfect depth is read, but not their scanner's files (`_sl`).
BlenderProc's `write_bop` writes `<dataset>/train_pbr` next to `camera.json`, without models.

An image without an entry in `scene_gt.json` is refused, because its objects would be missing
without a message. An empty list means that the image has no objects.

Sources: github.com/thodan/bop_toolkit, docs/bop_datasets_format.md; github.com/DLR-RM/BlenderProc,
blenderproc/python/writer/BopWriterUtility.py.
"""

import re
from collections import Counter
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from ...base.errors import DatasetError
from ...dataset.files.records import MM_PER_M, Images, Positive
from ...dataset.files.safe_reading import Unreadable
from ...dataset.files.scene_folder import (
    PICTURES,
    SCANNER,
    AnyCamera,
    AnyInfo,
    AnyPose,
    SceneFolder,
    of_sensor,
    scene_folders,
)
from .model_files import NO_MODELS, bop_models, read_models
from .source import Source, SourceImage, SourceOptions
from .source_files import REPAIR, pose_of, source_image, stored_depth

CAMERAS = "scene_camera*.json"
DEPTHS = (*PICTURES, ".npy")
_NEAR = 0.02  # If all objects are nearer than this share of the median depth, the unit is wrong.


class _View(AnyCamera):
    """A camera whose depth scale may be missing, because the user may state it."""

    depth_scale: Positive | None = None


def open_bop(folder: Path, options: SourceOptions) -> Source:
    """Open a split and read its JSON files and models; pictures are read on demand.

    Raises:
        DatasetError: there are no images, `options` does not choose one of several cameras, or a
            file is missing, damaged or contradicts another.
        ConfigError: the materials file is not valid.
    """
    folders = scene_folders(folder, CAMERAS)
    if not folders:
        raise DatasetError(
            f"{folder}: has no scenes (folders such as 000000 with scene_camera.json): give a "
            "split such as lm/train_pbr"
        )
    scenes = {int(path.name): path for path in folders}
    if len(scenes) < len(folders):
        twice = next(path for path in folders if scenes[int(path.name)] != path)
        raise DatasetError(f"{twice}: another folder has the same number: rename one of them")
    sensor = _sensor(folder, folders, options.sensor)
    depth = of_sensor("depth", sensor)
    if not any((path / depth).is_dir() for path in folders):
        raise DatasetError(
            f"{folder}: its scenes have no folder {depth}: give a split, or a --sensor, with depth"
        )
    images: list[tuple[int, int]] = []
    obj_ids: set[int] = set()
    for number, path in sorted(scenes.items()):
        scene = SceneFolder(path, sensor)
        try:
            numbers = set(_entries(scene, "scene_camera", Images[Any]))
            if not options.depth_only:
                obj_ids |= _objects_of_scene(scene, numbers)
        except Unreadable as error:
            raise DatasetError(f"{path}/{error}: {REPAIR}") from error
        images += [(number, image) for image in sorted(numbers)]
    if not images:
        raise DatasetError(f"{folder}: its scenes have no images: give a split that has some")
    models = NO_MODELS
    if not options.depth_only:
        files = bop_models(folder.parent, options.models, options.unit)
        models = read_models(files, obj_ids, options.materials)
    return Source(
        folder=folder,
        split=folder.name,
        images=tuple(images),
        parts=models.parts,
        plain=models.plain,
        notes=models.notes,
        image_of=partial(_read, scenes, sensor, options),
        sensor="" if options.ray_length else sensor,
        # BOP stores z, so for ray lengths, the result needs new depth files instead of links.
        scenes={} if options.ray_length else scenes,
    )


def _read(
    scenes: Mapping[int, Path], sensor: str, options: SourceOptions, scene_id: int, image_id: int
) -> SourceImage:
    scene = SceneFolder(scenes[scene_id], sensor)
    try:
        view = scene.of_image("scene_camera", image_id, _View)
        where = f"{scene.path}/{of_sensor('scene_camera', scene.sensor)}.json: image {image_id}"
        scale_mm = options.depth_scale_mm or view.depth_scale
        if scale_mm is None:
            raise DatasetError(
                f"{where}: has no depth_scale: give the millimetres of one step of depth, such as "
                "--depth-scale 0.1"
            )
        stored = scene.find_picture("depth", image_id, DEPTHS)
        path = stored or scene.png_path("depth", image_id)
        depth_m, step_m = stored_depth(path, scale_mm / MM_PER_M)
        return source_image(
            depth_m,
            scene.find_picture("rgb", image_id) or scene.find_picture("gray", image_id),
            (view.cam_K, f"{where}: cam_K"),
            () if options.depth_only else _objects(scene, image_id, depth_m),
            step_m=step_m,
            distortion=view.distortion,
            ray_length=options.ray_length,
        )
    except Unreadable as error:
        raise DatasetError(f"{scene.path}/{error}: {REPAIR}") from error


def _objects(
    scene: SceneFolder, image_id: int, depth_m: Float[np.ndarray, "h w"]
) -> list[tuple[int, np.ndarray]]:
    stored = scene.of_instances("scene_gt", image_id, AnyPose)
    where = f"{scene.path}/{of_sensor('scene_gt', scene.sensor)}.json: image {image_id}"
    objects = [
        (
            one.obj_id,
            pose_of(one.cam_R_m2c, np.array(one.cam_t_m2c) / MM_PER_M, f"{where}, instance {i}"),
        )
        for i, one in enumerate(stored)
    ]
    z_m = np.array([T[2, 3] for _, T in objects], float)
    if (behind := _visible(scene, image_id, z_m) & (z_m <= 0)).any():
        i = int(np.flatnonzero(behind)[0])
        raise DatasetError(
            f"{where}, instance {i}: lies behind the camera (z is {z_m[i] * MM_PER_M:.4g} mm): "
            "poses go to OpenCV's frame, whose z points into the scene"
        )
    middle_m = float(np.nanmedian(depth_m)) if np.isfinite(depth_m).any() else 0.0
    if objects and 0 < z_m.max() < _NEAR * middle_m:
        raise DatasetError(
            f"{where}: every object lies within {z_m.max() * MM_PER_M:.4g} mm, and the depth is "
            f"about {middle_m * MM_PER_M:.4g} mm: give cam_t_m2c in millimetres (write_bop does "
            "with m2mm=True)"
        )
    return objects


def _sensor(folder: Path, folders: list[Path], request: str) -> str:
    """Return the name of the requested camera, or of the only camera, whose name may be empty."""
    stems = {file.stem for path in folders for file in path.glob(CAMERAS)}
    names = {stem.removeprefix("scene_camera").removeprefix("_") for stem in stems}
    sensors = sorted(name for name in names if not f"_{name}".endswith(SCANNER))
    if request in sensors:
        return request
    if not request and len(sensors) == 1:
        return sensors[0]
    listed = ", ".join(name for name in sensors if name)
    if not listed:
        raise DatasetError(f"{folder}: has one camera without a name: leave out --sensor {request}")
    problem = f"no sensor {request}" if request else "several sensors"
    raise DatasetError(f"{folder}: has {problem}: give --sensor NAME, one of {listed}")


def _entries(scene: SceneFolder, name: str, form: Any) -> Mapping[int, Any]:
    """Return the entries of a JSON file by image number; refuse a number that is listed twice."""
    path = scene.path / f"{of_sensor(name, scene.sensor)}.json"
    entries = scene.record(name, form)
    # A JSON reader keeps only the last of equal keys. In these files, numeric keys are images.
    numbers = Counter(int(key) for key in re.findall(rb'"(\d+)"\s*:', path.read_bytes()))
    if twice := [number for number, count in numbers.items() if count > 1]:
        raise Unreadable(f"{path.name}: image {twice[0]} is listed twice")
    return entries


def _objects_of_scene(scene: SceneFolder, numbers: set[int]) -> set[int]:
    """Check the form of the poses of a scene, and return the ids of its objects."""
    name = f"{of_sensor('scene_gt', scene.sensor)}.json"
    poses = _entries(scene, "scene_gt", Images[list[AnyPose]])
    listed = set(poses)
    if without := sorted(numbers - listed):
        raise Unreadable(
            f"{name} says nothing of image {without[0]} (without objects, give it an empty list; "
            "to leave out all objects, give --depth-only)"
        )
    if without := sorted(listed - numbers):
        camera = f"{of_sensor('scene_camera', scene.sensor)}.json"
        raise Unreadable(f"{camera} says nothing of image {without[0]}, which {name} has")
    return {one.obj_id for objects in poses.values() for one in objects}


def _visible(
    scene: SceneFolder, image_id: int, z_m: Float[np.ndarray, " n"]
) -> Bool[np.ndarray, " n"]:
    """Return a mask of the visible instances of an image, or of the farthest if that is unknown.

    Some renderers also list objects outside the image, which may be behind the camera.
    """
    name = f"{of_sensor('scene_gt_info', scene.sensor)}.json"
    if not (scene.path / name).is_file():
        return z_m == z_m.max(initial=-np.inf)
    infos = scene.of_instances("scene_gt_info", image_id, AnyInfo)
    if len(infos) != len(z_m):
        counts = f"{len(infos)} instances of image {image_id}, scene_gt has {len(z_m)}"
        raise Unreadable(f"{name} has {counts}")
    return np.array([info.px_count_visib > 0 for info in infos], bool)
