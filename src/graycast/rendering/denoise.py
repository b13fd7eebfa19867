"""Denoising of pictures by Open Image Denoise, on the processor or on an NVIDIA GPU.

It is used for the colour picture. Patterns are denoised only on request of a study (`denoised`).
OptiX has a denoiser, too, but it ends the whole process if the driver's file of weights is missing,
as in many containers.
"""

import logging
import math
import sys
from dataclasses import replace
from typing import Any, Literal, final

import numpy as np
from jaxtyping import Float

from .radiance import Denoiser, Radiance

Image = Float[np.ndarray, "h w 3"]


def denoise(rgb: Image, albedo: Image, normal: Image, by: Denoiser) -> Image:
    """Denoise a linear colour picture of any scale with a renderer's denoiser.

    Albedo and unit normal belong to the visible surface; normals are NaN without a surface.
    """
    guides = np.clip(albedo, 0, 1), np.nan_to_num(normal, nan=0.0)
    images = [np.ascontiguousarray(image, dtype=np.float32) for image in (rgb, *guides)]
    return by(*images)


def denoised(radiance: Radiance, normal: Image, by: Denoiser) -> Radiance:
    """Denoise each picture of a stack separately, like a program that renders them separately."""

    def clean(picture: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        grey = picture.ndim == 2
        rgb = np.repeat(picture[..., None], 3, axis=-1) if grey else picture
        result = denoise(rgb, radiance.albedo, normal, by)
        return result.mean(axis=-1) if grey else result

    return replace(
        radiance,
        pattern=np.array([clean(one) for one in radiance.pattern], dtype=np.float32).reshape(
            radiance.pattern.shape
        ),
        white=clean(radiance.white),
        ambient=clean(radiance.ambient),
        white_rgb=clean(radiance.white_rgb),
        ambient_rgb=clean(radiance.ambient_rgb),
    )


def open_denoiser(device: str) -> Denoiser:
    """Open the denoiser for a renderer's device, or for the processor if the GPU cannot denoise.

    In the latter case the log has one line with the reason.
    """
    if device == "cuda":
        try:
            return OpenImageDenoise("cuda")
        except (OSError, RuntimeError) as error:
            logging.getLogger(__name__).warning(
                "colour pictures are denoised on the processor, because the GPU cannot: %s", error
            )
    return OpenImageDenoise("cpu")


def _library() -> Any:
    """Import the module `pyoidn`, but prevent it from loading PyTorch if PyTorch is installed.

    Only NumPy arrays are used here, and loading PyTorch costs every process seconds and 200 MB.
    """
    hides = "torch" not in sys.modules
    if hides:
        sys.modules["torch"] = None  # type: ignore[assignment]  # Importing torch now fails.
    try:
        import pyoidn
    finally:
        if hides:
            del sys.modules["torch"]
    return pyoidn


@final
class OpenImageDenoise:
    """Open Image Denoise on the processor, or on the first GPU that this process may use.

    The network and its buffers are kept until a picture has a different size.

    Raises:
        OSError: the library cannot be loaded.
        RuntimeError: the library finds no such device.
    """

    def __init__(self, device: Literal["cpu", "cuda"]) -> None:
        self._library = pyoidn = _library()
        kinds = {"cpu": pyoidn.OIDN_DEVICE_TYPE_CPU, "cuda": pyoidn.OIDN_DEVICE_TYPE_CUDA}
        if device == "cuda" and not pyoidn.Device.is_cuda_available():
            raise RuntimeError("Open Image Denoise finds no GPU that it supports")
        self.device = device
        self._device = pyoidn.Device(kinds[device])
        self._device.commit()
        self._check()
        self._last: tuple[tuple[int, ...], Any, dict[str, Any]] | None = None

    def __call__(self, rgb: Image, albedo: Image, normal: Image) -> Image:
        """Denoise a picture, see `Denoiser`; raise RuntimeError if memory is short, for example."""
        network, buffers = self._network(rgb.shape)
        for name, image in (("color", rgb), ("albedo", albedo), ("normal", normal)):
            buffers[name].write(0, image.nbytes, image)
        network.execute()
        self._check()
        clean = np.empty_like(rgb)
        buffers["output"].read(0, clean.nbytes, clean)
        return clean

    def _network(self, shape: tuple[int, ...]) -> tuple[Any, dict[str, Any]]:
        """Return the network for pictures of this shape, and its buffers on the device."""
        pyoidn = self._library
        if self._last is None or self._last[0] != shape:
            names = ("color", "albedo", "normal", "output")
            bytes_each = 4 * math.prod(shape)
            buffers = {name: pyoidn.Buffer(self._device, bytes_each) for name in names}
            network = pyoidn.Filter(self._device)
            for name, buffer in buffers.items():
                network.set_image(name, buffer, pyoidn.OIDN_FORMAT_FLOAT3, shape[1], shape[0])
            network.set_bool("hdr", True)
            network.commit()
            self._check()
            self._release()
            self._last = (shape, network, buffers)
        return self._last[1:]

    def _release(self) -> None:
        if self._last is not None:
            _, network, buffers = self._last
            network.release()
            for buffer in buffers.values():
                buffer.release()

    def _check(self) -> None:
        if message := self._device.get_error():
            raise RuntimeError(message)
