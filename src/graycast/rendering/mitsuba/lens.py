"""Lenses in Dr.Jit: the rays of pixels, and the pixels that see points."""

import math

import drjit as dr
import mitsuba as mi

from ...rig.optics import Optics, fold_radius2

NEWTON_STEPS = 6  # Each step doubles the digits; four steps suffice for float32 and usual lenses.


def camera_ray(camera: Optics, x: mi.Float, y: mi.Float) -> mi.Vector3f:
    """Return the undistorted unit direction of a pixel position in the camera frame."""
    xd, yd = (x - camera.cx_px) / camera.fx_px, (y - camera.cy_px) / camera.fy_px
    xi, yi = mi.Float(xd), mi.Float(yd)
    if camera.has_distortion:
        for _ in range(NEWTON_STEPS):
            a, b, d = _slopes(xi, yi, camera.distortion)
            fx, fy = distorted(xi, yi, camera.distortion)
            ex, ey = fx - xd, fy - yd
            scale = dr.rcp(a * d - b * b)
            xi, yi = xi - (d * ex - b * ey) * scale, yi - (a * ey - b * ex) * scale
    return dr.normalize(mi.Vector3f(xi, yi, 1))


def _slopes(x, y, distortion):
    """Return the derivatives xx, xy and yy of `distorted`, which are a symmetric matrix."""
    k1, k2, p1, p2, k3 = distortion
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2 * (k1 + r2 * (2 * k2 + 3 * r2 * k3))
    return (
        radial + slope * x * x + 2 * p1 * y + 6 * p2 * x,
        slope * x * y + 2 * p1 * x + 2 * p2 * y,
        radial + slope * y * y + 6 * p1 * y + 2 * p2 * x,
    )


def distorted(x, y, distortion):
    k1, k2, p1, p2, k3 = distortion
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return (
        x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
        y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
    )


def through_focus(
    camera: Optics, direction: mi.Vector3f, place: mi.Point2f
) -> tuple[mi.Vector3f, mi.Vector3f]:
    """Return start and unit direction, in the camera frame, of a ray through a point of the pupil.

    The point is given on the unit disc. All rays of a pixel position meet in the plane in focus.
    """
    start = mi.Vector3f(0.5 * camera.aperture_m * place.x, 0.5 * camera.aperture_m * place.y, 0)
    return start, dr.normalize(direction / direction.z - start / camera.focus_m)


def picture_place(
    optics: Optics, q: mi.Point3f | mi.Vector3f
) -> tuple[mi.Point2f, mi.Float, mi.Bool]:
    """Return the picture position of a point [px], 1 / z, and whether the point is visible."""
    ahead = q.z > 0
    scale = dr.select(ahead, dr.rcp(q.z), 0)
    x, y = q.x * scale, q.y * scale
    if optics.has_distortion:
        ahead &= x * x + y * y < fold_radius2(optics.distortion)
        x, y = distorted(x, y, optics.distortion)
    u = dr.fma(x, optics.fx_px, optics.cx_px)
    v = dr.fma(y, optics.fy_px, optics.cy_px)
    return mi.Point2f(u, v), scale, ahead


def camera_place(
    camera: Optics, q: mi.Point3f, place: mi.Point2f
) -> tuple[mi.Point2f, mi.Vector3f, mi.Float, mi.Bool]:
    """Return the picture position of a point, seen through a point of the pupil (on the unit disc).

    This is the inverse of `camera_ray` and `through_focus`.

    Returns:
        The position in the picture [px]; the ray from the pupil to the point [m]; the area of the
        picture per solid angle of such rays [px^2 sr^-1]; whether the point is visible.
    """
    pupil = mi.Vector3f(0.5 * camera.aperture_m * place.x, 0.5 * camera.aperture_m * place.y, 0)
    ray = mi.Vector3f(q) - pupil
    # This ray through the middle of the pupil meets `ray` in the plane in focus.
    central = mi.Vector3f(dr.fma(ray.z, pupil / camera.focus_m, ray))
    pixel, _, ahead = picture_place(camera, central)
    return pixel, ray, pixels_per_sr(camera, central, ray), ahead


def pixels_per_sr(optics: Optics, central: mi.Vector3f, ray: mi.Vector3f) -> mi.Float:
    """Return the area of the picture per solid angle of rays [px^2 sr^-1].

    Args:
        central: ray through the middle of the pupil to the same position; any length, like `ray`.
    """
    area = optics.fx_px * optics.fy_px
    slant = dr.norm(ray) / ray.z
    if optics.has_distortion:
        a, b, d = _slopes(central.x / central.z, central.y / central.z, optics.distortion)
        return area * (a * d - b * b) * slant * slant * slant
    return area * slant * slant * slant


def blur_radius2(projector: Optics, inverse_z: mi.Float) -> mi.Float:
    """Return the square of `optics.blur_radius_px` in normalised coordinates."""
    defocus = 0.5 * projector.aperture_m * (1 / projector.focus_m - inverse_z)
    return dr.square(defocus) + (projector.psf_px / projector.fx_px) ** 2


def in_field(projector: Optics, place: mi.Point2f) -> mi.Bool:
    inside = (place.x >= -0.5) & (place.x < projector.width_px - 0.5)
    return inside & (place.y >= -0.5) & (place.y < projector.height_px - 0.5)


def corner_share(optics: Optics, place: mi.Point2f) -> mi.Float:
    """Return `optics.corner_share`, computed in Dr.Jit."""
    x = (2 * place.x + 1) / optics.width_px - 1
    y = (2 * place.y + 1) / optics.height_px - 1
    return (x * x + y * y) / 2


def shines(projector: Optics, place: mi.Point2f) -> mi.Bool:
    """Return whether a position is on the active area of a pixel, and not in a gap or outside."""
    inside = in_field(projector, place)
    if projector.fill_factor < 1:
        half = 0.5 * math.sqrt(projector.fill_factor)
        inside &= dr.abs(place.x - dr.floor(place.x + 0.5)) < half
        inside &= dr.abs(place.y - dr.floor(place.y + 0.5)) < half
    return inside


def on_pixel(projector: Optics, place: mi.Point2f) -> mi.Point2f:
    """Return the centre of the pixel that contains a position."""
    u = dr.clip(dr.floor(place.x + 0.5), 0, projector.width_px - 1)
    return mi.Point2f(u, dr.clip(dr.floor(place.y + 0.5), 0, projector.height_px - 1))


def pixel_index(projector: Optics, middle: mi.Point2f) -> mi.UInt32:
    """Return the index of the pixel with this centre (see `on_pixel`); exact below 2^24 pixels."""
    return mi.UInt32(middle.y * projector.width_px + middle.x)
