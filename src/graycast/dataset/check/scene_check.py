"""Check one scene folder of a dataset from its files alone."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Float

from ...base.frames import is_rigid
from ...camera.decode import Reason
from ..files import records
from ..files.places import camera_file
from ..files.safe_reading import Form, Unreadable, is_intact_png, png_kind
from ..files.scene_folder import OWN_PICTURES, SceneFolder, of_sensor, own_form
from .mask_check import mask_problems
from .model_check import Model
from .plain_scene import Plain, holes_disagree, transform_of
from .raw_check import raw_problems

R = TypeVar("R")

BOX_MM = 1e-3  # This is a tolerance, because models store sizes with nine digits.
WORLD_MM, WORLD_TURN = 1e-6, 1e-9  # Poses from two cameras may differ by rounding.

_ONLY_FORM = ("rgb", "modulation_sl")  # No check reads the pixels of these pictures.
_OF_IMAGE = ("scene_camera", "scene_gt", "scene_gt_info")


def scene_problems(
    folder: Path,
    *,
    claim: records.Claim,
    cameras: Mapping[str, records.Camera],
    models: Mapping[int, Model],
) -> Iterator[str]:
    """Yield all problems of one scene folder.

    Args:
        cameras: intrinsics by the name of the scanner.
    """
    many = len(claim.images) > 1
    first: Plain | None = None
    for taker in claim.takers:
        files = SceneFolder(folder, taker.name)
        try:
            yield from _number_problems(files, taker.images)
            first_annotation = {"": 1, "_sl": 1}
            for number in range(taker.images):
                image = _read_image(files, number, range(taker.images), first_annotation)
                for suffix, coco in image.coco.items():
                    first_annotation[suffix] += len(coco.annotations)
                problems = _image_problems(image, cameras[taker.name], models)
                which = f"{' '.join(filter(None, ('image', str(number), taker.name)))}: "
                yield from ((which if many else "") + what for what in problems)
                first = first or image
                yield from _world_problems(first, image)
        except Unreadable as error:
            yield str(error)


def _number_problems(files: SceneFolder, count: int) -> Iterator[str]:
    """Compare the images in the records and in COCO's list with those that a scene must have."""
    must = set(range(count))
    for name in (*_OF_IMAGE, "scene_gt_box3d", "scene_sl"):
        for suffix in ("", "_sl") if name in _OF_IMAGE else ("",):
            images = set(files.record(name + suffix, records.Images[Any]))
            if images != must:
                odd = sorted(images ^ must)[0]
                yield (
                    f"{of_sensor(name + suffix, files.sensor)}.json tells of {len(images)} images, "
                    f"it must tell of {count}: see image {odd}"
                )
    for suffix in ("", "_sl"):
        coco = files.record(f"scene_gt_coco{suffix}", records.SceneCoco)
        numbers = [image.id for image in coco.images]
        places = [entry.image_id for entry in coco.annotations]
        if numbers != sorted(must) or places != sorted(places) or not set(places) <= must:
            name = of_sensor(f"scene_gt_coco{suffix}", files.sensor)
            yield f"{name}.json: images and image_id must go from 0 to {count - 1}"


def _world_problems(first: Plain, image: Plain) -> Iterator[str]:
    """Yield instances whose pose in the world differs from that in the first image."""
    if image is first:
        return
    where = f"{image.json_name('scene_gt')}: image {image.number}"
    if [pose.obj_id for pose in image.poses] != [pose.obj_id for pose in first.poses]:
        yield f"{where}: its instances are not those of the first image"
        return
    for i, (pose, other) in enumerate(zip(image.poses, first.poses, strict=True)):
        gap = image.T_world_cam @ _placed(pose) - first.T_world_cam @ _placed(other)
        if np.abs(gap[:3, :3]).max() > WORLD_TURN or np.abs(gap[:3, 3]).max() > WORLD_MM:
            yield (
                f"{where}: instance {i} lies {np.linalg.norm(gap[:3, 3]):.3g} mm from where the "
                "first image has it in the world"
            )


def _placed(pose: records.Pose) -> Float[np.ndarray, "4 4"]:
    return transform_of(pose.cam_R_m2c, pose.cam_t_m2c)


def _image_problems(
    scene: Plain, camera: records.Camera, models: Mapping[int, Model]
) -> Iterator[str]:
    yield from _camera_problems(scene, camera)
    yield from _pose_problems(scene, models)
    unfit = tuple(_picture_problems(scene, camera))
    yield from unfit
    if unfit:
        return
    yield from _scanner_problems(scene)
    gray, reason = scene.image["gray_sl"], scene.image["reason_sl"]
    yield from raw_problems(scene.files, scene.number, camera, gray=gray, reason=reason)
    try:
        yield from mask_problems(scene, camera, models)
    except Unreadable as error:
        yield str(error)


