"""Checks a dataset from its files alone: no renderer, no configuration, no trust."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from pycocotools import mask as coco_mask

from ..errors import DatasetError
from ..frames import is_rigid
from . import records
from .models import diameter
from .reading import Unreadable, read_json
from .real import is_real, real_problems
from .scene_check import Model, scene_problems
from .store import finished_scenes

_MODEL_MM = 1e-3  # nine digits in a PLY, read back in single precision


@dataclass(frozen=True, slots=True, kw_only=True)
class Problem:
    """What is wrong, and in which scene; `scene` None is the dataset as a whole."""

    scene: int | None
    what: str

    def __str__(self) -> str:
        return f"scene {self.scene:06d}: {self.what}" if self.scene is not None else self.what


def validate(out: Path) -> tuple[Problem, ...]:
    """All problems of a dataset folder; an empty tuple if it is sound.

    Poses are checked against masks and depth by rendering every model at its pose with a
    rasteriser of this package's own; masks must be a partition, and every count, box and run
    length must follow from them.

    Of real pictures only what they hold is checked: pictures, masks, counts and run lengths.

    Leaves out: whether the colour and the white-frame picture show the scene, and whether the
    scanner's depth is right: it is a measurement.

    Raises:
        DatasetError: the folder holds no dataset at all.
    """
    if is_real(out):
        return tuple(Problem(scene=scene, what=what) for scene, what in real_problems(out))
    try:
        claim = read_json(out / "graycast.json", records.Claim)
    except Unreadable as error:
        raise DatasetError(f"{out} is not a Graycast dataset: {error}") from error
    problems = [Problem(scene=None, what=what) for what in _leftovers(out)]
    try:
        camera = read_json(out / "camera.json", records.Camera)
        infos = read_json(out / "models" / "models_info.json", records.ModelsInfo).root
    except Unreadable as error:
        return (*problems, Problem(scene=None, what=str(error)))
    if camera.depth_scale != claim.depth_scale_mm:
        scales = f"{camera.depth_scale}, graycast.json has {claim.depth_scale_mm}"
        problems.append(Problem(scene=None, what=f"camera.json: depth_scale is {scales}"))
    expected = {str(part.obj_id) for part in claim.parts}
    if set(infos) != expected:
        what = f"models_info.json has objects {sorted(infos)}, graycast.json {sorted(expected)}"
        problems.append(Problem(scene=None, what=what))
    models: dict[int, Model] = {}
    for obj_id, info in infos.items():
        try:
            models[int(obj_id)] = model = _read_model(out, int(obj_id), info)
        except Unreadable as error:
            problems.append(Problem(scene=None, what=str(error)))
            continue
        problems += [Problem(scene=None, what=w) for w in _model_problems(int(obj_id), model)]
    finished = sorted(finished_scenes(out))
    for scene_id in finished:
        folder = out / "train" / f"{scene_id:06d}"
        found = scene_problems(folder, camera=camera, models=models)
        problems += [Problem(scene=scene_id, what=what) for what in found]
    problems += [
        Problem(scene=None, what=what) for what in _split_problems(out, camera, finished, claim)
    ]
    return tuple(problems)


def _leftovers(out: Path) -> Iterator[str]:
    """Traces of a killed run, and what does not belong into the split."""
    for path in sorted([*out.glob(".tmp-*"), *out.glob("train/.tmp-*")]):
        yield f"{path.relative_to(out)} is left over from a killed run: the next run removes it"
    names = {f"{scene_id:06d}" for scene_id in finished_scenes(out)}
    if not names:
        yield "train/ holds no scene"
    for path in sorted(out.glob("train/*")):
        if path.name not in names and not path.name.startswith("."):
            yield f"train/{path.name} is no scene"


def _read_model(out: Path, obj_id: int, info: records.ModelInfo) -> Model:
    path = out / "models" / f"obj_{obj_id:06d}.ply"
    if not path.is_file():
        raise Unreadable(f"models/{path.name} is missing")
    try:
        mesh = trimesh.load_mesh(path, process=False)
        vertices, faces = np.array(mesh.vertices, dtype=float), np.array(mesh.faces, dtype=int)
    except Exception as error:  # a damaged PLY makes trimesh raise whatever it met
        raise Unreadable(f"models/{path.name} cannot be read: {error}") from error
    if len(faces) == 0 or faces.min() < 0 or faces.max() >= len(vertices):
        raise Unreadable(f"models/{path.name} has no faces, or faces without vertices")
    texture = next(
        (
            line.split()[-1].decode()
            for line in path.read_bytes()[:1000].splitlines()
            if line.startswith(b"comment TextureFile")
        ),
        None,
    )
    if texture is not None and not (path.parent / texture).is_file():
        raise Unreadable(f"models/{texture} is missing")
    return Model(vertices=vertices, faces=faces, info=info)


def _model_problems(obj_id: int, model: Model) -> Iterator[str]:
    info, name = model.info, f"models_info.json: object {obj_id}"
    low, size = model.vertices.min(axis=0), np.ptp(model.vertices, axis=0)
    if np.abs([low - info.low, size - info.size]).max() > _MODEL_MM:
        yield f"{name}: box from {info.low}, size {info.size}; the PLY's: {low}, {size}"
    diameter_mm = diameter(model.vertices)
    if abs(diameter_mm - info.diameter) > _MODEL_MM:
        yield f"{name}: diameter is {info.diameter}, the PLY's is {diameter_mm:.6f}"
    for k, symmetry in enumerate(info.symmetries_discrete):
        if not is_rigid(np.array(symmetry, dtype=float).reshape(4, 4)):
            yield f"{name}: discrete symmetry {k} is not a rigid motion"
    for k, continuous in enumerate(info.symmetries_continuous):
        if abs(np.linalg.norm(continuous.axis) - 1) > 1e-6:
            yield f"{name}: the axis of continuous symmetry {k} has not length 1"


def _split_problems(
    out: Path, camera: records.Camera, finished: list[int], claim: records.Claim
) -> Iterator[str]:
    """`train_coco.json` against the scenes' own COCO files, which are checked against masks."""
    try:
        split = read_json(out / "train_coco.json", records.SplitCoco)
    except Unreadable as error:
        yield f"{error}: has the run finished?" if "missing" in str(error) else str(error)
        return
    names = {part.obj_id: part.name for part in claim.parts}
    if {entry.id: entry.name for entry in split.categories} != names:
        yield "train_coco.json: its categories are not the parts of graycast.json"
    images = [
        records.CocoImage(
            id=scene_id,
            file_name=f"train/{scene_id:06d}/rgb/000000.png",
            width=camera.width,
            height=camera.height,
        )
        for scene_id in finished
    ]
    if split.images != images:
        listed = sorted({image.id for image in split.images} ^ set(finished))
        yield f"train_coco.json: its images are not the finished scenes: see {listed or 'order'}"
        return
    ids = [entry.id for entry in split.annotations]
    if ids != list(range(1, len(ids) + 1)):
        yield "train_coco.json: annotation ids are not 1, 2, 3, ..."
    by_scene: dict[int, list[records.SplitAnnotation]] = {scene_id: [] for scene_id in finished}
    for entry in split.annotations:
        by_scene.setdefault(entry.image_id, []).append(entry)
    for scene_id, entries in by_scene.items():
        yield from _split_scene_problems(out, scene_id, entries)


