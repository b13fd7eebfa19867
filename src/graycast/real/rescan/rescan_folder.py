"""The folder of a result: the original files, linked or copied, and the scanner's files.

Original files keep their names; names of the scanner's files end in `_sl`, as in Graycast's own
datasets. The record `scan_sl/000012.json` is written after all pictures of image 12 and so marks
the image as finished. At the end of each run, the JSON files of scenes are made from the records.
"""

import shutil
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

import cv2
import numpy as np

from ...base.errors import DatasetError
from ...base.folder import beside, claimed_folder, refuse_foreign, remove_left, write_whole
from ...dataset.check.rescan_check import scene_records
from ...dataset.files.json_text import json_bytes
from ...dataset.files.places import CLAIM
from ...dataset.files.records import MM_PER_M
from ...dataset.files.safe_reading import Unreadable
from ...dataset.files.scene_folder import SCANNER, picture_name
from ...dataset.files.seal import MANIFEST, SUMS, sha256
from ...dataset.read.rescanned import (
    RECORDS,
    ImageRecord,
    changes,
    image_records,
    is_rescanned,
    read_rescan,
)
from ...dataset.write.claim import refuse_other
from ...dataset.write.models import model_files, models_info
from ...dataset.write.picture_bytes import depth_scale_mm, depth_steps, png
from .source import Source, SourceImage


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class RescanFolder:
    """The folder of a result, open for one run; `copies` makes copies instead of links."""

    out: Path
    source: Source
    copies: bool

    def finished(self) -> set[tuple[int, int]]:
        """Return the scene and image numbers of the finished images."""
        records = (self.out / self.source.split).glob(f"*/{RECORDS}/*.json")
        return {(int(path.parents[1].name), int(path.stem)) for path in records}

    def write(self, place: tuple[int, int], files: Iterable[tuple[str, bytes]]) -> None:
        """Write the files of one image in order; the last must be the result of `record_file`."""
        scene = self._scene(place[0])
        for name, content in files:
            path = scene / name
            path.parent.mkdir(parents=True, exist_ok=True)
            write_whole(path, content)

    def refuse_changed(self) -> None:
        """Refuse a source in which an image has changed since it was scanned.

        Raises:
            DatasetError: images have changed; the text has their number and names one of them.
        """
        finished, source = self.finished(), self.source
        images = set(source.images)
        changed: dict[tuple[int, int], list[str]] = {}
        for scene_id in sorted({scene_id for scene_id, _ in finished}):
            records = self._records(scene_id)
            left = [number for number in records if (scene_id, number) in images]
            sums = source.sums(scene_id, left) if left else {}
            for number, record in records.items():
                names = changes(record.source, sums.get(number, {})) if record.source else ()
                if names:
                    changed[scene_id, number] = list(names)
        if changed:
            (scene_id, number), names = next(iter(changed.items()))
            folders = ", ".join(sorted({self._scene(scene_id).name for scene_id, _ in changed}))
            raise DatasetError(
                f"{source.folder}: {len(changed)} of the {len(finished)} images in {self.out} are "
                f"not what they were when they were scanned, first scene {scene_id}, image "
                f"{number} ({', '.join(names)}): restore the original, or choose another --out, or "
                f"remove the scenes {folders} in {self.out / source.split} to scan them again"
            )

    def begin(self, scene_ids: Iterable[int]) -> None:
        """Link, copy or write the source's models, and link or copy scenes except scanner files."""
        source = self.source
        if source.scenes:
            root = source.folder.parent
            for path in (*root.glob("models*"), root / "camera.json"):
                if path.exists():
                    self._bring(path, self.out / path.name)
        elif source.parts:
            (self.out / "models").mkdir(exist_ok=True)
            parts = tuple(source.parts[obj_id] for obj_id in sorted(source.parts))
            files = model_files(parts) | {"models_info.json": json_bytes(models_info(parts))}
            for name, content in files.items():
                write_whole(self.out / "models" / name, content)
        for scene_id in scene_ids:
            scene = self._scene(scene_id)
            scene.mkdir(exist_ok=True)
            remove_left(*scene.glob(f"*{SCANNER}"))
            if source.scenes:
                for path in sorted(source.scenes[scene_id].iterdir()):
                    if not path.stem.endswith(SCANNER) and path.name != MANIFEST:
                        self._bring(path, scene / path.name)

    def finish(self) -> None:
        """Write the JSON files of each scene from the records of its finished images."""
        for scene_id in sorted({scene_id for scene_id, _ in self.finished()}):
            for name, content in scene_records(self._records(scene_id)).items():
                write_whole(self._scene(scene_id) / f"{name}.json", json_bytes(content))

    def _scene(self, scene_id: int) -> Path:
        return self.out / self.source.split / f"{scene_id:06d}"

    def _records(self, scene_id: int) -> dict[int, ImageRecord]:
        """Return the records of a scene by image number.

        Raises:
            DatasetError: a record is damaged.
        """
        try:
            return image_records(self._scene(scene_id))
        except Unreadable as error:
            raise DatasetError(
                f"{self._scene(scene_id)}: {error}: remove this record to scan its image again"
            ) from error

    def _bring(self, path: Path, place: Path) -> None:
        """Link to an original file or folder, or copy it; a copy replaces a link."""
        linked = place.is_symlink()
        if place.exists() and not (linked and self.copies):
            return
        if not self.copies:
            place.unlink(missing_ok=True)  # There may be a broken link.
            place.symlink_to(path.resolve(), target_is_directory=path.is_dir())
            return
        with (
            beside(place) as aside
        ):  # The file must be complete or absent, because the next run keeps an existing file.
            (shutil.copytree if path.is_dir() else shutil.copyfile)(path, aside)
            if linked:
                place.unlink()  # A folder cannot be renamed to the name of an existing link.


