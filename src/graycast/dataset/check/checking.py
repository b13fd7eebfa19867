"""Check a dataset from its files alone, without the renderer and the configuration."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

from ...base.file_limits import parse_json
from ...base.public_value import public_value
from ...base.spawn import in_order
from ..files import records
from ..files.places import CLAIM, camera_file, finished_scenes
from ..files.safe_reading import Unreadable, read_json
from ..files.scene_folder import SceneFolder, picture_name
from ..files.seal import MANIFEST, seal_problems, sum_problems
from ..read.real import RealClaim, read_claim, real_problems
from ..read.rescanned import is_rescanned
from ..write.claim import BESIDE_CONFIG, camera_json, difference, fingerprint, rig_of
from .model_check import Model, model_problems, read_model

_Finding = tuple[int | None, str]  # A scene (None is the whole dataset) and a message.


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Problem:
    """A problem and its scene; `scene` is None if the problem concerns the whole dataset."""

    scene: int | None
    what: str

    def __str__(self) -> str:
        return f"scene {self.scene:06d}: {self.what}" if self.scene is not None else self.what


def validate(out: Path | str, *, fast: bool = False, workers: int = 1) -> tuple[Problem, ...]:
    """Return all problems of a dataset folder; an empty tuple if the folder has no problems.

    Each file must have the SHA-256 that was recorded when it was written. With `fast`, nothing else
    is checked: this takes a hundredth of the time and still reveals every later change of a file.

    Poses are checked against masks and depth: an independent rasteriser renders every model at its
    pose. Visible masks must not overlap, and every count, box and run length must follow from them.

    Grasp labels, if there are any, must belong to the dataset's own instances and poses.

    A dataset of real pictures is checked for what it contains: pictures, masks, counts and run
    lengths. A rescan is checked only for what the scanner added.

    Args:
        workers: number of processes that check the contents of scenes; the result does not depend
            on it.

    Raises:
        DatasetError: the folder holds no dataset, or one of another version of Graycast.
    """
    return tuple(each_problem(out, fast=fast, workers=workers))


def each_problem(out: Path | str, *, fast: bool = False, workers: int = 1) -> Iterator[Problem]:
    """Yield the problems that `validate` returns, in the same order, each as soon as it is known.

    The claim and the cameras come first, then the scenes one by one, then models, COCO's file of
    the split, and grasps.
    """
    for scene, what in _problems(Path(out), fast=fast, workers=workers):
        yield Problem(scene=scene, what=what)


def _problems(out: Path, *, fast: bool, workers: int) -> Iterator[_Finding]:
    if is_rescanned(out):
        from .rescan_check import rescan_problems  # The first problem must not wait for it.

        yield from rescan_problems(out, fast=fast)
        return
    claim, finished = read_claim(out), sorted(finished_scenes(out))
    folders = [out / "train" / f"{scene_id:06d}" for scene_id in finished]
    check_sums = partial(_sum_problems, claim=claim)
    if isinstance(claim, RealClaim):
        yield from _of_scenes(check_sums, folders, workers)
        yield from () if fast else real_problems(out, claim)
        return
    yield from _of_dataset(_leftovers(out))
    yield from _of_dataset(_claim_problems(out, claim))
    if fast:
        yield from _of_scenes(check_sums, folders, workers)
        return
    try:
        cameras = {
            taker.name: read_json(out / camera_file(taker.name), records.Camera)
            for taker in claim.takers
        }
        infos = read_json(out / "models" / "models_info.json", dict[str, records.ModelInfo])
    except Unreadable as error:
        yield None, str(error)
        yield from _of_scenes(check_sums, folders, workers)
        return
    yield from _of_dataset(_camera_problems(cameras, claim))
    expected = {str(part.obj_id) for part in claim.parts}
    if set(infos) != expected:
        names = f"{sorted(infos)}, graycast.json {sorted(expected)}"
        yield None, f"models_info.json has objects {names}"
    models: dict[int, Model] = {}
    for obj_id, info in infos.items():
        try:
            models[int(obj_id)] = read_model(out, int(obj_id), info)
        except Unreadable as error:
            yield None, str(error)
    check = partial(_scene_problems, claim=claim, cameras=cameras, models=models)
    yield from _of_scenes(check, folders, workers)
    for number, model in models.items():
        yield from _of_dataset(model_problems(number, model))
    yield from _of_dataset(_split_problems(out, cameras, finished, claim))
    from .grasp_files import grasp_problems

    yield from _of_dataset(grasp_problems(out, claim.fingerprint, models))


def _of_scenes(
    check: Callable[[Path], Iterable[str]], folders: list[Path], workers: int
) -> Iterator[_Finding]:
    here = len(folders) if workers == 1 else 1  # The first problems must not wait for processes.
    others = in_order(partial(_listed, check), folders[here:], workers=workers)
    for folder, of_scene in zip(folders, chain(map(check, folders[:here]), others), strict=True):
        yield from ((int(folder.name), what) for what in of_scene)


def _listed(check: Callable[[Path], Iterable[str]], folder: Path) -> list[str]:
    return list(check(folder))


def _scene_problems(folder: Path, *, claim: records.Claim, **dataset: Any) -> Iterator[str]:
    yield from _sum_problems(folder, claim=claim)
    from .scene_check import scene_problems  # It loads compiled code: first report changed files.

    yield from scene_problems(folder, claim=claim, **dataset)


def _of_dataset(problems: Iterable[str]) -> Iterator[_Finding]:
    return ((None, what) for what in problems)


def _sum_problems(folder: Path, *, claim: records.Claim | RealClaim) -> Iterator[str]:
    """Yield files of a scene that have changed, and signs that it is of another dataset."""
    try:
        manifest = read_json(folder / MANIFEST, records.Manifest)
    except Unreadable as error:
        yield str(error)
        return
    yield from seal_problems(folder, manifest)
    scene_id = manifest.get("scene_id", int(folder.name))  # real pictures have no scene_id
    if scene_id != int(folder.name):
        yield f"{MANIFEST}: scene_id is {scene_id}: the folder may be a copy of another scene"
    if isinstance(claim, records.Claim):
        yield from _other_dataset(manifest, claim)


def _other_dataset(manifest: Mapping[str, Any], claim: records.Claim) -> Iterator[str]:
    """Yield the differences between this dataset and a scene copied from a different one."""
    config = {key: value for key, value in claim.config.items() if key not in BESIDE_CONFIG}
    for key, must in (("dataset_seed", claim.seed), ("config", config)):
        if (place := difference(manifest.get(key), must, key)) is not None:
            yield f"the scene is of another dataset: {MANIFEST} and {CLAIM} differ in {place}"


def _claim_problems(out: Path, claim: records.Claim) -> Iterator[str]:
    """Yield contradictions between `graycast.json`, its fingerprint, the models and the cameras."""
    content = parse_json((out / CLAIM).read_bytes())
    if fingerprint(content) != claim.fingerprint:
        yield f"{CLAIM} was changed after it was written: its fingerprint differs"
    if not claim.sha256:
        yield f"{CLAIM}: sha256 is missing: whether models and cameras were changed was not checked"
    yield from sum_problems(out, claim.sha256, listed_in=CLAIM)


def _camera_problems(cameras: Mapping[str, records.Camera], claim: records.Claim) -> Iterator[str]:
    """Yield differences between the files of intrinsics and the rigs in `graycast.json`."""
    if claim.takers[0].rig != claim.rig:
        yield f"{CLAIM}: rig is not that of the first of its scanners"
    for taker in claim.takers:
        camera, name = cameras[taker.name], camera_file(taker.name)
        if camera.depth_scale != claim.depth_scale_mm:
            scales = f"{camera.depth_scale}, graycast.json has {claim.depth_scale_mm}"
            yield f"{name}: depth_scale is {scales}"
        try:
            lens = rig_of(taker.rig).camera
        except (KeyError, TypeError, ValueError) as error:
            yield f"{CLAIM}: rig is none: {error}"
            continue
        must = camera_json(lens, claim.depth_scale_mm) | {"distortion": list(lens.distortion)}
        is_ = camera.model_dump()
        for key in sorted(set(must) - {"depth_scale"}):
            if is_[key] != must[key]:
                yield f"{name}: {key} is {is_[key]}, the rig of {CLAIM} has {must[key]}"


def _leftovers(out: Path) -> Iterator[str]:
    """Yield traces of a killed run, and files that do not belong to the split."""
    for path in sorted([*out.glob(".tmp-*"), *out.glob("train/.tmp-*")]):
        yield f"{path.relative_to(out)} is left over from a killed run: the next run removes it"
    names = {f"{scene_id:06d}" for scene_id in finished_scenes(out)}
    if not names:
        yield "train/ holds no scene"
    for path in sorted(out.glob("train/*")):
        if path.name not in names and not path.name.startswith("."):
            yield f"train/{path.name} is no scene"


def _split_problems(
    out: Path, cameras: Mapping[str, records.Camera], finished: list[int], claim: records.Claim
) -> Iterator[str]:
    """Check `train_coco.json` against the scenes' COCO files, whose masks are checked elsewhere."""
    try:
        split = read_json(out / "train_coco.json", records.CocoFile[records.SplitAnnotation])
    except Unreadable as error:
        yield (
            f"{error}: let the run finish, then validate again"
            if "missing" in str(error)
            else str(error)
        )
        return
    names = {part.obj_id: part.name for part in claim.parts}
    if {entry.id: entry.name for entry in split.categories} != names:
        yield "train_coco.json: its categories are not the parts of graycast.json"
    places = {
        scene_id * len(claim.images) + k: (scene_id, sensor, image)
        for scene_id in finished
        for k, (sensor, image) in enumerate(claim.images)
    }
    images = [
        records.CocoImage(
            id=image_id,
            file_name=f"train/{scene_id:06d}/{picture_name('rgb', image, sensor)}",
            width=cameras[sensor].width,
            height=cameras[sensor].height,
        )
        for image_id, (scene_id, sensor, image) in places.items()
    ]
    if split.images != images:
        listed = sorted({image.id for image in split.images} ^ set(places))
        yield f"train_coco.json: its images are not the finished scenes: see {listed or 'order'}"
        return
    ids = [entry.id for entry in split.annotations]
    if ids != list(range(1, len(ids) + 1)):
        yield "train_coco.json: annotation ids are not 1, 2, 3, ..."
    by_image: dict[int, list[records.SplitAnnotation]] = {image_id: [] for image_id in places}
    for entry in split.annotations:
        by_image.setdefault(entry.image_id, []).append(entry)
    for image_id, entries in by_image.items():
        if image_id not in places:
            yield (
                f"train_coco.json: {len(entries)} annotations of image {image_id}, "
                "which does not exist"
            )
            continue
        yield from _split_image_problems(out, image_id, places[image_id], entries)


