"""Writer of a BOP dataset from a folder of real pictures, their labels and their camera."""

import json
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...base.errors import DatasetError
from ...base.file_limits import parse_json
from ...base.folder import new_folder
from ...base.mask_box import mask_box
from ...base.progress import UNWATCHED, ProgressMeter
from ...base.version import __version__
from ...dataset.files.json_text import json_bytes
from ...dataset.files.places import CLAIM
from ...dataset.files.records import FORMAT_VERSION, MM_PER_M, split_annotation
from ...dataset.files.seal import sealed, sha256
from ...dataset.write.coco import (
    coco_categories,
    run_lengths,
    scene_annotation,
    scene_coco,
    scene_image,
)
from ...dataset.write.picture_bytes import depth_steps, png
from ...rendering.radiance import Silhouette
from ..depth_file import NO_OPTIONS, FileOptions
from ..picture_pairs import RealPicture, ShotData, find_shots, read_shot
from .annotations import Annotation, read_annotations
from .survey import survey


@dataclass(frozen=True, slots=True, kw_only=True)
class Import:
    """Summary of an import: the names of the pictures, in scene order, and what they contain.

    `categories` are the object names, `instances` is the number of labelled instances, and `holds`
    lists the kinds of data that were found.
    """

    stems: tuple[str, ...]
    categories: tuple[str, ...]  # object ids count from 1
    instances: int
    holds: tuple[str, ...]
    depth_scale_mm: float
    notes: tuple[str, ...]  # a warning for each probable mistake and each loss of data


def import_real(
    folder: Path,
    out: Path,
    *,
    files: FileOptions = NO_OPTIONS,
    annotations: Path | None = None,
    labelled: bool = True,
    names: Sequence[str] | None = None,
    range_m: tuple[float, float] | None = None,
    progress: ProgressMeter = UNWATCHED,
) -> Import:
    """Write real pictures as a dataset, with one scene per picture, sorted by file name.

    Args:
        folder: folder that contains `rgb`, `gray` and `depth`, or some of these folders.
        out: a folder that does not exist or is empty.
        files: properties that depth files do not record, such as intrinsics and scale. Lens
            distortion is stored with the camera and not removed from the pictures.
        annotations: a COCO file or a folder of LabelMe files; None means `folder/annotations`.
        labelled: False imports pictures without annotations; the dataset then has no masks.
        names: object names in the order of their ids, for example those of a simulated dataset.
        range_m: near and far end of the working range of a similar scanner; depth far outside this
            range is refused.
        progress: meter that counts the written pictures.

    Raises:
        GraycastError: a file is missing, is damaged or contradicts another; an annotation cannot
            be used; or `out` cannot be written.
    """
    shots = find_shots(folder)
    labels, own_names = _labels(folder, annotations, labelled, [shot.stem for shot in shots])
    known = _object_names(own_names, names)
    known_pictures = survey(shots, files, range_m=range_m)
    first, step_mm = known_pictures.first, known_pictures.step_mm
    holds = (*first.holds, *(("masks",) if labelled else ()))
    writer = _Writer(names=known, step_mm=step_mm, distortion=files.distortion or (), holds=holds)
    with new_folder(out) as aside:
        (aside / CLAIM).write_bytes(json_bytes(writer.claim(folder)))
        (aside / "camera.json").write_bytes(json_bytes(writer.camera(first)))
        for scene_id, shot in enumerate(shots):
            place = aside / "train" / f"{scene_id:06d}"
            writer.scene(place, shot, read_shot(shot, files), labels.get(shot.stem))
            progress.count("pictures", scene_id + 1, len(shots))
        if labelled:
            size = first.size_px
            (aside / "train_coco.json").write_text(writer.split_coco(aside, len(shots), size))
    return Import(
        stems=tuple(shot.stem for shot in shots),
        categories=tuple(known),
        instances=sum(len(each.names) for each in labels.values()),
        holds=holds,
        depth_scale_mm=step_mm,
        notes=(*known_pictures.notes, *_cut_notes(labels)),
    )


def _labels(
    folder: Path, annotations: Path | None, labelled: bool, stems: list[str]
) -> tuple[dict[str, Annotation], list[str]]:
    if not labelled:
        if annotations is not None:
            raise DatasetError(
                f"{annotations}: labels are given together with --unlabelled: remove one of the two"
            )
        return {}, []
    path = folder / "annotations" if annotations is None else annotations
    if not path.exists():
        raise DatasetError(
            f"{path}: no such file or folder: give --annotations with a COCO file or a folder of "
            "LabelMe files, or --unlabelled"
        )
    return read_annotations(path, stems)


def _object_names(own: Sequence[str], names: Sequence[str] | None) -> list[str]:
    if names is None:
        return list(own)
    if unknown := [name for name in own if name not in names]:
        raise DatasetError(
            f"the annotations name {unknown[0]!r}, and the objects are {', '.join(names)}: rename "
            "it there, or remove --like"
        )
    return list(names)


