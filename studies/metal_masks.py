"""Masks of three surfaces of the real metal stack, for docs/measurements/reenactment.md.

python -m studies.metal_masks out/metal

The rectangles were drawn by hand on the white picture of `xema_metal` (700 x 242 px).
"""

import argparse
from pathlib import Path

import cv2
import numpy as np

WIDTH_PX, HEIGHT_PX = 700, 242
# Rectangles: left, right, top, bottom [px]. The rail is inside the frame.
AREAS = {
    "plate": [(174, 380, 49, 242)],
    "frame": [(76, 174, 52, 242), (380, 532, 48, 208)],
    "rail": [(93, 172, 108, 242), (388, 484, 108, 208)],
}


def main() -> None:
    """Write a mask as PNG for each surface."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path, help="The folder of the masks.")
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    masks = {name: np.zeros((HEIGHT_PX, WIDTH_PX), dtype=np.uint8) for name in AREAS}
    for name, areas in AREAS.items():
        for left, right, top, bottom in areas:
            masks[name][top:bottom, left:right] = 255
    masks["frame"][masks["rail"] > 0] = 0
    for name, mask in masks.items():
        cv2.imwrite(str(out / f"{name}.png"), mask)
        print(out / f"{name}.png")


if __name__ == "__main__":
    main()
