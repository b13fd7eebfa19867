"""One scene folder of a dataset, judged from its files alone."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int, UInt16
from pycocotools import mask as coco_mask

from ..decode import Reason
from ..frames import is_rigid, rigid
from ..optics import Optics
from ..raster import Raster, rasterize
from . import records
from .raw_check import raw_problems
from .reading import Unreadable, read_json, read_png

# A pixel whose centre lies very near an edge may fall to either side in a renderer of single
# precision: in none or one of a mask's pixels when Mitsuba drew 40 built-in parts. One in fifty of
# the pixels along an outline and two more are allowed; a shift by a twentieth of a pixel is more.
EDGE_SHARE, EDGE_PX = 0.02, 2
# Off edges, depths differ by rounding to the scale and by single precision at grazing incidence.
DEPTH_TOLERANCE_MM = 0.02
DEPTH_SHARE, DEPTH_PX = 0.01, 2
BOX_MM = 1e-3  # of 3D boxes, whose sizes the models hold to nine digits

_SCENE_JSON = {
    "scene_camera": records.SceneCamera,
    "scene_gt": records.SceneGt,
    "scene_gt_info": records.SceneGtInfo,
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Model:
    """What `models/` says of one object [mm]."""

    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]
    info: records.ModelInfo


@dataclass(frozen=True, slots=True, kw_only=True)
class _Plain:
    """The images and records of one scene; `info` and `coco` by camera type."""

    image: Mapping[str, np.ndarray]
    view: records.View
    poses: list[records.Pose]
    info: Mapping[str, list[records.Info]]
    coco: Mapping[str, records.SceneCoco]
    box3d: list[records.Box3d]
    scanner: records.Scanner


def scene_problems(
    folder: Path, *, camera: records.Camera, models: Mapping[int, Model]
) -> Iterator[str]:
    """All that is wrong with one scene folder; nothing if it is sound."""
    try:
        scene = _read_scene(folder)
    except Unreadable as error:
        yield str(error)
        return
    yield from _camera_problems(scene, camera)
    yield from _pose_problems(scene, models)
    unfit = tuple(_image_problems(scene, camera))
    yield from unfit
    if unfit:
        return
    yield from _scanner_problems(scene)
    gray, reason = scene.image["gray_sl"], scene.image["reason_sl"]
    yield from raw_problems(folder, camera, gray=gray, reason=reason)
    try:
        yield from _mask_problems(folder, scene, camera, models)
    except Unreadable as error:
        yield str(error)


def _read_scene(folder: Path) -> _Plain:
    read = {
        name + suffix: read_json(folder / f"{name}{suffix}.json", form)
        for name, form in _SCENE_JSON.items()
        for suffix in ("", "_sl")
    }
    read_json(folder / "manifest.json", records.Manifest)
    for name in ("scene_camera", "scene_gt"):
        if read[name] != read[f"{name}_sl"]:
            raise Unreadable(f"{name}_sl.json differs from {name}.json: both look through one lens")
    return _Plain(
        image={name: read_png(folder / name / "000000.png") for name in _IMAGES},
        view=read["scene_camera"].image,
        poses=read["scene_gt"].image,
        info={suffix: read[f"scene_gt_info{suffix}"].image for suffix in ("", "_sl")},
        coco={suffix: read[f"scene_gt_coco{suffix}"] for suffix in ("", "_sl")},
        box3d=read_json(folder / "scene_gt_box3d.json", records.SceneBox3d).image,
        scanner=read_json(folder / "scene_sl.json", records.SceneScanner).image,
    )


def _image_problems(scene: _Plain, camera: records.Camera) -> Iterator[str]:
    for name, image in scene.image.items():
        shape = (camera.height, camera.width, 3)[: 3 if name == "rgb" else 2]
        if image.shape != shape or image.dtype != _IMAGES[name]:
            is_, must = f"{image.shape} {image.dtype}", f"{shape} {np.dtype(_IMAGES[name])}"
            yield f"{name}/000000.png is {is_}, it must be {must}"


def _camera_problems(scene: _Plain, camera: records.Camera) -> Iterator[str]:
    K = [camera.fx, 0.0, camera.cx, 0.0, camera.fy, camera.cy, 0.0, 0.0, 1.0]
    if scene.view.cam_K != K or scene.view.distortion != camera.distortion:
        yield f"scene_camera.json: cam_K {scene.view.cam_K} is not that of camera.json, {K}"
    if scene.view.depth_scale != camera.depth_scale:
        scales = f"{scene.view.depth_scale}, camera.json has {camera.depth_scale}"
        yield f"scene_camera.json: depth_scale is {scales}"
    if not is_rigid(_transform(scene.view.cam_R_w2c, scene.view.cam_t_w2c)):
        yield "scene_camera.json: cam_R_w2c is not a rotation"


def _pose_problems(scene: _Plain, models: Mapping[int, Model]) -> Iterator[str]:
    count = len(scene.poses)
    for name, entries in (
        ("scene_gt_info.json", scene.info[""]),
        ("scene_gt_info_sl.json", scene.info["_sl"]),
        ("scene_gt_box3d.json", scene.box3d),
    ):
        if len(entries) != count:
            yield f"{name} has {len(entries)} instances, scene_gt.json has {count}"
    for i, pose in enumerate(scene.poses):
        T = _transform(pose.cam_R_m2c, pose.cam_t_m2c)
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


def _scanner_problems(scene: _Plain) -> Iterator[str]:
    table = {reason.name: reason.value for reason in Reason}
    if scene.scanner.reasons != table:
        yield f"scene_sl.json: reasons are {scene.scanner.reasons}, known are {table}"
    reason, depth = scene.image["reason_sl"], scene.image["depth_sl"]
    if not np.isin(reason, list(table.values())).all():
        yield f"reason_sl/000000.png has the unknown value {reason.max()}"
    wrong = int(((depth > 0) != (reason == Reason.DECODED)).sum())
    if wrong:
        yield f"depth_sl and reason_sl disagree in {wrong} pixels on whether there is a depth"


def _mask_problems(
    folder: Path, scene: _Plain, camera: records.Camera, models: Mapping[int, Model]
) -> Iterator[str]:
    count = len(scene.poses)
    names = [f"000000_{i:06d}.png" for i in range(count)]
    for kind in ("mask", "mask_visib", "mask_sl", "mask_visib_sl"):
        there = sorted(path.name for path in (folder / kind).glob("*"))
        if there != names:
            odd = min(set(there) ^ set(names))
            yield f"{kind}/ has {len(there)} files for {count} instances: see {odd}"
            return
    size = (camera.height, camera.width)
    taken = np.zeros(size, dtype=bool)
    seen: list[tuple[int, dict[str, object]]] = []
    for i, (name, pose) in enumerate(zip(names, scene.poses, strict=True)):
        mask, visible = (_read_mask(folder / kind / name, size) for kind in ("mask", "mask_visib"))
        if any(
            (folder / kind / name).read_bytes() != (folder / f"{kind}_sl" / name).read_bytes()
            for kind in ("mask", "mask_visib")
        ):
            yield f"instance {i}: the masks of sl differ from the others"
        if (visible & ~mask).any():
            yield f"instance {i}: mask_visib reaches beyond mask"
        if (visible & taken).any():
            yield f"instance {i}: mask_visib overlaps that of another instance"
        taken |= visible
        for suffix, infos in scene.info.items():
            if i < len(infos):
                depth = scene.image[f"depth{suffix}"]
                for what in _info_problems(infos[i], mask, visible, depth):
                    yield f"instance {i}: scene_gt_info{suffix}.json: {what}"
        if pose.obj_id in models and i < len(scene.info[""]):
            for what in _surface_problems(scene, i, mask, visible, models[pose.obj_id], camera):
                yield f"instance {i}: {what}"
        if visible.any():
            runs = coco_mask.encode(np.asfortranarray(visible, dtype=np.uint8))
            seen.append((i, {"runs": runs["counts"], "box": _pixel_box(mask)}))
    for suffix, coco in scene.coco.items():
        image = f"{'gray_sl' if suffix else 'rgb'}/000000.png"
        for what in _coco_problems(scene, coco, seen, image, size):
            yield f"scene_gt_coco{suffix}.json: {what}"


def _read_mask(path: Path, size: tuple[int, int]) -> Bool[np.ndarray, "h w"]:
    image = read_png(path)
    name = f"{path.parent.name}/{path.name}"
    if image.shape != size or image.dtype != np.uint8:
        raise Unreadable(f"{name} is {image.shape} {image.dtype}, it must be {size} uint8")
    mask = image == 255
    if (image[~mask] != 0).any():
        raise Unreadable(f"{name} has values other than 0 and 255")
    return mask


def _info_problems(
    info: records.Info,
    mask: Bool[np.ndarray, "h w"],
    visible: Bool[np.ndarray, "h w"],
    depth: UInt16[np.ndarray, "h w"],
) -> Iterator[str]:
    mask_px, visible_px = int(mask.sum()), int(visible.sum())
    valid_px = int((depth[mask] > 0).sum())
    if info.px_count_visib != visible_px:
        yield f"px_count_visib is {info.px_count_visib}, the mask has {visible_px}"
    if info.px_count_valid != valid_px:
        yield f"px_count_valid is {info.px_count_valid}, mask and depth have {valid_px}"
    fraction = info.px_count_visib / info.px_count_all if info.px_count_all else 0.0
    if abs(info.visib_fract - fraction) > 1e-9:
        yield f"visib_fract is {info.visib_fract}, the counts make it {fraction}"
    if info.bbox_visib != _bop_box(visible):
        yield f"bbox_visib is {info.bbox_visib}, the mask's is {_bop_box(visible)}"
    if visible_px == 0:
        if info.bbox_obj != [-1, -1, -1, -1]:
            yield f"bbox_obj is {info.bbox_obj} though nothing is visible"
        return
    x, y, w, h = info.bbox_obj
    height_px, width_px = mask.shape
    left, top = max(x, 0), max(y, 0)
    right, bottom = min(x + w, width_px - 1), min(y + h, height_px - 1)
    whole = (x, y, x + w, y + h) == (left, top, right, bottom)
    # A silhouette that leaves the image has its box confirmed by the model; see below.
    if whole and (info.bbox_obj != _bop_box(mask) or info.px_count_all != mask_px):
        here = f"{info.bbox_obj} with {info.px_count_all} pixels"
        yield f"bbox_obj is {here}, the mask's is {_bop_box(mask)} with {mask_px}"
    if not whole and info.px_count_all < mask_px:
        yield f"px_count_all is {info.px_count_all}, the image alone has {mask_px}"


def _surface_problems(
    scene: _Plain,
    i: int,
    mask: Bool[np.ndarray, "h w"],
    visible: Bool[np.ndarray, "h w"],
    model: Model,
    camera: records.Camera,
) -> Iterator[str]:
    """The model, rendered at its pose by an independent rasteriser, against masks and depth."""
    pose = scene.poses[i]
    T = _transform(pose.cam_R_m2c, pose.cam_t_m2c)
    raster = rasterize(model.vertices @ T[:3, :3].T + T[:3, 3], model.faces, _optics(scene, camera))
    window, z_mm = _in_image(raster, mask.shape)
    drawn, mask_px = ~np.isnan(z_mm), int(mask.sum())
    allowed = EDGE_PX + EDGE_SHARE * _outline_px(drawn)
    mask, visible = mask[window], visible[window]
    wrong = int((drawn != mask).sum()) + mask_px - int(mask.sum())
    if wrong > allowed:
        yield (
            f"mask differs from the model at its pose in {wrong} of {int(drawn.sum())} pixels; "
            f"edges may cost {int(allowed)}"
        )
    if not any(camera.distortion):
        yield from _outside_problems(scene.info[""][i], raster)
    depth_mm = scene.image["depth"][window] * camera.depth_scale
    tolerance_mm = camera.depth_scale / 2 + DEPTH_TOLERANCE_MM
    checked = drawn & visible
    off = np.abs(depth_mm[checked] - z_mm[checked])
    bad = int((off > tolerance_mm).sum())
    if bad > DEPTH_PX + DEPTH_SHARE * checked.sum():
        yield (
            f"depth is off the model at its pose in {bad} of {int(checked.sum())} visible "
            f"pixels, by {np.median(off):.3g} mm in the middle"
        )
    hidden = drawn & mask & ~visible
    # Where parts touch, what hides is as deep as what is hidden: along a line, as edges are.
    covered = (depth_mm > 0) & (depth_mm < z_mm - tolerance_mm)
    bare = int((hidden & ~covered).sum())
    if bare > DEPTH_PX + DEPTH_SHARE * hidden.sum() + allowed:
        yield f"{bare} pixels count as hidden though nothing lies in front of the model"


def _outside_problems(info: records.Info, raster: Raster) -> Iterator[str]:
    """Counts and box of the whole silhouette, of which the image may show only a part."""
    drawn = ~np.isnan(raster.z)
    allowed = EDGE_PX + EDGE_SHARE * _outline_px(drawn)
    if abs(info.px_count_all - int(drawn.sum())) > allowed:
        yield f"px_count_all is {info.px_count_all}, the model covers {int(drawn.sum())} pixels"
    if drawn.any() and info.px_count_visib > 0:
        x, y, w, h = _bop_box(drawn)
        box = [x + raster.left_px, y + raster.top_px, w, h]
        if np.abs(np.subtract(info.bbox_obj, box)).max() > 2:
            yield f"bbox_obj is {info.bbox_obj}, the model covers {box}"


def _coco_problems(
    scene: _Plain,
    coco: records.SceneCoco,
    seen: list[tuple[int, dict[str, object]]],
    file_name: str,
    size: tuple[int, int],
) -> Iterator[str]:
    image = records.CocoImage(id=0, file_name=file_name, width=size[1], height=size[0])
    if coco.images != [image]:
        yield f"images must be one entry, {image}"
    if len(coco.annotations) != len(seen):
        yield f"{len(coco.annotations)} annotations for {len(seen)} visible instances"
        return
    for k, ((i, must), entry) in enumerate(zip(seen, coco.annotations, strict=True), start=1):
        info = scene.info[""][i] if i < len(scene.info[""]) else None
        if (entry.id, entry.image_id, entry.iscrowd) != (k, 0, 0):
            yield f"annotation {k} has id {entry.id}, image_id {entry.image_id}"
        if entry.category_id != scene.poses[i].obj_id:
            yield f"annotation {k} is of category {entry.category_id}, the pose of another"
        if entry.segmentation.size != list(size) or _counts(entry.segmentation) != must["runs"]:
            yield f"annotation {k}: its segmentation is not the mask_visib of instance {i}"
        if entry.bbox != must["box"]:
            yield f"annotation {k}: bbox is {entry.bbox}, the mask's is {must['box']}"
        if info is not None and entry.area != info.px_count_visib:
            yield f"annotation {k}: area is {entry.area}, the mask has {info.px_count_visib}"
        if info is not None and entry.ignore != (info.visib_fract < 0.1):
            yield f"annotation {k}: ignore is {entry.ignore} at visib_fract {info.visib_fract}"


def _counts(runs: records.RunLengths) -> bytes:
    """Compressed as pycocotools encodes; run lengths that do not fill the image give b''."""
    height_px, width_px = runs.size
    if sum(runs.counts) != height_px * width_px:
        return b""
    return coco_mask.frPyObjects(runs.model_dump(), height_px, width_px)["counts"]


def _optics(scene: _Plain, camera: records.Camera) -> Optics:
    """The scene's own K: poses, masks and depth must agree through it."""
    K = scene.view.cam_K
    k1, k2, p1, p2, k3 = scene.view.distortion
    return Optics(
        width_px=camera.width,
        height_px=camera.height,
        fx_px=K[0],
        fy_px=K[4],
        cx_px=K[2],
        cy_px=K[5],
        distortion=(k1, k2, p1, p2, k3),
    )


