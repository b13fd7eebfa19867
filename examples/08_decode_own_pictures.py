"""Decode pictures that a real camera took of a real projector's patterns to depth and a cloud.

`graycast rig patterns --codec gray_phase` writes the patterns. The pictures are in one folder;
sorted by name, they must be in the order of the patterns. The rig file comes from a calibration.

Run: .venv/bin/python examples/08_decode_own_pictures.py pictures/ rig.yaml out/cloud.ply
"""

import sys
from pathlib import Path

import numpy as np

import graycast
from graycast.camera.stack import describe_code, write_ply


def main(pictures: Path, rig_file: Path, cloud: Path) -> None:
    rig = graycast.load_scanner(rig_file).rig
    spec = graycast.CodeSpec(codec="gray_phase", axes=("column",))
    code = spec.code(rig.projector.width_px, rig.projector.height_px)
    names = sorted(file.name for file in pictures.glob("*.png"))
    if len(names) != len(code.frames):
        raise SystemExit(f"{pictures} has {len(names)} PNGs, the code {len(code.frames)} frames")

    description = pictures / "stack.yaml"
    description.write_text(describe_code(code, names), encoding="utf-8")
    result = graycast.decode_stack(description, rig)
    # Without a rig, there would be neither depth nor a cloud.
    assert result.depth is not None and result.cloud is not None

    for warning in result.warnings:
        print(f"warning: {warning}")
    for reason in graycast.Reason:
        print(f"{reason.name.lower():18} {np.mean(result.depth.reason == reason):6.1%}")
    cloud.parent.mkdir(parents=True, exist_ok=True)
    write_ply(result.cloud, cloud)
    print(f"{cloud}: {len(result.cloud.point_m)} points")


if __name__ == "__main__":
    if len(sys.argv) != 4:
        raise SystemExit("give pictures, rig and cloud, as the line at the top of this file shows")
    main(*map(Path, sys.argv[1:4]))
