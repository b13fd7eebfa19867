"""`graycast.json`: the configuration that a dataset folder belongs to."""

import hashlib
import json
import math
import platform
from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass, fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import BaseModel

from ...base.errors import DatasetError
from ...base.file_limits import parse_json
from ...base.version import __version__
from ...rig.former_names import with_current_names
from ...rig.optics import Optics
from ...rig.pair import Rig
from ..files.json_text import plain
from ..files.records import FORMAT_VERSION
from ..files.seal import SUMS

if TYPE_CHECKING:  # A check reads claims, and must not wait for the packages that make parts.
    from ...world.parts import Part

BESIDE_CONFIG = ("files", "scanner")  # A claim has these in addition to the configuration's keys.
_BESIDE = ("fingerprint", "sources", "versions", SUMS)  # The fingerprint does not cover these.
_CLAIMED = (
    "format_version",
    "seed",
    "depth_scale_mm",
    "rig",
    "parts",
    "distractors",
    "scanners",
    "config",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Taker:
    """One scanner of a dataset: its name, its number of images per scene, its rig and settings.

    `scanning` holds the settings that a dataset with one scanner stores as `config.scanner`.
    """

    name: str
    images: int
    rig: Rig
    scanning: Mapping[str, Any]


def make_claim(
    config: Mapping[str, Any],
    seed: int,
    parts: "tuple[Part, ...]",
    rig: Rig,
    depth_scale_mm: float,
    takers: tuple[Taker, ...] = (),
) -> dict[str, Any]:
    """Return the content of `graycast.json`; the fingerprint excludes versions and sources.

    Give `takers` if a scene has several images or a scanner has a name.
    """
    known = [part for part in parts if part.labelled]
    described = [
        {"obj_id": obj_id, "name": part.name, "content": part_digest(part)}
        for obj_id, part in enumerate(known, start=1)
    ]
    distractors = [
        {"name": part.name, "content": part_digest(part)} for part in parts if not part.labelled
    ]
    scanners = [
        {
            "name": taker.name,
            "images": taker.images,
            "rig": described_values(taker.rig),
            "scanner": taker.scanning,
        }
        for taker in takers
    ]
    claim = plain(
        {
            "format_version": FORMAT_VERSION,
            "config": config,
            "seed": seed,
            "depth_scale_mm": depth_scale_mm,
            "rig": described_values(rig),
            "parts": described,
        }
        | ({"distractors": distractors} if distractors else {})
        | ({"scanners": scanners} if scanners else {})
    )
    versions = {
        "graycast": __version__,
        "numpy": np.__version__,
        "python": platform.python_version(),
    }
    return claim | {
        "fingerprint": fingerprint(claim),
        "sources": [part.source for part in known],
        "versions": versions,
    }


def fingerprint(claim: Mapping[str, Any]) -> str:
    """Return the SHA-256 of everything that determines the contents of a dataset."""
    content = {key: value for key, value in claim.items() if key not in _BESIDE}
    text = json.dumps(content, sort_keys=True, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def described_values(value: Any) -> dict[str, Any]:
    """Return a frozen dataclass's fields as JSON values; infinity becomes the word 'inf'."""

    def worded(item: Any) -> Any:
        if isinstance(item, dict):
            return {key: worded(inner) for key, inner in item.items()}
        return "inf" if isinstance(item, float) and math.isinf(item) else item

    return worded(asdict(value))


def claimed_options(options: Any, *, without: Collection[str]) -> dict[str, Any]:
    """Return the fields of an options dataclass by name, as JSON values for a claim.

    A field that is added to the dataclass later enters the claim automatically.

    Args:
        without: fields that do not change a result, or that the claim stores in another form.

    Raises:
        ValueError: `without` contains a name that is not a field, for instance a former name.
    """
    names = [field.name for field in fields(options)]
    if unknown := sorted(set(without) - set(names)):
        raise ValueError(f"{type(options).__name__} has no field {unknown[0]}: correct the list")
    return {name: _as_json(getattr(options, name)) for name in names if name not in without}


def _as_json(value: Any) -> Any:
    if isinstance(value, BaseModel):
        return value.model_dump(mode="json")
    return plain(described_values(value) if is_dataclass(value) else value)


def rig_of(described: Mapping[str, Any]) -> Rig:
    """Return the rig that `described_values` wrote.

    Raises:
        KeyError, TypeError, ValueError: `described` is not a rig.
    """
    values = _unworded(described)
    lenses = {name: Optics(**values.pop(name)) for name in ("camera", "projector")}
    return Rig(**values | lenses | {"T_cam_proj": np.array(values["T_cam_proj"], dtype=np.float64)})


def camera_json(camera: Optics, scale_mm: float) -> dict[str, Any]:
    """Return the content of `camera.json`, with OpenCV's five coefficients if the lens distorts."""
    return {
        "cx": camera.cx_px,
        "cy": camera.cy_px,
        "depth_scale": scale_mm,
        "fx": camera.fx_px,
        "fy": camera.fy_px,
        "height": camera.height_px,
        "width": camera.width_px,
    } | distortion_json(camera)


def distortion_json(camera: Optics) -> dict[str, Any]:
    """Return the lens distortion, under a key that BOP does not define; empty for an ideal lens."""
    return {"distortion": list(camera.distortion)} if camera.has_distortion else {}


def _unworded(item: Any) -> Any:
    """Turn lists into tuples, and the word 'inf' into infinity."""
    if isinstance(item, Mapping):
        return {key: _unworded(inner) for key, inner in item.items()}
    if isinstance(item, list):
        return tuple(map(_unworded, item))
    return math.inf if item == "inf" else item


def part_digest(part: "Part") -> str:
    """Return the SHA-256 of a part's shape, material, density, friction and symmetries."""
    digest = hashlib.sha256()
    mesh, material = part.mesh, part.material
    for array in (mesh.vertices_m, mesh.faces, mesh.corner_uv, mesh.corner_normals):
        digest.update(b"none" if array is None else np.ascontiguousarray(array).tobytes())
    if material.texture is not None:
        digest.update(np.ascontiguousarray(material.texture).tobytes())
    look: tuple[object, ...] = (
        material.base_color,
        material.metallic,
        material.roughness,
        material.specular,
        material.projector_reflectance,
    )
    if (grain := material.grooves) is not None:
        look += (material.anisotropy, asdict(grain))
    if material.transparent is not None:
        look += (material.transparent, material.color_depth_m)
    if material.film is not None:
        look += ("film", material.film)
    if material.diffuse > 0:
        look += ("diffuse", material.diffuse)
    if material.mottle > 0:
        look += ("mottle", material.mottle, material.mottle_length_m)
    if (roughness_map := material.roughness_map) is not None:
        content = hashlib.sha256(np.ascontiguousarray(roughness_map).tobytes()).hexdigest()
        look += ("roughness_map", roughness_map.shape, content)
    discrete = [T.tolist() for T in part.symmetry.discrete]
    body = (part.density_kg_m3, part.friction, discrete, part.symmetry.continuous)
    digest.update(json.dumps(plain([look, body])).encode())
    return digest.hexdigest()


def refuse_other(path: Path, claim: Mapping[str, Any]) -> None:
    """Refuse a folder whose `graycast.json` differs from the one that this run would write.

    Raises:
        DatasetError: the file is damaged or its configuration differs; the text names the place.
    """
    try:
        content = parse_json(path.read_bytes())
        known = content["fingerprint"]
    except (ValueError, KeyError, TypeError) as error:
        raise DatasetError(f"{path} cannot be read ({error}): choose another folder") from error
    if known != claim["fingerprint"] and not _same_by_current_names(content, claim):
        where = next(
            (
                place
                for key in _CLAIMED
                if (place := difference(content.get(key), claim.get(key), key)) is not None
            ),
            "the fingerprint",
        )
        raise DatasetError(
            f"{path.parent} holds a dataset of another configuration, which differs in {where}: "
            "choose another folder, or remove this one"
        )


def _same_by_current_names(content: Mapping[str, Any], claim: Mapping[str, Any]) -> bool:
    """Return whether the stored claim is unmodified and differs only in former names of rigs."""
    if content["fingerprint"] != fingerprint(content):
        return False
    one, other = (parse_json(with_current_names(json.dumps(c))) for c in (content, claim))
    return fingerprint(one) == fingerprint(other)


def difference(a: Any, b: Any, where: str) -> str | None:
    """Return the first difference of two JSON values as `key.key[index]` with both values."""
    if a == b:
        return None
    if isinstance(a, dict) and isinstance(b, dict):
        pairs = ((a.get(key), b.get(key), f"{where}.{key}") for key in sorted({*a, *b}))
    elif isinstance(a, list) and isinstance(b, list) and len(a) == len(b):
        pairs = ((x, y, f"{where}[{i}]") for i, (x, y) in enumerate(zip(a, b, strict=True)))
    else:
        return f"{where} ({_short(a)} there, {_short(b)} here)"
    return next((place for x, y, key in pairs if (place := difference(x, y, key))), where)


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 40 else text[:37] + "..."
