"""What a renderer returns, and the protocol that every renderer keeps."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Literal, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from pydantic import Field

from ..base.mask_box import overlap
from ..base.public_value import public_value
from ..base.settings import check_fields
from ..rig.optics import Optics
from ..world.scene import Layout, Scene

Patterns = UInt8[np.ndarray, "n ph pw"]  # grey levels, 255 is white
DenoiserName = Literal["none", "oidn", "optix"]
# It takes radiance, albedo and normals, (h, w, 3) each in float32, and returns clean radiance.
Denoiser = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
Samples = Annotated[int, Field(ge=1, le=65536, description="The number of light paths per pixel.")]
PathDepth = Annotated[
    int,
    Field(
        ge=1,
        le=64,
        description="The largest number of surfaces on a light path. 1 is direct light only.",
    ),
]
OnFrame = Callable[[int, int], None]  # It gets the numbers of finished and all renders of a scene.
# It gets the numbers of finished and all samples of a stack; what it raises ends the rendering.
OnPass = Callable[[int, int], None]


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Quality:
    """The effort of a renderer: paths per pixel, and vertices per path.

    Depth 1 is only direct light; each further vertex adds one interreflection. `footprint`
    filters the patterns in interreflected light over the surface that a sample stands for; its
    bias vanishes as samples grow (Mitsuba alone has it). `denoise` cleans every picture of the
    stack by itself, with Open Image Denoise or, in Cycles on an NVIDIA GPU, OptiX.
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
    """The error that a finite number of light paths leaves in all patterns of a stack alike.

    Both are standard deviations for the projector's columns and rows, in this order, and 0 where no
    light comes straight: `place_sigma_px` of the mean place in the projector's picture that a
    pixel's straight light comes from, `stray` of the stripes in the light that other surfaces sent
    on, as a share of those in the straight light.
    """

    place_sigma_px: Float[np.ndarray, "2 h w"]
    stray: Float[np.ndarray, "2 h w"]

    def __post_init__(self) -> None:
        for array in (self.place_sigma_px, self.stray):
            array.flags.writeable = False


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Radiance:
    """Linear images of one scene before any sensor [W sr^-1 m^-2].

    The measuring camera, behind its filter: `pattern[k]` is what projected pattern k alone adds,
    `white` what an all-white projector adds, `ambient` all other light. The colour picture:
    `white_rgb` is what an all-white projector adds in each band; `ambient_rgb` is all other light,
    per band. Light adds, so any picture is a sum of these.

    `white` is `white_rgb` summed over the bands, and `ambient` is `ambient_rgb` over those that the
    filter passes, unless a material has a `projector_reflectance`. `path_noise` is None where the
    renderer does not know it.

    `place_px` is the mean place (column, row) in the projector's picture of the light that comes
    to a pixel straight from the projector, by the first surface alone [projector px]; NaN where
    there is no such light. A renderer may count whole projector pixels, which is off by at most
    half of one. It is None where no pattern was rendered.
    """

    pattern: Float[np.ndarray, "n h w"]
    white: Float[np.ndarray, "h w"]
    ambient: Float[np.ndarray, "h w"]
    white_rgb: Float[np.ndarray, "h w 3"]
    ambient_rgb: Float[np.ndarray, "h w 3"]
    albedo: Float[np.ndarray, "h w 3"]  # first surface's base reflectance, for denoisers
    path_noise: PathNoise | None = None
    place_px: Float[np.ndarray, "2 h w"] | None = None

    def __post_init__(self) -> None:
        for name in ("pattern", "white", "ambient", "white_rgb", "ambient_rgb", "albedo"):
            getattr(self, name).flags.writeable = False
        if self.place_px is not None:
            self.place_px.flags.writeable = False


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Silhouette:
    """All pixels whose ray meets one instance, hidden or not, cropped to their box.

    `mask[0, 0]` is the pixel (left_px, top_px), which may lie outside the image: silhouettes are
    complete to at most one image size beyond each border. No pixel at all is a (0, 0) mask.
    """

    left_px: int
    top_px: int
    mask: Bool[np.ndarray, "bh bw"]

    def __post_init__(self) -> None:
        self.mask.flags.writeable = False

    def clipped(self, height_px: int, width_px: int) -> "Silhouette":
        """The part of the silhouette that lies in an image."""
        image, own = overlap(self.top_px, self.left_px, self.mask.shape, (height_px, width_px))
        mask = self.mask[own]
        if mask.size == 0:
            return Silhouette(left_px=0, top_px=0, mask=np.zeros((0, 0), dtype=bool))
        return Silhouette(left_px=image[1].start, top_px=image[0].start, mask=mask)

    def in_image(self, height_px: int, width_px: int) -> Bool[np.ndarray, "h w"]:
        """The silhouette as a mask of a whole image."""
        image = np.zeros((height_px, width_px), dtype=bool)
        inside, own = overlap(self.top_px, self.left_px, self.mask.shape, image.shape)
        image[inside] = self.mask[own]
        return image


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class GroundTruth:
    """Geometry at pixel centres, from the scene itself.

    `depth_m` is z of the camera frame, NaN where a ray meets nothing. `normal` is the geometric
    unit normal in the camera frame, towards the camera; NaN likewise. `instance` indexes the
    layout; -1 is anything else. `amodal[i]` is the silhouette of instance i.
    """

    depth_m: Float[np.ndarray, "h w"]
    normal: Float[np.ndarray, "h w 3"]
    instance: Int[np.ndarray, "h w"]
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
    """Light transport and geometry only: no noise, no exposure, no files.

    An open renderer may hold a process: `close` it, or use it in a `with` statement. Back ends
    derive from this class, which closes for those that hold nothing. `denoiser` is what cleans a
    colour picture on its device.
    """

    name: str
    device: str
    denoiser: Denoiser
    versions: dict[str, str]  # of the software that renders

    def render(
        self, scene: Scene, layout: Layout, pattern: Patterns, *, quality: Quality, seed: int
    ) -> Rendering:
        """Render every pattern (grey levels, 255 is white) and the ground truth.

        Raises:
            ValueError: the patterns have another size than the scene's projector, or the rig has
                optics that this renderer or this quality cannot give.
        """
        ...

    def close(self) -> None:
        """Release all resources; closing again does nothing."""
        return  # a body of its own, so that type checkers do not take it for abstract

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
