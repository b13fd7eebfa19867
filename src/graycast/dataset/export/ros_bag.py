"""Export to ROS 2 bags, as SQLite or MCAP files, with the topics of a scanner's driver.

The topics of a scanner are in the namespace of its name, or in `/scanner` if it has none. All
coordinates are in metres in its optical frame: x right, y down, z forward. What no scanner knows
is in `/truth`. A picture has the next whole second as its time, so equal datasets give equal bags.

Source: the topics of github.com/zivid/zivid-ros and REP 118 (depth images in metres, NaN).
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from ...base.errors import GraycastError, ScannerError
from ..read.stored import StoredDataset, StoredScene
from .clouds import color_image, packed_color, point_image
from .options import Options
from .picture_job import PictureJob
from .stored_truth import camera_pose, exposure_times, instance_numbers, part_poses

try:
    from rosbags.highlevel import AnyReader, AnyReaderError
    from rosbags.interfaces import (
        Connection,
        Qos,
        QosDurability,
        QosHistory,
        QosLiveliness,
        QosReliability,
        QosTime,
    )
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore
except ImportError as error:
    raise GraycastError(
        "a ROS 2 bag needs rosbags, which is not installed: run pip install 'graycast[ros]'"
    ) from error

FIRST_S = 946_684_800  # The first picture is of 2000-01-01 00:00 UTC; time 0 means "none" in ROS.
_VERSION = 8  # ROS 2 from Humble on reads this version of `metadata.yaml`.
POSES, TRUTH = "/tf_static", "/truth"  # All scanners share these. The topics below are a scanner's.
COLOR, COLOR_INFO = "color/image_raw", "color/camera_info"
DEPTH, DEPTH_INFO, POINTS = "depth/image_raw", "depth/camera_info", "points"
GRAY, REASON, EXPOSURES = "gray/image_raw", "reason", "exposures"
_FLOAT32 = 7  # sensor_msgs/PointField


Message = tuple[str, str, bytes]  # topic, type and content


@dataclass(frozen=True, slots=True, kw_only=True)
class BagPicture:
    """A picture's messages, and the message of its camera's pose, which the bag may have already.

    `pose` is None for real pictures. `same_pose` is equal for equal poses of a scanner.
    """

    time_s: int
    sensor: str
    pose: Message | None
    same_pose: bytes
    messages: list[Message]


def content(job: PictureJob) -> BagPicture:
    """Return the messages of a picture."""
    time_s, scene, maker = FIRST_S + job.place, job.scene, _Maker(types=_types())
    T_world_cam = camera_pose(scene)
    pose = None if T_world_cam is None else maker.pose(scene, T_world_cam, time_s)
    return BagPicture(
        time_s=time_s,
        sensor=scene.sensor,
        pose=None if pose is None else maker.encoded(POSES, pose),
        same_pose=b"" if T_world_cam is None else T_world_cam.tobytes(),
        messages=[maker.encoded(*message) for message in maker.messages(job, time_s)],
    )


@cache
def _types() -> Any:
    return get_typestore(Stores.ROS2_HUMBLE)


def write_sqlite3(
    folder: Path,
    split: str,
    contents: Iterable[BagPicture],
    stored: StoredDataset,
    options: Options,
) -> None:
    """Write the bag `SPLIT`, with `SPLIT.db3` and `metadata.yaml`."""
    _fill(Writer(folder / split, version=_VERSION), contents)


def write_mcap(
    folder: Path,
    split: str,
    contents: Iterable[BagPicture],
    stored: StoredDataset,
    options: Options,
) -> None:
    """Write the bag `SPLIT`, with `SPLIT.mcap` in compressed chunks and `metadata.yaml`."""
    writer = Writer(folder / split, version=_VERSION, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    _fill(writer, contents)


def _fill(writer: "Writer", contents: Iterable[BagPicture]) -> None:
    """Write all messages; a pose, half a second before its picture, if it differs from the last."""
    topics: dict[str, Connection] = {}
    last_pose: dict[str, bytes] = {}

    def write(message: Message, time_ns: int) -> None:
        topic, kind, data = message
        if topic not in topics:
            quality = [_quality(latched=topic == POSES)]
            topics[topic] = writer.add_connection(
                topic, kind, typestore=_types(), offered_qos_profiles=quality
            )
        writer.write(topics[topic], time_ns, data)

    with writer:
        for picture in contents:
            time_ns = picture.time_s * 10**9
            if picture.pose is not None and last_pose.get(picture.sensor) != picture.same_pose:
                last_pose[picture.sensor] = picture.same_pose
                write(picture.pose, time_ns - 5 * 10**8)
            for message in picture.messages:
                write(message, time_ns)


def _quality(*, latched: bool) -> "Qos":
    """Return a driver's quality of service; a latched topic gives late listeners its last value."""
    durability = QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE
    unset = QosTime(0, 0)
    return Qos(
        QosHistory.KEEP_LAST, 10, QosReliability.RELIABLE, durability, unset, unset,
        QosLiveliness.AUTOMATIC, unset, False,
    )  # fmt: skip


