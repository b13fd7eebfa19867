"""Camera and projector optics: pinhole with Brown-Conrady distortion, both ways.

A projector is a camera run backwards, so one description serves both.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

UNDISTORT_ITERATIONS = 20


@dataclass(frozen=True, slots=True, kw_only=True)
class Optics:
    """Intrinsics of a camera or projector, in pixels; pixel (0, 0) is a centre.

    `distortion` is (k1, k2, p1, p2, k3) of Brown-Conrady in OpenCV's order:
    with `r2 = x^2 + y^2` and `radial = 1 + k1 r2 + k2 r2^2 + k3 r2^3`,
    `x' = x radial + 2 p1 x y + p2 (r2 + 2 x^2)`, `y' = y radial + p1 (r2 + 2 y^2) + 2 p2 x y`.

    Leaves out: defocus, vignetting, skew. Distortion beyond the monotonic range is refused.
    """

    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        if self.width_px < 1 or self.height_px < 1:
            size = f"{self.width_px} x {self.height_px}"
            raise ValueError(f"image size is {size} px; both must be at least 1")
        if not (self.fx_px > 0 and self.fy_px > 0):
            focal = f"({self.fx_px}, {self.fy_px})"
            raise ValueError(f"focal length is {focal} px; both must be positive")
        numbers = (self.fx_px, self.fy_px, self.cx_px, self.cy_px, *self.distortion)
        if not np.isfinite(numbers).all():
            raise ValueError(f"intrinsics are not finite: {numbers}")
        if len(self.distortion) != 5:
            raise ValueError(
                f"distortion has {len(self.distortion)} terms; give (k1, k2, p1, p2, k3)"
            )

    @property
    def K(self) -> Float[np.ndarray, "3 3"]:
        """The camera matrix."""
        return np.array(
            [[self.fx_px, 0.0, self.cx_px], [0.0, self.fy_px, self.cy_px], [0.0, 0.0, 1.0]]
        )

    @property
    def has_distortion(self) -> bool:
        return any(self.distortion)

    @property
    def field_of_view_rad(self) -> tuple[float, float]:
        """Full horizontal and vertical angle between the outer pixel borders, undistorted."""
        left, right = -0.5 - self.cx_px, self.width_px - 0.5 - self.cx_px
        top, bottom = -0.5 - self.cy_px, self.height_px - 0.5 - self.cy_px
        horizontal = np.arctan(right / self.fx_px) - np.arctan(left / self.fx_px)
        vertical = np.arctan(bottom / self.fy_px) - np.arctan(top / self.fy_px)
        return float(horizontal), float(vertical)


def distort(
    xy: Float[np.ndarray, "*n 2"], distortion: tuple[float, float, float, float, float]
) -> Float[np.ndarray, "*n 2"]:
    """Ideal normalised image coordinates to distorted ones.

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


@np.errstate(all="ignore")  # what diverges is refused at the end, by its residual
def undistort(
    xy: Float[np.ndarray, "*n 2"], distortion: tuple[float, float, float, float, float]
) -> Float[np.ndarray, "*n 2"]:
    """The inverse of `distort`, by Newton's method to 1e-9.

    Raises:
        ValueError: the distortion folds over within the given points, so it has no inverse.
    """
    k1, k2, p1, p2, k3 = distortion
    ideal = np.array(xy, dtype=np.float64)
    if not any(distortion):
        return ideal
    for _ in range(UNDISTORT_ITERATIONS):
        x, y = ideal[..., 0], ideal[..., 1]
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        slope = 2 * (k1 + r2 * (2 * k2 + 3 * r2 * k3))  # d radial / d r2, times 2
        a = radial + slope * x * x + 2 * p1 * y + 6 * p2 * x
        b = slope * x * y + 2 * p1 * x + 2 * p2 * y
        d = radial + slope * y * y + 6 * p1 * y + 2 * p2 * x
        error = distort(ideal, distortion) - xy
        determinant = a * d - b * b
        step = np.stack(
            [
                d * error[..., 0] - b * error[..., 1],
                a * error[..., 1] - b * error[..., 0],
            ],
            axis=-1,
        )
        ideal = ideal - step / determinant[..., None]
        if np.abs(step / determinant[..., None]).max(initial=0.0) < 1e-12:
            break
    residual = np.abs(distort(ideal, distortion) - xy)
    # NaN must fail too; a fold-over shows as a non-positive Jacobian at the solution.
    if not (residual.max(initial=0.0) < 1e-9 and (determinant > 0).all()):
        raise ValueError(
            f"distortion {distortion} has no inverse over this image: are the coefficients "
            "in the order (k1, k2, p1, p2, k3) and fitted to it?"
        )
    return ideal


def project(optics: Optics, point: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 2"]:
    """Pixel coordinates (x, y) of points in the camera frame; NaN where the lens model ends.

    It ends at and behind the lens, and beyond the field angle at which radial distortion folds
    over: there the polynomial would put points far outside the field back into the image.
    """
    z = np.where(point[..., 2:] > 0, point[..., 2:], np.nan)
    ideal = point[..., :2] / z
    if optics.has_distortion:
        r2 = np.square(ideal).sum(axis=-1, keepdims=True)
        ideal = np.where(r2 < fold_radius2(optics.distortion), ideal, np.nan)
    xy = distort(ideal, optics.distortion)
    return xy * [optics.fx_px, optics.fy_px] + [optics.cx_px, optics.cy_px]


def rays(optics: Optics, pixel: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 3"]:
    """Ideal ray directions of pixels, camera frame, scaled to unit z."""
    xy = (pixel - [optics.cx_px, optics.cy_px]) / [optics.fx_px, optics.fy_px]
    xy = undistort(xy, optics.distortion)
    return np.concatenate([xy, np.ones_like(xy[..., :1])], axis=-1)


def fold_radius2(distortion: tuple[float, float, float, float, float]) -> float:
    """Squared ideal radius at which radial distortion stops growing outwards; inf if it never does.

    The smallest positive root of d(r radial)/dr = 1 + 3 k1 s + 5 k2 s^2 + 7 k3 s^3, s = r^2.
    Leaves out the tangential terms, which move the fold by about their own size.
    """
    k1, k2, _, _, k3 = distortion
    root = np.roots([7 * k3, 5 * k2, 3 * k1, 1.0])
    real = root.real[(np.abs(root.imag) < 1e-9 * np.abs(root)) & (root.real > 0)]
    return float(real.min(initial=np.inf))
