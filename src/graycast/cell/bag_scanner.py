"""A bag of `graycast dataset export` as a device: each trigger returns the next picture."""

import math
import time
from collections.abc import Iterator, Mapping
from itertools import chain, groupby, islice
from pathlib import Path
from typing import Any

import numpy as np

from ..base import array_types as arrays
from ..base.errors import ArgumentError, ScannerError
from ..base.frames import rigid, rotation_from_quaternion
from ..dataset.export import ros_bag as bags
from ..rig.optics import optics_of
from .scanner_device import ScannerFrame

_MAPS = (bags.COLOR, bags.GRAY, bags.DEPTH, bags.REASON)
_TOPICS = (*_MAPS, bags.DEPTH_INFO, bags.POINTS, bags.EXPOSURES)
_NUMBERS = {"rgb8": "u1", "mono8": "u1", "8UC1": "u1", "32FC1": "<f4"}
Pose = arrays.FloatArray_4_4


class BagScanner:
    """A scanner of a bag as a device, with the calls of a `VirtualScanner`.

    A frame has the values that the bag has; see `ScannerFrame`. The truth in the bag is not read.
    """

    def __init__(
        self, bag: Path | str, *, name: str | None = None, readout_s: float = 0.010
    ) -> None:
        """Choose a scanner of a bag.

        Args:
            bag: the folder of a bag, such as `out/bag/train`, or its `.mcap` or `.db3` file.
            name: name of the scanner if the bag has several; None is the first one.
            readout_s: the time to read out a picture, which a bag does not have.
        """
        self._bag, self._name, self._readout_s = Path(bag), name, readout_s
        self._reader: Any = None
        self._rest: Iterator[tuple[ScannerFrame, Pose | None]] = iter(())
        self._pose: Pose | None = None

    # --- the connection -----------------------------------------------------------------------

    def connect(self) -> None:
        """Open the bag at its first picture; a second call has no effect.

        Raises:
            ArgumentError: the bag has no scanner of this name.
            ScannerError: the bag cannot be read or lacks a topic.
        """
        if self._reader is not None:
            return
        self._reader = bags.open_bag(self._bag)
        try:
            pictures = self._pictures(self._namespace())
            first = list(islice(pictures, 1))  # Its pose is the pose before the first trigger.
        except BaseException:
            self.disconnect()
            raise
        self._rest, self._pose = chain(first, pictures), first[0][1] if first else None

    def disconnect(self) -> None:
        """Close the bag; the next `connect` begins with the first picture again."""
        if self._reader is not None:
            self._reader.close()
        self._reader = None

    def __enter__(self) -> "BagScanner":
        self.connect()
        return self

    def __exit__(self, *error: object) -> None:
        self.disconnect()

    def _refuse_unconnected(self) -> None:
        if self._reader is None:
            raise ScannerError(
                f"bag {self._bag} is not connected: call connect() first, or use the scanner in a "
                "with statement"
            )

    # --- the calls of a scanner ---------------------------------------------------------------

    @property
    def T_world_cam(self) -> arrays.FloatArray_4_4:
        """Pose of the camera in the last frame or, before a frame is taken, in the first one.

        Raises:
            ScannerError: the scanner is not connected, or the bag has no pose.
        """
        self._refuse_unconnected()
        if self._pose is None:
            raise ScannerError(
                f"{self._bag}: has no pose of the camera: use that of your hand-eye calibration"
            )
        return self._pose

    def set(self, key: str, value: Any) -> None:
        """Refuse the setting, because the pictures exist already.

        Raises:
            ScannerError: in every case.
        """
        raise ScannerError(
            f"{key} cannot be {value!r}: the pictures of bag {self._bag} exist already; set it in "
            "the configuration of their dataset, or use a VirtualScanner"
        )

    def trigger(self, *, wait: bool = False) -> ScannerFrame:
        """Return the next picture of the bag.

        Args:
            wait: whether the call takes at least as long as the pictures of a real device, if the
                bag has their exposure times.

        Raises:
            ScannerError: the scanner is not connected, or the bag has no further picture.
        """
        start_s = time.perf_counter()
        self._refuse_unconnected()
        picture = next(self._rest, None)
        if picture is None:
            raise ScannerError(
                f"bag {self._bag} has no further picture: call disconnect() and connect() to begin "
                "with the first one again"
            )
        frame, self._pose = picture
        if wait and frame.pictures is not None:
            time.sleep(max(0.0, frame.duration_s - (time.perf_counter() - start_s)))
        return frame

    # --- the bag ------------------------------------------------------------------------------

    def _namespace(self) -> str:
        """Return the namespace of the scanner in the bag."""
        ending = f"/{bags.DEPTH}"
        topics = [connection.topic for connection in self._reader.connections]
        spaces = [
            topic.removesuffix(ending)
            for topic in topics
            if topic.endswith(ending) and not topic.startswith(f"{bags.TRUTH}/")
        ]
        if not spaces:
            raise ScannerError(
                f"{self._bag}: has no topic SCANNER{ending}: export the dataset with depth"
            )
        space = spaces[0] if self._name is None else bags.namespace(self._name)
        if space not in spaces:
            known = ", ".join(each[1:] for each in spaces)
            raise ArgumentError(f"name is {self._name!r}: {self._bag} has {known}")
        return space

    def _pictures(self, space: str) -> Iterator[tuple[ScannerFrame, Pose | None]]:
        """Yield the frames of a scanner in the order of time, with the pose of its camera."""
        names = {f"{space}/{topic}": topic for topic in _TOPICS} | {bags.POSES: bags.POSES}
        T_world_cam, first_ns, index = None, None, 0
        for time_ns, messages in self._messages(names):
            for each in messages[bags.POSES].transforms if bags.POSES in messages else ():
                if each.child_frame_id == bags.optical_frame(space):
                    T_world_cam = _pose(each.transform)
            if bags.DEPTH not in messages:
                continue
            if bags.DEPTH_INFO not in messages:
                raise ScannerError(
                    f"{self._bag}: has no message of {space}/{bags.DEPTH_INFO} at the time of a "
                    "depth picture: give a bag that graycast dataset export wrote"
                )
            first_ns = time_ns if first_ns is None else first_ns
            start_s = (time_ns - first_ns) / 1e9
            yield _frame(messages, index, start_s, readout_s=self._readout_s), T_world_cam
            index += 1

    def _messages(self, names: Mapping[str, str]) -> Iterator[tuple[int, dict[str, Any]]]:
        """Yield the messages of each time, by the new names of their topics."""
        reader = self._reader
        wanted = [each for each in reader.connections if each.topic in names]
        try:
            for time_ns, group in groupby(reader.messages(wanted), key=lambda each: each[1]):
                read = ((each, reader.deserialize(data, each.msgtype)) for each, _, data in group)
                yield time_ns, {names[each.topic]: message for each, message in read}
        except Exception as error:  # The errors of rosbags' storages have no common base.
            raise ScannerError(
                f"{self._bag}: is damaged ({error}): export the dataset again"
            ) from error


