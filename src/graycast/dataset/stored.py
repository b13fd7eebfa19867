"""A dataset read back, of simulated or of real pictures: the one reader of `train/`.

Nothing is trusted: a file that is missing, damaged or contradicts another is a DatasetError that
says which one.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, final

import numpy as np
from pycocotools import mask as coco_mask

from ..base.array_types import Bool, Float32, UInt8
from ..base.errors import DatasetError
from . import records
from .example import Example, InstanceLabel, label_arrays, metres
from .places import CLAIM, SPLITS, camera_file, finished_scenes
from .real import RealClaim, read_claim
from .safe_reading import Unreadable, read_json
from .scene_folder import SceneFolder, own_form
from .seal import facts_of

_CONTENTS = frozenset({"rgb", "gray_sl", "depth", "depth_sl", "masks", "amodal", "poses", "shares"})
# An instance has a pose and figures, and an annotation if it is seen.
Instance = tuple[Any, Any, records.SceneAnnotation | None]


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class StoredScene:
    """One image of a scene of a dataset, each file read and checked when it is asked for.

    Most scenes have one; `sensor` is the name of the scanner that took it, "" of the only one that
    has none, and `image` counts each scanner's own. Every method raises DatasetError where a file
    is missing, damaged or contradicts another.
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
    place: int = 0  # It counts all images of the scene, those of all scanners.
    of: int = 1  # The scene has so many images.

    @property
    def image_id(self) -> int:
        """Its number among all images of the split: the scene's, where that has only one."""
        return self.scene_id * self.of + self.place

    @property
    def key(self) -> str:
        """Its name among all images of the dataset: the scene's, where that has only one."""
        return self.scene_key if self.of == 1 else f"{self.scene_key}-{self.image_name}"

    @property
    def scene_key(self) -> str:
        """Its scene's name among all scenes of the dataset."""
        return f"{self.split}-{self.scene_id:06d}"

    @property
    def image_name(self) -> str:
        """Its name among the images of its scene: `1`, or `left-1` of the scanner `left`."""
        return f"{self.sensor}-{self.image}" if self.sensor else f"{self.image}"

    def view(self) -> records.View | Any:
        """Intrinsics and depth scale; of simulated scenes also where the camera stood."""
        return self.of_image("scene_camera", records.RealView if self.real else records.View)

    def manifest(self) -> dict[str, Any]:
        """What the run that made it had to say."""
        files = SceneFolder(self.folder)
        whole = self._checked(partial(files.record, "manifest", records.Manifest))
        return facts_of(whole, self.sensor, self.image)

    def obj_ids(self) -> tuple[int, ...]:
        """What each instance is, seen or not: all that one small file tells."""
        return tuple(pose.obj_id for pose in self.poses()) if "masks" in self.holds else ()

    def labels(self, *, min_visibility: float = 0.0) -> list[InstanceLabel]:
        """The visible instances, or those visible for at least a share; none without masks."""
        rated = "shares" in self.holds
        return [
            self._label(i, pose, info, entry)
            for i, (pose, info, entry) in enumerate(self.instances())
            if entry is not None and not (rated and info.visib_fract < min_visibility)
        ]

    def png(self, name: str) -> Path:
        """A picture's file, which is whole and of the right form."""
        self.picture(name)
        return self._files.png_path(name, self.image)

    def picture(self, name: str) -> np.ndarray:
        """A picture as stored: colours in OpenCV's order, depth in steps, 0 where there is none."""
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
        return np.ascontiguousarray(self.picture("rgb")[..., ::-1])

    def depth_m(self, name: str) -> Float32[np.ndarray, "h w"]:
        """z [m] of `depth` or `depth_sl`, NaN where there is none."""
        return metres(self.picture(name), self.view().depth_scale)

    def masks(self, name: str) -> Iterator[Bool[np.ndarray, "h w"]]:
        """All masks of `mask` or `mask_visib`, of hidden instances too."""
        for i in range(len(self.poses())):
            mask = self._checked(partial(self._files.mask, name, i, self.image))
            if mask.shape != self.size_px:
                path = self._files.mask_path(name, i, self.image)
                raise DatasetError(f"{path}: is {mask.shape}, not {self.size_px}")
            yield mask

    def example(self) -> Example:
        """What a trainer wants of it."""
        view, labels = self.view(), self.labels()
        return Example(
            scene_id=self.image_id,
            K=np.array(view.cam_K).reshape(3, 3),
            distortion=tuple(view.distortion),
            rgb=self.rgb() if "rgb" in self.holds else None,
            gray=self.picture("gray_sl") if "gray_sl" in self.holds else None,
            depth_m=self.depth_m("depth") if "depth" in self.holds else None,
            scanner_depth_m=self.depth_m("depth_sl") if "depth_sl" in self.holds else None,
            **(label_arrays(labels, self.size_px) if "masks" in self.holds else {}),
        )

    def poses(self) -> list[Any]:
        """What `scene_gt.json` says of every instance, seen or not."""
        poses = self.of_instances("scene_gt", records.RealPose if self.real else records.Pose)
        for obj_id in {pose.obj_id for pose in poses}.difference(self.categories):
            raise DatasetError(
                f"{self.folder / 'scene_gt.json'}: has object {obj_id}, {CLAIM} has "
                f"{', '.join(map(str, self.categories))}: run graycast validate"
            )
        return poses

    def instances(self) -> list[Instance]:
        """Every instance, seen or not; none without masks."""
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
            pose=(pose.cam_R_m2c, pose.cam_t_m2c) if "poses" in self.holds else None,
            visib_fract=info.visib_fract if "shares" in self.holds else None,
        )

    @property
    def _files(self) -> SceneFolder:
        return SceneFolder(self.folder, self.sensor)

    def of_image(self, name: str, form: Any) -> Any:
        """What a JSON file says of this image, as the record that it must be."""
        return self._checked(partial(self._files.of_image, name, self.image, form))

    def of_instances(self, name: str, form: Any) -> Any:
        """What a JSON file says of each instance in this image."""
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
        claim: what `graycast.json` says.
        categories: object ids and the parts' names.
        scene_ids: the scenes of each split's folder. Graycast writes `train` alone; who moves
            scenes to `val` and `test` has them counted and shown apart.
        sizes_px: height, width of each scanner's pictures, by its name, "" of the only one that
            has none; the first scanner first.
        images: every image of a scene: its scanner's name, and its number among that one's own.
        holds: which of rgb, gray_sl, depth, depth_sl, masks, amodal, poses and shares (visible
            ones) its scenes have.
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
        """Height, width of the first scanner's pictures."""
        return next(iter(self.sizes_px.values()))

    @property
    def real(self) -> bool:
        return self.claim.get("kind") == "real"

    @property
    def depth_scale_mm(self) -> float:
        return self.claim["depth_scale_mm"]

    @property
    def scenes(self) -> tuple[StoredScene, ...]:
        """The scenes of all splits, each by its first image."""
        return tuple(
            self.scene(scene_id, split=split)
            for split, scene_ids in self.scene_ids.items()
            for scene_id in scene_ids
        )

    def scene(
        self, scene_id: int, *, split: str = "train", sensor: str | None = None, image: int = 0
    ) -> StoredScene:
        """One image of a scene: without a sensor's name of the first scanner, its first one."""
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
        """The images of the scenes of all splits, those of a scene in a row."""
        return tuple(image for scene in self.scenes for image in self.images_of(scene))

    def image_ids(self, scene_ids: Iterable[int]) -> list[int]:
        """The numbers of all images of some scenes: the scenes' own, where each has only one."""
        of = len(self.images)
        return [scene_id * of + place for scene_id in scene_ids for place in range(of)]

    def picture(self, image_id: int) -> StoredScene:
        """An image by its number among all images of `train`."""
        scene_id, place = divmod(image_id, len(self.images))
        sensor, image = self.images[place]
        return self.scene(scene_id, sensor=sensor, image=image)

    def taker(self, sensor: str) -> Mapping[str, Any]:
        """The rig and the scanner of a name as the claim says them; nothing of real pictures."""
        for taker in self.claim.get("scanners", ()):
            if taker["name"] == sensor:
                return taker
        if "rig" not in self.claim:
            return {}
        return {"rig": self.claim["rig"], "scanner": self.claim["config"].get("scanner", {})}

    def images_of(self, scene: StoredScene) -> tuple[StoredScene, ...]:
        """All images of a scene, whichever of them is given."""
        return tuple(
            self.scene(scene.scene_id, split=scene.split, sensor=sensor, image=image)
            for sensor, image in self.images
        )


def open_dataset(folder: Path) -> StoredDataset:
    """A dataset that `graycast generate` or `graycast dataset import` made.

    Raises:
        DatasetError: the folder holds none, or none with a scene.
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
