"""The layout of a dataset's folder, for the code that writes it and the code that reads it."""

from pathlib import Path

CLAIM = "graycast.json"
SPLITS = ("train", "val", "test")


def camera_file(sensor: str) -> str:
    """Return the name of the file with a scanner's intrinsics."""
    return f"camera_{sensor}.json" if sensor else "camera.json"


def finished_scenes(out: Path, split: str = "train") -> set[int]:
    """Return the ids of the scenes in a dataset folder; a scene with a final name is complete."""
    place = out / split
    names = [entry.name for entry in place.iterdir()] if place.is_dir() else []
    return {int(name) for name in names if name.isdecimal() and len(name) >= 6}
