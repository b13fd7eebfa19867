"""The page's files for one scene: a script with its maps and figures, and thumbnails.

Captured frames and decoded projector positions, which not every dataset has, are in separate
scripts that the page loads on demand.
"""

import math
from collections.abc import Iterator, Mapping
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float32, UInt8, UInt16

from ....base.color import srgb_of_bytes
from ....base.errors import DatasetError
from ....camera.decode import REASON_COLOR
from ....camera.picture import srgb_frame
from ....dataset.files.safe_reading import Unreadable
from ....dataset.files.sample import Raw
from ....dataset.read.scene_content import NO_REASON, SceneContent
from ....dataset.stats import SceneFigures
from ....dataset.write.raw import read_capture, read_code_maps
from .packing import (
    jpeg,
    jpeg_url,
    pack_bytes,
    pack_difference,
    pack_words,
    palette_picture,
    receiving,
    shrunk,
)

THUMB_PX = 288
_THUMB_QUALITY, _FRAME_QUALITY, _PICTURE_QUALITY = 80, 85, 90
_STEPS = 65534  # largest number of steps in 16 bits; they begin at 1, because 0 means missing
MISSING_COLOR = "#555b6e"


def scene_page_files(
    scene: SceneContent, figures: SceneFigures, *, width_px: int
) -> Iterator[tuple[str, bytes]]:
    """Yield every file of one scene as (name, content).

    Args:
        width_px: maps that are wider are thinned: only every second, third, ... pixel is kept in
            both directions. Pictures are averaged.

    Raises:
        DatasetError: a captured frame or a code map is missing or damaged.
    """
    stored = scene.stored
    try:
        raw = read_capture(stored.folder, sensor=stored.sensor, number=stored.image)
        code_maps = read_code_maps(stored.folder, sensor=stored.sensor, number=stored.image)
    except Unreadable as error:
        raise DatasetError(f"{stored.folder}: {error}: run graycast validate") from error
    stride = -(-scene.reason.shape[1] // width_px)
    yield "thumb.jpg", jpeg(shrunk(_color(scene), THUMB_PX), _THUMB_QUALITY)
    if scene.gray is not None:
        thumb = shrunk(srgb_of_bytes(scene.gray), THUMB_PX)
        yield "white.jpg", jpeg(thumb, _THUMB_QUALITY)
    yield "reason.png", _reason_thumb(scene)
    yield "scene.js", receiving(_content(scene, raw, code_maps, stride=stride))
    if raw is not None:
        yield "frames.js", receiving(frames_script(f"{stored.key}/frames.js", raw, stride))
    if code_maps:
        yield "columns.js", receiving(columns_script(f"{stored.key}/columns.js", code_maps, stride))
    yield "figures.json", figures.model_dump_json().encode()


def frames_script(name: str, raw: Raw, stride: int) -> dict[str, Any]:
    """Return all captured frames as JPEG data URLs in 8-bit sRGB.

    The sensor's offset is shown as 0, and its saturation in the reference exposure as 255.

    Raises:
        ValueError: no picture was captured.
    """
    sensor, capture = raw.scanner.sensor, raw.capture
    if capture is None:
        raise ValueError("no picture was captured")
    width_px = -(-capture.frames.shape[2] // stride)
    pictures = [
        jpeg_url(shrunk(srgb_frame(capture, k), width_px), _FRAME_QUALITY)
        for k in range(len(capture.frames))
    ]
    return {
        "key": name,
        "pictures": pictures,
        "bits": sensor.bit_depth,
        "low_dn": float(sensor.offset_dn),
        "high_dn": float(sensor.saturation_dn),
        "merged": isinstance(capture.exposure_s, np.ndarray),
    }


def columns_script(
    name: str, code_maps: Mapping[str, Float32[np.ndarray, "h w"]], stride: int
) -> dict[str, Any]:
    """Return positions and sigmas as numbers of steps (a power of 2 in px); 0 means missing."""
    return {
        "key": name,
        "maps": {axis: _packed(image[::stride, ::stride]) for axis, image in code_maps.items()},
    }


def _packed(image: Float32[np.ndarray, "h w"]) -> dict[str, Any]:
    known = np.isfinite(image)
    low = float(np.floor(image[known].min(initial=0.0)))
    span = float(image[known].max(initial=0.0)) - low
    step = 2.0 ** math.ceil(math.log2(max(span, 2.0**-8) / (_STEPS - 1)))
    steps = np.rint((np.where(known, image, low).astype(np.float64) - low) / step) + 1
    return {
        "words": pack_words(np.where(known, steps, 0).astype(np.uint16), noisy=True),
        "low": low,
        "step": step,
    }


def _content(
    scene: SceneContent,
    raw: Raw | None,
    code_maps: Mapping[str, Float32[np.ndarray, "_ _"]],
    *,
    stride: int,
) -> dict[str, Any]:
    frames = () if raw is None else raw.scanner.light_code().frames
    thin = np.s_[::stride, ::stride]
    depth = _map(scene.depth, scene.reason.shape)[thin]
    scanner = _map(scene.scanner, scene.reason.shape)[thin]
    height_px, width_px = depth.shape
    maps = {
        "depth": pack_words(depth),
        "scanner": pack_difference(scanner, depth),
        "reason": pack_bytes(np.where(scanner > 0, 0, scene.reason[thin]).astype(np.uint8)),
        "instance": pack_words((scene.label[thin] + 1).astype(np.uint16)),
    }
    pictures = {"rgb": jpeg_url(shrunk(_color(scene), width_px), _PICTURE_QUALITY)}
    if scene.gray is not None:
        white = shrunk(srgb_of_bytes(scene.gray), width_px)
        pictures["white"] = jpeg_url(white, _PICTURE_QUALITY)
    return {
        "key": scene.stored.key,
        "sensor": scene.stored.sensor,
        "stride": stride,
        "width": width_px,
        "height": height_px,
        "full": [scene.reason.shape[1], scene.reason.shape[0]],
        "depth_scale_mm": scene.depth_scale_mm,
        "has": {"depth": scene.depth is not None, "scanner": scene.scanner is not None},
        "kept": {"frames": [frame.name for frame in frames], "columns": list(code_maps)},
        "view": {**_DOWNWARDS, **scene.view},
        "instances": _instances(scene),
        "maps": maps,
        "pictures": pictures,
        "manifest": {k: v for k, v in scene.manifest.items() if k not in _LEFT_OUT},
    }


_LEFT_OUT = (
    "config",
    "reasons",
    "part_reasons",
    "frames",
    "code_maps",
    "sha256",
    "manifest_sha256",
)

# The camera pose of a real picture is unknown, so the camera looks straight down here.
_DOWNWARDS = {"cam_R_w2c": [1, 0, 0, 0, -1, 0, 0, 0, -1], "cam_t_w2c": [0, 0, 0]}


def _color(scene: SceneContent) -> UInt8[np.ndarray, "h w 3"]:
    """Return the colour picture, else the white frame, else black."""
    if scene.rgb is not None:
        return scene.rgb
    gray = np.zeros(scene.reason.shape, np.uint8) if scene.gray is None else scene.gray
    return np.repeat(srgb_of_bytes(gray)[..., None], 3, axis=2)


def _map(
    values: UInt16[np.ndarray, "h w"] | None, size: tuple[int, int]
) -> UInt16[np.ndarray, "h w"]:
    return np.zeros(size, dtype=np.uint16) if values is None else values.astype(np.uint16)


def _instances(scene: SceneContent) -> list[dict[str, Any]]:
    return [
        {
            "name": scene.stored.categories[one.obj_id],
            "obj_id": one.obj_id,
            "visible": one.visib_fract,
            "area": one.area_px,
            "box": one.box,
            "amodal": one.amodal_box,
            "t": one.position_mm,
            "box3d": one.box3d,
        }
        for one in scene.instances
    ]


def _reason_thumb(scene: SceneContent) -> bytes:
    """Return a subsampled thumbnail of reasons; a mean colour could mean another reason."""
    stride = max(-(-scene.reason.shape[1] // THUMB_PX), 1)
    names = {**scene.reason_name, NO_REASON: "missing"}
    colors = {number: REASON_COLOR.get(name, MISSING_COLOR) for number, name in names.items()}
    picture = palette_picture(scene.reason[::stride, ::stride], colors)
    return cv2.imencode(".png", np.ascontiguousarray(picture[..., ::-1]))[1].tobytes()
