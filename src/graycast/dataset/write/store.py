"""Write a dataset's folder: one run at a time, one configuration, complete scenes only.

`graycast.json` reserves the folder for a configuration before anything else is written. A scene is
written to a temporary folder and renamed, so that a reader or a restarted run sees all of it or
nothing. Names that begin with `.tmp-` are leftovers of a killed run; the next run removes them.

Limitation: a power cut may lose the masks of the last scenes, because the thousand files of a scene
are not forced to the disk one by one; `validate` finds such scenes.
"""

import errno
import os
import shutil
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, final

from ...base.errors import DatasetError
from ...base.folder import ASIDE, beside, remove_left, take_lock
from ...rig.pair import Rig
from ...world.parts import Part
from ..files.json_text import json_bytes
from ..files.places import CLAIM, camera_file, finished_scenes
from ..files.records import Manifest
from ..files.safe_reading import Unreadable
from ..files.sample import Sample
from ..files.scene_folder import SceneFolder, of_sensor, picture_name
from ..files.seal import SUMS, sha256
from .bop import scene_files
from .claim import Taker, camera_json, make_claim, refuse_other
from .coco import coco_categories, split_coco
from .models import model_files, models_info
from .set_aside import SETASIDE

_LOCK = ".lock"


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Store:
    """An open dataset folder, locked against other runs until it is closed."""

    out: Path
    depth_scale_mm: float
    categories: tuple[tuple[int, str], ...]  # (object id, name of the part)
    takers: tuple[Taker, ...]  # A single scanner has the name "".
    lock: IO[str]

    def finished(self) -> set[int]:
        """Return the scenes in the folder, all of which are complete."""
        return finished_scenes(self.out)

    def write(self, scene_id: int, samples: Iterable[Sample]) -> None:
        """Write all images of a scene; errors are those of `write_files` and `scene_files`."""
        self.write_files(scene_id, scene_files(samples, self.depth_scale_mm))

    def write_files(self, scene_id: int, files: Iterable[tuple[str, bytes]]) -> None:
        """Write one scene, completely or not at all.

        Args:
            files: (path inside the scene's folder, content), as from `scene_files`.

        Raises:
            DatasetError: the disk refuses, or the scene exists already.
        """
        place = self.out / "train" / f"{scene_id:06d}"
        with _disk_errors(self.out), beside(place) as aside:
            if place.exists():  # No other run writes, since the folder is locked.
                raise DatasetError(f"{place} exists already: remove it to make it again")
            aside.mkdir()
            for taker in self.takers:
                for folder in ("mask", "mask_visib", "mask_sl", "mask_visib_sl"):
                    # The folders exist even if no instance is visible.
                    (aside / of_sensor(folder, taker.name)).mkdir()
            for name, content in files:
                path = aside / name
                path.parent.mkdir(exist_ok=True)
                _write(path, [content], to_disk=not name.startswith("mask"))
        with _disk_errors(self.out):
            _sync(place.parent)  # force the new name to the disk

    def finish(self, scene_ids: Iterable[int]) -> None:
        """Write the split's COCO file for all finished scenes.

        Args:
            scene_ids: scenes that must be finished.

        Raises:
            DatasetError: one of `scene_ids` is missing, or the disk refuses.
        """
        finished = sorted(self.finished())
        missing = sorted(set(scene_ids) - set(finished))
        if missing:
            raise DatasetError(
                f"{self.out}: scenes {missing} are not finished: run graycast generate to make them"
            )
        pictures = [picture for scene_id in finished for picture in self._pictures(scene_id)]
        text = split_coco(
            (of_picture for scene_id in finished for of_picture in self._annotations(scene_id)),
            pictures=pictures,
            categories=coco_categories(self.categories),
        )
        _replace(self.out / "train_coco.json", (piece.encode() for piece in text))

    def _pictures(self, scene_id: int) -> list[dict[str, Any]]:
        """Return the entries of a scene's images in the split's COCO file."""
        images = [(taker, image) for taker in self.takers for image in range(taker.images)]
        return [
            {
                "id": scene_id * len(images) + k,
                "file_name": f"train/{scene_id:06d}/{picture_name('rgb', image, taker.name)}",
                "width": taker.rig.camera.width_px,
                "height": taker.rig.camera.height_px,
            }
            for k, (taker, image) in enumerate(images)
        ]

    def _annotations(self, scene_id: int) -> Iterator[tuple[int, list[Any], list[Any]]]:
        """Yield each image's id in the split, its COCO annotations and its `scene_gt_info`."""
        number = scene_id * sum(taker.images for taker in self.takers)
        for taker in self.takers:
            scene = SceneFolder(self.out / "train" / f"{scene_id:06d}", taker.name)
            try:
                coco = scene.record("scene_gt_coco", Manifest)
                for image in range(taker.images):
                    infos = scene.of_image("scene_gt_info", image, list[dict[str, Any]])
                    own = [entry for entry in coco["annotations"] if entry["image_id"] == image]
                    yield number, own, infos
                    number += 1
            except (Unreadable, KeyError, TypeError) as error:
                raise DatasetError(
                    f"{scene.path} cannot be read back ({error}): remove this folder and run again"
                ) from error

    def tidy(self) -> None:
        """Remove unfinished scenes after a failed run; if no scene is finished, also the claim.

        An impossible configuration therefore does not keep the folder reserved.
        """
        with suppress(OSError):
            remove_left(self.out, self.out / "train")
            if self.finished():
                return
            shutil.rmtree(self.out / "models", ignore_errors=True)
            (self.out / "train").rmdir()
            for taker in self.takers:
                (self.out / camera_file(taker.name)).unlink(missing_ok=True)
            (self.out / SETASIDE).unlink(missing_ok=True)
            (self.out / CLAIM).unlink(missing_ok=True)

    def close(self) -> None:
        """Release the folder for other runs."""
        self.lock.close()

    def __enter__(self) -> "Store":
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()


