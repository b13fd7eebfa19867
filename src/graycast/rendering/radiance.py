"""The results of a renderer, and the protocol that every renderer implements."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Literal, Protocol, runtime_checkable

import numpy as np
from pydantic import Field

from ..base import array_types as arrays
from ..base.mask_box import overlap
from ..base.public_value import public_value
from ..base.settings import check_fields
from ..rig.optics import Optics
from ..world.scene import Layout, Scene

Patterns = arrays.UInt8Array_n_ph_pw  # Grey levels; 255 is white.
DenoiserName = Literal["none", "oidn", "optix"]
# A denoiser takes radiance, albedo and normals, and returns radiance.
Denoiser = Callable[
    [arrays.Float32Array_h_w_3, arrays.Float32Array_h_w_3, arrays.Float32Array_h_w_3],
    arrays.Float32Array_h_w_3,
]
Samples = Annotated[int, Field(ge=1, le=65536, description="The number of light paths per pixel.")]
PathDepth = Annotated[
    int,
    Field(
        ge=1,
        le=64,
        description="The largest number of surfaces on a light path. 1 is direct light only.",
    ),
]
# Arguments: number of finished renders of a scene, and number of all
OnFrame = Callable[[int, int], None]
# Arguments: number of finished samples of a stack, and of all. An exception ends the rendering.
OnPass = Callable[[int, int], None]


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Quality:
    """The effort of a renderer: paths per pixel, and vertices per path.

    Depth 1 is only direct light; each further vertex adds one interreflection. `footprint` (only
    in Mitsuba) filters the patterns in indirect light over the surface that a sample represents;
    its bias vanishes with more samples. `denoise` denoises each picture of the stack separately,
    with Open Image Denoise or, in Cycles on an NVIDIA GPU, OptiX.
    """

    samples: Samples = 16
    depth: PathDepth = 4
    footprint: bool = True
    denoise: DenoiserName = "none"

    def __post_init__(self) -> None:
        check_fields(self)
        if self.denoise not in ("none", "oidn", "optix"):
            raise ValueError(f"denoise is {self.denoise!r}; choose 'none', 'oidn' or 'optix'")


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class PathNoise:
    """The error from a finite number of light paths, which is common to all patterns of a stack.

    Both arrays are standard deviations for columns and rows of the projector, in this order; they
    are 0 without direct light. `place_sigma_px` describes the mean projector position of a pixel's
    direct light, and `stray` the stripes in indirect light, relative to stripes in direct light.
    """

    place_sigma_px: arrays.FloatArray_2_h_w
    stray: arrays.FloatArray_2_h_w

    def __post_init__(self) -> None:
        for array in (self.place_sigma_px, self.stray):
            array.flags.writeable = False


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Radiance:
    """Linear images of one scene before any sensor [W sr^-1 m^-2].

    For the measuring camera, behind its filter, `pattern[k]` is the light of projected pattern k,
    `white` the light of an all-white projector, and `ambient` all other light. For the colour
    picture, `white_rgb` is the light of an all-white projector and `ambient_rgb` all other light,
    in each band. Light is additive, so any picture is a sum of these.

    `white` is the sum of `white_rgb` over all bands, and `ambient` the sum of `ambient_rgb` over
    the bands that the filter passes, unless a material has a `projector_reflectance`. `path_noise`
    is None if the renderer does not estimate it.

    `place_px` is the mean projector position (column, row) of a pixel's direct light [projector
    px], or NaN without such light. A renderer may use whole projector pixels, with an error of at
    most half a pixel. It is None if no pattern was rendered.
    """

    pattern: arrays.FloatArray_n_h_w
    white: arrays.FloatArray_h_w
    ambient: arrays.FloatArray_h_w
    white_rgb: arrays.FloatArray_h_w_3
    ambient_rgb: arrays.FloatArray_h_w_3
    albedo: arrays.FloatArray_h_w_3  # Base reflectance of the first surface, for denoisers
    path_noise: PathNoise | None = None
    place_px: arrays.FloatArray_2_h_w | None = None

    def __post_init__(self) -> None:
        for name in ("pattern", "white", "ambient", "white_rgb", "ambient_rgb", "albedo"):
            getattr(self, name).flags.writeable = False
        if self.place_px is not None:
            self.place_px.flags.writeable = False


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Silhouette:
    """A mask of all pixels whose ray meets an instance, hidden or not, cropped to its box.

    `mask[0, 0]` is the pixel (left_px, top_px), which may be outside the image: silhouettes extend
    up to one image size beyond each border. An empty silhouette has a (0, 0) mask.
    """

    left_px: int
    top_px: int
    mask: arrays.BoolArray_bh_bw

    def __post_init__(self) -> None:
        self.mask.flags.writeable = False

    def clipped(self, height_px: int, width_px: int) -> "Silhouette":
        """Return the part of the silhouette that is inside an image."""
        image, own = overlap(self.top_px, self.left_px, self.mask.shape, (height_px, width_px))
        mask = self.mask[own]
        if mask.size == 0:
            return Silhouette(left_px=0, top_px=0, mask=np.zeros((0, 0), dtype=bool))
        return Silhouette(left_px=image[1].start, top_px=image[0].start, mask=mask)

    def in_image(self, height_px: int, width_px: int) -> arrays.BoolArray_h_w:
        """Return the silhouette as a mask of the whole image."""
        image = np.zeros((height_px, width_px), dtype=bool)
        inside, own = overlap(self.top_px, self.left_px, self.mask.shape, image.shape)
        image[inside] = self.mask[own]
        return image


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class GroundTruth:
    """Exact geometry at pixel centres, computed from the scene.

    `depth_m` is z in the camera frame, and `normal` the geometric unit normal in the camera frame,
    towards the camera; both are NaN if a ray meets no surface. `instance` is an index into the
    layout, or -1 for anything but a part. `amodal[i]` is the silhouette of instance i.
    """

    depth_m: arrays.FloatArray_h_w
    normal: arrays.FloatArray_h_w_3
    instance: arrays.IntArray_h_w
    amodal: tuple[Silhouette, ...]

    def __post_init__(self) -> None:
        for array in (self.depth_m, self.normal, self.instance):
            array.flags.writeable = False


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Rendering:
    """The complete result of rendering a scene."""

    radiance: Radiance
    truth: GroundTruth


@runtime_checkable
class Renderer(Protocol):
    """A renderer of light transport and geometry only: no noise, no exposure, no files.

    An open renderer may own a process, so `close` it, or use it in a `with` statement. Back ends
    derive from this class, whose `close` suffices for back ends that own no resources. `denoiser`
    denoises a colour picture on the renderer's device.
    """

    name: str
    device: str
    denoiser: Denoiser
    versions: dict[str, str]  # Versions of the rendering software

    def render(
        self, scene: Scene, layout: Layout, pattern: Patterns, *, quality: Quality, seed: int
    ) -> Rendering:
        """Render every pattern (UInt8Array_n_ph_pw, 255 is white) and the ground truth.

        Raises:
            ValueError: the patterns do not have the size of the scene's projector, or this renderer
                or quality does not support the rig's optics.
        """
        ...

    def close(self) -> None:
        """Release all resources; closing again does nothing."""
        return  # Without a body, type checkers would take it for an abstract method.

    def __enter__(self) -> "Renderer":
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def refuse_other_size(pattern: Patterns, projector: Optics) -> None:
    """Refuse, by ValueError, patterns that do not have the projector's size."""
    if pattern.shape[1:] != (projector.height_px, projector.width_px):
        size = f"{pattern.shape[2]} x {pattern.shape[1]}"
        wanted = f"{projector.width_px} x {projector.height_px}"
        raise ValueError(
            f"patterns are {size} px, and the projector has {wanted} px: give patterns of that size"
        )
