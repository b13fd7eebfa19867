"""The section on metal in docs/how-to/stacks.md: points lost by guards, and errors removed.

python -m studies.metal_stack ../shared/data/stacks/xema_metal

The stack shows machined metal with phases along both axes. The decoded rows check the columns: a
point is wrong if it is off its epipolar line by more than 2 px and three standard deviations.
"""

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import yaml

from graycast.camera.decode import Reason, epipolar_residual_px, off_the_line
from graycast.camera.rig_file import import_opencv
from graycast.camera.stack import decode_stack
from graycast.rig.pair import Rig


def real(folder: Path, rig: Rig, min_visibility: float) -> str:
    """Return decoded, saturated and wrong shares of the real stack as a line of text."""
    content = yaml.safe_load((folder / "stack.yaml").read_text(encoding="utf-8"))
    for frame in content["frames"]:
        frame["file"] = str((folder / frame["file"]).resolve())
    content["decode"] = {"min_visibility": min_visibility, "max_epipolar_px": 0}
    with TemporaryDirectory() as aside:
        path = Path(aside) / "stack.yaml"
        path.write_text(yaml.safe_dump(content), encoding="utf-8")
        result = decode_stack(path, rig)
    assert result.depth is not None
    residual_px = epipolar_residual_px(result.codes, result.depth, rig)
    known = np.isfinite(residual_px)
    wrong = off_the_line(result.codes, residual_px, rig, limit_px=2.0)[known]
    lit = result.codes.reason != Reason.SHADOW
    saturated = (result.codes.reason == Reason.SATURATED)[lit].mean()
    return (
        f"min_visibility {min_visibility:g}: depth {100 * known[lit].mean():.1f} % of the lit "
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
        print(real(folder, rig, min_visibility))


if __name__ == "__main__":
    main()
