"""Reading a dataset: its pictures, masks and poses as arrays, and the scanner's errors.

`graycast.open_examples` reads datasets and all that `graycast dataset export` makes of them alike.

Run after `make demo`: .venv/bin/python examples/07_read_a_dataset.py out/demo
"""

import sys
from pathlib import Path

import numpy as np

import graycast


def main(folder: Path) -> None:
    examples = graycast.open_examples(folder)
    print(f"{folder}: {len(examples)} scenes of {', '.join(examples.categories.values())}")
    print("scene  instance  part                  visible  without depth  median error")
    for example in examples:
        for i, mask in enumerate(example.mask):
            error_mm = 1000 * (example.scanner_depth_m[mask] - example.depth_m[mask])
            missing = np.isnan(error_mm)
            error = "-" if missing.all() else f"{np.nanmedian(np.abs(error_mm)):.2f} mm"
            name = examples.categories[int(example.obj_id[i])]
            print(
                f"{example.scene_id:5} {example.instance[i]:9}  {name:20}  "
                f"{example.visib_fract[i]:7.0%} {missing.mean():14.0%} {error:>13}"
            )


if __name__ == "__main__":
    if len(sys.argv) != 2:
        raise SystemExit("give the folder of a dataset, as the line at the top of this file shows")
    main(Path(sys.argv[1]))
