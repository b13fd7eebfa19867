"""What a user may say about a dataset of others that its own files leave open."""

from dataclasses import dataclass
from pathlib import Path

from ...base.errors import DatasetError


@dataclass(frozen=True, slots=True, kw_only=True)
class SourceOptions:
    """What the files of a dataset do not say, or what is to be read of them.

    Attributes:
        sensor: the camera, where a dataset has several.
        models: the folder of models, or the mesh of the only object; None looks beside the images.
        materials: a YAML file with a material for each object and for what is none; see
            `model_files.read_models` and `read_background`.
        depth_scale_mm: millimetres of one step of stored depth; it goes before what files say.
        intrinsics: a file or `fx,fy,cx,cy`, where a dataset is depth alone.
        depth_only: whether objects are left out: no models are needed, and no poses are read.
    """

    sensor: str = ""
    models: Path | None = None
    materials: Path | None = None
    depth_scale_mm: float | None = None
    intrinsics: str | None = None
    depth_only: bool = False

    def __post_init__(self) -> None:
        if self.depth_scale_mm is not None and not 0 < self.depth_scale_mm < float("inf"):
            raise DatasetError(
                f"--depth-scale is {self.depth_scale_mm}: give the millimetres of one step of "
                "depth, greater than 0"
            )
