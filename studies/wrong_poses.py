"""Doubts that `fuse` reports for wrong poses, for docs/measurements/merge.md.

graycast generate configs/views.yaml --out out/views --scenes 1
python -m studies.wrong_poses out/views
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from graycast.base.frames import axis_rotation, inverse, rigid
from graycast.dataset.read.stored import open_dataset
from graycast.score.merge import fuse, read_view

SENSOR, WRONG = "gray", 2  # a scanner of configs/views.yaml, and the index of the changed view


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("dataset", type=Path)
    stored = open_dataset(parser.parse_args().dataset)
    shots = [shot for shot in stored.images_of(stored.scenes[0]) if shot.sensor == SENSOR]
    views = [read_view(stored, shot).view for shot in shots]
    right = views[WRONG].T_world_cam
    for error, T_world_cam in wrong_poses(right).items():
        views[WRONG] = replace(views[WRONG], T_world_cam=T_world_cam)
        print(f"{error}: {fuse(views).doubts}")
    return 0


def wrong_poses(T_world_cam: np.ndarray) -> dict[str, np.ndarray]:
    """Return the camera's pose with each of the table's errors."""

    def moved(*shift_m: float) -> np.ndarray:
        return T_world_cam @ rigid(np.eye(3), np.array(shift_m))

    def turned(axis: str, degrees: float) -> np.ndarray:
        return T_world_cam @ rigid(axis_rotation(axis, np.radians(degrees)), np.zeros(3))

    return {
        "none": T_world_cam,
        "1 mm along its axis": moved(0, 0, 1e-3),
        "5 mm sideways": moved(5e-3, 0, 0),
        "turned by 0.3 degrees": turned("x", 0.3),
        "inverted": inverse(T_world_cam),
        "opposite translation": rigid(T_world_cam[:3, :3], -T_world_cam[:3, 3]),
        "turned by 90 degrees": turned("z", 90),
    }


if __name__ == "__main__":
    raise SystemExit(main())
