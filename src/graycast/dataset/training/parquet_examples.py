"""Read examples from Parquet exports."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ...base.errors import DatasetError
from ..export.parquet import schema  # If pyarrow is missing, this import's error names the remedy.
from ..export.record import ExportRecord
from ..read.example import Example
from .from_bytes import DEPTH_FIELDS, depth_m, image_fields, masks, picture

# If pyarrow is missing, `export.parquet` has already raised an error.
# isort: split
import pyarrow as pa
import pyarrow.parquet as pq

_LABELS = {
    "gt_id": ("instance", np.int64, (-1,)),
    "obj_id": ("obj_id", np.int64, (-1,)),
    "boxes": ("box_px", np.float32, (-1, 4)),
    "poses": ("T_cam_part", np.float64, (-1, 4, 4)),
    "visib_fract": ("visib_fract", np.float64, (-1,)),
}


def open_parquet(
    folder: Path, split: str, record: ExportRecord, scene_ids: Sequence[int]
) -> Callable[[int], Example]:
    """Find each scene's file and row group; rows are read on demand."""
    place: dict[int, tuple[Path, int, int]] = {}
    for path in sorted((folder / split).glob("part-*.parquet")):
        try:
            file = pq.ParquetFile(path)
            if not file.schema_arrow.equals(schema()):
                raise DatasetError(f"{path}: has other columns than an export has: export again")
            for group in range(file.num_row_groups):
                rows = file.read_row_group(group, columns=["scene_id"])["scene_id"].to_pylist()
                place |= {scene_id: (path, group, row) for row, scene_id in enumerate(rows)}
        except (pa.ArrowException, OSError) as error:
            raise DatasetError(f"{path}: is damaged ({error}): export again") from error
    if missing := sorted(set(scene_ids) - set(place)):
        raise DatasetError(f"{folder / split}: no file has scene {missing[0]}: export again")
    return partial(_example, place, record)


def _example(
    place: dict[int, tuple[Path, int, int]], record: ExportRecord, scene_id: int
) -> Example:
    path, group, row = place[scene_id]
    name = f"{path}: scene {scene_id}"
    try:
        line = pq.ParquetFile(path).read_row_group(group).slice(row, 1).to_pylist()[0]
    except (pa.ArrowException, OSError) as error:
        raise DatasetError(f"{path}: is damaged ({error}): export again") from error
    fields: dict[str, Any] = {}
    for kind in ("rgb", "gray"):
        if line[kind] is not None:
            fields |= image_fields(kind, picture(line[kind]["bytes"], name), name)
    for column, field in DEPTH_FIELDS.items():
        if line[column] is not None:
            steps = picture(line[column]["bytes"], name)
            fields[field] = depth_m(steps, line["depth_scale"], name)
    for column, (field, dtype, shape) in _LABELS.items():
        if line[column] is not None:
            fields[field] = np.array(line[column], dtype).reshape(shape)
    if line["masks"] is not None:
        fields["mask"] = masks(line["masks"], record.size_of(scene_id), name)
    return Example(
        scene_id=scene_id,
        K=np.array(line["cam_K"], float).reshape(3, 3),
        distortion=tuple(line["distortion"]),
        **fields,
    )
