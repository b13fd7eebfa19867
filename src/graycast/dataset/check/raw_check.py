"""Check captured pictures, code maps and flow of a scene folder from the files alone."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float32, UInt8

from ...base.errors import ConfigError
from ...camera.decode import POSITIONED
from ...camera.sensor import Capture
from ...rig.pattern import AXES
from ..files import records
from ..files.safe_reading import Unreadable
from ..files.scene_folder import SceneFolder, of_sensor
from ..write.flow import FLOW, flow_name, read_flow
from ..write.raw import (
    EXPOSURE,
    RIG,
    STACK,
    frames_folder,
    raw_facts_of,
    read_capture,
    read_code_maps,
)

if TYPE_CHECKING:  # Most scenes have no such files, and a check must not wait for these packages.
    from ..files.sample import Raw

# A pixel with one of these reasons has a projector position, even if its depth was rejected.
_GRAY_DN = 1  # Values halfway between two steps may round differently on other processors.


def raw_problems(
    files: SceneFolder,
    number: int,
    camera: records.Camera,
    *,
    gray: UInt8[np.ndarray, "h w"],
    reason: UInt8[np.ndarray, "h w"],
) -> Iterator[str]:
    """Yield all problems of an image's `frames/`, code maps and flow, if they are stored.

    The check does not decode the pictures; `graycast rig decode` shows whether they give the depth.
    """
    folder, sensor = files.path, files.sensor
    try:
        facts = raw_facts_of(folder, sensor=sensor, number=number)
        yield from _folder_problems(files, number, facts)
        raw = read_capture(folder, sensor=sensor, number=number)
        if raw is not None and raw.capture is not None and facts.frames is not None:
            frames = folder / frames_folder(sensor, number)
            yield from _stack_problems(frames, raw, facts.frames)
            yield from _picture_problems(frames.name, raw.capture, facts.frames, camera, gray)
        maps = read_code_maps(folder, sensor=sensor, number=number)
        yield from _code_problems(maps, reason)
        yield from _flow_problems(files, number, facts)
    except Unreadable as error:
        yield str(error)


def _folder_problems(files: SceneFolder, number: int, facts: records.RawFacts) -> Iterator[str]:
    """Yield files that the manifest does not list, and listed files that are missing."""
    folder, sensor = files.path, files.sensor
    name = frames_folder(sensor, number)
    there = sorted(path.name for path in (folder / name).glob("*"))
    must: list[str] = []
    if facts.frames is not None:
        must = [*(shown.file for shown in facts.frames.shown), STACK, RIG]
        must += [EXPOSURE] if len(facts.frames.exposures_s) > 1 else []
    if there != sorted(must):
        odd = min(set(there) ^ set(must))
        yield f"{name}/ has {len(there)} files, manifest.json tells of {len(must)}: see {odd}"
    kinds = [f"{axis}{sigma}_sl" for axis in AXES for sigma in ("", "_sigma")]
    for kind in kinds:
        map_file = folder / of_sensor(kind, sensor)
        if map_file.is_dir() and kind not in facts.code_maps:
            yield f"{map_file.name}/ is there, but manifest.json does not tell of it"


def _stack_problems(frames: Path, raw: "Raw", facts: records.FramesRecord) -> Iterator[str]:
    from ...camera.stack import code_of, describe_frames, read_description

    path = frames / STACK
    try:
        description = read_description(path)
        code = code_of(description, path)
    except ConfigError as error:
        yield f"{frames.name}/{STACK}: {error}"
        return
    files = [str(section.file) for section in description.frames]
    if describe_frames(code, files) != [shown.model_dump() for shown in facts.shown]:
        yield f"{frames.name}/{STACK}: its frames are not those of manifest.json"
    if code != raw.scanner.light_code():
        yield f"{frames.name}/{RIG}: its code is not that of {STACK}"


def _picture_problems(
    frames: str,
    capture: Capture,
    facts: records.FramesRecord,
    camera: records.Camera,
    gray: UInt8[np.ndarray, "h w"],
) -> Iterator[str]:
    from ...camera.picture import gray_picture

    count, *size = capture.frames.shape
    if size != [camera.height, camera.width]:
        yield f"{frames}/ has pictures of {size}, the camera has {[camera.height, camera.width]}"
        return
    depth, dtype = facts.bit_depth, capture.frames.dtype
    if depth != capture.sensor.bit_depth or (depth <= 8) != (dtype == np.uint8):
        stored = f"{8 * dtype.itemsize} bits, {RIG} has {capture.sensor.bit_depth}"
        yield f"{frames}/: manifest.json has bit_depth {depth}, the pictures {stored}"
    for k in range(count):
        brightest = int(capture.frames[k].max())
        if brightest >= 2**depth:
            name = facts.shown[k].file
            yield f"{frames}/{name} has the value {brightest}, which {depth} bits do not hold"
    off = np.abs(gray_picture(capture).astype(int) - gray)
    if off.max() > _GRAY_DN:
        wrong = int((off > _GRAY_DN).sum())
        yield f"gray_sl is not the first of {frames}/ in {wrong} pixels: another scene's?"


def _code_problems(
    maps: Mapping[str, Float32[np.ndarray, "h w"]], reason: UInt8[np.ndarray, "h w"]
) -> Iterator[str]:
    for name, image in maps.items():
        if image.shape != reason.shape:
            yield f"map of {name} is {image.shape}, the camera has {reason.shape}"
            continue
        wrong = int((np.isfinite(image) != np.isin(reason, POSITIONED)).sum())
        if wrong:
            yield f"map of {name} and reason_sl disagree in {wrong} pixels on what is decoded"
        least = 0.0 if name.startswith("sigma") else -0.5  # A pixel is a square around its centre.
        lowest = image[np.isfinite(image)].min(initial=least)
        if lowest < least:
            yield f"map of {name} has the value {lowest}, under {least}"


def _flow_problems(files: SceneFolder, number: int, facts: records.RawFacts) -> Iterator[str]:
    folder = files.path / of_sensor(FLOW, files.sensor)
    there = len(list(folder.glob(f"{number:06d}_*.png")))
    if there != facts.flow:
        yield f"{folder.name}/ has {there} files, and manifest.json states {facts.flow}"
        return
    if not facts.flow:
        return
    if facts.motion is None or facts.flow != sum(map(len, facts.motion.start_s)):
        yield f"{folder.name}/ has {there} files, and manifest.json has the times of other pictures"
        return
    times = zip(facts.motion.start_s, facts.motion.exposure_s, strict=True)
    has_depth = files.png("depth", number) > 0
    middle_s = np.concatenate([np.array(start_s) + long_s / 2 for start_s, long_s in times])
    for picture in range(facts.flow):
        flow_px = read_flow(files.path, picture, sensor=files.sensor, number=number)
        name = flow_name(picture, sensor=files.sensor, number=number)
        if flow_px.shape[:2] != has_depth.shape:
            yield f"{name} is {flow_px.shape[:2]}, the camera has {has_depth.shape}"
        elif np.isnan(flow_px[has_depth]).any():
            yield f"{name} has no flow in pixels with a depth"
        elif picture == np.abs(middle_s).argmin() and np.nanmax(np.abs(flow_px), initial=0.0) > 0:
            yield f"{name} is not 0, and it is the picture of the ground truth"