def open_store(
    out: Path,
    *,
    config: Mapping[str, Any],
    seed: int,
    parts: tuple[Part, ...],
    rig: Rig,
    depth_scale_mm: float,
    takers: tuple[Taker, ...] = (),
) -> Store:
    """Create a dataset folder, or open one of the same configuration, and lock it.

    Leftovers of a killed run are removed, and missing models and files of intrinsics are written.

    Args:
        rig: the rig of the first scanner.
        takers: all scanners, if a scene has several images or a scanner has a name.

    Raises:
        DatasetError: the folder belongs to another program, another configuration or a run that
            has not ended, or the disk refuses.
        ValueError: a value in `config` has no JSON form.
    """
    claim = make_claim(config, seed, parts, rig, depth_scale_mm, takers)
    takers = takers or (Taker(name="", images=1, rig=rig, scanning={}),)
    parts = tuple(part for part in parts if part.labelled)
    _refuse_foreign(out)
    with _disk_errors(out):
        out.mkdir(parents=True, exist_ok=True)
        lock = take_lock(out / _LOCK)
    if lock is None:
        raise DatasetError(
            f"another run is writing to {out}: wait until it ends, or choose another folder"
        )
    try:
        with _disk_errors(out):
            remove_left(out, out / "train")
            if (out / CLAIM).exists():
                refuse_other(out / CLAIM, claim)
                cameras = [camera_file(taker.name) for taker in takers]
                if not all((out / name).exists() for name in ("models", *cameras)):
                    _write_common(out, _common_files(parts, takers, depth_scale_mm))
            else:
                files = _common_files(parts, takers, depth_scale_mm)
                sums = {name: sha256(content) for name, content in files.items()}
                _replace(out / CLAIM, [json_bytes(claim | {SUMS: sums})])
                _write_common(out, files)
            (out / "train").mkdir(exist_ok=True)
    except BaseException:
        lock.close()
        raise
    return Store(
        out=out,
        depth_scale_mm=depth_scale_mm,
        categories=tuple((obj_id, part.name) for obj_id, part in enumerate(parts, start=1)),
        takers=takers,
        lock=lock,
    )


def _sync(path: Path) -> None:
    folder = os.open(path, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


def _refuse_foreign(out: Path) -> None:
    if out.exists() and not out.is_dir():
        raise DatasetError(f"{out} is a file: give a folder for the dataset")
    if not out.exists() or (out / CLAIM).exists():
        return
    with _disk_errors(out):
        foreign = [
            entry.name
            for entry in out.iterdir()
            if entry.name != _LOCK and not entry.name.startswith(ASIDE)
        ]
    if foreign:
        raise DatasetError(
            f"{out} is not empty and holds no Graycast dataset (it has {min(foreign)}): "
            "choose another folder"
        )


def _common_files(
    parts: tuple[Part, ...], takers: tuple[Taker, ...], depth_scale_mm: float
) -> dict[str, bytes]:
    """Return the files that all scenes share: the models and the cameras."""
    models = model_files(parts) | {"models_info.json": json_bytes(models_info(parts))}
    common = {f"models/{name}": content for name, content in models.items()}
    return common | {
        camera_file(taker.name): json_bytes(camera_json(taker.rig.camera, depth_scale_mm))
        for taker in takers
    }


def _write_common(out: Path, files: Mapping[str, bytes]) -> None:
    """Write the missing files; the folder of models is written as a whole."""
    for name, content in files.items():
        if not name.startswith("models/") and not (out / name).exists():
            _replace(out / name, [content])
    if (out / "models").exists():
        return
    with beside(out / "models") as aside:
        aside.mkdir()
        for name, content in files.items():
            if name.startswith("models/"):
                _write(aside / Path(name).name, [content], to_disk=True)


def _replace(path: Path, pieces: Iterable[bytes]) -> None:
    """Write a file under a temporary name and rename it."""
    with _disk_errors(path.parent), beside(path) as aside:
        _write(aside, pieces, to_disk=True)


def _write(path: Path, pieces: Iterable[bytes], *, to_disk: bool) -> None:
    with open(path, "wb") as file:
        for piece in pieces:
            file.write(piece)
        if to_disk:
            file.flush()
            os.fsync(file.fileno())


@contextmanager
def _disk_errors(out: Path) -> Iterator[None]:
    """Convert an error of the operating system to a DatasetError that names a remedy."""
    try:
        yield
    except OSError as error:
        remedy = {
            errno.ENOSPC: "free space",
            errno.EDQUOT: "free space in your disk quota",
            errno.EACCES: "make the folder writable",
            errno.EROFS: "choose a folder on a writable disk",
        }.get(error.errno or 0, "find the cause of this error of the operating system")
        raise DatasetError(
            f"cannot write to {out} ({error.strerror or error}{_free(out)}): {remedy} and run the "
            "same command again; finished scenes are kept"
        ) from error


def _free(out: Path) -> str:
    try:
        return f", {shutil.disk_usage(out).free / 2**30:.2f} GiB free"
    except OSError:
        return ""