def _cut_notes(labels: Mapping[str, Annotation]) -> tuple[str, ...]:
    """Return a note if outlines extend beyond their pictures, else an empty tuple."""
    beyond = {stem: each.beyond_px for stem, each in labels.items() if each.beyond_px > 0}
    if not beyond:
        return ()
    worst = max(beyond, key=lambda stem: beyond[stem])
    return (
        f"outlines in {len(beyond)} pictures lead out of the picture, by up to "
        f"{beyond[worst]:.2g} px in {worst}: they are cut at its border",
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Writer:
    """Writer of the files of a dataset of real pictures; see docs/reference/exports.md."""

    names: Sequence[str]
    step_mm: float
    distortion: tuple[float, ...]
    holds: tuple[str, ...]

    def claim(self, folder: Path) -> dict[str, Any]:
        return {
            "format_version": FORMAT_VERSION,
            "kind": "real",
            "depth_scale_mm": self.step_mm,
            "parts": [{"obj_id": i, "name": name} for i, name in enumerate(self.names, start=1)],
            "holds": list(self.holds),
            "sources": [str(folder)],
            "versions": {"graycast": __version__, "python": platform.python_version()},
        }

    def camera(self, images: ShotData) -> dict[str, Any]:
        (fx, _, cx), (_, fy, cy), _ = images.K.tolist()
        height_px, width_px = images.size_px
        size = {"width": width_px, "height": height_px, "depth_scale": self.step_mm}
        return size | {"fx": fx, "fy": fy, "cx": cx, "cy": cy} | self._distortion()

    def scene(
        self, place: Path, shot: RealPicture, images: ShotData, labels: Annotation | None
    ) -> None:
        files: dict[str, bytes] = {}
        view = {"cam_K": images.K.ravel(), "depth_scale": self.step_mm} | self._distortion()
        # BOP's names are always written; the scanner's only if it has a picture or depth.
        suffixes = ("", "_sl") if {"gray_sl", "depth_sl"} & set(self.holds) else ("",)
        for suffix in suffixes:
            files[f"scene_camera{suffix}.json"] = json_bytes({"0": view})
        if images.rgb is not None:
            files["rgb/000000.png"] = png(np.ascontiguousarray(images.rgb[..., ::-1]))
        if images.gray is not None:
            files["gray_sl/000000.png"] = png(images.gray)
        if images.depth_m is not None:
            known = ~np.isnan(images.depth_m)
            depth_m = np.maximum(images.depth_m, self.step_mm / MM_PER_M)  # 0 means no depth.
            steps = depth_steps(depth_m, self.step_mm, needed=known)
            files["depth_sl/000000.png"] = png(steps)
        if labels is not None:
            files |= self._label_files(shot, images, labels, suffixes)
        originals = {
            name: {"file": path.name, "sha256": sha256(path.read_bytes())}
            for name, path in shot.files.items()
        }
        manifest = {"stem": shot.stem, "files": originals}
        for name, content in sealed(files.items(), manifest):
            (place / name).parent.mkdir(parents=True, exist_ok=True)
            (place / name).write_bytes(content)

    def split_coco(self, out: Path, scenes: int, size_px: tuple[int, int]) -> str:
        picture = "rgb" if "rgb" in self.holds else _picture(self.holds)
        entries: list[dict[str, Any]] = []
        for scene_id in range(scenes):
            path = out / "train" / f"{scene_id:06d}" / "scene_gt_coco.json"
            for annotation in parse_json(path.read_bytes())["annotations"]:
                entries.append({"id": len(entries) + 1} | split_annotation(annotation, scene_id))
        size = {"width": size_px[1], "height": size_px[0]}
        content = {
            "info": {"description": "Graycast, real pictures"},
            "licenses": [],
            "categories": coco_categories(enumerate(self.names, start=1)),
            "images": [
                {"id": i, "file_name": f"train/{i:06d}/{picture}/000000.png"} | size
                for i in range(scenes)
            ],
            "annotations": entries,
        }
        return json.dumps(content) + "\n"

    def _distortion(self) -> dict[str, Any]:
        return {"distortion": list(self.distortion)} if any(self.distortion) else {}

    def _label_files(
        self, shot: RealPicture, images: ShotData, labels: Annotation, suffixes: Sequence[str]
    ) -> dict[str, bytes]:
        height_px, width_px = images.size_px
        if labels.size_px != images.size_px:
            raise DatasetError(
                f"{labels.source}: is of a picture of {labels.size_px[1]} x {labels.size_px[0]} "
                f"pixels, {shot.stem} has {width_px} x {height_px}: annotate the same picture"
            )
        obj_ids = [self.names.index(name) + 1 for name in labels.names]
        files, infos, entries = {}, [], []
        for i, obj_id in enumerate(obj_ids):
            mask = labels.mask(i)
            x, y, w, h = mask_box(mask)
            area_px = int(mask.sum())
            infos.append({"bbox_visib": [x, y, w - 1, h - 1], "px_count_visib": area_px})
            whole = Silhouette(left_px=0, top_px=0, mask=mask)
            runs = run_lengths(whole, height_px=height_px, width_px=width_px)
            annotation = scene_annotation(
                image_id=0,
                obj_id=obj_id,
                run_length=runs,
                box=[x, y, w, h],
                area_px=area_px,
                visib_fract=1.0,  # unknown; with 1, no evaluation ignores the object
                height_px=height_px,
                width_px=width_px,
            )
            entries.append({"id": i + 1} | annotation)
            for suffix in suffixes:
                name = f"mask_visib{suffix}/000000_{i:06d}.png"
                files[name] = png(mask.astype(np.uint8) * 255)
        for suffix in suffixes:
            picture = "rgb" if suffix == "" and "rgb" in self.holds else _picture(self.holds)
            coco = scene_coco(
                obj_ids=range(1, len(self.names) + 1),
                images=[
                    scene_image(
                        image_id=0,
                        file_name=f"{picture}/000000.png",
                        height_px=height_px,
                        width_px=width_px,
                    )
                ],
                annotations=entries,
            )
            poses = [{"obj_id": obj_id} for obj_id in obj_ids]
            files[f"scene_gt{suffix}.json"] = json_bytes({"0": poses})
            files[f"scene_gt_info{suffix}.json"] = json_bytes({"0": infos})
            files[f"scene_gt_coco{suffix}.json"] = json_bytes(coco)
        return files


def _picture(holds: Sequence[str]) -> str:
    return next(name for name in ("gray_sl", "rgb", "depth_sl") if name in holds)
