"""Read examples from other datasets: COCO annotations, and folders in BOP's form.

Each picture is an example. Examples are numbered in the order of their files, and an example's name
identifies its picture.
"""

import glob
import json
from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, final

import cv2
import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from ...base.errors import DatasetError
from ...base.file_limits import check_runs, parse_json
from ...base.folder import leads_out
from ..files.records import Images, Positive
from ..files.safe_reading import Unreadable, pixels
from ..files.scene_folder import (
    SCANNER,
    AnyInfo,
    AnyPose,
    AnyView,
    SceneFolder,
    dead_links,
    scene_folders,
)
from ..read.example import Example, metres, pose_m
from ..read.rescanned import SCANNED_POSES, image_record, is_rescanned, read_rescan
from .from_bytes import boxes, compressed, masks


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Foreign:
    """A dataset that Graycast did not make.

    Attributes:
        scene_of: the scene of each example; the pictures of a scene stay in one set.
        categories: object ids and names.
        read: function that returns an example by its number.
    """

    scene_of: tuple[int, ...]
    categories: Mapping[int, str]
    read: Callable[[int], Example]


def is_foreign(path: Path) -> bool:
    """Return whether a path is a JSON file, or a folder of scenes in BOP's form."""
    is_bop = scene_folders(path) or scene_folders(path, SCANNED_POSES)
    return path.suffix == ".json" or bool(is_bop)


def open_foreign(path: Path) -> Foreign:
    """Read the annotations; pictures are read on demand.

    Args:
        path: a file of COCO annotations, with its pictures in the same folder or in the one above;
            or a folder with the scenes of one of BOP's splits, such as `train_pbr`.

    Raises:
        DatasetError: a file is missing, damaged, or not of the required form.
    """
    return _open_coco(path) if path.suffix == ".json" else _open_bop(path)


# --- COCO ---------------------------------------------------------------------------------------


class _Entry(BaseModel):
    """An entry of a COCO list; error messages use the descriptions of its fields."""

    model_config = ConfigDict(frozen=True, extra="ignore", strict=True, allow_inf_nan=False)


_Text = Annotated[str, Field(min_length=1)]


class _Image(_Entry):
    id: int | _Text = Field(description="a number")
    file_name: _Text = Field(description="the name of a file")


class _Category(_Entry):
    id: int = Field(description="a whole number")
    name: _Text = Field(description="a word")


class _Annotation(_Entry):
    image_id: int | _Text = Field(description="the id of an image")
    category_id: int = Field(description="a whole number, the id of a category")
    bbox: list[float] = Field(
        min_length=4, max_length=4, description="four numbers [x, y, width, height] in pixels"
    )


_COCO: Mapping[str, type[_Entry]] = {
    "images": _Image,
    "categories": _Category,
    "annotations": _Annotation,
}


def _open_coco(path: Path) -> Foreign:
    content = _json(path)
    for name, form in _COCO.items():
        if not isinstance(content, dict) or not isinstance(content.get(name), list):
            raise DatasetError(f"{path}: holds no COCO annotations (a list of {name} is missing)")
        for number, entry in enumerate(content[name]):
            _check(entry, form, f"{path}: {name}[{number}]")
    refuse_repeated(content, str(path))
    # If a file mixes numeric and text ids, numbers come first.
    images = sorted(content["images"], key=lambda one: (isinstance(one["id"], str), one["id"]))
    if not images:
        raise DatasetError(f"{path}: has no images")
    categories = {entry["id"]: entry["name"] for entry in content["categories"]}
    entries: dict[Any, list[dict[str, Any]]] = defaultdict(list)
    for number, entry in enumerate(content["annotations"]):
        if entry["category_id"] not in categories:
            raise DatasetError(
                f"{path}: annotations[{number}] has category_id {entry['category_id']}, and "
                "categories do not list it: add the category, or remove the annotation"
            )
        entries[entry["image_id"]].append(entry)
    return Foreign(
        scene_of=tuple(range(len(images))),
        categories=categories,
        read=partial(_coco_example, path, tuple(images), dict(entries)),
    )


def refuse_repeated(content: Mapping[str, Any], where: str) -> None:
    """Refuse a COCO file in which two images or categories share an id, or two categories a name.

    A reader would confuse the two entries.

    Raises:
        DatasetError: the text names the first such pair and its place in the file.
    """
    for kind, key in (("images", "id"), ("categories", "id"), ("categories", "name")):
        place: dict[Any, int] = {}
        for number, entry in enumerate(content[kind]):
            if (first := place.setdefault(entry[key], number)) != number:
                raise DatasetError(
                    f"{where}: {kind}[{first}] and {kind}[{number}] have the same {key} "
                    f"{entry[key]}: give each its own, or remove one of them"
                )


