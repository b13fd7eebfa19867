"""Write one scene as the files of a BOP scene folder, following bop_toolkit's docs and scripts.

Files of the colour camera have BOP's plain names; those of the scanner have the camera type `sl`.
Both share the lens and the viewpoint, so poses and masks are equal; they are written under both
names because bop_toolkit looks them up that way. Images are numbered from 0. A scanner that has a
name has its own files and its own numbers.

Lengths are in millimetres. A depth picture times `depth_scale` is z in the camera frame; 0 means
unknown. Pixel (0, 0) is the centre of the top-left pixel, in BOP as in this package.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, UInt16
from scipy import ndimage

from ...base.frames import inverse
from ...base.mask_box import mask_box
from ...base.streams import OF_IMAGE
from ...camera.decode import Reason
from ...rendering.radiance import Silhouette
from ..files.json_text import json_bytes
from ..files.records import MM_PER_M
from ..files.sample import Sample, labelled
from ..files.scene_folder import SCANNER, of_sensor, picture_name
from ..files.seal import FURTHER, FURTHER_TIMINGS, OWN_FACTS, sealed
from .claim import distortion_json
from .coco import add_images, run_lengths, scene_annotation, scene_coco, scene_image
from .picture_bytes import depth_steps, mask_png, modulation_steps, png, probability_steps
from .raw import raw_facts, raw_files

_NOTHING = [-1, -1, -1, -1]  # BOP gives this box to an invisible instance.


def scene_files(samples: Iterable[Sample], scale_mm: float) -> Iterator[tuple[str, bytes]]:
    """Yield every file of a scene folder as (path inside the folder, content).

    Equal samples give equal files. The last file is the manifest, which holds the SHA-256 of the
    others. A sample is no longer needed when the next one is requested.

    Args:
        samples: the images of one scene, all with the same layout, in order.

    Raises:
        ValueError: the images of a sample do not have the size of its camera, or the number of
            silhouettes differs from the number of instances.
        DatasetError: a depth does not fit into 16 bits at this scale.
    """
    scene_record = _SceneRecord()
    yield from sealed(_unsealed_files(samples, scale_mm, scene_record), scene_record.manifest)


def scanner_files(
    sample: Sample, scale_mm: float, obj_ids: Sequence[int]
) -> tuple[list[tuple[str, bytes]], dict[str, Any]]:
    """Return the pictures, masks and JSON entries that a scan adds to an image of another dataset.

    Args:
        obj_ids: the object ids of the scene's labelled parts, in order.

    Returns:
        A list of (path inside the scene's folder, content), and this image's entry of each JSON
        file by the file's name. The entry of `scene_gt_coco_sl` is a whole file for one image.

    Raises:
        ValueError, DatasetError: see `scene_files`.
    """
    _check_shapes(sample, sample.truth.instance.shape)
    scene_record = _SceneRecord()
    image_files = _image_files(labelled(sample), scale_mm, scene_record, obj_ids)
    files = [(name, content) for name, content in image_files if SCANNER in name]
    entries = {
        name: images[str(sample.image)]
        for name, images in scene_record.records.items()
        if name.endswith(SCANNER)
    }
    name = f"scene_gt_coco{SCANNER}"
    return files, entries | {name: scene_record.coco[name]}


class _SceneRecord:
    """Manifest and JSON records of a scene, collected while its images are written."""

    def __init__(self) -> None:
        self.manifest: dict[str, Any] = {}
        self.records: dict[str, dict[str, Any]] = {}  # The keys are file and image number.
        self.coco: dict[str, dict[str, Any]] = {}  # The key is the file's name.

    def image(self, name: str, number: int, entry: Any) -> None:
        self.records.setdefault(name, {})[str(number)] = entry

    def of_manifest(self, sample: Sample) -> None:
        """Add a sample's facts to the manifest: the first sample's as keys, later ones to lists."""
        facts = {} if sample.raw is None else raw_facts(sample.raw)
        facts = {**sample.manifest, **facts}
        sensor = {"sensor": sample.sensor} if sample.sensor else {}
        if not self.manifest:
            self.manifest |= facts | sensor
            return
        which = sensor | {"image": sample.image}
        own = {key: facts[key] for key in OWN_FACTS if key in facts}
        own["seeds"] = {name: facts["seeds"][name] for name in OF_IMAGE}
        self.manifest.setdefault(FURTHER, []).append(which | own)
        self.manifest.setdefault(FURTHER_TIMINGS, []).append(which | {"seconds": facts["timings"]})


def _unsealed_files(
    samples: Iterable[Sample], scale_mm: float, scene_record: _SceneRecord
) -> Iterator[tuple[str, bytes]]:
    """Yield all files except the manifest, whose content is collected in `scene_record`."""
    for sample in samples:
        camera = sample.scene.rig.camera
        _check_shapes(sample, (camera.height_px, camera.width_px))
        scene_record.of_manifest(sample)
        known = labelled(sample)
        yield from _image_files(known, scale_mm, scene_record, range(1, len(known.scene.parts) + 1))
    for name, record in (scene_record.records | scene_record.coco).items():
        yield f"{name}.json", json_bytes(record)


def _image_files(
    sample: Sample, scale_mm: float, scene_record: _SceneRecord, obj_ids: Sequence[int]
) -> Iterator[tuple[str, bytes]]:
    """Yield pictures and masks of one image; add its JSON entries to `scene_record`."""
    camera, silhouettes, number = sample.scene.rig.camera, _instances(sample), sample.image
    truth = depth_steps(sample.truth.depth_m, scale_mm, needed=sample.truth.instance >= 0)
    known = sample.scanner_depth.reason == Reason.DECODED
    scanned = depth_steps(sample.scanner_depth.depth_m, scale_mm, needed=known)
    modulation, modulation_scale = modulation_steps(sample.modulation)

    def place(kind: str) -> str:
        return picture_name(kind, number, sample.sensor)

    yield place("rgb"), png(np.ascontiguousarray(sample.rgb[..., ::-1]))
    yield place("gray_sl"), png(sample.gray)
    yield place("depth"), png(truth)
    yield place("depth_sl"), png(scanned)
    yield place("reason_sl"), png(sample.scanner_depth.reason)
    yield place("modulation_sl"), png(modulation)
    if sample.scanner_depth.p_wrong is not None:
        yield place("pwrong_sl"), png(probability_steps(sample.scanner_depth.p_wrong))
    for i, instance in enumerate(silhouettes):
        amodal = mask_png(instance.inside, camera.height_px, camera.width_px)
        visible = mask_png(instance.visible, camera.height_px, camera.width_px)
        for suffix in ("", "_sl"):
            for kind, content in ((f"mask{suffix}", amodal), (f"mask_visib{suffix}", visible)):
                yield f"{of_sensor(kind, sample.sensor)}/{number:06d}_{i:06d}.png", content
    poses, view = _poses(sample, obj_ids), _view(sample, scale_mm)
    size = {"height_px": camera.height_px, "width_px": camera.width_px}
    annotations = _annotations(sample, silhouettes, obj_ids)
    for suffix, depth, image in (("", truth, "rgb"), ("_sl", scanned, "gray_sl")):
        entries = {
            "scene_camera": view,
            "scene_gt": poses,
            "scene_gt_info": [_info(instance, depth) for instance in silhouettes],
        }
        for name, entry in entries.items():
            scene_record.image(of_sensor(name + suffix, sample.sensor), number, entry)
        coco = scene_record.coco.setdefault(
            of_sensor(f"scene_gt_coco{suffix}", sample.sensor),
            scene_coco(obj_ids=obj_ids, images=[], annotations=[]),
        )
        listed = scene_image(image_id=number, file_name=place(image), **size)
        add_images(coco, [listed], annotations)
    scene_record.image(of_sensor("scene_gt_box3d", sample.sensor), number, _boxes_3d(sample))
    reasons = {reason.name: reason.value for reason in Reason}
    scanner = {"modulation_scale": modulation_scale, "reasons": reasons}
    scene_record.image(of_sensor("scene_sl", sample.sensor), number, scanner)
    if sample.raw is not None:
        yield from raw_files(sample.raw, sensor=sample.sensor, number=number)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Silhouettes:
    """Silhouettes of one instance: the whole, the part inside the image, and the visible part."""

    whole: Silhouette
    inside: Silhouette
    visible: Silhouette


def _instances(sample: Sample) -> list[_Silhouettes]:
    truth, (height_px, width_px) = sample.truth, sample.truth.instance.shape
    windows = ndimage.find_objects(truth.instance + 1, max_label=len(truth.amodal))
    silhouettes = []
    for i, (whole, box) in enumerate(zip(truth.amodal, windows, strict=True)):
        rows, columns = box if box is not None else (slice(0, 0), slice(0, 0))
        visible = Silhouette(
            left_px=columns.start, top_px=rows.start, mask=truth.instance[rows, columns] == i
        )
        if visible.mask.sum() > whole.mask.sum():
            raise ValueError(f"instance {i} has more visible pixels than its silhouette has")
        inside = whole.clipped(height_px, width_px)
        silhouettes.append(_Silhouettes(whole=whole, inside=inside, visible=visible))
    return silhouettes


def _check_shapes(sample: Sample, size: tuple[int, int]) -> None:
    images = {
        "rgb": sample.rgb[..., 0],
        "gray": sample.gray,
        "true depth": sample.truth.depth_m,
        "instance": sample.truth.instance,
        "scanner depth": sample.scanner_depth.depth_m,
        "reason": sample.scanner_depth.reason,
        "modulation": sample.modulation,
    }
    for name, image in images.items():
        if image.shape != size:
            raise ValueError(f"{name} is {image.shape}, the camera has {size} (rows, columns)")
    count, poses = len(sample.truth.amodal), len(sample.layout.T_world_part)
    if count != poses or sample.truth.instance.max(initial=-1) >= poses:
        raise ValueError(
            f"{poses} poses, {count} silhouettes: the ground truth belongs to another layout"
        )


def _view(sample: Sample, scale_mm: float) -> dict[str, Any]:
    T_cam_world = inverse(sample.scene.T_world_cam)
    camera = sample.scene.rig.camera
    return {
        "cam_K": camera.K.ravel(),
        "cam_R_w2c": T_cam_world[:3, :3].ravel(),
        "cam_t_w2c": T_cam_world[:3, 3] * MM_PER_M,
        "depth_scale": scale_mm,
    } | distortion_json(camera)


def _T_cam_part(sample: Sample) -> Float[np.ndarray, "n 4 4"]:
    return inverse(sample.scene.T_world_cam) @ sample.layout.T_world_part


def _poses(sample: Sample, obj_ids: Sequence[int]) -> list[dict[str, Any]]:
    return [
        {
            "cam_R_m2c": T[:3, :3].ravel(),
            "cam_t_m2c": T[:3, 3] * MM_PER_M,
            "obj_id": obj_ids[part],
        }
        for T, part in zip(_T_cam_part(sample), sample.layout.part_index, strict=True)
    ]


def _boxes_3d(sample: Sample) -> list[dict[str, Any]]:
    """Return the bounding box of each part, aligned with its own axes, in the camera frame."""
    boxes = []
    for T, part in zip(_T_cam_part(sample), sample.layout.part_index, strict=True):
        mesh = sample.scene.parts[part].mesh
        corner_m = mesh.vertices_m[np.unique(mesh.faces)].astype(np.float64)
        middle_m = (corner_m.min(axis=0) + corner_m.max(axis=0)) / 2
        boxes.append(
            {
                "R": T[:3, :3].ravel(),
                "center": (T[:3, :3] @ middle_m + T[:3, 3]) * MM_PER_M,
                "size": np.ptp(corner_m, axis=0) * MM_PER_M,
            }
        )
    return boxes


def _info(silhouettes: _Silhouettes, depth: UInt16[np.ndarray, "h w"]) -> dict[str, Any]:
    """Return an entry of `scene_gt_info.json`, with pixel counts as in bop_toolkit."""
    inside, visible_px = silhouettes.inside, int(silhouettes.visible.mask.sum())
    h, w = inside.mask.shape
    window = depth[inside.top_px : inside.top_px + h, inside.left_px : inside.left_px + w]
    whole_px = int(silhouettes.whole.mask.sum())
    return {
        "bbox_obj": _span(silhouettes.whole) if visible_px else _NOTHING,
        "bbox_visib": _span(silhouettes.visible) if visible_px else _NOTHING,
        "px_count_all": whole_px,
        "px_count_valid": int((window[inside.mask] > 0).sum()),
        "px_count_visib": visible_px,
        "visib_fract": visible_px / whole_px if whole_px else 0.0,
    }


def _span(crop: Silhouette) -> list[int]:
    """Return BOP's box [x, y, w, h] of a mask, where w is the last column minus the first."""
    x, y, columns, rows = mask_box(crop.mask)
    return [x + crop.left_px, y + crop.top_px, columns - 1, rows - 1]


def _annotations(
    sample: Sample, silhouettes: list[_Silhouettes], obj_ids: Sequence[int]
) -> list[dict[str, Any]]:
    """Return the COCO annotations of the visible instances, without ids."""
    camera = sample.scene.rig.camera
    size = {"height_px": camera.height_px, "width_px": camera.width_px}
    annotations: list[dict[str, Any]] = []
    for instance, part in zip(silhouettes, sample.layout.part_index, strict=True):
        area_px = int(instance.visible.mask.sum())
        if area_px == 0:
            continue
        x, y, w, h = _span(instance.inside)
        annotations.append(
            scene_annotation(
                image_id=sample.image,
                obj_id=obj_ids[part],
                run_length=run_lengths(instance.visible, **size),
                box=[x, y, w + 1, h + 1],
                area_px=area_px,
                visib_fract=area_px / int(instance.whole.mask.sum()),
                **size,
            )
        )
    return annotations
