"""One scene folder of a dataset, judged from its files alone."""

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Int

from ..decode import Reason
from ..frames import is_rigid
from . import records
from .mask_check import mask_problems
from .plain_scene import Model, Plain, transform_of
from .raw_check import raw_problems
from .reading import Unreadable, png_kind
from .records import OneImage
from .scene_folder import SceneFolder
from .sense import Evidence, sense_problems

BOX_MM = 1e-3  # of 3D boxes, whose sizes the models hold to nine digits

_SCENE_JSON = {
    "scene_camera": OneImage[records.View],
    "scene_gt": OneImage[list[records.Pose]],
    "scene_gt_info": OneImage[list[records.Info]],
    "scene_gt_coco": records.SceneCoco,
}
_IMAGES = {
    "rgb": np.uint8,
    "depth": np.uint16,
    "gray_sl": np.uint8,
    "depth_sl": np.uint16,
    "reason_sl": np.uint8,
    "modulation_sl": np.uint16,
}


def scene_problems(
    folder: Path, *, claim: records.Claim, camera: records.Camera, models: Mapping[int, Model]
) -> Iterator[str]:
    """All that is wrong with one scene folder; nothing if it is sound."""
    try:
        scene = _read_scene(SceneFolder(folder))
    except Unreadable as error:
        yield str(error)
        return
    yield from _camera_problems(scene, camera)
    yield from _pose_problems(scene, models)
    unfit = tuple(_image_problems(folder, scene, camera))
    yield from unfit
    if unfit:
        return
    yield from _scanner_problems(scene)
    gray, reason = scene.image["gray_sl"], scene.image["reason_sl"]
    yield from raw_problems(folder, camera, gray=gray, reason=reason)
    instance = np.full(reason.shape, -1)
    try:
        yield from mask_problems(folder, scene, camera, models, instance)
        if all(pose.obj_id in models for pose in scene.poses):
            evidence = _evidence(folder, scene, claim, camera, models, instance)
            yield from sense_problems(evidence)
    except Unreadable as error:
        yield str(error)


def _evidence(
    folder: Path,
    scene: Plain,
    claim: records.Claim,
    camera: records.Camera,
    models: Mapping[int, Model],
    instance: Int[np.ndarray, "h w"],
) -> Evidence:
    placed = ((models[p.obj_id], transform_of(p.cam_R_m2c, p.cam_t_m2c)) for p in scene.poses)
    return Evidence(
        scene_id=int(folder.name),
        claim=claim,
        manifest=scene.manifest,
        lens=scene.lens,
        view=scene.view,
        poses=scene.poses,
        scanner=scene.scanner,
        rgb=scene.image["rgb"],
        gray=scene.image["gray_sl"],
        depth=scene.image["depth"],
        depth_sl=scene.image["depth_sl"],
        reason=scene.image["reason_sl"],
        modulation_step=scene.image["modulation_sl"],
        instance=instance,
        parts_mm=tuple(model.vertices @ T[:3, :3].T + T[:3, 3] for model, T in placed),
    )


def _read_scene(files: SceneFolder) -> Plain:
    read = {
        name + suffix: files.record(name + suffix, form)
        for name, form in _SCENE_JSON.items()
        for suffix in ("", "_sl")
    }
    for name in ("scene_camera", "scene_gt"):
        if read[name] != read[f"{name}_sl"]:
            raise Unreadable(f"{name}_sl.json differs from {name}.json: both look through one lens")
    return Plain(
        image={name: files.png(name) for name in _IMAGES},
        view=read["scene_camera"].image,
        poses=read["scene_gt"].image,
        info={suffix: read[f"scene_gt_info{suffix}"].image for suffix in ("", "_sl")},
        coco={suffix: read[f"scene_gt_coco{suffix}"] for suffix in ("", "_sl")},
        box3d=files.record("scene_gt_box3d", OneImage[list[records.Box3d]]).image,
        scanner=files.record("scene_sl", OneImage[records.ScannerRecord]).image,
        manifest=files.record("manifest", records.Manifest).root,
    )


def _image_problems(folder: Path, scene: Plain, camera: records.Camera) -> Iterator[str]:
    for name, image in scene.image.items():
        kind = png_kind(SceneFolder(folder).png_path(name))
        if kind != ("colour" if name == "rgb" else "grey"):
            yield f"{name}/000000.png is a PNG of the kind {kind}, which no writer of ours makes"
        shape = (camera.height, camera.width, 3)[: 3 if name == "rgb" else 2]
        if image.shape != shape or image.dtype != _IMAGES[name]:
            is_, must = f"{image.shape} {image.dtype}", f"{shape} {np.dtype(_IMAGES[name])}"
            yield f"{name}/000000.png is {is_}, it must be {must}"


def _camera_problems(scene: Plain, camera: records.Camera) -> Iterator[str]:
    K = [camera.fx, 0.0, camera.cx, 0.0, camera.fy, camera.cy, 0.0, 0.0, 1.0]
    if scene.view.cam_K != K or scene.view.distortion != camera.distortion:
        yield f"scene_camera.json: cam_K {scene.view.cam_K} is not that of camera.json, {K}"
    if scene.view.depth_scale != camera.depth_scale:
        scales = f"{scene.view.depth_scale}, camera.json has {camera.depth_scale}"
        yield f"scene_camera.json: depth_scale is {scales}"
    if not is_rigid(transform_of(scene.view.cam_R_w2c, scene.view.cam_t_w2c)):
        yield "scene_camera.json: cam_R_w2c is not a rotation"


def _pose_problems(scene: Plain, models: Mapping[int, Model]) -> Iterator[str]:
    count = len(scene.poses)
    for name, entries in (
        ("scene_gt_info.json", scene.info[""]),
        ("scene_gt_info_sl.json", scene.info["_sl"]),
        ("scene_gt_box3d.json", scene.box3d),
    ):
        if len(entries) != count:
            yield f"{name} has {len(entries)} instances, scene_gt.json has {count}"
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
        yield f"scene_sl.json: reasons are {scene.scanner.reasons}, known are {table}"
    reason, depth = scene.image["reason_sl"], scene.image["depth_sl"]
    if not np.isin(reason, list(table.values())).all():
        yield f"reason_sl/000000.png has the unknown value {reason.max()}"
    wrong = int(((depth > 0) != (reason == Reason.DECODED)).sum())
    if wrong:
        yield f"depth_sl and reason_sl disagree in {wrong} pixels on whether there is a depth"