def _read_image(
    files: SceneFolder, number: int, numbers: range, first_annotation: Mapping[str, int]
) -> Plain:
    view = _of_both(files, "scene_camera", number, records.View)
    poses = _of_both(files, "scene_gt", number, list[records.Pose])
    info = _of_both(files, "scene_gt_info", number, list[records.Info])
    alike = {"scene_camera": view[""] == view["_sl"], "scene_gt": poses[""] == poses["_sl"]}
    for name, same in alike.items():
        if not same:
            one, other = (of_sensor(name + suffix, files.sensor) for suffix in ("_sl", ""))
            raise Unreadable(f"{one}.json differs from {other}.json: both look through one lens")
    return Plain(
        files=files,
        number=number,
        numbers=numbers,
        first_annotation=dict(first_annotation),
        image=_pictures(files, number),
        view=view[""],
        poses=poses[""],
        info=info,
        coco={suffix: _coco_of(files, suffix, number) for suffix in ("", "_sl")},
        box3d=files.of_image("scene_gt_box3d", number, list[records.Box3d]),
        scanner=files.of_image("scene_sl", number, records.ScannerRecord),
    )


def _pictures(files: SceneFolder, number: int) -> dict[str, np.ndarray]:
    """Read the pictures, except those of which only the form is checked, if they are intact."""
    names = (*OWN_PICTURES, *files.optional_pictures())
    image = {name: files.png(name, number) for name in names if name not in _ONLY_FORM}
    for name in _ONLY_FORM:
        form = own_form(name, image["depth"].shape[:2])
        if not is_intact_png(files.png_path(name, number), *form):
            image[name] = files.png(name, number)
    return image


def _of_both(files: SceneFolder, name: str, number: int, form: Form[R]) -> dict[str, R]:
    """Return the entry of one image in a JSON file, for both camera types."""
    return {suffix: files.of_image(name + suffix, number, form) for suffix in ("", "_sl")}


def _coco_of(files: SceneFolder, suffix: str, number: int) -> records.SceneCoco:
    """Return the part of a COCO file that describes one image."""
    whole = files.record(f"scene_gt_coco{suffix}", records.SceneCoco)
    own = {
        "images": [image for image in whole.images if image.id == number],
        "annotations": [entry for entry in whole.annotations if entry.image_id == number],
    }
    return whole.model_copy(update=own)


def _picture_problems(scene: Plain, camera: records.Camera) -> Iterator[str]:
    for name, image in scene.image.items():
        kind = png_kind(scene.files.png_path(name, scene.number))
        if kind != ("colour" if name == "rgb" else "grey"):
            yield f"{scene.name(name)} is a PNG of the kind {kind}, which no writer of ours makes"
        shape, dtype = own_form(name, (camera.height, camera.width))
        if image.shape != shape or image.dtype != dtype:
            is_, must = f"{image.shape} {image.dtype}", f"{shape} {np.dtype(dtype)}"
            yield f"{scene.name(name)} is {is_}, it must be {must}"


def _camera_problems(scene: Plain, camera: records.Camera) -> Iterator[str]:
    sensor = scene.files.sensor
    K = [camera.fx, 0.0, camera.cx, 0.0, camera.fy, camera.cy, 0.0, 0.0, 1.0]
    if scene.view.cam_K != K or scene.view.distortion != camera.distortion:
        name, must = scene.json_name("scene_camera"), camera_file(sensor)
        yield f"{name}: cam_K {scene.view.cam_K} is not that of {must}, {K}"
    if scene.view.depth_scale != camera.depth_scale:
        scales = f"{scene.view.depth_scale}, {camera_file(sensor)} has {camera.depth_scale}"
        yield f"{scene.json_name('scene_camera')}: depth_scale is {scales}"
    if not is_rigid(transform_of(scene.view.cam_R_w2c, scene.view.cam_t_w2c)):
        yield f"{scene.json_name('scene_camera')}: cam_R_w2c is not a rotation"


def _pose_problems(scene: Plain, models: Mapping[int, Model]) -> Iterator[str]:
    count = len(scene.poses)
    for name, entries in (
        ("scene_gt_info", scene.info[""]),
        ("scene_gt_info_sl", scene.info["_sl"]),
        ("scene_gt_box3d", scene.box3d),
    ):
        if len(entries) != count:
            yield f"{scene.json_name(name)} has {len(entries)} instances, scene_gt has {count}"
    for i, pose in enumerate(scene.poses):
        T = transform_of(pose.cam_R_m2c, pose.cam_t_m2c)
        if not is_rigid(T):
            yield f"instance {i}: cam_R_m2c is not a rotation"
        if pose.obj_id not in models:
            yield f"instance {i}: there is no model {pose.obj_id}"
        elif i < len(scene.box3d):
            info, box = models[pose.obj_id].info, scene.box3d[i]
            center = T[:3, :3] @ (np.array(info.low) + np.array(info.size) / 2) + T[:3, 3]
            wrong = np.abs([np.subtract(box.center, center), np.subtract(box.size, info.size)])
            if wrong.max() > BOX_MM or box.R != pose.cam_R_m2c:
                yield f"instance {i}: scene_gt_box3d.json is not its model's box at its pose"


def _scanner_problems(scene: Plain) -> Iterator[str]:
    table = {reason.name: reason.value for reason in Reason}
    if scene.scanner.reasons != table:
        name = scene.json_name("scene_sl")
        yield f"{name}: reasons are {scene.scanner.reasons}, known are {table}"
    reason = scene.image["reason_sl"]
    if not set(np.flatnonzero(np.bincount(reason.ravel()))) <= set(table.values()):
        yield f"{scene.name('reason_sl')} has the unknown value {reason.max()}"
    yield from holes_disagree(scene.image)