def _check(entry: Any, form: type[_Entry], place: str) -> None:
    """Check that an entry has the keys that are read, and that they hold valid values."""
    try:
        form.model_validate(entry)
    except ValidationError as error:
        first = error.errors()[0]
        if not first["loc"]:
            raise DatasetError(
                f"{place} is {_short(entry)}: it must be an object with "
                f"{', '.join(form.model_fields)}"
            ) from error
        key = str(first["loc"][0])
        remedy = form.model_fields[key].description
        if first["type"] == "missing":
            why = f"has no {key}: add it ({remedy}), or remove the entry"
        else:
            why = f"has {key} {_short(entry[key])}: it must be {remedy}"
        raise DatasetError(f"{place} {why}") from error


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 40 else f"{text[:37]}..."


def _coco_example(
    path: Path, images: tuple[dict[str, Any], ...], entries: Mapping[Any, list], number: int
) -> Example:
    image = images[number]
    file = _beside(path, image["file_name"])
    rgb = _colour(file)
    size = rgb.shape[:2]
    labels = entries.get(image["id"], [])
    name = f"{path}: image {image['id']}"
    shapes = [entry.get("segmentation") or [] for entry in labels]
    mask = None
    if all(shapes):
        mask = masks([_run(each, size, name) for each in shapes], size, name)
    return Example(
        scene_id=number,
        rgb=rgb,
        obj_id=np.array([entry["category_id"] for entry in labels], np.int64),
        mask=mask,
        box_px=np.array([entry["bbox"] for entry in labels], np.float32).reshape(-1, 4),
        ignored=np.array([bool(entry.get("iscrowd", 0)) for entry in labels], bool),
    )


def _run(shape: Any, size: tuple[int, int], name: str) -> dict[str, Any]:
    """Return compressed run lengths of polygons or run lengths."""
    try:
        if not isinstance(shape, list):
            check_runs(shape, f"{name}: a segmentation", DatasetError)
        return compressed(shape, size)
    except KeyError as error:
        raise DatasetError(f"{name}: a segmentation is damaged ({error} is missing)") from error
    except (TypeError, ValueError) as error:
        raise DatasetError(f"{name}: a segmentation is damaged ({error})") from error


def _beside(path: Path, name: str) -> Path:
    """Return the path of a picture near the annotations: in their folder, the one above, or below.

    Raises:
        DatasetError: no such picture exists, or its name leads out of these folders.
    """
    if leads_out(name):
        raise DatasetError(
            f"{path}: picture {name} leads out of the folder: give its name without the folders "
            "before it; pictures are found beside the annotations, beside their folder, and in the "
            "folders there"
        )
    name = name.replace("\\", "/")  # Windows separates folders by backslashes.
    plain = glob.escape(name)  # Brackets in a name are not a pattern.
    for folder in (path.parent, path.parent.parent):
        for file in (folder / name, *folder.glob(f"*/{plain}"), *folder.glob(f"*/*/{plain}")):
            if file.is_file():
                return file
    raise DatasetError(
        f"{path}: picture {name} is neither beside the annotations nor in a folder near them"
    )


# --- BOP ----------------------------------------------------------------------------------------


class _View(AnyView):
    """One image in `scene_camera.json`; the scale is optional, since there may be no depth."""

    depth_scale: Positive = 1.0


@dataclass(frozen=True, slots=True)
class _Place:
    """An image of a scene; `perfect` is the folder of its error-free pictures, or None."""

    scene: SceneFolder
    image: int
    perfect: SceneFolder | None


def _open_bop(path: Path) -> Foreign:
    rescan = read_rescan(path.parent) if is_rescanned(path.parent) else None
    place: list[_Place] = []
    obj_ids: set[int] = set()
    for folder in scene_folders(path) if rescan is None else scene_folders(path, SCANNED_POSES):
        for problem in dead_links(folder):
            raise DatasetError(problem)
        scene = SceneFolder(folder, "" if rescan is None else SCANNER[1:])
        alike = rescan is not None and rescan.config["camera"] == "image"
        perfect = SceneFolder(folder, rescan.config["sensor"]) if rescan and alike else None
        try:
            annotations = scene.record("scene_gt", Images[list[AnyPose]])
        except Unreadable as error:
            raise DatasetError(
                f"{folder}/{error}: each key must be the number of an image, and hold the list of "
                "its objects, each with obj_id (a whole number), cam_R_m2c and cam_t_m2c"
            ) from error
        place += [_Place(scene, image, perfect) for image in sorted(annotations)]
        obj_ids |= {one.obj_id for objects in annotations.values() for one in objects}
    names = {} if rescan is None else rescan.names
    return Foreign(
        scene_of=tuple(int(one.scene.path.name) for one in place),
        categories={i: names.get(i, f"obj_{i:06d}") for i in sorted(obj_ids)},
        read=partial(_bop_example, tuple(place)),
    )


