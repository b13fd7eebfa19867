"""Empty a bin with the program of a robot cell whose scanner is not delivered yet.

For a real scanner, change the three lines marked `device` to the maker's class, as their comments
say. The line marked `robot` stands for a robot that grips, and `segment` for your detector. The
program does not use the truth (`scanner.truth()`).

Run: .venv/bin/python examples/10_virtual_scanner.py
"""

import sys

import cv2
import numpy as np
from scipy import ndimage

import graycast as gc

FLOOR_M, WALL_M, STEP_M = 0.008, 0.004, 0.006  # what belongs to the bin; a step between parts
LEAST_PX, LEAST_SCORE = 150, 0.75


def segment(depth_m, points_world, inner_m) -> list:
    """Return masks of connected pixels above the floor without steps; your detector goes here."""
    half_m = np.array(inner_m[:2]) / 2 - WALL_M
    filled = np.nan_to_num(depth_m)
    smooth = ndimage.maximum_filter(filled, 3) - ndimage.minimum_filter(filled, 3) < STEP_M
    inside = (np.abs(points_world[..., :2]) < half_m).all(axis=-1)  # False for NaN
    part = inside & smooth & (points_world[..., 2] > FLOOR_M)
    count, label = cv2.connectedComponents(part.astype(np.uint8))
    masks = (label == k for k in range(1, count))  # 0 is the rest of the picture.
    return [mask for mask in masks if mask.sum() >= LEAST_PX]


def main(count: int, samples: int) -> None:
    config = gc.Config(
        parts=(gc.PartSection(builtin="yellow_salt_cube"),),
        count=count,
        rig="like-phoxi-m",
        resolution="small",
        render=gc.RenderSection(samples=samples),
    )
    part = gc.builtin_part("yellow_salt_cube")
    model = gc.pose_model(part.mesh, part.symmetry)
    with gc.VirtualScanner(config, seed=1) as scanner:  # device: Camera().connect("192.168.1.10")
        scanner.set("exposure.auto", True)  # device: its own name of the same setting
        T_world_cam = scanner.T_world_cam  # your hand-eye calibration
        lifted, misses, seconds = 0, 0, 0.0
        while misses < 3:
            frame = scanner.trigger()  # device: camera.capture(), and its depth and intrinsics
            seconds += frame.duration_s
            points_world = frame.points @ T_world_cam[:3, :3].T + T_world_cam[:3, 3]
            masks = segment(frame.depth_m, points_world, config.bin.inner_m)
            if not masks:
                break
            matches = gc.find_poses(model, frame.depth_m, frame.camera, masks)
            poses = [T_world_cam @ m.T_cam_part for m in matches if m.score > LEAST_SCORE]
            top = max(poses, key=lambda T_world_part: T_world_part[2, 3], default=None)
            if top is not None and scanner.bin.lift_at(top[:3, 3]) is not None:  # robot: grip, lift
                lifted, misses = lifted + 1, 0
                print(f"frame {frame.index}: lifted a part at {np.round(top[:3, 3], 3)} m")
                continue
            misses += 1
            scanner.bin.nudge()
        print(f"{lifted} of {count} parts in {seconds:.1f} s of scanning")


if __name__ == "__main__":
    arguments = [int(word) for word in sys.argv[1:]]
    main(*(arguments or [8, 16]))
