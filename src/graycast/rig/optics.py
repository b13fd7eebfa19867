"""Camera and projector optics: distortion and its inverse, thin lens, vignetting, pixels.

A projector is an inverse camera, so both have the same description.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from jaxtyping import Bool, Float, Int
from pydantic import AfterValidator, Field

from ..base import array_types as arrays
from ..base.frames import pixel_grid
from ..base.public_value import public_value
from ..base.settings import Finite, Level, Positive, check_fields

MAX_SIDE_PX = 32_768  # Twice the side of the largest sensors; a larger value must be a mistake.


def _side(pixels: int) -> int:
    if not 1 <= pixels <= MAX_SIDE_PX:
        raise ValueError(f"a picture has 1 to {MAX_SIDE_PX} pixels along each side")
    return pixels


def _pupil(metres: float) -> float:
    if metres >= 1:
        raise ValueError(
            "a pupil's diameter must be less than 1 m: give it in metres, not in millimetres"
        )
    return metres


Side = Annotated[int, Field(ge=1), AfterValidator(_side)]
Distortion = tuple[Finite, Finite, Finite, Finite, Finite]  # (k1, k2, p1, p2, k3)


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Optics:
    """Intrinsics of a camera or projector in pixels; (0, 0) is the centre of the first pixel.

    `distortion` is (k1, k2, p1, p2, k3) of Brown-Conrady in OpenCV's order:
    with `r2 = x^2 + y^2` and `radial = 1 + k1 r2 + k2 r2^2 + k3 r2^3`,
    `x' = x radial + 2 p1 x y + p2 (r2 + 2 x^2)`, `y' = y radial + p1 (r2 + 2 y^2) + 2 p2 x y`.

    The entrance pupil is at z = 0. The blur `psf_px` models aberrations and diffraction.
    `natural_vignetting` multiplies a camera's image by `cos^4` of the field angle, and a
    projector's intensity by the cosine (see `relative_illumination`). `falloff` is any other
    darkening towards the corners (see `corner_share`). The active area of a pixel (`fill_factor`)
    is a centred square. Distortion that is not monotonic over the image is refused.

    Leaves out: skew; the effect of mechanical vignetting on blur. `blur_radius_px` lists more.
    """

    width_px: Annotated[Side, Field(description="Width of the image in pixels.")]
    height_px: Annotated[Side, Field(description="Height of the image in pixels.")]
    fx_px: Annotated[Positive, Field(description="Focal length along x in pixels.")]
    fy_px: Annotated[Positive, Field(description="Focal length along y in pixels.")]
    cx_px: Annotated[
        Finite, Field(description="The x coordinate of the principal point in pixels.")
    ]
    cy_px: Annotated[
        Finite, Field(description="The y coordinate of the principal point in pixels.")
    ]
    distortion: Annotated[
        Distortion,
        Field(description="Brown-Conrady coefficients (k1, k2, p1, p2, k3) in OpenCV's order."),
    ] = (0.0, 0.0, 0.0, 0.0, 0.0)
    aperture_m: Annotated[
        Level,
        Field(description="Diameter of the entrance pupil in metres; 0 is a pinhole."),
        AfterValidator(_pupil),
    ] = 0.0
    focus_m: Annotated[
        Positive,
        Field(
            description="Distance of the plane in focus along the axis in metres; infinite if the "
            "key is absent."
        ),
    ] = math.inf
    psf_px: Annotated[
        Level,
        Field(description="Radius in pixels of a blur that is the same at every distance."),
    ] = 0.0
    natural_vignetting: Annotated[
        bool,
        Field(
            description="Whether the image darkens towards its corners with a power of the cosine "
            "of the field angle."
        ),
    ] = False
    falloff: Annotated[
        float | None,
        Field(
            ge=0,
            lt=1,
            description="Share of the light that is missing in the corners of the picture beyond "
            "natural vignetting; it grows with the square of the distance from the middle.",
        ),
    ] = None
    fill_factor: Annotated[
        float, Field(gt=0, le=1, description="Share of a pixel's area that senses or emits light.")
    ] = 1.0

    def __post_init__(self) -> None:
        check_fields(self)

    @property
    def K(self) -> arrays.FloatArray_3_3:
        """Camera matrix."""
        return np.array(
            [[self.fx_px, 0.0, self.cx_px], [0.0, self.fy_px, self.cy_px], [0.0, 0.0, 1.0]]
        )

    @property
    def has_distortion(self) -> bool:
        return any(self.distortion)

    @property
    def is_pinhole(self) -> bool:
        """Whether points at every distance are sharp."""
        return self.aperture_m == 0 and self.psf_px == 0

    @property
    def field_of_view_rad(self) -> tuple[float, float]:
        """Horizontal and vertical angle between the outer pixel borders, without distortion."""
        left, right = -0.5 - self.cx_px, self.width_px - 0.5 - self.cx_px
        top, bottom = -0.5 - self.cy_px, self.height_px - 0.5 - self.cy_px
        horizontal = np.arctan(right / self.fx_px) - np.arctan(left / self.fx_px)
        vertical = np.arctan(bottom / self.fy_px) - np.arctan(top / self.fy_px)
        return float(horizontal), float(vertical)


def optics_of(
    K: Sequence[float] | Float[np.ndarray, "3 3"],
    size_px: tuple[int, int],
    distortion: Sequence[float] = (0.0,) * 5,
) -> Optics:
    """Return the optics for a camera matrix (row by row); `size_px` is (height, width).

    Raises:
        ValueError: `Optics` refuses a value, or `distortion` does not have five coefficients.
    """
    (fx_px, _, cx_px), (_, fy_px, cy_px), _ = np.reshape(K, (3, 3)).tolist()
    k1, k2, p1, p2, k3 = distortion
    return Optics(
        width_px=size_px[1],
        height_px=size_px[0],
        fx_px=fx_px,
        fy_px=fy_px,
        cx_px=cx_px,
        cy_px=cy_px,
        distortion=(float(k1), float(k2), float(p1), float(p2), float(k3)),
    )


def pinhole(width_px: int, height_px: int, f_px: float) -> Optics:
    """Return ideal optics whose principal point is the middle of the picture."""
    return Optics(
        width_px=width_px,
        height_px=height_px,
        fx_px=f_px,
        fy_px=f_px,
        cx_px=(width_px - 1) / 2,
        cy_px=(height_px - 1) / 2,
    )


def distort(xy: Float[np.ndarray, "*n 2"], distortion: Distortion) -> Float[np.ndarray, "*n 2"]:
    """Map ideal normalised image coordinates to distorted ones.

    Source: D. C. Brown, "Close-range camera calibration", 1971; OpenCV's coefficient order.
    """
    k1, k2, p1, p2, k3 = distortion
    x, y = xy[..., 0], xy[..., 1]
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return np.stack(
        [
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
        ],
        axis=-1,
    )


def undistort(xy: Float[np.ndarray, "*n 2"], distortion: Distortion) -> Float[np.ndarray, "*n 2"]:
    """Map distorted coordinates to ideal ones: the inverse of `distort`, accurate to 1e-9.

    Raises:
        ValueError: the distortion folds over at one of the points, so it has no inverse there.
    """
    ideal = np.array(xy, dtype=np.float64)
    _undistort_rows(ideal.reshape(-1, 2), distortion)
    return ideal


def _undistort_rows(table: Float[np.ndarray, "n columns"], distortion: Distortion) -> None:
    """Undistort the first two numbers of each row in place; raise the errors of `undistort`."""
    if not any(distortion):
        return
    from .lens_inverse import undistort_in_place  # Numba is slow to import; `--help` must be fast.

    if not undistort_in_place(table, *map(float, distortion)):
        raise ValueError(no_inverse(distortion))


def no_inverse(distortion: Distortion) -> str:
    """Return the error message for a distortion that folds over inside the picture."""
    return (
        f"distortion {distortion} has no inverse over this image: give coefficients in the "
        "order (k1, k2, p1, p2, k3) that were fitted to it"
    )


def in_picture(optics: Optics, pixel: Float[np.ndarray, "*n 2"]) -> Bool[np.ndarray, "*n"]:
    """Return whether positions are inside the outer pixel borders of a picture; false for NaN."""
    end = np.array([optics.width_px, optics.height_px]) - 0.5
    return np.all((pixel >= -0.5) & (pixel <= end), axis=-1)


def project(optics: Optics, point: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 2"]:
    """Return pixel coordinates (x, y) of points in the camera frame; NaN outside the lens model.

    The model holds in front of the lens, up to the field angle at which radial distortion folds
    over: beyond it the polynomial would map points far outside the field into the image.
    """
    z = np.where(point[..., 2:] > 0, point[..., 2:], np.nan)
    ideal = point[..., :2] / z
    if optics.has_distortion:
        r2 = np.square(ideal).sum(axis=-1, keepdims=True)
        ideal = np.where(r2 < fold_radius2(optics.distortion), ideal, np.nan)
    xy = distort(ideal, optics.distortion)
    return xy * [optics.fx_px, optics.fy_px] + [optics.cx_px, optics.cy_px]


def pixels_of(
    optics: Optics, point: Float[np.ndarray, "*n 3"]
) -> tuple[Int[np.ndarray, "*n 2"], Bool[np.ndarray, "*n"]]:
    """Return the pixel (row, column) in which each point appears, and whether there is one.

    Points are in the camera frame. Row and column are 0 for a point outside the picture.
    """
    column, row = np.moveaxis(np.rint(np.nan_to_num(project(optics, point), nan=-1.0)), -1, 0)
    inside = (column >= 0) & (column < optics.width_px) & (row >= 0) & (row < optics.height_px)
    pixel = np.where(inside[..., None], np.stack([row, column], axis=-1), 0)
    return pixel.astype(np.int64), inside


def rays(optics: Optics, pixel: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 3"]:
    """Return the undistorted ray directions of pixels in the camera frame, scaled to unit z."""
    return _rays(optics, pixel[..., 0], pixel[..., 1])


def picture_rays(optics: Optics) -> Float[np.ndarray, "h w 3"]:
    """Return `rays` of all pixels of a picture."""
    y, x = np.ogrid[: optics.height_px, : optics.width_px]
    return _rays(optics, x, y)


def mask_rays(optics: Optics, mask: Bool[np.ndarray, "h w"]) -> Float[np.ndarray, "n 3"]:
    """Return `rays` of the pixels in a mask of the whole picture, row by row."""
    y, x = np.nonzero(mask)
    return _rays(optics, x, y)


def _rays(optics: Optics, x: np.ndarray, y: np.ndarray) -> Float[np.ndarray, "*n 3"]:
    ray = np.empty((*np.broadcast_shapes(x.shape, y.shape), 3))
    ray[..., 0] = (x - optics.cx_px) / optics.fx_px
    ray[..., 1] = (y - optics.cy_px) / optics.fy_px
    ray[..., 2] = 1.0
    _undistort_rows(ray.reshape(-1, 3), optics.distortion)
    return ray


def points(optics: Optics, depth_m: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "h w 3"]:
    """Return the point [m] that each pixel sees, in the camera frame; NaN without a depth.

    Args:
        depth_m: z of every pixel of the picture; NaN without a depth.
    """
    point_m = picture_rays(optics)
    point_m *= depth_m[..., None]
    return point_m


def mask_points(
    optics: Optics, depth_m: Float[np.ndarray, "h w"], mask: Bool[np.ndarray, "h w"]
) -> Float[np.ndarray, "n 3"]:
    """Return `points` of the pixels in a mask, row by row."""
    point_m = mask_rays(optics, mask)
    point_m *= depth_m[mask][:, None]
    return point_m


def fold_radius2(distortion: Distortion) -> float:
    """Return the squared ideal radius at which radial distortion folds over; inf if it never does.

    It is the smallest root s = r^2 > 0 of d(r radial)/dr = 1 + 3 k1 s + 5 k2 s^2 + 7 k3 s^3.
    Leaves out the tangential terms, which move the fold by about their own size.
    """
    k1, k2, _, _, k3 = distortion
    root = np.roots([7 * k3, 5 * k2, 3 * k1, 1.0])
    real = root.real[(np.abs(root.imag) < 1e-9 * np.abs(root)) & (root.real > 0)]
    return float(real.min(initial=np.inf))


def blur_radius_px(optics: Optics, z_m: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Return the blur radius of a thin lens for a point at depth `z_m` [pixels along x].

    The rays from a pupil of diameter A to a point at depth z cross the plane in focus, at depth f,
    in a disc. Its radius is `A / 2 |1 / f - 1 / z|` in normalised coordinates. The constant disc
    `psf_px` is added in quadrature, because the second moments of blurs add up.

    Leaves out: the shape of diffraction and aberrations, and their growth towards the corners; the
    foreshortening of the pupil there; focus breathing.

    Source: geometrical optics; e.g. Potmesil & Chakravarty, "A Lens and Aperture Camera Model for
    Synthetic Image Generation", SIGGRAPH 1981.
    """
    defocus = 0.5 * optics.aperture_m * np.abs(1 / optics.focus_m - 1 / z_m)
    return np.hypot(defocus * optics.fx_px, optics.psf_px)


def relative_illumination(optics: Optics) -> Float[np.ndarray, "h w"]:
    """Return the share of a camera's light that vignetting and falloff leave at each pixel.

    With `natural_vignetting`, irradiance is proportional to `cos^4` of the field angle: two factors
    for the longer distance to the sensor, one each for the tilt of the pupil and of the sensor.
    Source: e.g. R. Kingslake, "Optics in Photography", 1992.
    """
    pixel = pixel_grid(optics.height_px, optics.width_px)
    left = np.ones(pixel.shape[:2])
    if optics.falloff:
        left -= optics.falloff * corner_share(optics, pixel)
    if optics.natural_vignetting:
        left /= np.square(np.square(rays(optics, pixel)).sum(axis=-1))
    return left


def corner_share(optics: Optics, pixel: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n"]:
    """Return the factor of `falloff` at pixel positions: 0 in the middle, 1 in the corners.

    It is `(x^2 + y^2) / 2`, with x and y scaled to -1 and 1 at the borders.
    """
    place = (2 * pixel + 1) / np.array([optics.width_px, optics.height_px]) - 1
    return np.square(place).sum(axis=-1) / 2
