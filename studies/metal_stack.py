"""The section on metal in docs/how-to/stacks.md: depth lost and errors removed by limits.

python -m studies.metal_stack ../shared/data/stacks/xema_metal

The stack shows machined metal with phases along both axes. The decoded rows check the columns: a
point is wrong if it is off its epipolar line by more than 2 px and three standard deviations.
The probability of a wrong depth is estimated from the columns alone, so that the rows can judge it.
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
from graycast.rig.pattern import AXES, Axis


def decoded(folder: Path, rig: Rig, settings: dict[str, float], axes: tuple[Axis, ...]):
    """Return the decoded stack with the given settings and only the frames of some axes."""
    content = yaml.safe_load((folder / "stack.yaml").read_text(encoding="utf-8"))
    content["frames"] = [f for f in content["frames"] if f.get("axis") in (None, *axes)]
    for frame in content["frames"]:
        frame["file"] = str((folder / frame["file"]).resolve())
    content["decode"] = {"max_epipolar_px": 0, **settings}
    with TemporaryDirectory() as aside:
        path = Path(aside) / "stack.yaml"
        path.write_text(yaml.safe_dump(content), encoding="utf-8")
        return decode_stack(path, rig)


def real(folder: Path, rig: Rig, setting: str, value: float) -> str:
    """Return decoded, saturated and wrong shares of the real stack as a line of text."""
    both = decoded(folder, rig, {} if setting == "max_p_wrong" else {setting: value}, AXES)
    alone = decoded(folder, rig, {setting: value}, AXES[:1]) if setting == "max_p_wrong" else both
    residual_px = epipolar_residual_px(both.codes, alone.depth, rig)
    known = np.isfinite(residual_px)
    wrong = off_the_line(both.codes, residual_px, rig, limit_px=2.0)[known]
    lit = both.codes.reason != Reason.SHADOW
    saturated = (both.codes.reason == Reason.SATURATED)[lit].mean()
    return (
        f"{setting} {value:g}: depth {100 * known[lit].mean():.1f} % of the lit "
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
        print(real(folder, rig, "max_p_wrong", max_p_wrong))


if __name__ == "__main__":
    main()
