"""The encoding of a picture for a network: its channels, missing depth, and size.

The encoding is stored with the weights, so that training and detection use the same one.
"""

import math
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, final

import cv2
import numpy as np
from jaxtyping import Float32, UInt8

from ...base.errors import GraycastError
from ...dataset.read.example import LEAST_LOG_P, Example
from .networks import HOLES, INPUTS

# The published backbones were trained with these means and deviations of photographs.
_RGB_MEAN = np.array([0.485, 0.456, 0.406], np.float32)
_RGB_DEVIATION = np.array([0.229, 0.224, 0.225], np.float32)
BLACK = -_RGB_MEAN / _RGB_DEVIATION  # A pixel without light is encoded as this.
_RELIEF_WINDOW = 1 / 10  # A window's side is this share of the longer side of the input.
_RELIEF_SHARE = 1 / 20  # A height of this share of the working volume saturates the relief.
_NOISY_SIGMA_M = 1e-3
_NOISY_HOLES_SHARE = 0.05
_NOISY_HOLE_PX = (1, 12)  # range of radii at the picture's own size


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Encoding:
    """A picture's channels, in the order of a network's input.

    Colour is sRGB, normalized by the mean and deviation of photographs. Depth is metric, from -1 at
    `near_m` to 1 at `far_m`, and clipped. If `holes` is `channel`, depth is multiplied by the share
    of the pixel with known depth, and this share is a channel; `zero` and `far` encode missing
    depth as the near or far end. `relief` adds a channel with the height above the mean nearby.
    `p_wrong` adds a last channel: 1 where the scanner's depth is wrong with a probability of 1e-4
    or less, 0 where it is certainly wrong or missing, and the logarithm of the probability between.

    A picture is scaled to fit into `size_px` and is put in its top-left corner; the rest is 0.

    Attributes:
        input: `rgb`; `depth`, perfect depth; `depth_sl`, scanner depth; `depth_noisy`, perfect
            depth with Gaussian noise and random holes; `rgbd`, colour and the scanner's depth.
        size_px: height and width, multiples of 32.
        near_m, far_m: range of z in the camera's frame; None for `rgb`.
    """

    input: str
    size_px: tuple[int, int]
    near_m: float | None = None
    far_m: float | None = None
    holes: str = "channel"
    relief: bool = True
    p_wrong: bool = False

    def __post_init__(self) -> None:
        if self.input not in INPUTS:
            raise GraycastError(f"input is {self.input!r}: choose one of {', '.join(INPUTS)}")
        if self.holes not in HOLES:
            raise GraycastError(f"holes is {self.holes!r}: choose one of {', '.join(HOLES)}")
        if min(self.size_px) < 32 or any(side % 32 for side in self.size_px):
            raise GraycastError(f"size_px is {self.size_px}: give a multiple of 32 of at least 32")
        if self.deep and not 0 < (self.near_m or 0) < (self.far_m or 0):
            raise GraycastError(
                f"the depth's range is {self.near_m} to {self.far_m} m: give 0 < near < far"
            )

    @property
    def deep(self) -> bool:
        """Whether depth is among the channels."""
        return self.input != "rgb"

    @property
    def coloured(self) -> bool:
        """Whether colour is among the channels; if so, it comes first."""
        return self.input in ("rgb", "rgbd")

    @property
    def channels(self) -> int:
        deep = 1 + (self.holes == "channel") + self.relief
        return 3 * self.coloured + deep * self.deep + self.p_wrong

    def scale(self, picture_px: tuple[int, int]) -> float:
        """Return the scale from a picture of this height and width to the input."""
        return min(self.size_px[0] / picture_px[0], self.size_px[1] / picture_px[1])

    def encode(self, example: Example, *, seed: int) -> Float32[np.ndarray, "c h w"]:
        """Return the network's input; `seed` is only used for the noise of `depth_noisy`.

        Raises:
            GraycastError: the example lacks a picture that the encoding needs.
        """
        layers = []
        if self.coloured:
            layers += self._colour(_needed(example.rgb, "rgb", example))
        if self.deep:
            depth_m = self.depth_m(example)
            rough = self.input == "depth_noisy" and example.depth_m is not None
            layers += self._depth(noisy(depth_m, seed=seed) if rough else depth_m)
        if self.p_wrong:
            layers.append(self._sureness(example))
        return np.stack(layers)

    def picture_px(self, example: Example) -> tuple[int, int]:
        """Return height and width of the picture before its encoding."""
        image = example.rgb if self.coloured else self.depth_m(example)
        return _needed(image, "rgb", example).shape[:2]

    def depth_m(self, example: Example) -> Float32[np.ndarray, "h w"]:
        """Return the depth to encode, without added noise.

        If perfect depth is needed but missing, as for a real camera, this is the scanner's depth.
        """
        if self.input in ("depth", "depth_noisy") and example.depth_m is not None:
            return example.depth_m
        return _needed(example.scanner_depth_m, "scanner depth", example)

    def _colour(self, rgb: UInt8[np.ndarray, "h w 3"]) -> list[np.ndarray]:
        small = self._fitted(rgb.astype(np.float32) / 255)
        return [self._placed((small[..., i] - _RGB_MEAN[i]) / _RGB_DEVIATION[i]) for i in range(3)]

    def _depth(self, depth_m: Float32[np.ndarray, "h w"]) -> list[np.ndarray]:
        if self.near_m is None or self.far_m is None:
            raise ValueError(f"input {self.input} has no range of depth")
        valid = np.isfinite(depth_m)
        middle_m, half_m = (self.far_m + self.near_m) / 2, (self.far_m - self.near_m) / 2
        height = np.clip(np.where(valid, (depth_m - middle_m) / half_m, 0.0), -1, 1)
        share = self._fitted(valid.astype(np.float32))
        if self.holes != "channel":
            height = np.where(valid, height, -1.0 if self.holes == "zero" else 1.0)
        small = self._fitted(height.astype(np.float32))
        layers = [small]
        if self.holes == "channel":
            layers.append(share)
        if self.relief:
            weighted = small if self.holes == "channel" else small * share
            layers.append(self._relief(weighted, share))
        return [self._placed(layer) for layer in layers]

    def _sureness(self, example: Example) -> Float32[np.ndarray, "h w"]:
        if example.p_wrong is None:
            raise GraycastError(
                f"scene {example.scene_id} has no p_wrong: make the dataset with max_p_wrong below "
                "1, or train without --p-wrong"
            )
        p_wrong = np.nan_to_num(example.p_wrong, nan=1.0).clip(10**LEAST_LOG_P, 1.0)
        return self._placed(self._fitted((np.log10(p_wrong) / LEAST_LOG_P).astype(np.float32)))

    def _relief(
        self, weighted: Float32[np.ndarray, "h w"], share: Float32[np.ndarray, "h w"]
    ) -> Float32[np.ndarray, "h w"]:
        """Return the height above the mean of known depth nearby, positive towards the camera."""
        side = 2 * round(max(self.size_px) * _RELIEF_WINDOW / 2) + 1
        window = (side, side)
        known = cv2.blur(share, window, borderType=cv2.BORDER_REFLECT_101)
        total = cv2.blur(weighted, window, borderType=cv2.BORDER_REFLECT_101)
        mean = total / np.maximum(known, 1e-6)
        return np.tanh((mean * share - weighted) / (2 * _RELIEF_SHARE)).astype(np.float32)

    def _fitted(self, image: Float32[np.ndarray, "h w *c"]) -> Float32[np.ndarray, "h2 w2 *c"]:
        scale = self.scale(image.shape[:2])
        size = [max(1, round(side * scale)) for side in image.shape[:2]]
        way = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
        return cv2.resize(image, (size[1], size[0]), interpolation=way)

    def _placed(self, layer: np.ndarray) -> Float32[np.ndarray, "h w"]:
        full = np.zeros(self.size_px, np.float32)
        full[: layer.shape[0], : layer.shape[1]] = layer
        return full


