"""Comparison of decoders on the stacks of `decoder_scenes`, for docs/measurements/decoders.md."""

import time
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import cv2
import numpy as np
import yaml
from jaxtyping import Bool, Float

from graycast.base.errors import GraycastError
from graycast.base.tables import markdown_table
from graycast.camera.decode import CodeMap, Reason, triangulate
from graycast.camera.rig_file import load_scanner
from graycast.camera.scanner import Scanner
from graycast.rig.pair import Rig
from graycast.rig.pattern import AXES
from graycast.score.evaluate.shares import roc_auc

from .decoder_scenes import ABOUT, TRUTH
from .decoders import (
    NO_LIMITS,
    calibration_error,
    decode_with,
    decoded_at_limit,
    is_wrong,
    reliability,
)

OURS, LIMITED, PAPER, OPENCV = "graycast", "graycast, `max_p_wrong` 0.05", "paper", "OpenCV"
LIMIT = 0.05
LEAST_DN = 5  # OpenCV refuses a bit whose picture and inverse differ by less.


@dataclass(frozen=True, slots=True, kw_only=True)
class Maps:
    """A decoder's depth of one stack [m], with its standard deviation and `p_wrong`, if known."""

    depth_m: Float[np.ndarray, "h w"]
    sigma_m: Float[np.ndarray, "h w"] | None = None
    p_wrong: Float[np.ndarray, "h w"] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Compared:
    """The depths that a decoder has for the parts' pixels of one stack."""

    decoder: str
    code: str
    material: str
    pixels: int
    wrong: Bool[np.ndarray, " n"]
    p_wrong: Float[np.ndarray, " n"] | None
    seconds: float


def compared(folder: Path, results: Path | None = None) -> Iterator[Compared]:
    """Yield the depths of every stack by each decoder.

    Args:
        results: the results of another decoder, one file for each stack.

    Raises:
        GraycastError: there are no scenes, or a file of the results is missing or has other maps.
    """
    scenes = sorted(folder.glob("scene_*"))
    if not scenes:
        raise GraycastError(f"{folder}: has no scenes: write them with `decoders write {folder}`")
    for scene in scenes:
        material = yaml.safe_load((scene / ABOUT).read_text(encoding="utf-8"))["material"]
        with np.load(scene / TRUTH) as file:
            true_m, parts = file["depth_m"], file["parts"]
        for stack in sorted(path.parent for path in scene.glob("*/stack.yaml")):
            for decoder, maps, seconds in _decoded(stack, parts, results):
                known = parts & np.isfinite(maps.depth_m)
                sigma_m, p_wrong = maps.sigma_m, maps.p_wrong
                yield Compared(
                    decoder=decoder,
                    code=stack.name,
                    material=material,
                    pixels=int(parts.sum()),
                    wrong=is_wrong(
                        maps.depth_m[known],
                        true_m[known],
                        None if sigma_m is None else sigma_m[known],
                    ),
                    p_wrong=None if p_wrong is None else p_wrong[known],
                    seconds=seconds,
                )


def _decoded(
    stack: Path, parts: Bool[np.ndarray, "h w"], results: Path | None
) -> Iterator[tuple[str, Maps, float]]:
    """Yield the name, the maps and the seconds of each decoder."""
    scanner = load_scanner(stack / "rig.yaml")
    rig = scanner.rig
    start = time.perf_counter()
    ours = _maps(stack, rig, {**NO_LIMITS, "max_p_wrong": 0.9999})
    seconds = time.perf_counter() - start
    yield OURS, ours, seconds
    assert ours.p_wrong is not None
    likely_m = np.where(ours.p_wrong <= LIMIT, ours.depth_m, np.nan)
    yield LIMITED, Maps(depth_m=likely_m, sigma_m=ours.sigma_m), seconds
    if stack.name == "gray":
        start = time.perf_counter()
        paper = _maps(stack, rig, {"max_epipolar_px": 0})
        yield PAPER, paper, time.perf_counter() - start
        if hasattr(cv2, "structured_light"):
            yield OPENCV, Maps(depth_m=opencv_depth(stack, scanner, parts)), np.nan
    if results is not None:
        file = results / stack.parent.name / f"{stack.name}.npz"
        yield results.name, read_result(file, parts.shape), np.nan


def _maps(stack: Path, rig: Rig, settings: Mapping[str, Any]) -> Maps:
    depth = decode_with(stack, rig, settings).depth
    assert depth is not None
    return Maps(depth_m=depth.depth_m, sigma_m=depth.sigma_m, p_wrong=depth.p_wrong)


