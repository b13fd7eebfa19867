"""Export to Parquet: a row per picture, with images as PNG bytes and labels as lists.

An image is a struct of `bytes` and `path`. The schema's metadata declares it as an image, so that
the library `datasets` of Hugging Face opens it as an `Image`.
Source: huggingface.co/docs/datasets, "Image" and "Features".
"""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from ...base.errors import GraycastError
from ..read.stored import StoredDataset
from .options import Options, settled
from .picture_job import PictureJob
from .placing import groups

try:
    import pyarrow as pa
    import pyarrow.parquet as pq
except ImportError as error:
    raise GraycastError(
        "Parquet needs pyarrow, which is not installed: run pip install 'graycast[parquet]'"
    ) from error

_GROUP = 16  # This number of scenes is in memory at a time.
_IMAGES = {"rgb": "rgb", "gray_sl": "gray", "depth": "depth", "depth_sl": "depth_sl"}


def schema() -> "pa.Schema":
    """Return the columns of a row; columns that a dataset does not contain are null."""
    masks = pa.struct([("size", pa.list_(pa.int32(), 2)), ("counts", pa.string())])
    image = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
    features = {name: {"_type": "Image"} for name in _IMAGES.values()}
    return pa.schema(
        [
            ("scene_id", pa.int64()),
            *((name, image) for name in _IMAGES.values()),
            ("depth_scale", pa.float64()),
            ("cam_K", pa.list_(pa.float64(), 9)),
            ("distortion", pa.list_(pa.float64(), 5)),
            ("gt_id", pa.list_(pa.int64())),
            ("obj_id", pa.list_(pa.int64())),
            ("boxes", pa.list_(pa.list_(pa.float32(), 4))),
            ("masks", pa.list_(masks)),
            ("poses", pa.list_(pa.list_(pa.float64(), 16))),
            ("visib_fract", pa.list_(pa.float64())),
        ],
        # Columns that are not named here keep their Arrow type.
        metadata={"huggingface": json.dumps({"info": {"features": features}})},
    )


def write_split(
    folder: Path,
    split: str,
    contents: Iterable[dict[str, Any]],
    stored: StoredDataset,
    options: Options,
) -> None:
    """Write `SPLIT/part-000000.parquet` ... in row groups of few scenes, to limit memory use."""
    (folder / split).mkdir()
    for part, of_file in enumerate(groups(contents, settled(options.shard_scenes))):
        target = folder / split / f"part-{part:06d}.parquet"
        with pq.ParquetWriter(target, schema()) as writer:
            for group in groups(of_file, _GROUP):
                writer.write_table(pa.Table.from_pylist(list(group), schema=schema()))


def content(job: PictureJob) -> dict[str, Any]:
    """Return the row of a picture."""
    scene, options = job.scene, job.options
    view = scene.view()
    names = (*options.depths, *([options.picture] if options.picture else ()))
    row: dict[str, Any] = {
        _IMAGES[name]: {"bytes": scene.png(name).read_bytes(), "path": f"{scene.image_id:06d}.png"}
        for name in names
    }
    row |= {"scene_id": scene.image_id, "depth_scale": view.depth_scale}
    row |= {"cam_K": view.cam_K, "distortion": view.distortion}
    if "masks" not in scene.holds:
        return row
    labels = scene.labels(min_visibility=settled(options.min_visibility))
    row |= {
        "gt_id": [label.instance for label in labels],
        "obj_id": [label.obj_id for label in labels],
        "boxes": [label.box for label in labels],
        "masks": [label.segmentation for label in labels],
    }
    if "poses" in scene.holds:
        row["poses"] = [label.T_cam_part.ravel().tolist() for label in labels]
    if "shares" in scene.holds:
        row["visib_fract"] = [label.visib_fract for label in labels]
    return row
