"""Results that a dataset may store in addition: captured pictures, code maps, and flow.

The pictures are in a scene's `frames/` as the sensor stored them, with the files that `graycast rig
decode` needs: `stack.yaml` describes each picture and how to decode it, and `rig.yaml` describes
the scanner. Decoding reproduces `depth_sl`, except where a filter compares with sigma: sigma
depends on the exposure (through speckle) and on the renderer's sampling noise, and neither is
stored with the pictures.
"""

import io
import warnings
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from jaxtyping import Float32, UInt8, UInt16
from PIL import Image, UnidentifiedImageError

from ...base.errors import ConfigError
from ...base.file_limits import refuse_large_picture
from ...camera.sensor import Capture
from ...rig.pattern import AXES
from ..files import records
from ..files.safe_reading import Unreadable, read_json, read_png, record_as
from ..files.scene_folder import of_sensor
from ..files.seal import facts_of
from .flow import flow_files

if TYPE_CHECKING:  # Most scenes have no such files, and a check must not wait for these packages.
    from ..files.sample import Raw

_THREADS = 4  # PNG decoding releases the GIL.
FRAMES = "frames"
STACK, RIG, EXPOSURE = "stack.yaml", "rig.yaml", "exposure.png"  # They are in the pictures' folder.
# Noise hardly compresses: these settings take half the time of zlib's own and give smaller files.
_NOISY_PNG = [
    cv2.IMWRITE_PNG_COMPRESSION,
    1,
    cv2.IMWRITE_PNG_STRATEGY,
    cv2.IMWRITE_PNG_STRATEGY_RLE,
]


def raw_files(raw: "Raw", *, sensor: str = "", number: int = 0) -> Iterator[tuple[str, bytes]]:
    """Yield each file as (path in the scene's folder, content); equal values give equal files."""
    if raw.capture is not None:
        yield from _frame_files(raw, raw.capture, frames_folder(sensor, number))
    if raw.flow_px is not None:
        yield from flow_files(raw.flow_px, sensor=sensor, number=number)
    if raw.codes is not None:
        for name in raw.code_maps:
            image = getattr(raw.codes, name)
            folder = of_sensor(_folder(name), sensor)
            yield f"{folder}/{number:06d}.tiff", _tiff(image.astype(np.float32))


def raw_facts(raw: "Raw") -> dict[str, Any]:
    """Return the entries about these files for a scene's manifest."""
    from ...camera.stack import describe_frames

    facts: dict[str, Any] = {}
    if raw.capture is not None:
        facts["frames"] = {
            "bit_depth": raw.scanner.sensor.bit_depth,
            "exposures_s": np.unique(raw.capture.exposure_s).astype(np.float64),
            "shown": describe_frames(raw.scanner.light_code(), _names(raw.capture)),
        }
    if raw.codes is not None:
        facts["code_maps"] = [_folder(name) for name in raw.code_maps]
    if raw.flow_px is not None:
        facts["flow"] = len(raw.flow_px)
    return facts


def frames_folder(sensor: str, number: int) -> str:
    """Return the folder of an image's pictures: `frames`, then `frames_000001` and so on."""
    return of_sensor(FRAMES, sensor) + (f"_{number:06d}" if number else "")


def _frame_files(raw: "Raw", capture: Capture, folder: str) -> Iterator[tuple[str, bytes]]:
    from ...camera.rig_file import scanner_text
    from ...camera.stack import describe_stack

    names = _names(capture)
    for name, image in zip(names, capture.frames, strict=True):
        yield f"{folder}/{name}", _png(image)
    if isinstance(capture.exposure_s, np.ndarray):
        index = np.unique(capture.exposure_s, return_inverse=True)[1]
        yield f"{folder}/{EXPOSURE}", _png(index.reshape(capture.exposure_s.shape).astype(np.uint8))
    yield f"{folder}/{STACK}", describe_stack(raw.scanner, names, rig=RIG).encode()
    yield f"{folder}/{RIG}", scanner_text(raw.scanner).encode()


def _names(capture: Capture) -> list[str]:
    return [f"{k:04d}.png" for k in range(len(capture.frames))]