def _frame(
    messages: Mapping[str, Any], index: int, time_s: float, *, readout_s: float
) -> ScannerFrame:
    """Return the frame of the messages of one time."""
    info, cloud = messages[bags.DEPTH_INFO], messages.get(bags.POINTS)
    maps = {topic: _pixels(messages[topic]) for topic in _MAPS if topic in messages}
    color = maps.get(bags.COLOR)
    gray_color = color is not None and color.ndim == 2  # This is an export with --picture gray.
    times_s = messages[bags.EXPOSURES].data.tolist() if bags.EXPOSURES in messages else None
    return ScannerFrame(
        index=index,
        time_s=time_s,
        duration_s=math.nan if times_s is None else sum(times_s) + len(times_s) * readout_s,
        pictures=None if times_s is None else len(times_s),
        camera=optics_of(info.k.reshape(3, 3), (info.height, info.width), info.d.tolist()),
        depth_m=maps[bags.DEPTH],
        sigma_m=None,
        p_wrong=None if cloud is None else _field(cloud, "p_wrong"),
        reason=maps.get(bags.REASON),
        gray=color if gray_color else maps.get(bags.GRAY),
        rgb=None if gray_color else color,
    )


def _pixels(image: Any) -> np.ndarray:
    """Return the pixels of an image message, in a read-only array of its own."""
    shape = (image.height, image.width, 3)[: 3 if image.encoding == "rgb8" else 2]
    return np.frombuffer(image.data.tobytes(), _NUMBERS[image.encoding]).reshape(shape)


def _field(cloud: Any, name: str) -> arrays.FloatArray_h_w | None:
    """Return a field of an organised cloud of numbers in single precision; None if it is absent."""
    names = [field.name for field in cloud.fields]
    if name not in names:
        return None
    numbers = np.frombuffer(cloud.data.tobytes(), "<f4").reshape(cloud.height, cloud.width, -1)
    return numbers[..., names.index(name)].copy()


def _pose(transform: Any) -> Pose:
    shift, turn = transform.translation, transform.rotation
    R = rotation_from_quaternion(np.array([turn.x, turn.y, turn.z, turn.w]))
    return rigid(R, np.array([shift.x, shift.y, shift.z]))