def opencv_depth(
    stack: Path, scanner: Scanner, pixels: Bool[np.ndarray, "h w"]
) -> Float[np.ndarray, "h w"]:
    """Return the depth of some pixels from the positions of OpenCV's decoder of Gray code.

    Its module `structured_light` is part of opencv-contrib-python. One call decodes one pixel, so
    the time of this function says nothing about the decoder.
    """
    content = yaml.safe_load((stack / "stack.yaml").read_text(encoding="utf-8"))
    files = {
        (frame.get("axis"), frame["kind"], frame.get("bit"), "inverse" in frame): frame["file"]
        for frame in content["frames"]
    }
    bits = [
        (axis, "gray", bit, inverse)
        for axis in AXES
        for bit in sorted({key[2] for key in files if key[:2] == (axis, "gray")}, reverse=True)
        for inverse in (False, True)
    ]
    pictures = [_eight_bits(stack / files[key], scanner.sensor.bit_depth) for key in bits]
    projector = scanner.rig.projector
    decoder = cv2.structured_light.GrayCodePattern.create(projector.width_px, projector.height_px)
    decoder.setWhiteThreshold(LEAST_DN)
    place = {axis: np.full(pixels.shape, np.nan, dtype=np.float32) for axis in AXES}
    for y, x in np.argwhere(pixels):
        failed, (column, row) = decoder.getProjPixel(pictures, int(x), int(y))
        if not failed:
            place["column"][y, x], place["row"][y, x] = column, row
    return _triangulated(place["column"], place["row"], scanner.rig)


def _triangulated(
    column: Float[np.ndarray, "h w"], row: Float[np.ndarray, "h w"], rig: Rig
) -> Float[np.ndarray, "h w"]:
    half = np.full(column.shape, 0.29, dtype=np.float32)  # A uniform error of one pixel
    codes = CodeMap(
        column=column,
        row=row,
        sigma_column=half,
        sigma_row=half,
        modulation=np.ones_like(half),
        reason=np.where(np.isnan(column), Reason.SHADOW, Reason.DECODED).astype(np.uint8),
    )
    return triangulate(codes, rig).depth_m


def _eight_bits(file: Path, bit_depth: int) -> np.ndarray:
    picture = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
    if picture is None:
        raise GraycastError(f"{file}: is missing or no picture: write the scenes again")
    return (picture >> max(bit_depth - 8, 0)).astype(np.uint8)


def read_result(path: Path, shape: tuple[int, ...]) -> Maps:
    """Read the maps of another decoder.

    Raises:
        GraycastError: the file is missing or damaged, or has no depth, or maps that are unknown or
            of another size.
    """
    if not path.exists():
        raise GraycastError(f"{path}: is missing: write one file for each stack")
    try:
        with np.load(path) as file:
            maps = dict(file)
    except (OSError, ValueError, TypeError, BadZipFile) as error:
        raise GraycastError(f"{path}: is no NPZ file: write it with numpy.savez") from error
    unknown = set(maps) - set(Maps.__slots__)
    if unknown or "depth_m" not in maps:
        raise GraycastError(
            f"{path}: has {', '.join(sorted(maps))}: store depth_m, and sigma_m and p_wrong if "
            "they are known"
        )
    if wrong := [name for name, values in maps.items() if values.shape != shape]:
        h, w = shape
        raise GraycastError(f"{path}: {wrong[0]} has not the camera's size of {w} x {h} px")
    return Maps(**maps)


def table(rows: Iterable[Compared], *, by_material: bool = False) -> str:
    """Return a Markdown table with one row for each decoder and code, over all scenes.

    Args:
        by_material: whether each material has its own rows.
    """
    groups: dict[tuple[str, ...], list[Compared]] = {}
    for row in rows:
        key = (row.decoder, row.code, *((row.material,) if by_material else ()))
        groups.setdefault(key, []).append(row)
    head = ["decoder", "code", *(["material"] if by_material else [])]
    head += ["depth [%]", "wrong [%]", "ROC", "calibration", "depth at 1 % wrong [%]", "seconds"]
    return markdown_table(head, [[*key, *_figures(own)] for key, own in sorted(groups.items())])


def _figures(rows: list[Compared]) -> list[str]:
    wrong = np.concatenate([row.wrong for row in rows])
    pixels = sum(row.pixels for row in rows)
    share = f"{100 * wrong.mean():.2f}" if wrong.size else ""
    cells = [f"{100 * wrong.size / pixels:.1f}", share]
    several = [row.p_wrong for row in rows if row.p_wrong is not None]
    if wrong.size and len(several) == len(rows):
        p_wrong = np.concatenate(several)
        cells += [
            f"{roc_auc(p_wrong, wrong):.3f}",
            f"{calibration_error(reliability(p_wrong, wrong)):.3f}",
            f"{100 * decoded_at_limit(p_wrong, wrong, pixels):.1f}",
        ]
    else:
        cells += ["", "", ""]
    seconds = np.mean([row.seconds for row in rows])
    return [*cells, "" if np.isnan(seconds) else f"{seconds:.2f}"]
