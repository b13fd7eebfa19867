"""The section on metal in docs/how-to/stacks.md: depth lost and errors removed by limits.

python -m studies.metal_stack ../shared/data/stacks/xema_metal

The stack shows machined metal with phases along both axes. The decoded rows check the columns: a
point is wrong if it is off its epipolar line by more than 2 px and three standard deviations.
The probability of a wrong depth is estimated from the columns alone, so that the rows can check it,
with the rig and without.
"""

import argparse
from pathlib import Path

import numpy as np

from benchmarks.decoders import decode_with
from graycast.camera.decode import Reason, epipolar_residual_px, off_the_line, triangulate
from graycast.camera.rig_file import import_opencv
from graycast.rig.pair import Rig
from graycast.rig.pattern import AXES


def real(folder: Path, rig: Rig, setting: str, value: float, *, with_rig: bool = True) -> str:
    """Return decoded, saturated and wrong shares of the real stack as a line of text."""
    free, limited = {"max_epipolar_px": 0}, {"max_epipolar_px": 0, setting: value}
    both = decode_with(folder, rig, free if setting == "max_p_wrong" else limited)
    alone = both
    if setting == "max_p_wrong":
        alone = decode_with(folder, rig if with_rig else None, limited, AXES[:1])
    depth = alone.depth or triangulate(alone.codes, rig)
    residual_px = epipolar_residual_px(both.codes, depth, rig)
    known = np.isfinite(residual_px)
    wrong = off_the_line(both.codes, residual_px, rig, limit_px=2.0)[known]
    lit = both.codes.reason != Reason.SHADOW
    saturated = (both.codes.reason == Reason.SATURATED)[lit].mean()
    name = f"{setting} {value:g}" + ("" if with_rig else ", no rig")
    return (
        f"{name}: depth {100 * known[lit].mean():.1f} % of the lit "
        f"pixels, wrong {100 * wrong.mean():.3f} % of these, saturated {100 * saturated:.1f} %"
    )


def main() -> None:
    """Print the figures of the section."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="The folder of the real stack.")
    folder = parser.parse_args().folder
    rig = import_opencv(
        folder / "calibration.json",
        unit=None,
        near_m=None,
        far_m=None,
        camera_size_px=None,
        projector_size_px=None,
    )
    for min_visibility in (0.0, 0.3, 0.5, 0.6, 0.7):
        print(real(folder, rig, "min_visibility", min_visibility))
    for max_p_wrong in (0.5, 0.2, 0.1, 0.05, 0.02):
        for with_rig in (True, False):
            print(real(folder, rig, "max_p_wrong", max_p_wrong, with_rig=with_rig))


if __name__ == "__main__":
    main()
