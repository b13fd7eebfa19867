"""Pictures of one rendering for many scanners, and figures of a decoder against true depth."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import yaml
from jaxtyping import Bool, Float, UInt8

from graycast.camera.decode import WRONG_M, WRONG_SIGMAS, DecodeSpec, FilterSpec
from graycast.camera.scanner import Scanner, take
from graycast.camera.sensor import Capture
from graycast.camera.stack import StackResult, decode_stack
from graycast.cell.resolve import patterns_of
from graycast.rendering.radiance import Radiance
from graycast.rig.pair import Rig
from graycast.rig.pattern import AXES, Axis
from graycast.score.evaluate.shares import roc_auc

EDGES = (0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 0.6, 0.9)
MOST_WRONG = 0.01
NO_LIMITS: Mapping[str, Any] = {"min_contrast": 0.002, "doubt": 0.0, "max_epipolar_px": 0.0}


def bare(scanner: Scanner) -> Scanner:
    """Return the scanner without any limit against wrong depths, and with the same faults."""
    return replace(scanner, decode=DecodeSpec(**NO_LIMITS), filters=FilterSpec())


def with_single_limits(scanner: Scanner) -> Scanner:
    """Return the scanner with one limit for each kind of evidence, and with the same faults."""
    decode = DecodeSpec(
        min_contrast=0.002, min_sigmas=30.0, min_visibility=0.3, max_epipolar_px=0.5
    )
    filters = FilterSpec(
        flying_angle_deg=75.0,
        outlier_sigmas=4.0,
        outlier_repair=True,
        hidden_sigmas=3.0,
        edge_px=1.0,
        island_px=30,
        smoothing_px=0.55,
    )
    return replace(scanner, decode=decode, filters=filters)


def keys_of(scanner: Scanner) -> list[tuple[Any, ...]]:
    """Return a key for each of a scanner's pictures; equal keys mean equal pictures."""
    code = scanner.light_code()
    return [(frame, code.offset_px, code.stride_px) for frame in code.frames]


def shared_patterns(
    scanners: Sequence[Scanner],
) -> tuple[list[tuple[Any, ...]], UInt8[np.ndarray, "n h w"]]:
    """Return every different picture of all scanners once, with its key."""
    pictures: dict[tuple[Any, ...], np.ndarray] = {}
    for scanner in scanners:
        pictures |= dict(zip(keys_of(scanner), patterns_of(scanner), strict=True))
    return list(pictures), np.stack(list(pictures.values()))


def pictures_of(
    scanner: Scanner, radiance: Radiance, keys: Sequence[tuple[Any, ...]], *, seed: int
) -> tuple[Capture, Radiance]:
    """Take the scanner's own pictures out of the radiance of the shared patterns.

    Returns:
        The pictures, and the radiance of the scanner's own patterns.
    """
    own = [keys.index(key) for key in keys_of(scanner)]
    light = replace(radiance, pattern=radiance.pattern[own])
    return take(scanner, light, seed=seed), light


def decode_with(
    folder: Path, rig: Rig | None, settings: Mapping[str, Any], axes: Sequence[Axis] = AXES
) -> StackResult:
    """Decode a stack with other settings of its section `decode`, and only the frames of `axes`."""
    content = yaml.safe_load((folder / "stack.yaml").read_text(encoding="utf-8"))
    content["frames"] = [f for f in content["frames"] if f.get("axis") in (None, *axes)]
    for frame in content["frames"]:
        frame["file"] = str((folder / frame["file"]).resolve())
    content["decode"] = dict(settings)
    with TemporaryDirectory() as aside:
        path = Path(aside) / "stack.yaml"
        path.write_text(yaml.safe_dump(content), encoding="utf-8")
        return decode_stack(path, rig)


def is_wrong(
    depth_m: Float[np.ndarray, " n"],
    true_m: Float[np.ndarray, " n"],
    sigma_m: Float[np.ndarray, " n"] | None = None,
) -> Bool[np.ndarray, " n"]:
    """Return which depths are off by more than 1 mm and, if sigma is given, 5 sigmas."""
    off_m = np.abs(depth_m - true_m)
    wrong = off_m > WRONG_M
    return wrong if sigma_m is None else wrong & (off_m > WRONG_SIGMAS * sigma_m)


@dataclass(frozen=True, slots=True, kw_only=True)
class Bin:
    """Depths of similar `p_wrong`: the mean probability, the share that is wrong, the number."""

    mean: float
    wrong: float
    count: int


def reliability(p_wrong: Float[np.ndarray, " n"], wrong: Bool[np.ndarray, " n"]) -> list[Bin]:
    """Return the bins between EDGES that have depths, from the lowest probability upwards."""
    number = np.digitize(p_wrong, EDGES)
    inside = [number == k for k in np.unique(number)]
    return [
        Bin(mean=float(p_wrong[i].mean()), wrong=float(wrong[i].mean()), count=int(i.sum()))
        for i in inside
    ]


def calibration_error(bins: Sequence[Bin]) -> float:
    """Return the mean difference of stated and observed share, weighted by number; NaN if empty."""
    total = sum(one.count for one in bins)
    off = sum(one.count * abs(one.mean - one.wrong) for one in bins)
    return off / total if total else float("nan")


def decoded_at_limit(
    p_wrong: Float[np.ndarray, " n"], wrong: Bool[np.ndarray, " n"], pixels: int
) -> float:
    """Return the share of all pixels below the largest limit with at most 1 % wrong depths."""
    order = np.argsort(p_wrong, kind="stable")
    p, share = p_wrong[order], np.cumsum(wrong[order]) / np.arange(1, len(order) + 1)
    last = np.append(p[1:] != p[:-1], True)[: len(p)]  # A limit includes all equal probabilities.
    ends = np.nonzero(last & (share <= MOST_WRONG))[0]
    return float(ends[-1] + 1) / max(pixels, 1) if len(ends) else 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Worth:
    """Figures of one depth map; `wrong` is a share of the decoded pixels of the parts."""

    decoded: float
    wrong: float
    roc_area: float | None = None
    calibration_error: float | None = None
    decoded_at_limit: float | None = None


def worth(
    depth_m: Float[np.ndarray, "h w"],
    true_m: Float[np.ndarray, "h w"],
    parts: Bool[np.ndarray, "h w"],
    *,
    sigma_m: Float[np.ndarray, "h w"] | None = None,
    p_wrong: Float[np.ndarray, "h w"] | None = None,
) -> Worth:
    """Compare the depth of the parts' pixels with the true depth."""
    known = parts & np.isfinite(depth_m)
    sigma = None if sigma_m is None else sigma_m[known]
    wrong = is_wrong(depth_m[known], true_m[known], sigma)
    pixels = int(parts.sum())
    share = float(wrong.mean()) if wrong.size else 0.0
    decoded = int(known.sum()) / max(pixels, 1)
    if p_wrong is None:
        return Worth(decoded=decoded, wrong=share)
    p = p_wrong[known]
    return Worth(
        decoded=decoded,
        wrong=share,
        roc_area=roc_auc(p, wrong),
        calibration_error=calibration_error(reliability(p, wrong)),
        decoded_at_limit=decoded_at_limit(p, wrong, pixels),
    )
