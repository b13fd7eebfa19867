"""A trained detector in one file: the network, the encoding of its input, and its classes."""

import json
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, final

import cv2
import numpy as np
import torch
from jaxtyping import Float32
from pycocotools import mask as coco_mask

from ...base.errors import GraycastError
from ...base.file_limits import parse_json
from ...base.folder import fill_whole
from ...base.version import __version__
from ...dataset.read.detections import WEIGHTS, Detections
from ...dataset.read.example import Example
from ...real.depth_sense import refuse_beyond
from .encoding import Encoding, encoding_from
from .network import Network, NetworkOutput
from .networks import network_class

ONE_CLASS = "part"
_FORM = 1


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class About:
    """The description of a detector without its weights.

    Attributes:
        model: one of `networks.MODELS`, or the class name of the user's own network.
        backbone: name of the backbone; None for the model's default.
        encoding: encoding of pictures as the network's input.
        names: names of the classes.
        trained: a record of the training: datasets, settings, versions.
    """

    model: str
    backbone: str | None
    encoding: Encoding
    names: tuple[str, ...]
    trained: Mapping[str, Any]

    @property
    def tells_apart(self) -> bool:
        """Whether the detector has a class for each kind of part, and not one class for all."""
        return self.names != (ONE_CLASS,)

    def classes(self, categories: Mapping[int, str]) -> dict[int, int]:
        """Return the class of each object id of a dataset; -1 for parts without a class."""
        if not self.tells_apart:
            return dict.fromkeys(categories, 0)
        place = {name: i for i, name in enumerate(self.names)}
        return {obj_id: place.get(name, -1) for obj_id, name in categories.items()}

    def obj_ids(self, categories: Mapping[int, str], folder: Path) -> dict[str, int]:
        """Return the object id of each class in a dataset; a single class gets the smallest id.

        Raises:
            GraycastError: the dataset has none of the classes.
        """
        if not self.tells_apart:
            return {ONE_CLASS: min(categories)}
        own = {name: obj_id for obj_id, name in categories.items() if name in self.names}
        if not own:
            raise GraycastError(
                f"{folder}: has {', '.join(categories.values())}, and the detector was trained on "
                f"{', '.join(self.names)}: give a dataset of the same parts"
            )
        return own

    def open_network(self, own: type[Network] | None = None) -> Network:
        """Return the network, or one of the class `own`, with random weights."""
        return (own or network_class(self.model))(
            channels=self.encoding.channels,
            classes=len(self.names),
            backbone=self.backbone,
            size_px=self.encoding.size_px,
        )

    def as_dict(self) -> dict[str, Any]:
        return {
            "form": _FORM,
            "graycast": __version__,
            "model": self.model,
            "backbone": self.backbone,
            "encoding": asdict(self.encoding),
            "names": list(self.names),
            "trained": dict(self.trained),
        }


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Detector:
    """A network with its weights, ready for detection."""

    about: About
    network: Network
    device: torch.device

    def detect(
        self,
        example: Example,
        *,
        obj_ids: Mapping[str, int],
        most: int = 300,
        least_score: float = 0.05,
    ) -> Detections:
        """Return the detections in one picture; labels of the picture are not used.

        Args:
            obj_ids: the dataset's object id of each class; other classes are left out.
            most: largest number of detections.
            least_score: lowest score of a detection.

        Raises:
            GraycastError: the example lacks the picture that the detector needs, or its depth is
                far outside the range of the training.
        """
        encoding = self.about.encoding
        if encoding.near_m is not None and encoding.far_m is not None:
            refuse_beyond(
                encoding.depth_m(example),
                near_m=encoding.near_m,
                far_m=encoding.far_m,
                name=f"scene {example.scene_id}",
                whose="the detector learnt",
            )
        encoded = encoding.encode(example, seed=example.scene_id)
        return self.look(
            encoded,
            example.scene_id,
            encoding.picture_px(example),
            obj_ids=obj_ids,
            most=most,
            least_score=least_score,
        )

    def look(
        self,
        encoded: Float32[np.ndarray, "c h w"],
        scene_id: int,
        picture_px: tuple[int, int],
        *,
        obj_ids: Mapping[str, int],
        most: int = 300,
        least_score: float = 0.05,
    ) -> Detections:
        """Return the detections in an encoded picture, which was `picture_px` high and wide."""
        image = torch.from_numpy(encoded)[None].to(self.device)
        output = self.answer(image, most=most, least_score=least_score)
        ids = np.array([obj_ids.get(name, -1) for name in self.about.names], np.int64)
        return _detections(output, scene_id, ids, picture_px, self.about.encoding.scale(picture_px))

    def answer(
        self, image: Float32[torch.Tensor, "1 c h w"], *, most: int, least_score: float
    ) -> NetworkOutput:
        """Return the network's output in pixels of its input, with the device's precision."""
        with torch.inference_mode(), autocast(self.device), without_denormals():
            return self.network.find(image, most=most, least_score=least_score)[0]


