"""A finished dataset read back: its scenes, and each scene as the arrays that a trainer wants."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, final

import numpy as np
from jaxtyping import Bool, Float, Float32, Int, UInt8, UInt16
from pycocotools import mask as coco_mask

from ..errors import DatasetError
from ..frames import rigid
from . import records
from .models import MM_PER_M
from .reading import Unreadable, read_json, read_png
from .real import RealClaim, RealSceneCamera, RealSceneGt, RealSceneGtInfo, is_real
from .store import finished_scenes

_HELD = frozenset({"rgb", "gray_sl", "depth", "depth_sl", "masks", "amodal", "poses", "shares"})
_PIXELS = {"rgb": (3, np.uint8), "gray_sl": (2, np.uint8)}
_DEPTH = (2, np.uint16)


@dataclass(frozen=True, slots=True, kw_only=True)
class Example:
    """One picture and its labels, for the instances of which something is visible.

    What a dataset or a format does not hold is None.

    Attributes:
        scene_id: of the dataset that it comes from.
        K: pinhole intrinsics [px]; the centre of the top-left pixel is (0, 0).
        distortion: k1, k2, p1, p2, k3 of OpenCV.
        rgb: the colour picture, 8-bit sRGB.
        gray: the scanner's white frame, 8 bit, linear.
        depth_m: perfect z of the camera frame [m], NaN where there is none.
        scanner_depth_m: z as the scanner measured it [m], NaN where it has none.
        instance: places of the instances in the dataset's `scene_gt.json`.
        obj_id: what each instance is.
        mask: what is visible of each instance.
        box_px: [x, y, columns, rows] of the visible masks; integers from the top-left pixel on.
        T_cam_part: poses, part to camera [m].
        visib_fract: visible share of each silhouette.
    """

    scene_id: int
    K: Float[np.ndarray, "3 3"] | None = None
    distortion: tuple[float, ...] | None = None
    rgb: UInt8[np.ndarray, "h w 3"] | None = None
    gray: UInt8[np.ndarray, "h w"] | None = None
    depth_m: Float32[np.ndarray, "h w"] | None = None
    scanner_depth_m: Float32[np.ndarray, "h w"] | None = None
    instance: Int[np.ndarray, " n"] | None = None
    obj_id: Int[np.ndarray, " n"] | None = None
    mask: Bool[np.ndarray, "n h w"] | None = None
    box_px: Float32[np.ndarray, "n 4"] | None = None
    T_cam_part: Float[np.ndarray, "n 4 4"] | None = None
    visib_fract: Float[np.ndarray, " n"] | None = None

    def __post_init__(self) -> None:
        for name in self.__slots__:
            if isinstance(value := getattr(self, name), np.ndarray):
                value.flags.writeable = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Label:
    """One visible instance of a scene as its files have it.

    `segmentation` is compressed RLE, `box` [x, y, columns, rows] of it; `pose` (rotation, 9
    numbers, and translation [mm]) and `visib_fract` are None where nobody knows them.
    """

    instance: int
    obj_id: int
    area_px: int
    box: list[int]
    segmentation: dict[str, Any]
    pose: tuple[list[float], list[float]] | None
    visib_fract: float | None

    @property
    def T_cam_part(self) -> Float[np.ndarray, "4 4"]:
        """Part to camera [m]."""
        return pose_m(*self.pose)


def pose_m(rotation: list[float], translation_mm: list[float]) -> Float[np.ndarray, "4 4"]:
    """A pose of BOP's files in metres."""
    R = np.array(rotation, dtype=np.float64).reshape(3, 3)
    return rigid(R, np.array(translation_mm, dtype=np.float64) / MM_PER_M)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class StoredScene:
    """One scene of a dataset, each file read and checked when it is asked for."""

    folder: Path
    scene_id: int
    size_px: tuple[int, int]
    real: bool
    holds: frozenset[str]

    def view(self) -> records.View | Any:
        """Intrinsics and depth scale."""
        form = RealSceneCamera if self.real else records.SceneCamera
        return self._json("scene_camera", form)

    def labels(self, *, min_visibility: float = 0.0) -> list[Label]:
        """The visible instances, or those visible for at least a share; none without masks."""
        if "masks" not in self.holds:
            return []
        poses = self._json("scene_gt", RealSceneGt if self.real else records.SceneGt)
        infos = self._json("scene_gt_info", RealSceneGtInfo if self.real else records.SceneGtInfo)
        coco = self._read("scene_gt_coco.json", records.SceneCoco)
        seen = [i for i, info in enumerate(infos) if info.px_count_visib > 0]
        if len(poses) != len(infos) or len(seen) != len(coco.annotations):
            raise DatasetError(
                f"{self.folder}: scene_gt.json has {len(poses)} instances, scene_gt_info.json "
                f"{len(seen)} visible of {len(infos)}, scene_gt_coco.json "
                f"{len(coco.annotations)} annotations: run graycast validate"
            )
        labels = (
            self._label(i, poses[i], infos[i], entry)
            for i, entry in zip(seen, coco.annotations, strict=True)
        )
        return [
            label
            for label in labels
            if label.visib_fract is None or label.visib_fract >= min_visibility
        ]

    def png(self, name: str) -> Path:
        """A picture's file, found whole and of the right form.

        Raises:
            DatasetError: it is missing, cut off, damaged or of another form.
        """
        self._image(name)
        return self.folder / name / "000000.png"

    def rgb(self) -> UInt8[np.ndarray, "h w 3"]:
        return np.ascontiguousarray(self._image("rgb")[..., ::-1])

    def gray(self) -> UInt8[np.ndarray, "h w"]:
        return self._image("gray_sl")

    def depth_steps(self, name: str) -> UInt16[np.ndarray, "h w"]:
        """`depth` or `depth_sl` as stored: steps of the depth scale, 0 where there is none."""
        return self._image(name)

    def depth_m(self, name: str) -> Float32[np.ndarray, "h w"]:
        """z [m] of `depth` or `depth_sl`, NaN where there is none."""
        return metres(self._image(name), self.view().depth_scale)

    def masks(self, name: str) -> list[Bool[np.ndarray, "h w"]]:
        """All masks of `mask` or `mask_visib`, of hidden instances too."""
        count = len(self._json("scene_gt", RealSceneGt if self.real else records.SceneGt))
        return [self._mask(f"{name}/000000_{i:06d}.png") for i in range(count)]

    def example(self, *, min_visibility: float = 0.0) -> Example:
        """Everything that the scene holds.

        Raises:
            DatasetError: a file is missing, damaged or contradicts another.
        """
        view, labels = self.view(), self.labels(min_visibility=min_visibility)
        known = labels if "masks" in self.holds else None
        return Example(
            scene_id=self.scene_id,
            K=np.array(view.cam_K).reshape(3, 3),
            distortion=tuple(view.distortion),
            rgb=self.rgb() if "rgb" in self.holds else None,
            gray=self.gray() if "gray_sl" in self.holds else None,
            depth_m=self.depth_m("depth") if "depth" in self.holds else None,
            scanner_depth_m=self.depth_m("depth_sl") if "depth_sl" in self.holds else None,
            **label_arrays(known, self.size_px),
        )

    def read_bytes(self, name: str) -> bytes:
        """A JSON file of the scene as it is."""
        try:
            return (self.folder / name).read_bytes()
        except OSError as error:
            why = f"cannot be read ({error.strerror}): run graycast validate"
            raise DatasetError(f"{self.folder / name}: {why}") from error

    def _label(self, i: int, pose: Any, info: Any, entry: records.SceneAnnotation) -> Label:
        size = list(self.size_px)
        if entry.segmentation.size != size or sum(entry.segmentation.counts) != size[0] * size[1]:
            raise DatasetError(
                f"{self.folder / 'scene_gt_coco.json'}: annotation {entry.id} is of another image "
                f"than {size[1]} x {size[0]} pixels: run graycast validate"
            )
        runs = coco_mask.frPyObjects(entry.segmentation.model_dump(), *size)
        return Label(
            instance=i,
            obj_id=pose.obj_id,
            area_px=entry.area,
            box=[int(edge) for edge in coco_mask.toBbox(runs)],
            segmentation={"size": size, "counts": runs["counts"].decode()},
            pose=(pose.cam_R_m2c, pose.cam_t_m2c) if "poses" in self.holds else None,
            visib_fract=info.visib_fract if "shares" in self.holds else None,
        )

    def _image(self, name: str) -> np.ndarray:
        axes, kind = _PIXELS.get(name, _DEPTH)
        image = self._checked(partial(read_png, self.folder / name / "000000.png"))
        if image.ndim != axes or image.dtype != kind or image.shape[:2] != self.size_px:
            height_px, width_px = self.size_px
            must = f"{np.dtype(kind)}, {width_px} x {height_px} pixels"
            raise DatasetError(
                f"{self.folder / name / '000000.png'}: is {image.dtype} {image.shape}, it must be "
                f"{must}: run graycast validate"
            )
        return image

    def _mask(self, name: str) -> Bool[np.ndarray, "h w"]:
        mask = self._checked(partial(read_png, self.folder / name))
        if mask.shape != self.size_px:
            raise DatasetError(f"{self.folder / name}: is {mask.shape}, not {self.size_px}")
        return mask > 0

    def _json(self, name: str, form: type) -> Any:
        return self._read(f"{name}.json", form).image

    def _read(self, name: str, form: type) -> Any:
        return self._checked(partial(read_json, self.folder / name, form))

    def _checked(self, read: partial) -> Any:
        try:
            return read()
        except Unreadable as error:
            why = "run graycast validate, remove the scene and make it again"
            raise DatasetError(f"{self.folder}: {error}: {why}") from error


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Master:
    """A finished dataset in BOP's form, of simulated or of real pictures.

    Attributes:
        categories: object ids and the parts' names.
        size_px: height, width.
        holds: which of rgb, gray_sl, depth, depth_sl, masks, amodal, poses and shares (visible
            ones) its scenes have.
        fingerprint: of its configuration; empty for real pictures.
    """

    folder: Path
    categories: Mapping[int, str]
    scene_ids: tuple[int, ...]
    size_px: tuple[int, int]
    depth_scale_mm: float
    real: bool
    holds: frozenset[str]
    fingerprint: str

    def scene(self, scene_id: int) -> StoredScene:
        return StoredScene(
            folder=self.folder / "train" / f"{scene_id:06d}",
            scene_id=scene_id,
            size_px=self.size_px,
            real=self.real,
            holds=self.holds,
        )