def _folder(name: str) -> str:
    """Return the folder of a code map: `column_sigma_sl` for `sigma_column`."""
    return "_".join(reversed(name.split("_"))) + "_sl"


def _png(image: UInt8[np.ndarray, "h w"] | UInt16[np.ndarray, "h w"]) -> bytes:
    return cv2.imencode(".png", image, _NOISY_PNG)[1].tobytes()


def _tiff(image: Float32[np.ndarray, "h w"]) -> bytes:
    """Return a deflated TIFF that stores differences of neighbouring numbers (predictor 3)."""
    file = io.BytesIO()
    Image.fromarray(image).save(
        file, "TIFF", compression="tiff_adobe_deflate", tiffinfo={_PREDICTOR: _FLOATING_POINT}
    )
    return file.getvalue()


_PREDICTOR, _FLOATING_POINT = 317, 3  # These are the tag and the value of TIFF Technical Note 3.


# --- reading -----------------------------------------------------------------------------------


def read_capture(scene: Path, *, sensor: str = "", number: int = 0) -> "Raw | None":
    """Return the captured pictures of an image and their scanner; None if they are not stored.

    Raises:
        Unreadable: a file is missing or damaged, or the files do not fit together.
    """
    facts = raw_facts_of(scene, sensor=sensor, number=number)
    record = facts.frames
    if record is None:
        return None
    from ...camera.rig_file import load_scanner
    from ..files.sample import Raw

    name = frames_folder(sensor, number)
    folder = scene / name
    with ThreadPoolExecutor(_THREADS) as pool:
        images = list(pool.map(read_png, [folder / shown.file for shown in record.shown]))
    exposure_s: float | Float32[np.ndarray, "h w"] = record.exposures_s[0]
    if len(record.exposures_s) > 1:
        index = read_png(folder / EXPOSURE)
        if index.max() >= len(record.exposures_s):
            raise Unreadable(f"{name}/{EXPOSURE} numbers more exposures than manifest.json")
        exposure_s = np.array(record.exposures_s, dtype=np.float32)[index]
    try:
        scanner = load_scanner(folder / RIG)
        capture = Capture(
            frames=np.stack(images),
            sensor=scanner.sensor,
            exposure_s=exposure_s,
            reference_s=facts.exposure_s,
        )
        return Raw(scanner=scanner, capture=capture)
    except (ConfigError, ValueError) as error:
        raise Unreadable(f"{name}: {error}") from error


def read_code_maps(
    scene: Path, *, sensor: str = "", number: int = 0
) -> Mapping[str, Float32[np.ndarray, "h w"]]:
    """Return projector positions and their standard deviations, by the field names of `CodeMap`.

    Raises:
        Unreadable: a file is missing or damaged.
    """
    names = [name for axis in AXES for name in (axis, f"sigma_{axis}")]
    there = raw_facts_of(scene, sensor=sensor, number=number).code_maps
    return {
        name: _read_tiff(scene / of_sensor(_folder(name), sensor) / f"{number:06d}.tiff")
        for name in names
        if _folder(name) in there
    }


def raw_facts_of(scene: Path, *, sensor: str = "", number: int = 0) -> records.RawFacts:
    """Return a manifest's entries about an image's frames and code maps; empty without a manifest.

    Raises:
        Unreadable: the manifest is damaged.
    """
    path = scene / "manifest.json"
    if not path.exists():
        return records.RawFacts()
    manifest = read_json(path, records.Manifest)
    return record_as(facts_of(manifest, sensor, number), records.RawFacts, "manifest.json")


def _read_tiff(path: Path) -> Float32[np.ndarray, "h w"]:
    name = f"{path.parent.name}/{path.name}"
    try:
        refuse_large_picture(path, name, Unreadable)
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # Pillow only warns of a truncated tag table.
            with Image.open(path) as image:
                values = np.array(image)
    except FileNotFoundError as error:
        raise Unreadable(f"{name} is missing") from error
    except (UnidentifiedImageError, OSError, SyntaxError, ValueError, UserWarning) as error:
        raise Unreadable(f"{name} is cut off or damaged") from error
    if values.dtype != np.float32 or values.ndim != 2:
        raise Unreadable(f"{name} is {values.shape} {values.dtype}, it must be float32")
    return values
