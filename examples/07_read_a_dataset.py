"""Read a dataset: its pictures, masks and poses as arrays, and the scanner's errors.

`graycast.open_examples` reads datasets, and also all exports of `graycast dataset export`.

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
        depth_m, true_m, masks = example.scanner_depth_m, example.depth_m, example.mask
        obj_id, instance, visible = example.obj_id, example.instance, example.visib_fract
        # A field is None if the dataset lacks it; datasets from Graycast have all fields.
        assert depth_m is not None and true_m is not None and masks is not None
        assert obj_id is not None and instance is not None and visible is not None
        for i, mask in enumerate(masks):
            error_mm = 1000 * (depth_m[mask] - true_m[mask])
            missing = np.isnan(error_mm)
            error = "-" if missing.all() else f"{np.nanmedian(np.abs(error_mm)):.2f} mm"
            name = examples.categories[int(obj_id[i])]
            print(
                f"{example.scene_id:5} {instance[i]:9}  {name:20}  "
                f"{visible[i]:7.0%} {missing.mean():14.0%} {error:>13}"
            )


if __name__ == "__main__":
    if len(sys.argv) != 2:
        raise SystemExit("give the folder of a dataset, as the line at the top of this file shows")
    main(Path(sys.argv[1]))
