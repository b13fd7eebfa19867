"""Scans of a board from a folder: stacks, or pictures with depth from any scanner."""

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, Shaped

from ....base.folder import visible_entries
from ....camera.scanner import Scanner
from ....camera.stack import decode_stack, stack_scanner
from ....rig.optics import Optics, optics_of
from ...depth_file import FileOptions
from ...picture_pairs import find_shots, read_shot
from ..board import CalibrationError


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotScan:
    """A picture with its depth, if there is any, and the camera."""

    name: str
    picture: Shaped[np.ndarray, "h w"]
    depth_m: Float[np.ndarray, "h w"] | None
    sigma_m: Float[np.ndarray, "h w"] | None
    camera: Optics


def read_scans(folder: Path, scanner: Scanner | None, files: FileOptions) -> Iterator[RobotScan]:
    """Yield the scans in a folder in the order of their names, where 10 comes after 9.

    A scan is a folder with a `stack.yaml`, or the files of one name in the folders `rgb` or `gray`
    and `depth`.

    Args:
        scanner: its rig decodes the stacks, or is the camera of the pictures. None takes the rig
            that a stack file names, or the camera of `files`.

    Raises:
        GraycastError: there are no scans, or a scan cannot be read.
    """
    if any((folder / name).is_dir() for name in ("rgb", "gray", "depth")):
        yield from _pictures(folder, scanner, files)
        return
    stacks = [
        path
        for scan in visible_entries(folder)
        for path in (scan / "stack.yaml", scan / "frames" / "stack.yaml")
        if path.is_file()
    ]
    if not stacks:
        raise CalibrationError(
            f"{folder}: has no scans: give a folder of folders with a stack.yaml each, or of the "
            "folders rgb and depth with pictures of the same names"
        )
    names = {path: path.relative_to(folder).parts[0] for path in stacks}
    for path in sorted(stacks, key=lambda path: _by_number(names[path])):
        yield _stack(path, names[path], scanner)


def _by_number(name: str) -> list[tuple[str, int]]:
    return [(text, int(word or 0)) for text, word in re.findall(r"(\D*)(\d*)", name)]


def _stack(path: Path, name: str, scanner: Scanner | None) -> RobotScan:
    if scanner is None:
        scanner = stack_scanner(path)
    if scanner is None:
        raise CalibrationError(f"{path}: names no rig, which depth needs: give --rig")
    result = decode_stack(path, scanner.rig, filters=scanner.filters)
    assert result.depth is not None
    return RobotScan(
        name=name,
        picture=result.picture.mean(axis=2).astype(np.uint8),
        depth_m=result.depth.depth_m.astype(np.float64),
        sigma_m=result.depth.sigma_m.astype(np.float64),
        camera=scanner.rig.camera,
    )


def _pictures(folder: Path, scanner: Scanner | None, files: FileOptions) -> Iterator[RobotScan]:
    if scanner is not None:
        camera = scanner.rig.camera
        files = replace(files, K=camera.K, distortion=camera.distortion)
    for shot in sorted(find_shots(folder), key=lambda shot: _by_number(shot.stem)):
        images = read_shot(shot, files)
        picture = images.gray
        if picture is None and images.rgb is not None:
            picture = images.rgb.mean(axis=2).astype(np.uint8)
        if picture is None:
            raise CalibrationError(
                f"{folder}: the scan {shot.stem} has no picture: add the folder rgb or gray"
            )
        yield RobotScan(
            name=shot.stem,
            picture=picture,
            depth_m=images.depth_m,
            sigma_m=None,
            camera=optics_of(images.K, images.size_px, files.distortion or (0.0,) * 5),
        )
