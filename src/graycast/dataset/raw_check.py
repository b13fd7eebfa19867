"""Captured pictures and code maps of a scene folder, judged from the files alone."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from ..decode import Reason
from ..errors import ConfigError
from ..picture import gray_picture
from ..sensor import Capture
from ..stack import code_of, describe_frames, read_description
from . import records
from .raw import EXPOSURE, FRAMES, RIG, STACK, read_capture, read_code_maps, told_of
from .reading import Unreadable
from .sample import Raw

# A pixel has a projector position where only its depth was refused, not its code.
_POSITIONED = (Reason.DECODED, Reason.OUT_OF_RANGE, Reason.OUTLIER)
_GRAY_DN = 1  # another processor may round a half otherwise


def raw_problems(
    folder: Path,
    camera: records.Camera,
    *,
    gray: UInt8[np.ndarray, "h w"],
    reason: UInt8[np.ndarray, "h w"],
) -> Iterator[str]:
    """All that is wrong with a scene's `frames/` and code maps; nothing where it keeps none.

    Leaves out: whether the pictures decode to the stored depth; `graycast decode` tells.
    """
    try:
        told = told_of(folder)
        yield from _folder_problems(folder, told)
        raw = read_capture(folder)
        if raw is not None and raw.capture is not None and told.frames is not None:
            yield from _stack_problems(folder, raw, told.frames)
            yield from _picture_problems(raw.capture, told.frames, camera, gray)
        yield from _code_problems(folder, reason)
    except Unreadable as error:
        yield str(error)


def _folder_problems(folder: Path, told: records.RawFacts) -> Iterator[str]:
    """Files that the manifest does not tell of."""
    there = sorted(path.name for path in (folder / FRAMES).glob("*"))
    must: list[str] = []
    if told.frames is not None:
        must = [*(shown.file for shown in told.frames.shown), STACK, RIG]
        must += [EXPOSURE] if len(told.frames.exposures_s) > 1 else []
    if there != sorted(must):
        odd = min(set(there) ^ set(must))
        yield f"{FRAMES}/ has {len(there)} files, manifest.json tells of {len(must)}: see {odd}"
    maps = {path.name for axis in ("column", "row") for path in folder.glob(f"{axis}_*sl")}
    for name in sorted(maps - set(told.code_maps)):
        yield f"{name}/ is there, but manifest.json does not tell of it"


def _stack_problems(folder: Path, raw: Raw, told: records.FramesTold) -> Iterator[str]:
    path = folder / FRAMES / STACK
    try:
        description = read_description(path)
        code = code_of(description, path)
    except ConfigError as error:
        yield f"{FRAMES}/{STACK}: {error}"
        return
    files = [str(section.file) for section in description.frames]
    if describe_frames(code, files) != [shown.model_dump() for shown in told.shown]:
        yield f"{FRAMES}/{STACK}: its frames are not those of manifest.json"
    if code != raw.scanner.light_code():
        yield f"{FRAMES}/{RIG}: its code is not that of {STACK}"


def _picture_problems(
    capture: Capture,
    told: records.FramesTold,
    camera: records.Camera,
    gray: UInt8[np.ndarray, "h w"],
) -> Iterator[str]:
    count, *size = capture.frames.shape
    if size != [camera.height, camera.width]:
        yield f"{FRAMES}/ has pictures of {size}, the camera has {[camera.height, camera.width]}"
        return
    depth, dtype = told.bit_depth, capture.frames.dtype
    if depth != capture.sensor.bit_depth or (depth <= 8) != (dtype == np.uint8):
        stored = f"{8 * dtype.itemsize} bits, {RIG} has {capture.sensor.bit_depth}"
        yield f"{FRAMES}/: manifest.json has bit_depth {depth}, the pictures {stored}"
    for k in range(count):
        brightest = int(capture.frames[k].max())
        if brightest >= 2**depth:
            name = told.shown[k].file
            yield f"{FRAMES}/{name} has the value {brightest}, which {depth} bits do not hold"
    off = np.abs(gray_picture(capture).astype(int) - gray)
    if off.max() > _GRAY_DN:
        wrong = int((off > _GRAY_DN).sum())
        yield f"gray_sl is not the first of {FRAMES}/ in {wrong} pixels: another scene's?"


def _code_problems(folder: Path, reason: UInt8[np.ndarray, "h w"]) -> Iterator[str]:
    positioned = np.isin(reason, _POSITIONED)
    for name, image in read_code_maps(folder).items():
        if image.shape != reason.shape:
            yield f"map of {name} is {image.shape}, the camera has {reason.shape}"
            continue
        wrong = int((np.isfinite(image) != positioned).sum())
        if wrong:
            yield f"map of {name} and reason_sl disagree in {wrong} pixels on what is decoded"
        least = 0.0 if name.startswith("sigma") else -0.5  # a pixel is a square about its centre
        lowest = image[np.isfinite(image)].min(initial=least)
        if lowest < least:
            yield f"map of {name} has the value {lowest}, under {least}"
