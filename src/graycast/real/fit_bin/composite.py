"""The empty bin from views of a full one: the farthest depth on which two views agree.

Parts lie before the bin, never behind it. Where at least two of the views see past all parts they
agree, and what is farther than that, a stray, is in one view alone.

Leaves out: parts that lie at the same place in two views while all others are covered there too.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, UInt8

from ...base.errors import DatasetError
from .bin_views import BinView

SHARED_M = 2e-3  # Two depths nearer to each other than this are of one surface.


def empty_view(views: Sequence[BinView]) -> BinView:
    """One view of the bin as it would be without what lies in it.

    Its colours are the mean of the views that see the bin there; without pictures it has none.

    Raises:
        DatasetError: there are fewer than two views, or they share too little.
    """
    if len(views) < 2:
        raise DatasetError(
            f"{len(views)} view is given: give at least two views, because the empty bin is "
            "composed of depth on which two views agree"
        )
    depth_m = np.stack([view.depth_m for view in views])
    shared_m = farthest_shared(depth_m)
    sees = np.abs(depth_m - shared_m) < SHARED_M
    pictures = [view.rgb for view in views if view.rgb is not None]
    return BinView(
        name=f"what {len(views)} views share",
        camera=views[0].camera,
        depth_m=shared_m,
        rgb=_mean_color(pictures, sees) if len(pictures) == len(views) else None,
    )


def farthest_shared(depth_m: Float[np.ndarray, "n h w"]) -> Float[np.ndarray, "h w"]:
    """The mean of the farthest two depths that agree; NaN where no two do.

    In order of depth, two that agree have no third between them.
    """
    ordered = np.sort(np.where(np.isnan(depth_m), -np.inf, depth_m), axis=0)[::-1]
    shared = np.full(depth_m.shape[1:], np.nan)
    for farther, nearer in pairwise(ordered):
        with np.errstate(invalid="ignore"):  # infinity less infinity, where neither has depth
            agree = np.isnan(shared) & (farther - nearer < SHARED_M)
        shared[agree] = (0.5 * (farther + nearer))[agree]
    return shared


def _mean_color(
    pictures: Sequence[UInt8[np.ndarray, "h w 3"]], sees: Bool[np.ndarray, "n h w"]
) -> UInt8[np.ndarray, "h w 3"]:
    """Of the views that see the bin; of all where none does."""
    weight = np.where(sees.any(axis=0), sees, True)[..., None].astype(np.float64)
    mean = (np.stack(pictures) * weight).sum(axis=0) / weight.sum(axis=0)
    return np.round(mean).astype(np.uint8)
