"""The JSON files of a dataset as values; a missing or an unknown key is refused."""

import math
from collections.abc import Mapping
from typing import Annotated, Any, Generic, TypeVar

from pycocotools import mask as coco_mask
from pydantic import AfterValidator, BaseModel, ConfigDict, Field

MM_PER_M = 1000.0  # The files are in millimetres, as in BOP.
FORMAT_VERSION = 3  # This is the version of `graycast.json` and of all files that belong to it.

Vector = Annotated[list[float], Field(min_length=3, max_length=3)]
Matrix3 = Annotated[list[float], Field(min_length=9, max_length=9)]
Matrix4 = Annotated[list[float], Field(min_length=16, max_length=16)]
Box = Annotated[list[int], Field(min_length=4, max_length=4)]
Distortion = Annotated[list[float], Field(min_length=5, max_length=5)]
Count = Annotated[int, Field(ge=0)]
Positive = Annotated[float, Field(gt=0)]

T = TypeVar("T")
Images = dict[Count, T]  # A file of a scene with an entry for each image has this form.
Manifest = dict[str, Any]  # The run that made the scene chooses the keys.


def _refuse_other_format(version: int) -> int:
    if version != FORMAT_VERSION:
        raise ValueError(
            f"{version} is of another version of Graycast, and this one reads {FORMAT_VERSION} "
            "alone: use the version that made the dataset, or make it again"
        )
    return version


FormatVersion = Annotated[int, AfterValidator(_refuse_other_format)]