@contextmanager
def open_rescan(
    out: Path,
    source: Source,
    claim: Mapping[str, Any],
    *,
    scene_ids: Iterable[int],
    copies: bool,
) -> Iterator[RescanFolder]:
    """Make the folder, or continue a folder with the same claim, and lock it against other runs.

    Args:
        scene_ids: ids of the scenes whose original files are linked or copied.

    Raises:
        GraycastError: the folder has other content, was made from another source, is inside the
            source, is in use or cannot be written, or the source has changed since.
    """
    refuse_foreign(out, CLAIM)
    original = source.folder.resolve()
    if out.resolve() == original or original in out.resolve().parents:
        raise DatasetError(f"{out}: lies in {source.folder}, which is not changed: give another")
    with claimed_folder(out, source.split, ".lock"):
        folder = RescanFolder(out=out, source=source, copies=copies)
        if (out / CLAIM).exists():
            _refuse_other_source(out, source)
            refuse_other(out / CLAIM, claim)
            folder.refuse_changed()
        else:
            write_whole(out / CLAIM, json_bytes(claim))
        try:
            folder.begin(scene_ids)
            yield folder
        except OSError as error:
            raise DatasetError(
                f"{out}: cannot be written ({error.strerror or error}): free space, or choose a "
                "writable folder; finished images are kept"
            ) from error


def _refuse_other_source(out: Path, source: Source) -> None:
    """Refuse to continue a result that was made from a dataset in another folder.

    Raises:
        DatasetError: the result was made from another folder; the text names both folders.
    """
    if is_rescanned(out):
        places = {str(source.folder), str(source.folder.resolve())}
        if places.isdisjoint(before := read_rescan(out).sources):
            raise DatasetError(
                f"{out}: was made from {', '.join(before)}, not from {source.folder}: choose "
                "another --out; if the dataset was moved, put it back, or link it there"
            )


def record_file(
    number: int, record: Mapping[str, Any], files: Iterable[tuple[str, bytes]]
) -> tuple[str, bytes]:
    """Return path and content of an image's record, including the SHA-256 of the image's files."""
    sums = {name: sha256(content) for name, content in files}
    return f"{RECORDS}/{number:06d}.json", json_bytes({**record, SUMS: sums})


def plain_files(image: SourceImage, number: int) -> tuple[list[tuple[str, bytes]], dict[str, Any]]:
    """Return the pictures and JSON entries of an image, converted from any layout to BOP's form."""
    scale_mm = depth_scale_mm(float(np.nanmax(image.depth_m)))
    steps = depth_steps(image.depth_m, scale_mm, needed=np.isfinite(image.depth_m))
    files = [(picture_name("depth", number), png(steps))]
    if image.rgb is not None:
        files.append((picture_name("rgb", number), png(cv2.cvtColor(image.rgb, cv2.COLOR_RGB2BGR))))
    poses = [
        {
            "cam_R_m2c": T[:3, :3].ravel().tolist(),
            "cam_t_m2c": (T[:3, 3] * MM_PER_M).tolist(),
            "obj_id": int(obj_id),
        }
        for T, obj_id in zip(image.T_cam_part, image.obj_id, strict=True)
    ]
    view = {"cam_K": image.camera.K.ravel().tolist(), "depth_scale": scale_mm}
    return files, {"scene_camera": view, "scene_gt": poses}
