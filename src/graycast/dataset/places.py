"""Where things lie in a dataset's folder, for who writes it and for who reads it."""

from pathlib import Path

CLAIM = "graycast.json"
SPLITS = ("train", "val", "test")


def camera_file(sensor: str) -> str:
    """The name of a scanner's file of intrinsics."""
    return f"camera_{sensor}.json" if sensor else "camera.json"


def finished_scenes(out: Path, split: str = "train") -> set[int]:
    """The scenes of a dataset folder; a scene that has its name is whole."""
    place = out / split
    names = [entry.name for entry in place.iterdir()] if place.is_dir() else []
    return {int(name) for name in names if name.isdecimal() and len(name) >= 6}
