"""Export to folders that the demos of FoundationPose and of SAM-6D read without changes.

A folder holds one picture for one part; its mask is of that part's most visible instance. Pictures
have no lens distortion, which neither program models, and depth has steps of 1 mm, which the former
requires. FoundationPose reads the mesh in metres, SAM-6D the model in millimetres.

Source: the class YcbineoatReader in FoundationPose's `datareader.py`; `demo.sh` and
`run_inference_custom.py` of SAM-6D.
"""

import io
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import cv2
import numpy as np
import trimesh
from pycocotools import mask as coco_mask

from ..files.json_text import json_bytes
from ..files.records import MM_PER_M
from ..read.example import InstanceLabel
from ..read.stored import StoredDataset, StoredScene
from ..write.picture_bytes import png
from .clouds import color_image
from .options import Options, settled
from .picture_job import PictureJob
from .placing import place

_NAME = "000000"  # A folder holds a single picture.


def content(job: PictureJob) -> dict[str, bytes]:
    """Return the files of a picture, by their paths inside the folder of the set."""
    scene, options = job.scene, job.options
    depth_mm = np.nan_to_num(scene.depth_m(options.depths[0])) * MM_PER_M
    K, lens = scene.view().cam_K, any(scene.view().distortion)
    picture = (
        scene.png("rgb").read_bytes()
        if options.image == "rgb" and not lens
        else _png(settled(color_image(scene, options))[..., ::-1], scene)
    )
    every = {
        f"rgb/{_NAME}.png": picture,
        f"depth/{_NAME}.png": _png(np.rint(depth_mm).astype(np.uint16), scene),
        "cam_K.txt": _text(np.reshape(K, (3, 3))),
        "camera.json": json_bytes({"cam_K": K, "depth_scale": 1.0}),
    }
    files: dict[str, bytes] = {}
    for label in _most_visible(scene):
        mask = coco_mask.decode(label.segmentation) * np.uint8(255)
        own = {f"masks/{_NAME}.png": _png(mask, scene)}
        if label.pose is not None:
            own[f"annotated_poses/{_NAME}.txt"] = _text(label.T_cam_part)
        folder = f"{scene.image_id:06d}_{label.obj_id:06d}"
        files |= {f"{folder}/{name}": data for name, data in (every | own).items()}
    return files


def write_split(
    folder: Path,
    split: str,
    contents: Iterable[Mapping[str, bytes]],
    stored: StoredDataset,
    options: Options,
) -> None:
    """Write a folder `SPLIT/000003_000001` for each picture and each part visible in it."""
    for files in contents:
        for name, data in files.items():
            target = folder / split / name
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(data)


def write_rest(
    folder: Path, splits: Iterable[str], stored: StoredDataset, options: Options
) -> None:
    """Write `models/` [mm] as they are, and the same meshes [m] as `models_m/obj_000001/mesh.obj`.

    Each mesh is in its own folder, because trimesh gives the textures of all meshes one name.
    """
    for source in sorted((stored.folder / "models").glob("*")):
        place(source, folder / "models" / source.name, link=False)
        if source.suffix == ".ply":
            mesh = trimesh.load_mesh(source, process=False)
            target = folder / "models_m" / source.stem / "mesh.obj"
            target.parent.mkdir(parents=True)
            mesh.apply_scale(1 / MM_PER_M).export(target)


def _most_visible(scene: StoredScene) -> Iterator[InstanceLabel]:
    """Yield the instance of each part that has the largest visible fraction, or else area."""
    labels = scene.labels()
    for obj_id in sorted({label.obj_id for label in labels}):
        same = (label for label in labels if label.obj_id == obj_id)
        yield max(same, key=lambda label: (label.visib_fract or 0, label.area_px))


def _png(image: np.ndarray, scene: StoredScene) -> bytes:
    return png(np.ascontiguousarray(_without_lens(image, scene)))


def _text(matrix: np.ndarray) -> bytes:
    text = io.BytesIO()
    np.savetxt(text, matrix)
    return text.getvalue()


def _without_lens(image: np.ndarray, scene: StoredScene) -> np.ndarray:
    """Return a picture as a pinhole with the same intrinsics would take it.

    Only colours are interpolated. Outside the picture, all values are 0.
    """
    view, (height_px, width_px) = scene.view(), scene.size_px
    if not any(view.distortion):
        return image
    K, lens = np.reshape(view.cam_K, (3, 3)), np.array(view.distortion)
    size = (width_px, height_px)
    x, y = cv2.initUndistortRectifyMap(K, lens, None, K, size, cv2.CV_32FC1)
    kind = cv2.INTER_LINEAR if image.ndim == 3 else cv2.INTER_NEAREST
    return cv2.remap(image, x, y, kind)