def open_bag(path: Path) -> "AnyReader":
    """Open a bag for reading.

    Args:
        path: the folder of a bag, or its `.mcap` or `.db3` file.

    Raises:
        ScannerError: the bag cannot be read.
    """
    try:
        reader = AnyReader([path])
        reader.open()
    except (AnyReaderError, OSError) as error:
        raise ScannerError(
            f"{path}: is no bag that can be read ({error}): give the folder of a set in an export, "
            "such as out/bag/train"
        ) from error
    return reader


@dataclass(slots=True, kw_only=True)
class _Maker:
    """Makes messages of the types of ROS."""

    types: Any

    def make(self, name: str, *values: Any, **named: Any) -> Any:
        """Return a message, such as `std_msgs/Header`."""
        return self.types.types[name.replace("/", "/msg/")](*values, **named)

    def encoded(self, topic: str, message: Any) -> Message:
        kind = message.__msgtype__
        return topic, kind, bytes(self.types.serialize_cdr(message, kind))

    def header(self, frame: str, time_s: int) -> Any:
        return self.make("std_msgs/Header", self.make("builtin_interfaces/Time", time_s, 0), frame)

    def pose(self, scene: StoredScene, T_world_cam: Float[np.ndarray, "4 4"], time_s: int) -> Any:
        """Return the message of a camera's pose."""
        transform = self.make(
            "geometry_msgs/TransformStamped",
            self.header("world", time_s),
            optical_frame(namespace(scene.sensor)),
            self.make("geometry_msgs/Transform", *self.placement("Vector3", T_world_cam)),
        )
        return self.make("tf2_msgs/TFMessage", [transform])

    def placement(self, kind: str, T: Float[np.ndarray, "4 4"]) -> tuple[Any, Any]:
        """Return a translation of some kind and a quaternion."""
        turn = Rotation.from_matrix(T[:3, :3]).as_quat()
        return (
            self.make(f"geometry_msgs/{kind}", *T[:3, 3].tolist()),
            self.make("geometry_msgs/Quaternion", *turn.tolist()),
        )

    def messages(self, job: PictureJob, time_s: int) -> Iterator[tuple[str, Any]]:
        """Yield the topics and messages of a picture, as far as the dataset has their data."""
        scene, options = job.scene, job.options
        name = namespace(scene.sensor)
        header = self.header(optical_frame(name), time_s)
        info, color = self.camera_info(scene, header), color_image(scene, options)
        if color is not None:
            gray = options.image == "gray"
            picture, encoding = (color[..., 0], "mono8") if gray else (color, "rgb8")
            yield f"{name}/{COLOR_INFO}", info
            yield f"{name}/{COLOR}", self.image(picture, encoding, header)
        if options.image != "gray" and "gray_sl" in scene.holds:
            yield f"{name}/{GRAY}", self.image(scene.picture("gray_sl"), "mono8", header)
        if options.depths:  # If there are both depths, the scanner's is the second.
            depth_m = scene.depth_m(options.depths[-1])
            yield f"{name}/{DEPTH_INFO}", info
            yield f"{name}/{DEPTH}", self.image(depth_m, "32FC1", header)
            measured = options.depths[-1] == "depth_sl"
            p_wrong = scene.p_wrong() if measured else None
            fields = {"xyz": point_image(scene, depth_m)}
            fields |= {} if color is None else {"rgb": packed_color(color)}
            fields |= {} if p_wrong is None else {"p_wrong": p_wrong}
            yield f"{name}/{POINTS}", self.cloud(fields, header)
            if measured and not scene.real:
                yield f"{name}/{REASON}", self.image(scene.picture("reason_sl"), "8UC1", header)
        if (times_s := exposure_times(scene, job.taker)) is not None:
            layout = self.make("std_msgs/MultiArrayLayout", [], 0)
            yield f"{name}/{EXPOSURES}", self.make("std_msgs/Float64MultiArray", layout, times_s)
        if len(options.depths) == 2:
            depth_m = scene.depth_m(options.depths[0])
            yield f"{TRUTH}{name}/{DEPTH}", self.image(depth_m, "32FC1", header)
        yield from self.truth(scene, header)

    def truth(self, scene: StoredScene, header: Any) -> Iterator[tuple[str, Any]]:
        name = f"{TRUTH}{namespace(scene.sensor)}"
        if "masks" in scene.holds:
            yield f"{name}/instances", self.image(instance_numbers(scene), "16UC1", header)
            layout = self.make("std_msgs/MultiArrayLayout", [], 0)
            obj_ids = np.array(scene.obj_ids(), dtype=np.int32)
            yield f"{name}/obj_ids", self.make("std_msgs/Int32MultiArray", layout, obj_ids)
        if "poses" in scene.holds:
            poses = [self.placement("Point", T) for T in part_poses(scene)]
            each = [self.make("geometry_msgs/Pose", *pose) for pose in poses]
            yield f"{name}/poses", self.make("geometry_msgs/PoseArray", header, each)

    def image(self, image: np.ndarray, encoding: str, header: Any) -> Any:
        height_px, width_px = image.shape[:2]
        data = np.ascontiguousarray(image).view(np.uint8).ravel()
        step = len(data) // height_px
        return self.make("sensor_msgs/Image", header, height_px, width_px, encoding, 0, step, data)

    def camera_info(self, scene: StoredScene, header: Any) -> Any:
        view, (height_px, width_px) = scene.view(), scene.size_px
        K = np.array(view.cam_K, dtype=np.float64)
        return self.make(
            "sensor_msgs/CameraInfo", header, height_px, width_px, "plumb_bob",
            d=np.array(view.distortion, dtype=np.float64),
            k=K,
            r=np.eye(3).ravel(),
            p=np.hstack([K.reshape(3, 3), np.zeros((3, 1))]).ravel(),
            binning_x=0,
            binning_y=0,
            roi=self.make("sensor_msgs/RegionOfInterest", 0, 0, 0, 0, False),
        )  # fmt: skip

    def cloud(self, fields: dict[str, np.ndarray], header: Any) -> Any:
        """Return an organised cloud: a point for each pixel, with NaN where depth is missing."""
        height_px, width_px = fields["xyz"].shape[:2]
        names = ["x", "y", "z", *list(fields)[1:]]
        columns = [np.atleast_3d(column).astype("<f4") for column in fields.values()]
        data = np.concatenate(columns, axis=-1)
        point_step = 4 * len(names)
        return self.make(
            "sensor_msgs/PointCloud2", header, height_px, width_px,
            [self.make("sensor_msgs/PointField", name, 4 * i, _FLOAT32, 1)
             for i, name in enumerate(names)],
            False, point_step, point_step * width_px, data.view(np.uint8).ravel(), False,
        )  # fmt: skip


def namespace(sensor: str) -> str:
    """Return a scanner's namespace; ROS does not allow hyphens."""
    return "/" + (sensor.replace("-", "_") or "scanner")


def optical_frame(space: str) -> str:
    """Return the name of the camera frame of the scanner with a namespace."""
    return f"{space[1:]}_optical_frame"