def open_master(folder: Path) -> Master:
    """A dataset that `graycast generate` or `graycast import-real` made.

    Raises:
        DatasetError: the folder holds none, or none with a scene.
    """
    real = is_real(folder)
    try:
        claim = read_json(folder / "graycast.json", RealClaim if real else records.Claim)
        camera = read_json(folder / "camera.json", records.Camera)
    except Unreadable as error:
        raise DatasetError(f"{folder} is not a Graycast dataset: {error}") from error
    scene_ids = tuple(sorted(finished_scenes(folder)))
    if not scene_ids:
        raise DatasetError(f"{folder}: has no finished scene: run graycast generate first")
    return Master(
        folder=folder,
        categories={part.obj_id: part.name for part in claim.parts},
        scene_ids=scene_ids,
        size_px=(camera.height, camera.width),
        depth_scale_mm=claim.depth_scale_mm,
        real=real,
        holds=frozenset(claim.holds) if real else _HELD,
        fingerprint="" if real else claim.fingerprint,
    )


def metres(steps: UInt16[np.ndarray, "h w"], scale_mm: float) -> Float32[np.ndarray, "h w"]:
    """A depth picture in metres; its 0 is NaN."""
    depth_m = steps.astype(np.float64) * (scale_mm / MM_PER_M)
    return np.where(steps > 0, depth_m, np.nan).astype(np.float32)


def label_arrays(labels: list[Label] | None, size_px: tuple[int, int]) -> dict[str, Any]:
    """The labels as `Example` has them."""
    if labels is None:
        return {}
    count = len(labels)
    mask = np.zeros((count, *size_px), dtype=bool)
    for i, label in enumerate(labels):
        mask[i] = coco_mask.decode(label.segmentation)
    posed = all(label.pose is not None for label in labels)
    rated = all(label.visib_fract is not None for label in labels)
    pose = [label.T_cam_part for label in labels] if posed else []
    return {
        "instance": np.array([label.instance for label in labels], dtype=np.int64),
        "obj_id": np.array([label.obj_id for label in labels], dtype=np.int64),
        "mask": mask,
        "box_px": np.array([label.box for label in labels], np.float32).reshape(count, 4),
        "T_cam_part": np.array(pose, np.float64).reshape(count, 4, 4) if posed else None,
        "visib_fract": np.array([b.visib_fract for b in labels], float) if rated else None,
    }
