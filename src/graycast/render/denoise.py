"""Denoising of pictures: Open Image Denoise on the CPU, NVIDIA OptiX on the GPU.

It is for the colour picture. Patterns are denoised only where a study asks for it (`denoised`).
"""

import numpy as np
from jaxtyping import Float

from .radiance import Denoiser, Radiance


def denoise(
    rgb: Float[np.ndarray, "h w 3"],
    albedo: Float[np.ndarray, "h w 3"],
    normal: Float[np.ndarray, "h w 3"],
    by: Denoiser,
) -> Float[np.ndarray, "h w 3"]:
    """A clean copy of a linear colour picture.

    Args:
        rgb: radiance [W sr^-1 m^-2], any scale.
        albedo: base reflectance of what each pixel sees.
        normal: unit normals, NaN where there is nothing.
        by: 'oidn' on the processor, 'optix' on an NVIDIA GPU that Mitsuba has opened.
    """
    guides = np.clip(albedo, 0, 1), np.nan_to_num(normal, nan=0.0)
    images = [np.ascontiguousarray(image, dtype=np.float32) for image in (rgb, *guides)]
    return _optix(*images) if by == "optix" else _oidn(*images)


def denoised(radiance: Radiance, normal: Float[np.ndarray, "h w 3"], by: Denoiser) -> Radiance:
    """Every picture of a stack cleaned by itself, as a program that renders them singly would."""

    def clean(picture: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        grey = picture.ndim == 2
        rgb = np.repeat(picture[..., None], 3, axis=-1) if grey else picture
        result = denoise(rgb, radiance.albedo, normal, by)
        return result.mean(axis=-1) if grey else result

    return Radiance(
        pattern=np.array([clean(one) for one in radiance.pattern], dtype=np.float32).reshape(
            radiance.pattern.shape
        ),
        white=clean(radiance.white),
        ambient=clean(radiance.ambient),
        white_rgb=clean(radiance.white_rgb),
        ambient_rgb=clean(radiance.ambient_rgb),
        albedo=radiance.albedo,
    )


def _oidn(rgb: np.ndarray, albedo: np.ndarray, normal: np.ndarray) -> np.ndarray:
    import pyoidn

    return pyoidn.denoise(rgb, albedo, normal, hdr=True)


def _optix(rgb: np.ndarray, albedo: np.ndarray, normal: np.ndarray) -> np.ndarray:
    import mitsuba as mi

    h, w = rgb.shape[:2]
    denoiser = mi.OptixDenoiser(input_size=[w, h], albedo=True, normals=True, temporal=False)
    clean = denoiser(
        mi.TensorXf(rgb), False, albedo=mi.TensorXf(albedo), normals=mi.TensorXf(normal)
    )
    return np.array(clean)
