"""A cell that is made quickly: three boxes in a plain bin, and a camera of 160 x 120 pixels."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import trimesh
import yaml

from graycast.camera.rig_file import save_scanner
from graycast.camera.scanner import Scanner
from graycast.rig.pair import preset_rig
from studies.smaller import shrunk

GRAYCAST = [sys.executable, "-m", "graycast"]


def write_cell(folder: Path, *without: str, **changes) -> Path:
    """Write a configuration, a mesh and a rig; `changes` and `without` are top-level keys."""
    trimesh.creation.box((60, 40, 30)).export(folder / "box.stl")
    rig = preset_rig("paper")
    camera, projector = shrunk(rig.camera, 160, 120), shrunk(rig.projector, 128, 96)
    rig = replace(rig, name="small", camera=camera, projector=projector)
    save_scanner(Scanner(rig=rig), folder / "rig.yaml")
    content = {
        "parts": [{"mesh": "box.stl", "unit": "mm"}],
        "count": 3,
        "scenes": 2,
        "rig": "rig.yaml",
        "bin": {"inner_m": [0.25, 0.2, 0.1], "material": {"base_color": [0.4, 0.3, 0.2]}},
        "render": {"samples": 4, "denoise": False},
    }
    settings = {key: value for key, value in (content | changes).items() if key not in without}
    path = folder / "cell.yaml"
    path.write_text(yaml.safe_dump(settings), encoding="utf-8")
    return path


def content(out: Path) -> dict:
    """Return all files of a dataset, also hidden ones; manifests are parsed, without timings."""
    files = {
        str(path.relative_to(out)): path.read_bytes() for path in out.rglob("*") if path.is_file()
    }
    for name in [name for name in files if name.endswith("manifest.json")]:
        manifest = json.loads(files[name])
        assert set(manifest.pop("timings")) == {"drop", "render", "sensor", "picture", "decode"}
        for further in manifest.pop("further_timings", ()):
            assert set(further["seconds"]) == {"render", "sensor", "picture", "decode"}
        files[name] = manifest
    return files


def start(*arguments: object) -> subprocess.Popen:
    """Start the command in its own process group, as a terminal does."""
    return subprocess.Popen(
        [*GRAYCAST, *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env=os.environ | {"COLUMNS": "200"},
    )


def finished(out: Path) -> int:
    """Return the number of finished scenes in a folder."""
    return len(list(out.glob("train/[0-9]*")))
