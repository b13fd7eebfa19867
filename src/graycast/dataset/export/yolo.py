"""Export to YOLO in Ultralytics' form: `data.yaml`, pictures, and a text file for each picture.

A row is the class (from 0, in the order of object ids), followed by the centre and size of the box
or the corners of a polygon, all as fractions of width and height.

Source: docs.ultralytics.com, datasets/detect and datasets/segment.
"""

from collections.abc import Iterable
from pathlib import Path

import yaml

from ..read.example import InstanceLabel
from ..read.stored import StoredDataset
from .options import Options, settled
from .outline import path
from .picture_job import PictureJob
from .placing import place


def content(job: PictureJob) -> tuple[str, Path, str]:
    """Return the name of a picture, its file after a check, and the rows of its labels."""
    scene, options = job.scene, job.options
    place_of = {obj_id: i for i, obj_id in enumerate(scene.categories)}
    kind = settled(options.labels)
    source = scene.png(settled(options.picture))
    rows = (
        f"{place_of[label.obj_id]} {_label_line(label, kind, scene.size_px)}\n"
        for label in scene.labels(min_visibility=settled(options.min_visibility))
    )
    return f"{scene.image_id:06d}", source, "".join(rows)


def write_split(
    folder: Path,
    split: str,
    contents: Iterable[tuple[str, Path, str]],
    stored: StoredDataset,
    options: Options,
) -> None:
    """Write `images/SPLIT/000000.png` and `labels/SPLIT/000000.txt`."""
    labels = folder / "labels" / split
    labels.mkdir(parents=True)
    for name, source, rows in contents:
        place(source, folder / "images" / split / f"{name}.png", link=settled(options.link))
        (labels / f"{name}.txt").write_text(rows, encoding="ascii")


def write_rest(
    folder: Path, splits: Iterable[str], stored: StoredDataset, options: Options
) -> None:
    """Write `data.yaml` without `path`, so that its own folder is the root and can be moved."""
    content = {split: f"images/{split}" for split in splits}
    # Ultralytics requires both keys; a dataset with one set uses it for training and validation.
    first = next(iter(content.values()))
    content = {"train": first, "val": first} | content
    names = dict(enumerate(stored.categories.values()))
    text = yaml.safe_dump(content | {"names": names}, sort_keys=False, allow_unicode=True)
    (folder / "data.yaml").write_text(text, encoding="utf-8")


def _label_line(label: InstanceLabel, kind: str, size_px: tuple[int, int]) -> str:
    height_px, width_px = size_px
    if kind == "boxes":
        x, y, w, h = label.box
        numbers = [x + w / 2, y + h / 2, w, h]
    else:
        numbers = (path(label.window()) + label.box[:2]).ravel().tolist()
    shares = (n / (height_px if i % 2 else width_px) for i, n in enumerate(numbers))
    return " ".join(f"{share:.7f}" for share in shares)
