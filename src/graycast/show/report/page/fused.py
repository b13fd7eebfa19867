"""The fused cloud of a scene's pictures for the page, as one script that all of them bring in."""

import base64
from typing import Any

import numpy as np

from ....dataset.stored import StoredDataset, StoredScene
from ....score.merge import FusedCloud, fuse, read_view
from .scene_files import receiving

FUSED = "fused.js"
_STEPS = 65535  # The longest side of the cloud has this many steps, which 16 bits can count.
_MOST = 400000  # A browser draws this many points smoothly.
_SIGMA_STEP_MM = 0.002  # In 8 bits, steps of this size reach half a millimetre.


def fused_script(stored: StoredDataset, first: StoredScene) -> bytes:
    """The cloud of all pictures of a scene, under the key of the first.

    Raises:
        DatasetError: a file is missing or damaged.
    """
    shots = stored.images_of(first)
    fused = fuse([read_view(stored, shot).view for shot in shots])
    stride = -(-len(fused.cloud.views) // _MOST)
    content = {"key": f"{first.key}/{FUSED}", "names": [shot.image_name for shot in shots]}
    return receiving(content | _packed(fused.cloud, max(stride, 1)))


def _packed(cloud: FusedCloud, stride: int) -> dict[str, Any]:
    """Places [mm, world] as steps of 16 bits from a corner; a byte each of what else is known."""
    place_mm = 1000 * cloud.point_m[::stride]
    low = place_mm.min(axis=0) if len(place_mm) else np.zeros(3)
    step = float(max((place_mm - low).max(initial=0.0), 1.0) / _STEPS)
    sigma = np.rint(1000 * cloud.sigma_m[::stride] / _SIGMA_STEP_MM).clip(0, 255)
    normal = np.rint(127 * cloud.normal[::stride]).astype(np.int8)
    return {
        "count": len(place_mm),
        "low": low.tolist(),
        "step": step,
        "sigma_step_mm": _SIGMA_STEP_MM,
        "place": _text(np.rint((place_mm - low) / step).astype("<u2")),
        "normal": _text(normal),
        "color": _text(cloud.color[::stride]),
        "sigma": _text(sigma.astype(np.uint8)),
        "views": _text(cloud.views[::stride]),
        "view": _text(cloud.view[::stride]),
        "first": _text(cloud.first_reason[::stride]),
    }


def _text(array: np.ndarray) -> str:
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode()