def _transform(rotation: list[float], translation: list[float]) -> Float[np.ndarray, "4 4"]:
    return rigid(np.array(rotation, dtype=float).reshape(3, 3), np.array(translation, dtype=float))


def _in_image(
    raster: Raster, size: tuple[int, ...]
) -> tuple[tuple[slice, slice], Float[np.ndarray, "bh bw"]]:
    """The window of the image that a raster covers, perhaps an empty one, and z inside it."""
    h, w = raster.z.shape
    top, left = max(raster.top_px, 0), max(raster.left_px, 0)
    bottom = max(min(raster.top_px + h, size[0]), top)
    right = max(min(raster.left_px + w, size[1]), left)
    rows = slice(top - raster.top_px, bottom - raster.top_px)
    columns = slice(left - raster.left_px, right - raster.left_px)
    return (slice(top, bottom), slice(left, right)), raster.z[rows, columns]


def _outline_px(mask: Bool[np.ndarray, "h w"]) -> int:
    """How many neighbouring pixels a mask's border separates."""
    mask = np.pad(mask, 1)
    across, down = mask[:, 1:] != mask[:, :-1], mask[1:] != mask[:-1]
    return int(across.sum()) + int(down.sum())


def _bop_box(mask: Bool[np.ndarray, "h w"]) -> list[int]:
    """BOP's [x, y, last column - first, last row - first]; -1 for an empty mask."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if len(rows) == 0:
        return [-1, -1, -1, -1]
    return [int(columns[0]), int(rows[0]), int(np.ptp(columns)), int(np.ptp(rows))]


def _pixel_box(mask: Bool[np.ndarray, "h w"]) -> list[int]:
    """COCO's [x, y, columns, rows]."""
    x, y, w, h = _bop_box(mask)
    return [x, y, w + 1, h + 1]
