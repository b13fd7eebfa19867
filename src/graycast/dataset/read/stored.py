"""Read a dataset of simulated or real pictures; no other module reads `train/`.

Files are not trusted: if one is missing, damaged or contradicts another, a DatasetError names it.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, final

import cv2
import numpy as np
from pycocotools import mask as coco_mask

from ...base.array_types import Bool, Float32, UInt8
from ...base.errors import DatasetError
from ..files import records
from ..files.places import CLAIM, SPLITS, camera_file, finished_scenes
from ..files.safe_reading import Unreadable, is_intact_png, read_json
from ..files.scene_folder import SceneFolder, own_form
from ..files.seal import facts_of
from .example import Example, InstanceLabel, label_arrays, metres, probabilities
from .real import RealClaim, read_claim

_CONTENTS = frozenset({"rgb", "gray_sl", "depth", "depth_sl", "masks", "amodal", "poses", "shares"})
# These are an instance's pose and figures and, if it is visible, its annotation.
Instance = tuple[Any, Any, records.SceneAnnotation | None]


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class StoredScene:
    """One image of a scene of a dataset; each file is read and checked on demand.

    Most scenes have one image. `sensor` is the name of the scanner that took it, or "" if the only
    scanner has no name; `image` is its number among that scanner's images. Every method raises
    DatasetError if a file is missing, damaged or contradicts another.
    """

    folder: Path
    split: str
    scene_id: int
    size_px: tuple[int, int]
    categories: Mapping[int, str] = field(hash=False)
    real: bool
    holds: frozenset[str]
    sensor: str = ""
    image: int = 0
    place: int = 0  # This is the image's index among the images of all scanners.
    of: int = 1  # This is the number of images in the scene.

    @property
    def image_id(self) -> int:
        """Number of the image in the split; equal to the scene's id if each scene has one image."""
        return self.scene_id * self.of + self.place

    @property
    def key(self) -> str:
        """Name of the image in the dataset; the scene's name if the scene has only one image."""
        return self.scene_key if self.of == 1 else f"{self.scene_key}-{self.image_name}"

    @property
    def scene_key(self) -> str:
        """Name of the scene in the dataset."""
        return f"{self.split}-{self.scene_id:06d}"

    @property
    def image_name(self) -> str:
        """Name of the image in its scene: `1`, or `left-1` for the scanner `left`."""
        return f"{self.sensor}-{self.image}" if self.sensor else f"{self.image}"

    def view(self) -> records.View | Any:
        """Return intrinsics and depth scale; for a simulated scene also the camera's pose."""
        return self.of_image("scene_camera", records.RealView if self.real else records.View)

    def manifest(self) -> dict[str, Any]:
        """Return the scene's manifest with the entries of this image."""
        files = SceneFolder(self.folder)
        whole = self._checked(partial(files.record, "manifest", records.Manifest))
        return facts_of(whole, self.sensor, self.image)

    def obj_ids(self) -> tuple[int, ...]:
        """Return the object id of each instance, visible or hidden; only one small file is read."""
        return tuple(pose.obj_id for pose in self.poses()) if "masks" in self.holds else ()

    def labels(self, *, min_visibility: float = 0.0) -> list[InstanceLabel]:
        """Return the instances with at least the given visible fraction; empty without masks."""
        rated = "shares" in self.holds
        return [
            self._label(i, pose, info, entry)
            for i, (pose, info, entry) in enumerate(self.instances())
            if entry is not None and not (rated and info.visib_fract < min_visibility)
        ]

    def png(self, name: str) -> Path:
        """Return the path of a picture, after a check that it is complete and of the right form.

        Checksums tell that it is complete, because decoding takes thirty times as long.
        """
        path = self._files.png_path(name, self.image)
        if not is_intact_png(path, *own_form(name, self.size_px)):
            self.picture(name)
        return path

    def picture(self, name: str) -> np.ndarray:
        """Return a picture as stored: colours in OpenCV's order, depth in steps (0: missing)."""
        shape, dtype = own_form(name, self.size_px)
        image = self._checked(partial(self._files.png, name, self.image))
        if image.shape != shape or image.dtype != dtype:
            height_px, width_px = self.size_px
            must = f"{np.dtype(dtype)}, {width_px} x {height_px} pixels"
            path = self._files.png_path(name, self.image)
            raise DatasetError(
                f"{path}: is {image.dtype} {image.shape}, it must be {must}: run graycast validate"
            )
        return image

    def rgb(self) -> UInt8[np.ndarray, "h w 3"]:
        return cv2.cvtColor(self.picture("rgb"), cv2.COLOR_BGR2RGB)

    def depth_m(self, name: str) -> Float32[np.ndarray, "h w"]:
        """Return z [m] of `depth` or `depth_sl`; NaN where it is missing."""
        return metres(self.picture(name), self.view().depth_scale)

    def p_wrong(self) -> Float32[np.ndarray, "h w"] | None:
        """Return the probability that each depth of the scanner is wrong; NaN without depth.

        The result is None if the scanner did not estimate it.
        """
        if "pwrong_sl" not in self._files.optional_pictures():
            return None
        return probabilities(self.picture("pwrong_sl"))

    def masks(self, name: str) -> Iterator[Bool[np.ndarray, "h w"]]:
        """Yield all masks of `mask` or `mask_visib`, including those of hidden instances."""
        for i in range(len(self.poses())):
            mask = self._checked(partial(self._files.mask, name, i, self.image))
            if mask.shape != self.size_px:
                path = self._files.mask_path(name, i, self.image)
                raise DatasetError(f"{path}: is {mask.shape}, not {self.size_px}")
            yield mask

    def example(self) -> Example:
        """Return the image and its labels for training."""
        view, labels = self.view(), self.labels()
        return Example(
            scene_id=self.image_id,
            K=np.array(view.cam_K).reshape(3, 3),
            distortion=tuple(view.distortion),
            rgb=self.rgb() if "rgb" in self.holds else None,
            gray=self.picture("gray_sl") if "gray_sl" in self.holds else None,
            depth_m=self.depth_m("depth") if "depth" in self.holds else None,
            scanner_depth_m=self.depth_m("depth_sl") if "depth_sl" in self.holds else None,
            p_wrong=self.p_wrong(),
            **(label_arrays(labels, self.size_px) if "masks" in self.holds else {}),
        )

    def poses(self) -> list[Any]:
        """Return the entry in `scene_gt.json` of each instance, visible or hidden."""
        poses = self.of_instances("scene_gt", records.RealPose if self.real else records.Pose)
        for obj_id in {pose.obj_id for pose in poses}.difference(self.categories):
            raise DatasetError(
                f"{self.folder / 'scene_gt.json'}: has object {obj_id}, {CLAIM} has "
                f"{', '.join(map(str, self.categories))}: run graycast validate"
            )
        return poses

    def instances(self) -> list[Instance]:
        """Return every instance, visible or not; none without masks."""
        if "masks" not in self.holds:
            return []
        poses = self.poses()
        infos = self.of_instances("scene_gt_info", records.RealInfo if self.real else records.Info)
        whole = self._checked(partial(self._files.record, "scene_gt_coco", records.SceneCoco))
        annotations = [entry for entry in whole.annotations if entry.image_id == self.image]
        visible = sum(info.px_count_visib > 0 for info in infos)
        if len(poses) != len(infos) or visible != len(annotations):
            raise DatasetError(
                f"{self.folder}: scene_gt.json has {len(poses)} instances, scene_gt_info.json "
                f"{visible} visible of {len(infos)}, scene_gt_coco.json "
                f"{len(annotations)} annotations: run graycast validate"
            )
        size = list(self.size_px)
        for entry in annotations:
            runs = entry.segmentation
            if runs.size != size or sum(runs.counts) != size[0] * size[1]:
                raise DatasetError(
                    f"{self.folder / 'scene_gt_coco.json'}: annotation {entry.id} is of another "
                    f"image than {size[1]} x {size[0]} pixels: run graycast validate"
                )
        entries = iter(annotations)
        return [
            (pose, info, next(entries) if info.px_count_visib > 0 else None)
            for pose, info in zip(poses, infos, strict=True)
        ]

    def _label(self, i: int, pose: Any, info: Any, entry: records.SceneAnnotation) -> InstanceLabel:
        size = list(self.size_px)
        runs = coco_mask.frPyObjects(entry.segmentation.model_dump(), *size)
        return InstanceLabel(
            instance=i,
            obj_id=pose.obj_id,
            area_px=entry.area,
            box=[int(edge) for edge in coco_mask.toBbox(runs)],
            segmentation={"size": size, "counts": runs["counts"].decode()},
            runs=entry.segmentation.counts,
            pose=(pose.cam_R_m2c, pose.cam_t_m2c) if "poses" in self.holds else None,
            visib_fract=info.visib_fract if "shares" in self.holds else None,
        )

    @property
    def _files(self) -> SceneFolder:
        return SceneFolder(self.folder, self.sensor)

    def of_image(self, name: str, form: Any) -> Any:
        """Return this image's entry in a JSON file, as a record of the given form."""
        return self._checked(partial(self._files.of_image, name, self.image, form))

    def of_instances(self, name: str, form: Any) -> Any:
        """Return the entries of this image's instances in a JSON file."""
        return self._checked(partial(self._files.of_instances, name, self.image, form))

    def _checked(self, read: partial) -> Any:
        try:
            return read()
        except Unreadable as error:
            why = "run graycast validate, remove the scene and make it again"
            raise DatasetError(f"{self.folder}: {error}: {why}") from error


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class StoredDataset:
    """A finished dataset in BOP's form, of simulated or of real pictures.

    Attributes:
        claim: the content of `graycast.json`.
        categories: object ids and the parts' names.
        scene_ids: the scenes in the folder of each split. Graycast writes only `train`; if you move
            scenes to `val` and `test`, they are counted and shown separately.
        sizes_px: (height, width) of each scanner's pictures, by its name, starting with the first
            scanner; the name is "" if the only scanner has none.
        images: all images of a scene, as (scanner's name, number among that scanner's images).
        holds: the contents of the scenes: some of rgb, gray_sl, depth, depth_sl, masks, amodal,
            poses and shares (visible fractions).
    """

    folder: Path
    claim: Mapping[str, Any]
    categories: Mapping[int, str]
    scene_ids: Mapping[str, tuple[int, ...]]
    sizes_px: Mapping[str, tuple[int, int]]
    images: tuple[tuple[str, int], ...]
    holds: frozenset[str]

    @property
    def size_px(self) -> tuple[int, int]:
        """Height and width of the first scanner's pictures."""
        return next(iter(self.sizes_px.values()))

    @property
    def real(self) -> bool:
        return self.claim.get("kind") == "real"

    @property
    def depth_scale_mm(self) -> float:
        return self.claim["depth_scale_mm"]

    @property
    def scenes(self) -> tuple[StoredScene, ...]:
        """The scenes of all splits, each represented by its first image."""
        return tuple(
            self.scene(scene_id, split=split)
            for split, scene_ids in self.scene_ids.items()
            for scene_id in scene_ids
        )

    def scene(
        self, scene_id: int, *, split: str = "train", sensor: str | None = None, image: int = 0
    ) -> StoredScene:
        """Return one image of a scene; without a sensor's name, an image of the first scanner."""
        sensor = self.images[0][0] if sensor is None else sensor
        return StoredScene(
            folder=self.folder / split / f"{scene_id:06d}",
            split=split,
            scene_id=scene_id,
            size_px=self.sizes_px[sensor],
            categories=self.categories,
            real=self.real,
            holds=self.holds,
            sensor=sensor,
            image=image,
            place=self.images.index((sensor, image)),
            of=len(self.images),
        )

    @property
    def pictures(self) -> tuple[StoredScene, ...]:
        """The images of the scenes of all splits; those of a scene are consecutive."""
        return tuple(image for scene in self.scenes for image in self.images_of(scene))

    def image_ids(self, scene_ids: Iterable[int]) -> list[int]:
        """Return the numbers of all images of some scenes; with one image each, the scenes' ids."""
        of = len(self.images)
        return [scene_id * of + place for scene_id in scene_ids for place in range(of)]

    def picture(self, image_id: int) -> StoredScene:
        """Return an image by its number among all images of `train`."""
        scene_id, place = divmod(image_id, len(self.images))
        sensor, image = self.images[place]
        return self.scene(scene_id, sensor=sensor, image=image)

    def taker(self, sensor: str) -> Mapping[str, Any]:
        """Return a scanner's rig and settings from the claim; empty for real pictures."""
        for taker in self.claim.get("scanners", ()):
            if taker["name"] == sensor:
                return taker
        if "rig" not in self.claim:
            return {}
        return {"rig": self.claim["rig"], "scanner": self.claim["config"].get("scanner", {})}

    def images_of(self, scene: StoredScene) -> tuple[StoredScene, ...]:
        """Return all images of the scene that an image belongs to."""
        return tuple(
            self.scene(scene.scene_id, split=scene.split, sensor=sensor, image=image)
            for sensor, image in self.images
        )


def open_dataset(folder: Path) -> StoredDataset:
    """Open a dataset that `graycast generate` or `graycast dataset import` made.

    Raises:
        DatasetError: the folder holds no dataset, or one without scenes.
    """
    claim = read_claim(folder)
    images = claim.images if isinstance(claim, records.Claim) else [("", 0)]
    try:
        cameras = {
            sensor: read_json(folder / camera_file(sensor), records.Camera)
            for sensor in dict.fromkeys(sensor for sensor, _ in images)
        }
    except Unreadable as error:
        raise DatasetError(
            f"{folder} is not a Graycast dataset that can be read: {error}"
        ) from error
    scene_ids = {split: tuple(sorted(finished_scenes(folder, split))) for split in SPLITS}
    if not any(scene_ids.values()):
        raise DatasetError(f"{folder}: has no finished scene: run graycast generate first")
    return StoredDataset(
        folder=folder,
        claim=claim.model_dump(),
        categories={part.obj_id: part.name for part in claim.parts},
        scene_ids=scene_ids,
        sizes_px={name: (camera.height, camera.width) for name, camera in cameras.items()},
        images=tuple(images),
        holds=frozenset(claim.holds) if isinstance(claim, RealClaim) else _CONTENTS,
    )
