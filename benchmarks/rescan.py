"""Test of `graycast rescan` on generated datasets without their scanner depth.

The scenes of each cell are generated, and the files of the scanner are removed. Then `rescan` makes
these files again from perfect depth, models, poses and colour pictures. A second rescan, with
another seed, shows the random differences between two scans, and a rescan without models shows how
good a rescan from depth alone is.
"""

import shutil
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from jaxtyping import Bool, Float

from graycast.camera.decode import Reason
from graycast.cell.generate import generate
from graycast.cell.resolve import Cell, load_cell
from graycast.dataset.files.scene_folder import AnyView, SceneFolder
from graycast.real.realism import DepthScan
from graycast.real.realism.measure import measure_all, pool
from graycast.real.rescan.open_source import open_source
from graycast.real.rescan.rescanning import RescanSpec, rescan
from graycast.real.rescan.source import SourceOptions

from .figures import Figures, Show

CELLS = {
    "metal, like-phoxi-s": ("configs/phoxi_cell.yaml", {}),
    "plastic, like-phoxi-m": (
        "configs/demo.yaml",
        {"rig": "like-phoxi-m", "parts": [{"builtin": "hygiene_spray"}], "count": 15},
    ),
    "metal, paper": ("configs/demo.yaml", {}),
}
WRONG_M = 1e-3
ROOT = Path(__file__).resolve().parents[1]


@dataclass(frozen=True, slots=True)
class _Scan:
    """The compared data of one image."""

    name: str
    depth_m: Float[np.ndarray, "h w"]
    reason: np.ndarray
    perfect_m: Float[np.ndarray, "h w"]
    on_part: Bool[np.ndarray, "h w"]
    K: Float[np.ndarray, "3 3"]

    @property
    def shadow(self) -> Bool[np.ndarray, "h w"]:
        return (self.reason == Reason.SHADOW) | (self.reason == Reason.LOW_MODULATION)


def measure(scenes: int, show: Show) -> Figures:
    """Return a row of results for each cell and each kind of scan."""
    rows: list[Figures] = []
    with tempfile.TemporaryDirectory() as folder:
        for name, (config, changes) in CELLS.items():
            content = yaml.safe_load((ROOT / config).read_text()) | changes
            (Path(folder) / "cell.yaml").write_text(yaml.safe_dump(content))
            cell = load_cell(Path(folder) / "cell.yaml")
            rows += _rows(name, cell, Path(folder) / name.replace(", ", "-"), scenes, show)
    return {"scenes": scenes, "rows": rows}


def _rows(name: str, cell: Cell, folder: Path, scenes: int, show: Show) -> Iterator[Figures]:
    show(f"{name}: generate")
    start = time.process_time()
    generate(cell, folder / "whole", scenes=scenes, seed=0)
    whole_s = (time.process_time() - start) / scenes
    _strip(folder / "whole", folder / "bare")
    materials = folder / "materials.yaml"
    parts = {i: part.material.words for i, part in enumerate(cell.scene.parts, start=1)}
    for i, words in parts.items():
        if cell.scene.parts[i - 1].material.texture is not None:
            del words["base_color"]  # The model file has its own texture.
    materials.write_text(yaml.safe_dump(parts))
    original = _scans(folder / "whole/train", folder / "whole/train")
    yield {"cell": name, "scan": "generate", "s": whole_s, **_figures(original, original)}
    for label, seed, only in (("rescan", 1, False), ("again", 2, False), ("depth alone", 1, True)):
        show(f"{name}: {label}")
        options = SourceOptions(depth_only=only, materials=None if only else materials)
        out = folder / label
        start = time.process_time()
        rescan(
            open_source(folder / "bare/train", options), cell.scanner, out, RescanSpec(seed=seed)
        )
        seconds = (time.process_time() - start) / scenes
        scans = _scans(out / "train", folder / "whole/train")
        yield {"cell": name, "scan": label, "s": seconds, **_figures(scans, original)}


def _strip(whole: Path, bare: Path) -> None:
    """Copy a dataset without the files of its scanner."""
    shutil.copytree(whole / "models", bare / "models")
    for path in sorted((whole / "train").iterdir()):
        keep = (entry for entry in path.iterdir() if not entry.stem.endswith("_sl"))
        for entry in keep:
            place = bare / "train" / path.name / entry.name
            place.parent.mkdir(parents=True, exist_ok=True)
            (shutil.copytree if entry.is_dir() else shutil.copyfile)(entry, place)


def _scans(split: Path, perfect: Path) -> list[_Scan]:
    scans = []
    for path in sorted(split.iterdir()):
        own, whole = SceneFolder(path), SceneFolder(perfect / path.name)
        view, true = (
            one.of_image(kind, 0, AnyView)
            for one, kind in ((own, "scene_camera_sl"), (whole, "scene_camera"))
        )
        steps, perfect_steps = own.png("depth_sl"), whole.png("depth")
        masks = [
            whole.mask("mask_visib", i) for i in range(len(list(whole.path.glob("mask_visib/*"))))
        ]
        scans.append(
            _Scan(
                name=path.name,
                depth_m=np.where(steps > 0, steps * view.depth_scale / 1e3, np.nan),
                reason=own.png("reason_sl"),
                perfect_m=np.where(
                    perfect_steps > 0, perfect_steps * true.depth_scale / 1e3, np.nan
                ),
                on_part=np.any(masks, axis=0),
                K=np.reshape(view.cam_K, (3, 3)).astype(float),
            )
        )
    return scans


def _figures(scans: list[_Scan], original: list[_Scan]) -> dict[str, Any]:
    known = np.concatenate([np.isfinite(scan.depth_m).ravel() for scan in scans])
    on_part = np.concatenate([scan.on_part.ravel() for scan in scans])
    off_m = np.concatenate([np.abs(scan.depth_m - scan.perfect_m).ravel() for scan in scans])
    shadow, first = (
        np.concatenate([scan.shadow.ravel() for scan in each]) for each in (scans, original)
    )
    record = pool(
        measure_all(DepthScan(name=s.name, depth_m=s.depth_m, K=s.K) for s in scans), name="scans"
    )
    quantiles = 1e3 * np.nanquantile(off_m, [0.5, 0.9, 0.99])
    sigma = record.noise.percentiles_m or [np.nan] * 5
    lags = record.autocorrelation.along_rows or [np.nan]
    return {
        "decoded %": 100 * known.mean(),
        "of parts %": 100 * known[on_part].mean(),
        "wrong %": 100 * (off_m[known] > WRONG_M).mean(),
        "p50 mm": quantiles[0],
        "p90 mm": quantiles[1],
        "p99 mm": quantiles[2],
        "noise mm": 1e3 * sigma[2],
        "lag 1": lags[0],
        "flying %": 100 * (record.steps.flying or 0.0),
        "shadow IoU": (shadow & first).sum() / (shadow | first).sum(),
    }
