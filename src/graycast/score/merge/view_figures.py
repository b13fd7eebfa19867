"""Figures of a scene's views: measured surface, added surface, and errors of the fused cloud."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, final

import numpy as np
from jaxtyping import Bool, Float, UInt8

from ...base.frames import transform_points
from ...rig.optics import points
from .adding import WRONG, WRONG_M, SurfacePoints, best_order, why_not
from .fuse import HIDDEN, OUTSIDE, THROUGH, Fused, FusedCloud
from .stored_views import StoredView
from .view import points_of

OWN_NAMES = {
    WRONG: "wrong", THROUGH: "seen_through", HIDDEN: "hidden", OUTSIDE: "outside_picture"
}  # fmt: skip


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class SurfaceCoverage:
    """Reason why each view lacks each visible point; 0 if it has depth. `of` counts all points."""

    why: UInt8[np.ndarray, "views n"]
    of: int

    def __post_init__(self) -> None:
        self.why.flags.writeable = False

    @property
    def has(self) -> Bool[np.ndarray, "views n"]:
        return self.why == 0


def surface_coverage(surface: SurfacePoints, views: Sequence[StoredView]) -> SurfaceCoverage:
    """Return the coverage of the surface by all views, for the points that a camera sees."""
    why = np.stack([why_not(surface, v.view, points_of(v.view), v.truth) for v in views])
    visible = ((why != HIDDEN) & (why != OUTSIDE)).any(axis=0)
    return SurfaceCoverage(why=why[:, visible], of=why.shape[1])


def joined(parts: Sequence[SurfaceCoverage]) -> SurfaceCoverage:
    """Return the joint coverage of several scenes whose views have the same names."""
    return SurfaceCoverage(
        why=np.concatenate([one.why for one in parts], axis=1), of=sum(one.of for one in parts)
    )


def surface_figures(
    parts: SurfaceCoverage, names: Sequence[str], reason_name: dict[int, str]
) -> dict[str, Any]:
    """Return shares of the visible surface by view, and the greedy order of views."""
    has, places = parts.has, max(parts.why.shape[1], 1)
    some = has.any(axis=0)
    names_of = reason_name | OWN_NAMES
    views = [
        {
            "view": name,
            "measured": float(row.sum() / places),
            "only_this_view": float((row & (has.sum(axis=0) == 1)).sum() / places),
            "filled_by_others": _shares(parts.why[i][some & ~row], names_of, places),
            "missing": _shares(parts.why[i][~row], names_of, places),
        }
        for i, (name, row) in enumerate(zip(names, has, strict=True))
    ]
    order, gains = best_order(has)
    total = np.cumsum(gains)
    return {
        "points": parts.of,
        "visible": float(parts.why.shape[1] / max(parts.of, 1)),
        "wrong_m": WRONG_M,
        "measured": float(some.sum() / places),
        "views": views,
        "best_order": [
            {"view": names[i], "adds": gain / places, "together": float(total[k] / places)}
            for k, (i, gain) in enumerate(zip(order, gains, strict=True))
        ],
    }


def cloud_figures(
    fused: Fused, views: Sequence[StoredView], reason_name: dict[int, str]
) -> dict[str, Any]:
    """Return figures of the fused cloud; errors are along the normals, by number of views."""
    cloud = fused.cloud
    error_m = cloud_errors_m(cloud, views)
    counts = sorted(set(cloud.views.tolist()))
    return {
        "points": len(cloud.views),
        "doubtful": int((cloud.against > 0).sum()),
        "first_reason": _shares(cloud.first_reason, reason_name | OWN_NAMES, len(cloud.views)),
        "by_views": [
            {"views": count, **_noise(cloud.sigma_m[own], error_m[own])}
            for count, own in ((count, cloud.views == count) for count in counts)
        ],
        "views": [
            {
                "view": one.view.name,
                "noise_from": one.noise,
                "measured_px": fused.measured_px[i],
                "confirmed_px": fused.confirmed_px[i],
                "rejected_px": fused.rejected_px[i],
            }
            for i, one in enumerate(views)
        ],
    }


def cloud_errors_m(cloud: FusedCloud, views: Sequence[StoredView]) -> Float[np.ndarray, " n"]:
    """Return each point's distance along its normal from the true surface; NaN without a surface.

    The true surface is approximated by a plane at the point's pixel.
    """
    error_m = np.full(len(cloud.view), np.nan)
    for i, one in enumerate(views):
        own, camera = cloud.view == i, one.view.camera
        true_m = transform_points(one.view.T_world_cam, points(camera, one.truth.depth_m))
        apart = cloud.point_m[own] - true_m[tuple(cloud.pixel[own].T)]
        error_m[own] = (apart * cloud.normal[own]).sum(axis=-1)
    return error_m


def _noise(
    sigma_m: Float[np.ndarray, " n"], error_m: Float[np.ndarray, " n"]
) -> dict[str, float | int | None]:
    """Return stated and true sigma; true sigma is half the range of the errors' middle 68.27 %."""
    known = np.isfinite(error_m)
    figures: dict[str, float | int | None] = {
        "points": len(sigma_m),
        "sigma_m": float(np.median(sigma_m)),
    }
    if not known.any():
        return figures | {"error_median_m": None, "error_sigma_m": None, "within_3_sigma": None}
    low, middle, high = np.quantile(error_m[known], (0.15866, 0.5, 0.84134))
    return figures | {
        "error_median_m": float(middle),
        "error_sigma_m": float((high - low) / 2),
        "within_3_sigma": float((np.abs(error_m[known]) <= 3 * sigma_m[known]).mean()),
    }


def _shares(reason: UInt8[np.ndarray, " n"], names_of: dict[int, str], of: int) -> dict[str, float]:
    number, count = np.unique(reason, return_counts=True)
    return {names_of[int(k)]: float(c / max(of, 1)) for k, c in zip(number, count, strict=True)}