def encoding_from(record: Mapping[str, Any]) -> Encoding:
    """Return the encoding with the fields in a record."""
    return Encoding(**{**record, "size_px": tuple(record["size_px"])})


def fitting_size(picture_px: tuple[int, int], longest_px: int) -> tuple[int, int]:
    """Return the input's height and width, multiples of 32, for pictures of a given size."""
    scale = longest_px / max(picture_px)
    height_px, width_px = (max(32, math.ceil(side * scale / 32 - 1e-9) * 32) for side in picture_px)
    return height_px, width_px


def noisy(depth_m: Float32[np.ndarray, "h w"], *, seed: int) -> Float32[np.ndarray, "h w"]:
    """Return depth with simple simulated noise: 1 mm (Gaussian), and round holes in 5 % of it.

    This noise is for comparison only: its holes do not depend on the light. It depends on the seed
    and on the picture, so that two pictures with one seed, such as two images of a scene or a
    picture for training and one for validation, have different noise.
    """
    picture = zlib.crc32(depth_m.tobytes())
    rng = np.random.default_rng([seed, 0x6E6F6973, picture])
    rough = depth_m + rng.normal(0.0, _NOISY_SIGMA_M, depth_m.shape).astype(np.float32)
    low, high = _NOISY_HOLE_PX
    mean_area_px = math.pi * (low * low + low * high + high * high) / 3
    hole = np.zeros(depth_m.shape, np.uint8)
    for _ in range(round(_NOISY_HOLES_SHARE * depth_m.size / mean_area_px)):
        centre = int(rng.integers(depth_m.shape[1])), int(rng.integers(depth_m.shape[0]))
        cv2.circle(hole, centre, round(rng.uniform(low, high)), 1, -1)
    return np.where(hole > 0, np.float32(np.nan), rough)


def _needed(picture: np.ndarray | None, name: str, example: Example) -> np.ndarray:
    if picture is None:
        raise GraycastError(
            f"scene {example.scene_id} has no {name}: choose an --input that the dataset holds"
        )
    return picture
