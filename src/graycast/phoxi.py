"""Scanners that are known by name, in numbers: the Photoneo PhoXi family, and the paper's own."""

from collections.abc import Mapping
from types import MappingProxyType

# fx at full resolution [px], baseline [m], toe-in of either device [deg], range [m]: figures of the
# Photoneo PhoXi family from secondary sources that agree; 2064 x 1544, low resolution halves it.
# Both devices are read as toed in: only then do the axes cross inside each stated range.
PHOXI = {
    "phoxi-s": (2246.0, 0.230, 15.45, 0.384, 0.520),
    "phoxi-m": (2269.0, 0.350, 11.75, 0.458, 1.118),
    "phoxi-l": (2263.0, 0.550, 9.45, 0.870, 2.150),
}
PROJECTOR_FIELD_DEG = (47.5, 36.0)
RED_LASER = (1.0, 0.0, 0.0)  # 637 nm lies in the red band

PRESETS = ("paper", *PHOXI)
# Sensor pixels across one pixel of the picture: a camera that sums squares of pixels is faster.
BINNING: Mapping[str, int] = MappingProxyType({"small": 4, "low": 2, "full": 1})
RESOLUTIONS = tuple(BINNING)