def _split_image_problems(
    out: Path,
    image_id: int,
    place: tuple[int, str, int],
    entries: list[records.SplitAnnotation],
) -> Iterator[str]:
    scene_id, sensor, image = place
    scene = SceneFolder(out / "train" / f"{scene_id:06d}", sensor)
    try:
        of_scene = scene.record("scene_gt_coco", records.SceneCoco).annotations
        infos = scene.of_image("scene_gt_info", image, list[records.Info])
    except Unreadable:
        return  # The check of the scene reports this.
    annotations = [entry for entry in of_scene if entry.image_id == image]
    visible = [info.visib_fract for info in infos if info.px_count_visib > 0]
    if not len(entries) == len(annotations) == len(visible):
        counts = f"{len(entries)} annotations of image {image_id}, the scene has {len(annotations)}"
        yield f"train_coco.json: {counts}"
        return
    for entry, source, visib_fract in zip(entries, annotations, visible, strict=True):
        must = records.split_annotation(source.model_dump(), image_id)
        must["visib_fract"] = visib_fract
        values = entry.model_dump(exclude={"id"})
        if values != must:
            wrong = ", ".join(key for key in must if values[key] != must[key])
            yield f"train_coco.json: annotation {entry.id}: {wrong} differs from scene {scene_id}"
