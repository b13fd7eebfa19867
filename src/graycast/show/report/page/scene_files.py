"""One scene as the page's files: a script with its maps, thumbnails, its figures."""

import json
from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np
from jaxtyping import UInt8, UInt16

from ....base.color import srgb_of_bytes
from ....camera.decode import REASON_COLOR
from ....dataset.scene_content import NO_REASON, SceneContent
from ....dataset.stats import SceneFigures
from .capture_pieces import Kept, columns_script, frames_script, read_kept
from .packing import (
    jpeg,
    jpeg_url,
    pack_bytes,
    pack_difference,
    pack_words,
    palette_picture,
    shrunk,
)

THUMB_PX = 288
_THUMB_QUALITY, _PICTURE_QUALITY = 80, 90
MISSING_COLOR = "#555b6e"


def reason_colors(names: dict[int, str]) -> dict[int, str]:
    """A colour per reason's number, by the palette of all pictures."""
    return {number: REASON_COLOR.get(name, MISSING_COLOR) for number, name in names.items()}


def scene_page_files(
    scene: SceneContent, figures: SceneFigures, *, width_px: int
) -> Iterator[tuple[str, bytes]]:
    """Every file of one scene as (name, content).

    Args:
        width_px: maps wider than this are thinned: every second, third, ... pixel in both
            directions keeps its own value; pictures are averaged.

    Raises:
        DatasetError: a captured frame or a code map is missing or damaged.
    """
    kept = read_kept(scene.stored)
    stride = -(-scene.reason.shape[1] // width_px)
    yield "thumb.jpg", jpeg(shrunk(_color(scene), THUMB_PX), _THUMB_QUALITY)
    if scene.gray is not None:
        thumb = shrunk(srgb_of_bytes(scene.gray), THUMB_PX)
        yield "white.jpg", jpeg(thumb, _THUMB_QUALITY)
    yield "reason.png", _reason_thumb(scene)
    yield "scene.js", receiving(_content(scene, kept, stride=stride))
    if kept.raw is not None:
        yield (
            "frames.js",
            receiving(frames_script(f"{scene.stored.key}/frames.js", kept.raw, stride)),
        )
    if kept.code_maps:
        name = f"{scene.stored.key}/columns.js"
        yield "columns.js", receiving(columns_script(name, kept.code_maps, stride))
    yield "figures.json", figures.model_dump_json().encode()


def receiving(content: dict[str, Any]) -> bytes:
    """A script that hands its content to the page."""
    text = json.dumps(content, allow_nan=False, separators=(",", ":"))
    return f"Graycast.receive({text});\n".encode()


def _content(scene: SceneContent, kept: Kept, *, stride: int) -> dict[str, Any]:
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
        "kept": {"frames": kept.frame_names, "columns": list(kept.code_maps)},
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

# The pose of the camera of a real picture is not known, so it looks straight down here.
_DOWNWARDS = {"cam_R_w2c": [1, 0, 0, 0, -1, 0, 0, 0, -1], "cam_t_w2c": [0, 0, 0]}


def _color(scene: SceneContent) -> UInt8[np.ndarray, "h w 3"]:
    """The colour picture, or in its place the white frame, or black."""
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
    """Not averaged: a mixture of two reasons would have a third one's colour."""
    stride = max(-(-scene.reason.shape[1] // THUMB_PX), 1)
    colors = reason_colors({**scene.reason_name, NO_REASON: "missing"})
    picture = palette_picture(scene.reason[::stride, ::stride], colors)
    return cv2.imencode(".png", np.ascontiguousarray(picture[..., ::-1]))[1].tobytes()
