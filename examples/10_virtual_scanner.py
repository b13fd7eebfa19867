"""Empty a bin with the program of a robot cell whose scanner is not delivered yet.

`empty_bin` is the user's program, for a simulated scanner or a bag of `graycast dataset export`.
For a real scanner, change the lines marked `device`. `segment` stands for your detector.

Run: .venv/bin/python examples/10_virtual_scanner.py [--bag out/cubes-bag/train]
"""

import argparse

import cv2
import numpy as np
from scipy import ndimage

import graycast as gc

FLOOR_M, WALL_M, STEP_M = 0.008, 0.004, 0.006  # what belongs to the bin; a step between parts
LEAST_PX, LEAST_SCORE = 150, 0.75


def segment(depth_m, points_world, inner_m) -> list:
    """Return masks of connected pixels above the floor without steps; your detector goes here."""
    half_m = np.array(inner_m[:2]) / 2 - WALL_M
    smooth = ndimage.morphological_gradient(np.nan_to_num(depth_m), 3) < STEP_M
    inside = (np.abs(points_world[..., :2]) < half_m).all(axis=-1)  # False for NaN
    part = inside & smooth & (points_world[..., 2] > FLOOR_M)
    count, label = cv2.connectedComponents(part.astype(np.uint8))
    masks = (label == k for k in range(1, count))  # 0 is the rest of the picture.
    return [mask for mask in masks if mask.sum() >= LEAST_PX]


def empty_bin(scanner: gc.ScannerDevice, lift_at, nudge, model, inner_m) -> None:
    """Let a robot lift the highest part of each frame, until no part is left."""
    lifted, misses, seconds = 0, 0, 0.0
    while misses < 3:
        try:
            frame = scanner.trigger()  # device: camera.capture(), and its depth and intrinsics
        except gc.ScannerError as error:
            print(error)
            break
        seconds += frame.duration_s
        T_world_cam = scanner.T_world_cam  # device: your hand-eye calibration
        points_world = frame.points @ T_world_cam[:3, :3].T + T_world_cam[:3, 3]
        masks = segment(frame.depth_m, points_world, inner_m)
        if not masks:
            break
        matches = gc.find_poses(model, frame.depth_m, frame.camera, masks)
        poses = [T_world_cam @ m.T_cam_part for m in matches if m.score > LEAST_SCORE]
        top = max(poses, key=lambda T_world_part: T_world_part[2, 3], default=None)
        if top is None or lift_at(top[:3, 3]) is None:  # robot: grip, lift
            misses += 1
            nudge()
        else:
            lifted, misses = lifted + 1, 0
            print(f"frame {frame.index}: lifted a part at {np.round(top[:3, 3], 3)} m")
    print(f"{lifted} parts in {seconds:.1f} s of scanning")


def main(count: int, samples: int, bag: str | None) -> None:
    part = gc.builtin_part("yellow_salt_cube")
    model, inner_m = gc.pose_model(part.mesh, part.symmetry), gc.BinSection().inner_m
    if bag is not None:  # No part moves in recorded pictures.
        with gc.BagScanner(bag) as scanner:
            return empty_bin(scanner, lambda point_m: 0, lambda: None, model, inner_m)
    config = gc.Config(  # A pose needs the depth at edges, of which some is doubtful.
        parts=(gc.PartSection(builtin="yellow_salt_cube"),), count=count, rig="like-phoxi-m",
        resolution="small", render=gc.RenderSection(samples=samples), decode={"max_p_wrong": 0.2},
    )  # fmt: skip
    with gc.VirtualScanner(config, seed=1) as scanner:  # device: Camera().connect("192.168.1.10")
        scanner.set("exposure.auto", True)  # device: its own name of the same setting
        empty_bin(scanner, scanner.bin.lift_at, scanner.bin.nudge, model, inner_m)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("count", type=int, nargs="?", default=8)
    parser.add_argument("samples", type=int, nargs="?", default=16)
    parser.add_argument("--bag")
    main(**vars(parser.parse_args()))
