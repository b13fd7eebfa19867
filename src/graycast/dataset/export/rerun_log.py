"""Export to recordings of the viewer rerun: `rerun SPLIT.rrd` shows pictures, clouds and parts.

Coordinates are in metres. `world/SCANNER` is the optical frame of a scanner, or of the scanner
`scanner` if it has no name: x right, y down, z forward. The timeline `picture` has the numbers of
the pictures. Rerun gives each row a random id, so recordings of equal datasets differ in bytes.
Rerun's camera has no lens distortion: `points` are exact, but depth shown in 3D is not corrected.
"""

from collections.abc import Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ...base.errors import GraycastError
from ..read.stored import StoredDataset, StoredScene
from ..write.models import read_models
from .clouds import color_image, point_image
from .options import Options
from .picture_job import PictureJob
from .stored_truth import camera_pose, instance_numbers, part_poses

try:
    import rerun as rr
except ImportError as error:
    raise GraycastError(
        "a recording of rerun needs rerun-sdk, which is not installed: run pip install "
        "'graycast[rerun]'"
    ) from error


_PNG = "image/png"
# A path, and the call that makes what rerun shows there. On the way between processes, its result
# would lose the marks `not null` of its Arrow types.
_Logged = tuple[str, partial[Any]]


def content(job: PictureJob) -> tuple[int, list[_Logged]]:
    """Return the number of a picture, and its values in a recording."""
    scanner, truth = _scanner(job.scene, job.options), _truth(job.scene, job.options)
    return job.scene.image_id, [*scanner, *truth]


def write_split(
    folder: Path,
    split: str,
    contents: Iterable[tuple[int, list[_Logged]]],
    stored: StoredDataset,
    options: Options,
) -> None:
    """Write `SPLIT.rrd`; the models of the parts are in it once, and their poses per picture."""
    recording = rr.RecordingStream(
        "graycast", recording_id=f"{stored.folder.name}-{split}", send_properties=False
    )
    recording.set_log_time_enabled(False)
    recording.set_log_tick_enabled(False)
    try:
        recording.save(folder / f"{split}.rrd")
        recording.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        _log_models(recording, stored)
        for image_id, logged in contents:
            recording.set_time("picture", sequence=image_id)
            for path, make in logged:
                recording.log(path, make())
    finally:
        recording.disconnect()


def _root(sensor: str) -> str:
    return f"world/{sensor or 'scanner'}"


def _log_models(recording: "rr.RecordingStream", stored: StoredDataset) -> None:
    """Log each model under each scanner, because the poses are in the scanners' frames."""
    if "poses" not in stored.holds:
        return
    for obj_id, model in read_models(stored.folder).items():
        # Each face has corners of its own, so that edges look sharp.
        mesh = rr.Mesh3D(
            vertex_positions=model.mesh.vertices_m[model.mesh.faces].reshape(-1, 3),
            vertex_normals=np.repeat(model.mesh.face_normal, 3, axis=0),
        )
        for sensor in stored.sizes_px:
            recording.log(f"{_root(sensor)}/truth/parts/{obj_id}", mesh, static=True)


def _scanner(scene: StoredScene, options: Options) -> Iterator[_Logged]:
    root, view, (height_px, width_px) = _root(scene.sensor), scene.view(), scene.size_px
    T_world_cam = camera_pose(scene)
    if T_world_cam is not None:
        shift, turn = T_world_cam[:3, 3], T_world_cam[:3, :3]
        yield root, partial(rr.Transform3D, translation=shift, mat3x3=turn)
    yield (
        f"{root}/camera",
        partial(
            rr.Pinhole,
            image_from_camera=np.reshape(view.cam_K, (3, 3)),
            resolution=[width_px, height_px],
            camera_xyz=rr.ViewCoordinates.RDF,
        ),
    )
    if options.picture is not None:
        picture = scene.png(options.picture).read_bytes()
        yield f"{root}/camera/image", partial(rr.EncodedImage, contents=picture, media_type=_PNG)
    if options.depths:  # If there are both depths, the scanner's is the second.
        depth_m, color = scene.depth_m(options.depths[-1]), color_image(scene, options)
        yield f"{root}/camera/depth", _depth(scene, options.depths[-1])
        keep = np.flatnonzero(depth_m > 0)
        point_m = point_image(scene, depth_m).reshape(-1, 3).take(keep, axis=0)
        own_color = None if color is None else color.reshape(-1, 3).take(keep, axis=0)
        yield f"{root}/points", partial(rr.Points3D, point_m, colors=own_color)


def _depth(scene: StoredScene, depth: str) -> partial["rr.EncodedDepthImage"]:
    """Return a depth picture as it is stored, in steps; `meter` is the steps per metre."""
    steps_per_m = 1000 / scene.view().depth_scale
    blob = scene.png(depth).read_bytes()
    return partial(rr.EncodedDepthImage, blob=blob, media_type=_PNG, meter=steps_per_m)


def _truth(scene: StoredScene, options: Options) -> Iterator[_Logged]:
    root = _root(scene.sensor)
    if len(options.depths) == 2:
        yield f"{root}/camera/truth/depth", _depth(scene, options.depths[0])
    if "masks" in scene.holds:
        numbers = partial(rr.SegmentationImage, instance_numbers(scene))
        yield f"{root}/camera/truth/instances", numbers
    if "poses" in scene.holds:
        T_cam_part, part_id = part_poses(scene), np.array(scene.obj_ids())
        for obj_id in scene.categories:
            T = T_cam_part[part_id == obj_id]
            # Rerun draws a mesh without poses at the origin, so an absent part gets size zero.
            T = T if len(T) else np.zeros((1, 4, 4))
            shifts, turns = T[:, :3, 3], T[:, :3, :3]
            poses = partial(rr.InstancePoses3D, translations=shifts, mat3x3=turns)
            yield f"{root}/truth/parts/{obj_id}", poses