def _bop_example(place: tuple[_Place, ...], number: int) -> Example:
    """Return an example; `depth_m` equals the scanner depth unless there is a perfect depth."""
    scene, image, perfect = place[number].scene, place[number].image, place[number].perfect
    try:
        poses = scene.of_instances("scene_gt", image, AnyPose)
        infos = scene.of_instances("scene_gt_info", image, AnyInfo)
        camera = scene.of_image("scene_camera", image, _View)
        rgb, gray, steps = (scene.picture(kind, image) for kind in ("rgb", "gray", "depth"))
        size = next((array.shape[:2] for array in (rgb, gray, steps) if array is not None), None)
        if size is None:
            raise Unreadable(f"image {image} has no rgb, gray or depth")
        if len(poses) != len(infos):
            counts = f"{len(poses)} objects in scene_gt.json, {len(infos)} in scene_gt_info.json"
            raise Unreadable(f"image {image} has {counts}")
        instances = [i for i, info in enumerate(infos) if info.px_count_visib > 0]
        mask = np.zeros((len(instances), *size), dtype=bool)
        for k, i in enumerate(instances):
            visible = scene.mask("mask_visib", i, image)
            if visible.shape != size:
                raise Unreadable(f"image {image}: mask {i} is {visible.shape}, the picture {size}")
            if not visible.any():
                count = infos[i].px_count_visib
                raise Unreadable(f"image {image}: mask {i} is empty, and px_count_visib is {count}")
            mask[k] = visible
    except Unreadable as error:
        raise DatasetError(
            f"{scene.path}: {error}: training needs a picture, the visible masks of every "
            "instance, and the image in scene_gt.json, scene_gt_info.json and scene_camera.json: "
            "repair the damaged files, or remove the image from all three"
        ) from error
    pose = [pose_m(poses[i].cam_R_m2c, poses[i].cam_t_m2c) for i in instances]
    scanner_depth_m = None if steps is None else metres(steps, camera.depth_scale)
    depth_m = None if scanner_depth_m is None else scanner_depth_m.copy()
    if perfect is not None:
        rgb, steps = perfect.picture("rgb", image), perfect.picture("depth", image)
        step_mm = image_record(scene.path, image).perfect_step_mm
        depth_m = metres(steps, step_mm) if steps is not None and step_mm else None
    return Example(
        scene_id=number,
        K=np.array(camera.cam_K, float).reshape(3, 3),
        rgb=None if rgb is None else np.ascontiguousarray(rgb[..., :3][..., ::-1]),
        gray=gray,
        depth_m=depth_m,
        scanner_depth_m=scanner_depth_m,
        instance=np.array(instances, np.int64),
        obj_id=np.array([poses[i].obj_id for i in instances], np.int64),
        mask=mask,
        box_px=boxes(mask) if instances else np.zeros((0, 4), np.float32),
        T_cam_part=np.array(pose, float).reshape(-1, 4, 4),
        visib_fract=np.array([infos[i].visib_fract for i in instances], float),
    )


# --- both ---------------------------------------------------------------------------------------


def _json(path: Path) -> Any:
    try:
        return parse_json(_bytes(path))
    except ValueError as error:
        raise DatasetError(f"{path}: is not JSON, or is cut off") from error


def _bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise DatasetError(f"{path}: cannot be read ({error.strerror})") from error


def _colour(file: Path) -> np.ndarray:
    try:
        image = pixels(_bytes(file), str(file))
    except Unreadable as error:
        raise DatasetError(f"{error}: correct the picture, or remove it from the list") from error
    if image.dtype != np.uint8:
        raise DatasetError(f"{file}: is {image.dtype}, but a colour picture must have 8 bits")
    if image.ndim == 2:
        return cv2.cvtColor(image, cv2.COLOR_GRAY2RGB)
    return np.ascontiguousarray(image[..., :3][..., ::-1])
