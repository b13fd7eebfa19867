"""A scene as its folder holds it: pictures, labels and what its manifest says."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int, UInt8, UInt16

from ..dataset.claim import CLAIM
from ..dataset.reading import Unreadable, read_png
from ..errors import DatasetError

SPLITS = ("train", "val", "test")
NO_REASON = 255  # a pixel without scanner depth in a dataset that does not say why


@dataclass(frozen=True, slots=True, kw_only=True)
class ScenePlace:
    """Where a scene lies; `key` is its name among all scenes of the dataset."""

    split: str
    scene_id: int
    folder: Path

    @property
    def key(self) -> str:
        return f"{self.split}-{self.scene_id:06d}"


@dataclass(frozen=True, slots=True, kw_only=True)
class DatasetFacts:
    """What `graycast.json` says of a dataset; empty where there is none (pictures of others)."""

    claim: dict[str, Any]
    part_names: dict[int, str]

    def part_name(self, obj_id: int) -> str:
        return self.part_names.get(obj_id, f"object {obj_id}")


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredInstance:
    """One instance; None is what a dataset of real pictures does not know.

    `box` and `amodal_box` are BOP's [x, y, last column - first, last row - first], -1 four times
    where nothing is visible; `box3d` is rotation (9), centre and size [mm], camera frame.
    """

    obj_id: int
    area_px: int
    box: list[int]
    visib_fract: float | None = None
    amodal_box: list[int] | None = None
    position_mm: list[float] | None = None
    box3d: tuple[list[float], list[float], list[float]] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredScene:
    """One scene's pictures and labels; a picture that the dataset does not hold is None.

    Depths are steps of `depth_scale_mm`, 0 where there is none. `reason` holds the numbers of
    `reason_name`, 0 where there is a scanner depth and `NO_REASON` where the dataset does not say
    why there is none. `label` is the visible instance of each pixel, -1 for none; where masks of
    annotators overlap, the later one. `view` is the image's entry in `scene_camera.json`.
    """

    place: ScenePlace
    rgb: UInt8[np.ndarray, "h w 3"] | None
    gray: UInt8[np.ndarray, "h w"] | None
    depth: UInt16[np.ndarray, "h w"] | None
    scanner: UInt16[np.ndarray, "h w"] | None
    reason: UInt8[np.ndarray, "h w"]
    label: Int[np.ndarray, "h w"]
    view: dict[str, Any]
    instances: tuple[StoredInstance, ...]
    reason_name: dict[int, str]
    manifest: dict[str, Any]

    @property
    def depth_scale_mm(self) -> float:
        return float(self.view["depth_scale"])


def find_scenes(dataset: Path) -> list[ScenePlace]:
    """Every finished scene of a dataset, by split and number.

    Raises:
        DatasetError: the folder holds no scene.
    """
    found = [
        ScenePlace(split=split, scene_id=int(entry.name), folder=entry)
        for split in SPLITS
        if (dataset / split).is_dir()
        for entry in sorted((dataset / split).iterdir(), key=lambda entry: entry.name)
        if entry.name.isdecimal() and len(entry.name) >= 6
    ]
    if not found:
        raise DatasetError(
            f"{dataset} holds no scene in {', '.join(SPLITS)}: give the folder that "
            "graycast generate wrote"
        )
    return found


def read_facts(dataset: Path) -> DatasetFacts:
    """The dataset's own description.

    Raises:
        DatasetError: `graycast.json` is there and cannot be read.
    """
    path = dataset / CLAIM
    if not path.exists():
        return DatasetFacts(claim={}, part_names={})
    try:
        claim = json.loads(path.read_bytes())
        names = {int(part["obj_id"]): str(part["name"]) for part in claim["parts"]}
    except (ValueError, KeyError, TypeError) as error:
        raise DatasetError(f"{path} cannot be read ({error}): run graycast validate") from error
    return DatasetFacts(claim=claim, part_names=names)


def load_scene(place: ScenePlace) -> StoredScene:
    """Read one scene, simulated or of real pictures.

    Raises:
        DatasetError: a file is missing or damaged.
    """
    try:
        return _load(place)
    except (Unreadable, OSError, ValueError, KeyError, IndexError, TypeError) as error:
        raise DatasetError(f"{place.folder}: {error}: run graycast validate") from error


def _load(place: ScenePlace) -> StoredScene:
    folder = place.folder
    image = {name: _picture(folder / name / "000000.png") for name in _PICTURES}
    sizes = {name: held.shape[:2] for name, held in image.items() if held is not None}
    if len(set(sizes.values())) != 1:
        raise Unreadable(f"the pictures are of sizes {sizes} (rows, columns); they must be one")
    size = next(iter(sizes.values()))
    rgb = image["rgb"]
    if rgb is not None:
        rgb = np.repeat(rgb[..., None], 3, axis=2) if rgb.ndim == 2 else rgb[..., 2::-1]
    scanner = image["depth_sl"]
    reason, names = _reasons(folder, image["reason_sl"], scanner, size)
    infos = _entry(folder / "scene_gt_info.json", [])
    manifest = folder / "manifest.json"
    return StoredScene(
        place=place,
        rgb=None if rgb is None else np.ascontiguousarray(rgb),
        gray=image["gray_sl"],
        depth=image["depth"],
        scanner=scanner,
        reason=reason,
        label=_labels(folder, infos, size),
        view={"distortion": [0.0] * 5, **_entry(folder / "scene_camera.json")},
        instances=_instances(folder, infos),
        reason_name=names,
        manifest=json.loads(manifest.read_bytes()) if manifest.exists() else {},
    )


_PICTURES = ("rgb", "gray_sl", "depth", "depth_sl", "reason_sl")


def _picture(path: Path) -> np.ndarray | None:
    return read_png(path) if path.exists() else None


def _entry(path: Path, default: Any = None) -> Any:
    """The one image's entry of a scene's JSON file."""
    if default is not None and not path.exists():
        return default
    return json.loads(path.read_bytes())["0"]


def _reasons(
    folder: Path, reason: np.ndarray | None, scanner: np.ndarray | None, size: tuple[int, int]
) -> tuple[UInt8[np.ndarray, "h w"], dict[int, str]]:
    if reason is not None:
        said = _entry(folder / "scene_sl.json")["reasons"]
        return reason, {number: name.lower() for name, number in said.items()}
    known = np.zeros(size, dtype=bool) if scanner is None else scanner > 0
    return np.where(known, 0, NO_REASON).astype(np.uint8), {0: "decoded", NO_REASON: "missing"}


def _instances(folder: Path, infos: list[dict[str, Any]]) -> tuple[StoredInstance, ...]:
    poses = _entry(folder / "scene_gt.json", [])
    boxes = _entry(folder / "scene_gt_box3d.json", []) or [None] * len(poses)
    return tuple(
        StoredInstance(
            obj_id=pose["obj_id"],
            area_px=info["px_count_visib"],
            box=info["bbox_visib"],
            visib_fract=info.get("visib_fract"),
            amodal_box=info.get("bbox_obj"),
            position_mm=pose.get("cam_t_m2c"),
            box3d=None if box is None else (box["R"], box["center"], box["size"]),
        )
        for pose, info, box in zip(poses, infos, boxes, strict=True)
    )


def _labels(
    folder: Path, infos: list[dict[str, Any]], size: tuple[int, int]
) -> Int[np.ndarray, "h w"]:
    """The visible masks as one picture of instance numbers.

    From the scene's run lengths: a picture per mask would be read a hundred times slower.
    """
    path = folder / "scene_gt_coco.json"
    annotations = json.loads(path.read_bytes())["annotations"] if path.exists() else []
    seen = [i for i, info in enumerate(infos) if info["px_count_visib"] > 0]
    label = np.full(size[0] * size[1], -1, dtype=np.int32)  # column by column, as COCO counts
    for i, annotation in zip(seen, annotations, strict=True):
        turn = np.cumsum(annotation["segmentation"]["counts"]).tolist()
        for start, end in zip(turn[0::2], turn[1::2], strict=False):
            label[start:end] = i
    return np.ascontiguousarray(label.reshape(size[1], size[0]).T)