def _detections(
    output: NetworkOutput,
    scene_id: int,
    obj_ids: np.ndarray,
    picture_px: tuple[int, int],
    scale: float,
) -> Detections:
    """Return detections in the picture's pixels, clipped to the picture and without empty boxes."""
    height_px, width_px = picture_px
    edge = output.box.float().cpu().numpy().astype(np.float64) / scale
    edge = np.clip(edge, 0, [width_px, height_px, width_px, height_px])
    size = edge[:, 2:] - edge[:, :2]
    obj_id = obj_ids[output.label.cpu().numpy()] if len(edge) else np.zeros(0, np.int64)
    index = np.flatnonzero((size > 0).all(axis=1) & (obj_id >= 0))
    score = output.score.float().cpu().numpy()
    index = index[np.argsort(-score[index], kind="stable")]
    mask = None
    if output.mask is not None:
        probability = output.mask.cpu().numpy()
        mask = tuple(_outline(probability[i], edge[i], picture_px, scale) for i in index)
    return Detections(
        scene_id=scene_id,
        score=score[index],
        obj_id=obj_id[index],
        box_px=np.hstack([edge[:, :2], size])[index].astype(np.float32),
        mask=mask,
    )


def _outline(
    probability: np.ndarray, edge: np.ndarray, picture_px: tuple[int, int], scale: float
) -> dict[str, Any]:
    """Return a mask at the picture's size: pixels with interpolated probability above 0.5.

    For speed, only the box and a margin of one input pixel around it are computed.
    """
    height_px, width_px = picture_px
    margin = 1 / scale + 1
    x0, y0 = np.floor(np.maximum(edge[:2] - margin, 0)).astype(int)
    x1 = min(width_px, int(np.ceil(edge[2] + margin)))
    y1 = min(height_px, int(np.ceil(edge[3] + margin)))
    # Pixel i of the picture has its centre at (i + 0.5) * scale - 0.5 in pixels of the input.
    move = np.array(
        [
            [scale, 0, (x0 + 0.5) * scale - 0.5],
            [0, scale, (y0 + 0.5) * scale - 0.5],
        ]
    )
    soft = cv2.warpAffine(
        probability,
        move,
        (x1 - x0, y1 - y0),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REPLICATE,
    )
    full = np.zeros(picture_px, np.uint8, order="F")
    full[y0:y1, x0:x1] = soft > 127
    run = coco_mask.encode(full)
    return {"size": list(picture_px), "counts": run["counts"].decode()}


def save_detector(path: Path, about: About, state: Mapping[str, torch.Tensor]) -> None:
    """Write the weights and the description of a detector, completely or not at all."""
    checkpoint = {"about": json.dumps(about.as_dict()), "state": dict(state)}
    fill_whole(path, lambda file: torch.save(checkpoint, file))


def load_detector(
    path: Path | str, *, device: str = "auto", network: type[Network] | None = None
) -> Detector:
    """Load a detector from its file or from the folder of its training.

    Args:
        network: class of the user's own network, as passed to `train`.

    Raises:
        GraycastError: the file is missing, damaged, or not a detector of Graycast.
    """
    path = Path(path)
    file = path / WEIGHTS if path.is_dir() else path
    if not file.is_file():
        raise GraycastError(
            f"{file}: does not exist: give a folder that graycast detector train wrote"
        )
    try:
        checkpoint = torch.load(file, map_location="cpu", weights_only=True)
        record = parse_json(checkpoint["about"])
        about = About(
            model=record["model"],
            backbone=record["backbone"],
            encoding=encoding_from(record["encoding"]),
            names=tuple(record["names"]),
            trained=record["trained"],
        )
        state = checkpoint["state"]
    except Exception as error:  # A damaged pickle can raise anything.
        why = " ".join(str(error).split())[:120]
        raise GraycastError(
            f"{file}: is damaged or is not a detector ({why}): train it again"
        ) from error
    opened = about.open_network(network)
    try:
        opened.load_state_dict(state)
    except RuntimeError as error:
        raise GraycastError(
            f"{file}: its weights do not fit the network {about.model} of this release: train it "
            "again, or detect with the release that trained it"
        ) from error
    opened.eval()
    place = choose_device(device)
    return Detector(about=about, network=put_on(opened, place), device=place)


def choose_device(name: str) -> torch.device:
    """Return the device with a name; `auto` is the GPU if torch has one, else the processor.

    Raises:
        GraycastError: a GPU is requested, and torch finds no GPU.
    """
    if name == "cuda" and not torch.cuda.is_available():
        raise GraycastError("torch finds no NVIDIA GPU: use --device cpu, or repair the driver")
    gpu = name == "cuda" or (name == "auto" and torch.cuda.is_available())
    return torch.device("cuda" if gpu else "cpu")


@contextmanager
def without_denormals() -> Iterator[None]:
    """Treat denormal numbers as zero inside the block, because processors are slow with them.

    The mode is restored at the end, because it affects all code of the thread: for example, SciPy's
    k-d tree runs forever if the difference of two unequal numbers is zero.
    """
    before = sys.float_info.min / 2 == 0  # torch sets the mode but cannot report it.
    torch.set_flush_denormal(True)
    try:
        yield
    finally:
        torch.set_flush_denormal(before)


def put_on(network: Network, device: torch.device) -> Network:
    """Move a network to a device, with its weights in the memory format `channels_last`.

    With this format, training of Mask R-CNN on a processor takes two thirds of the time.
    """
    return network.to(device, memory_format=torch.channels_last)


def autocast(device: torch.device):
    """Return a context with mixed precision if the device is fast with it, such as a GPU.

    On a processor that only emulates bfloat16, mixed precision would be slower than float32.
    """
    # Older releases of torch do not report the CPU's capabilities.
    can: Mapping[str, object] = getattr(torch.cpu, "get_capabilities", dict)()
    fast = device.type == "cuda" or can.get("avx512_bf16") or can.get("amx_bf16")
    return torch.autocast(device.type, torch.bfloat16, enabled=bool(fast))
