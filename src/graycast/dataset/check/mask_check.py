"""Check masks, counts and boxes of a scene for consistency and against the posed models."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, UInt16
from pycocotools import mask as coco_mask

from ...base.mask_box import Box, Window, mask_box, overlap
from ...rig.meshdepth import Raster, rasterize
from ..files import records
from ..files.safe_reading import Unreadable, content_of, mask_pixels
from ..files.scene_folder import of_sensor
from .model_check import Model
from .plain_scene import Plain, transform_of

# In single precision, a renderer may put a pixel whose centre is very near an edge on either side.
# With 40 built-in parts, Mitsuba did so for at most one pixel of a mask. Two pixels and 2 % of the
# outline are allowed; a shift by a twentieth of a pixel exceeds that.
EDGE_SHARE, EDGE_PX = 0.02, 2
# Away from edges, depths differ by rounding, and by single precision at grazing incidence.
DEPTH_TOLERANCE_MM = 0.02
DEPTH_SHARE, DEPTH_PX = 0.01, 2


def mask_problems(
    scene: Plain,
    camera: records.Camera,
    models: Mapping[int, Model],
) -> Iterator[str]:
    """Yield contradictions between masks, counts, boxes and models."""
    count, files = len(scene.poses), scene.files
    names = [f"{scene.number:06d}_{i:06d}.png" for i in range(count)]
    place = {
        kind: files.path / of_sensor(kind, files.sensor)
        for kind in ("mask", "mask_visib", "mask_sl", "mask_visib_sl")
    }
    for path in place.values():
        there = sorted(entry.name for entry in path.glob(f"{scene.number:06d}_*"))
        there += _of_no_image(path, scene)
        if there != names:
            odd = min(set(there) ^ set(names))
            yield f"{path.name}/ has {len(there)} files for {count} instances: see {odd}"
            return
    size = (camera.height, camera.width)
    taken = np.zeros(size, dtype=bool)
    known: list[tuple[int, dict[str, object]]] = []
    for i, (name, pose) in enumerate(zip(names, scene.poses, strict=True)):
        data = {kind: content_of(path / name)[0] for kind, path in place.items()}
        if any(data[kind] != data[f"{kind}_sl"] for kind in ("mask", "mask_visib")):
            yield f"instance {i}: the masks of sl differ from the others"
        masks = _read_masks(data, name, size)
        window = masks.window
        mask, visible = masks.mask[window], masks.visible[window]
        if (visible & ~mask).any():
            yield f"instance {i}: mask_visib reaches beyond mask"
        if (visible & taken[window]).any():
            yield f"instance {i}: mask_visib overlaps that of another instance"
        taken[window] |= visible
        for suffix, infos in scene.info.items():
            if i < len(infos):
                file = scene.json_name(f"scene_gt_info{suffix}")
                for what in _info_problems(infos[i], masks, scene.image[f"depth{suffix}"]):
                    yield f"instance {i}: {file}: {what}"
        if pose.obj_id in models and i < len(scene.info[""]):
            for what in _surface_problems(scene, i, masks, models[pose.obj_id], camera):
                yield f"instance {i}: {what}"
        if visible.any():
            whole = np.zeros(size, dtype=np.uint8, order="F")  # COCO counts down the columns.
            whole[window] = visible
            runs = coco_mask.encode(whole)["counts"]
            known.append((i, {"runs": runs, "box": list(masks.box)}))
    for suffix, coco in scene.coco.items():
        for what in _coco_problems(scene, suffix, coco, known, size):
            yield f"{scene.json_name(f'scene_gt_coco{suffix}')}: {what}"


@dataclass(frozen=True, slots=True, kw_only=True)
class _Masks:
    """The masks of an instance, their boxes as in COCO, and a window that contains both masks."""

    mask: Bool[np.ndarray, "h w"]
    visible: Bool[np.ndarray, "h w"]
    box: Box
    visible_box: Box
    window: Window


def _read_masks(data: Mapping[str, bytes], name: str, size: tuple[int, int]) -> _Masks:
    mask = visible = _sized_mask(data["mask"], f"mask/{name}", size)
    box = visible_box = both = mask_box(mask)
    if data["mask_visib"] != data["mask"]:  # They are equal if nothing hides the instance.
        visible = _sized_mask(data["mask_visib"], f"mask_visib/{name}", size)
        visible_box, both = mask_box(visible), mask_box(mask | visible)
    x, y, columns, rows = both
    window = slice(y, y + rows), slice(x, x + columns)
    return _Masks(mask=mask, visible=visible, box=box, visible_box=visible_box, window=window)


def _of_no_image(path: Path, scene: Plain) -> list[str]:
    """Return the names of masks that belong to no image; empty unless `scene` is image 0."""
    if scene.number:
        return []
    has = {f"{number:06d}" for number in scene.numbers}
    return sorted(entry.name for entry in path.glob("*") if entry.name[:6] not in has)


def _sized_mask(data: bytes, name: str, size: tuple[int, int]) -> Bool[np.ndarray, "h w"]:
    mask = mask_pixels(data, name)
    if mask.shape != size:
        raise Unreadable(f"{name} is {mask.shape}, it must be {size}")
    return mask


def _info_problems(
    info: records.Info, masks: _Masks, depth: UInt16[np.ndarray, "h w"]
) -> Iterator[str]:
    mask, visible = masks.mask[masks.window], masks.visible[masks.window]
    mask_px, visible_px = int(mask.sum()), int(visible.sum())
    valid_px = int((depth[masks.window][mask] > 0).sum())
    if info.px_count_visib != visible_px:
        yield f"px_count_visib is {info.px_count_visib}, the mask has {visible_px}"
    if info.px_count_valid != valid_px:
        yield f"px_count_valid is {info.px_count_valid}, mask and depth have {valid_px}"
    fraction = info.px_count_visib / info.px_count_all if info.px_count_all else 0.0
    if abs(info.visib_fract - fraction) > 1e-9:
        yield f"visib_fract is {info.visib_fract}, the counts make it {fraction}"
    if info.bbox_visib != _bop_box(masks.visible_box):
        yield f"bbox_visib is {info.bbox_visib}, the mask's is {_bop_box(masks.visible_box)}"
    if visible_px == 0:
        if info.bbox_obj != [-1, -1, -1, -1]:
            yield f"bbox_obj is {info.bbox_obj} though nothing is visible"
        return
    x, y, w, h = info.bbox_obj
    height_px, width_px = masks.mask.shape
    left, top = max(x, 0), max(y, 0)
    right, bottom = min(x + w, width_px - 1), min(y + h, height_px - 1)
    whole = (x, y, x + w, y + h) == (left, top, right, bottom)
    # If a silhouette leaves the image, `_outside_problems` checks its box against the model.
    if whole and (info.bbox_obj != _bop_box(masks.box) or info.px_count_all != mask_px):
        here = f"{info.bbox_obj} with {info.px_count_all} pixels"
        yield f"bbox_obj is {here}, the mask's is {_bop_box(masks.box)} with {mask_px}"
    if not whole and info.px_count_all < mask_px:
        yield f"px_count_all is {info.px_count_all}, the image alone has {mask_px}"


def _surface_problems(
    scene: Plain,
    i: int,
    masks: _Masks,
    model: Model,
    camera: records.Camera,
) -> Iterator[str]:
    """Compare masks and depth with the posed model, rendered by an independent rasteriser."""
    pose = scene.poses[i]
    T = transform_of(pose.cam_R_m2c, pose.cam_t_m2c)
    raster = rasterize(model.vertices @ T[:3, :3].T + T[:3, 3], model.faces, scene.lens)
    window, own = overlap(raster.top_px, raster.left_px, raster.z.shape, masks.mask.shape)
    z_mm = raster.z[own]
    rendered = ~np.isnan(z_mm)
    allowed = EDGE_PX + EDGE_SHARE * _outline_px(rendered)
    mask, visible = masks.mask[window], masks.visible[window]
    outside = int(masks.mask[masks.window].sum()) - int(mask.sum())
    wrong = int((rendered != mask).sum()) + outside
    if wrong > allowed:
        yield (
            f"mask differs from the model at its pose in {wrong} of {int(rendered.sum())} pixels; "
            f"edges may cost {int(allowed)}"
        )
    if not any(camera.distortion):
        yield from _outside_problems(scene.info[""][i], raster)
    depth_mm = scene.image["depth"][window] * camera.depth_scale
    tolerance_mm = camera.depth_scale / 2 + DEPTH_TOLERANCE_MM
    checked = rendered & visible
    off = np.abs(depth_mm[checked] - z_mm[checked])
    bad = int((off > tolerance_mm).sum())
    if bad > DEPTH_PX + DEPTH_SHARE * checked.sum():
        yield (
            f"depth is off the model at its pose in {bad} of {int(checked.sum())} visible "
            f"pixels, by {np.median(off):.3g} mm in the middle"
        )
    hidden = rendered & mask & ~visible
    # The edge tolerance applies here, too: parts that touch have equal depths along a line.
    covered = (depth_mm > 0) & (depth_mm < z_mm - tolerance_mm)
    bare = int((hidden & ~covered).sum())
    if bare > DEPTH_PX + DEPTH_SHARE * hidden.sum() + allowed:
        yield f"{bare} pixels count as hidden though nothing lies in front of the model"


def _outside_problems(info: records.Info, raster: Raster) -> Iterator[str]:
    """Check count and box of the whole silhouette, which may extend beyond the image."""
    rendered = ~np.isnan(raster.z)
    allowed = EDGE_PX + EDGE_SHARE * _outline_px(rendered)
    if abs(info.px_count_all - int(rendered.sum())) > allowed:
        yield f"px_count_all is {info.px_count_all}, the model covers {int(rendered.sum())} pixels"
    if rendered.any() and info.px_count_visib > 0:
        x, y, w, h = _bop_box(mask_box(rendered))
        box = [x + raster.left_px, y + raster.top_px, w, h]
        if np.abs(np.subtract(info.bbox_obj, box)).max() > 2:
            yield f"bbox_obj is {info.bbox_obj}, the model covers {box}"


def _coco_problems(
    scene: Plain,
    suffix: str,
    coco: records.SceneCoco,
    known: list[tuple[int, dict[str, object]]],
    size: tuple[int, int],
) -> Iterator[str]:
    file_name, number = scene.name("gray_sl" if suffix else "rgb"), scene.number
    image = records.CocoImage(id=number, file_name=file_name, width=size[1], height=size[0])
    if coco.images != [image]:
        yield f"images must have one entry of image {number}, {image}"
    if len(coco.annotations) != len(known):
        yield f"{len(coco.annotations)} annotations for {len(known)} visible instances"
        return
    first = scene.first_annotation[suffix]
    for k, ((i, must), entry) in enumerate(zip(known, coco.annotations, strict=True), start=first):
        info = scene.info[""][i] if i < len(scene.info[""]) else None
        if (entry.id, entry.image_id, entry.iscrowd) != (k, number, 0):
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
    """Return the RLE in pycocotools' form; b'' if the runs do not fill the image."""
    height_px, width_px = runs.size
    if sum(runs.counts) != height_px * width_px:
        return b""
    return coco_mask.frPyObjects(runs.model_dump(), height_px, width_px)["counts"]


def _outline_px(mask: Bool[np.ndarray, "h w"]) -> int:
    """Return the number of pairs of neighbouring pixels that the border of a mask separates."""
    borders = (np.diff(mask, axis=axis, prepend=False, append=False) for axis in (0, 1))
    return sum(int(border.sum()) for border in borders)


def _bop_box(box: Box) -> list[int]:
    """Return BOP's [x, y, last column - first, last row - first]; -1 for an empty mask."""
    x, y, columns, rows = box
    return [x, y, columns - 1, rows - 1] if columns else [-1, -1, -1, -1]