class Record(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


class PartClaim(Record):
    obj_id: Annotated[int, Field(ge=1)]
    name: str
    content: str


class DistractorClaim(Record):
    """A part that is placed among the annotated parts but has no annotations."""

    name: str
    content: str


class TakerClaim(Record):
    """One scanner of a dataset; a single scanner may have no name."""

    name: str
    images: Annotated[int, Field(ge=1)]
    rig: dict[str, Any]
    scanner: dict[str, Any]


class Claim(Record):
    """The content of `graycast.json`."""

    format_version: FormatVersion
    fingerprint: str
    config: dict[str, Any]
    seed: int
    depth_scale_mm: Positive
    rig: dict[str, Any]
    parts: list[PartClaim]
    distractors: list[DistractorClaim] = []
    scanners: list[TakerClaim] = []  # Empty if one scanner without a name takes one image.
    sources: list[str]
    versions: dict[str, str]
    sha256: dict[str, str] = {}  # The keys are files outside the scenes.

    @property
    def takers(self) -> list[TakerClaim]:
        """All scanners; if the claim lists no scanners, a single scanner without a name."""
        one = {"rig": self.rig, "scanner": self.config.get("scanner", {})}
        return self.scanners or [TakerClaim(name="", images=1, **one)]

    @property
    def images(self) -> list[tuple[str, int]]:
        """All images of a scene, as (name of the scanner, number of the image)."""
        return [(taker.name, image) for taker in self.takers for image in range(taker.images)]


class Camera(Record):
    """The content of `camera.json`."""

    cx: float
    cy: float
    depth_scale: Positive
    fx: Positive
    fy: Positive
    height: Annotated[int, Field(ge=1)]
    width: Annotated[int, Field(ge=1)]
    distortion: Distortion = [0.0] * 5


class Continuous(Record):
    axis: Vector
    offset: Vector


class ModelInfo(Record):
    """One model in `models_info.json`."""

    diameter: Positive
    min_x: float
    min_y: float
    min_z: float
    size_x: Annotated[float, Field(ge=0)]
    size_y: Annotated[float, Field(ge=0)]
    size_z: Annotated[float, Field(ge=0)]
    symmetries_discrete: list[Matrix4] = []
    symmetries_continuous: list[Continuous] = []

    @property
    def low(self) -> list[float]:
        return [self.min_x, self.min_y, self.min_z]

    @property
    def size(self) -> list[float]:
        return [self.size_x, self.size_y, self.size_z]


class RealView(Record):
    """One image in `scene_camera.json` of real pictures, without the camera's unknown pose."""

    cam_K: Matrix3
    depth_scale: Positive
    distortion: Distortion = [0.0] * 5


class View(RealView):
    """One image in `scene_camera.json`."""

    cam_R_w2c: Matrix3
    cam_t_w2c: Vector


class RealPose(Record):
    """One instance in `scene_gt.json` of real pictures: its object, without a pose."""

    obj_id: Annotated[int, Field(ge=1)]


class Pose(RealPose):
    """One instance in `scene_gt.json`."""

    cam_R_m2c: Matrix3
    cam_t_m2c: Vector


class RealInfo(Record):
    """One instance in `scene_gt_info.json` of real pictures."""

    bbox_visib: Box
    px_count_visib: Count


class Info(RealInfo):
    """One instance in `scene_gt_info.json`."""

    bbox_obj: Box
    px_count_all: Count
    px_count_valid: Count
    visib_fract: Annotated[float, Field(ge=0, le=1)]


class Box3d(Record):
    """One instance in `scene_gt_box3d.json`."""

    R: Matrix3
    center: Vector
    size: Vector


class ScannerRecord(Record):
    """One image in `scene_sl.json`."""

    modulation_scale: Positive
    reasons: dict[str, int]


class OneImage(Record, Generic[T]):
    """A scene's file with a single image, whose number is the only key."""

    image: Annotated[T, Field(alias="0")]


class RunLengths(Record):
    counts: list[Count]
    size: Annotated[list[int], Field(min_length=2, max_length=2)]


class CompressedRunLengths(Record):
    counts: str
    size: Annotated[list[int], Field(min_length=2, max_length=2)]


class CocoImage(Record):
    id: Count
    file_name: str
    width: int
    height: int


class CocoCategory(Record):
    id: int
    name: str
    supercategory: str


class _Annotation(Record):
    id: int
    image_id: int
    category_id: int
    iscrowd: int
    area: int
    bbox: Box


class SceneAnnotation(_Annotation):
    segmentation: RunLengths
    width: int
    height: int
    ignore: bool


class RealAnnotation(_Annotation):
    """An annotation in the COCO file of a split of real pictures."""

    segmentation: CompressedRunLengths


class SplitAnnotation(RealAnnotation):
    visib_fract: float


class CocoFile(Record, Generic[T]):
    """A file of COCO annotations: `scene_gt_coco.json`, or `train_coco.json` of a split."""

    info: dict[str, str]
    licenses: list[Any]
    categories: list[CocoCategory]
    images: list[CocoImage]
    annotations: list[T]


SceneCoco = CocoFile[SceneAnnotation]


def split_annotation(annotation: Mapping[str, Any], image_id: int) -> dict[str, Any]:
    """Convert an annotation of `scene_gt_coco.json` to its form in a split's file, without id."""
    runs = annotation["segmentation"]
    height_px, width_px = runs["size"]
    compressed = coco_mask.frPyObjects(dict(runs), height_px, width_px)
    return {
        "image_id": image_id,
        "category_id": annotation["category_id"],
        "iscrowd": 0,
        "area": annotation["area"],
        "bbox": [int(b) for b in coco_mask.toBbox(compressed)],
        "segmentation": {"counts": compressed["counts"].decode(), "size": [height_px, width_px]},
    }


class FrameRecord(BaseModel):
    """An entry in a scene's `frames`, with the keys of a stack file."""

    model_config = ConfigDict(frozen=True, extra="allow", strict=True, allow_inf_nan=False)

    file: str


class FramesRecord(Record):
    """The captured pictures of a scene, in its `manifest.json`."""

    bit_depth: Annotated[int, Field(ge=1, le=16)]
    exposures_s: Annotated[list[Positive], Field(min_length=1)]
    shown: Annotated[list[FrameRecord], Field(min_length=1)]


class MotionRecord(BaseModel):
    """The times of the pictures of a scan that moves, exposure by exposure."""

    model_config = ConfigDict(frozen=True, extra="ignore", strict=True)

    start_s: list[list[float]]
    exposure_s: list[float]


class RawFacts(BaseModel):
    """The entries of `manifest.json` about captured pictures, code maps and flow."""

    model_config = ConfigDict(frozen=True, extra="ignore", strict=True)

    exposure_s: Positive = math.nan
    frames: FramesRecord | None = None
    code_maps: list[str] = []
    flow: int = 0  # number of pictures
    motion: MotionRecord | None = None