def _split_scene_problems(
    out: Path, scene_id: int, entries: list[records.SplitAnnotation]
) -> Iterator[str]:
    folder = out / "train" / f"{scene_id:06d}"
    try:
        annotations = read_json(folder / "scene_gt_coco.json", records.SceneCoco).annotations
        infos = read_json(folder / "scene_gt_info.json", records.SceneGtInfo).image
    except Unreadable:
        return  # told where the scene is checked
    seen = [info.visib_fract for info in infos if info.px_count_visib > 0]
    if not len(entries) == len(annotations) == len(seen):
        counts = f"{len(entries)} annotations of image {scene_id}, the scene has {len(annotations)}"
        yield f"train_coco.json: {counts}"
        return
    for entry, source, visib_fract in zip(entries, annotations, seen, strict=True):
        runs = source.segmentation.model_dump()
        compressed = coco_mask.frPyObjects(runs, *runs["size"])
        must = {
            "category_id": source.category_id,
            "iscrowd": 0,
            "area": source.area,
            "bbox": [int(b) for b in coco_mask.toBbox(compressed)],
            "segmentation": {"size": runs["size"], "counts": compressed["counts"].decode()},
            "visib_fract": visib_fract,
        }
        held = entry.model_dump(exclude={"id", "image_id"})
        if held != must:
            wrong = ", ".join(key for key in must if held[key] != must[key])
            yield f"train_coco.json: annotation {entry.id}: {wrong} differs from scene {scene_id}"
