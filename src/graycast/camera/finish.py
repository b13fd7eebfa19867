"""The finish of surfaces differs from patch to patch: noise is stronger here, weaker there.

In scans of a real bin and its parts, the amplitude of the depth noise differs between patches of
about 10 mm. It belongs to the surface: it is the same in every scan of a surface, and neither the
same pixel nor the same ray of the projector has it on another surface. Brightness does not explain
it (docs/measurements/twin.md).

Leaves out: patches that move with their surface, since a capture has patches of its own. Their size
in the picture is the same everywhere.
"""

import numpy as np
from jaxtyping import Float
from scipy import ndimage

from ..base.streams import CaptureStream, stream

# At this distance on a surface, the finish of two places has a correlation of 1/e. It was measured
# on five scans of one bin of plastic, the parts in it included.
PATCH_M = 0.010


def uneven(
    amplitude: Float[np.ndarray, "h w"], unevenness: float, *, patch_px: float, seed: int
) -> Float[np.ndarray, "h w"]:
    """An amplitude of noise, at most 1, on surfaces whose finish differs from patch to patch.

    It is multiplied by a field with a log-normal law, whose logarithm has the standard deviation
    `unevenness` and the correlation `exp(-(r / patch_px)^2)`. The mean square of the amplitude
    stays what it was, and so does the mean power of the noise.

    Args:
        patch_px: `PATCH_M` in the picture.
        seed: of the field.
    """
    rng = stream(seed, CaptureStream.FINISH)
    field = rng.standard_normal(amplitude.shape, dtype=np.float32)
    field = ndimage.gaussian_filter(field, patch_px / 2, mode="wrap")
    field *= unevenness / max(float(field.std()), 1e-9)
    return np.minimum(amplitude * np.exp(field - np.float32(unevenness**2)), np.float32(1))
