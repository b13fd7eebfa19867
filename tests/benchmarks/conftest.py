"""Fixtures: a small scanner in front of a wall, and fake renderers that return known pictures."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest
import trimesh

from benchmarks import agree, cells, convergence, denoise, renderers
from graycast.camera.scanner import Scanner
from graycast.cell.config import Config
from graycast.cell.resolve import resolve_cell
from graycast.rendering import GroundTruth, Radiance, Rendering
from graycast.world.scene import Layout

SIZE_PX = (48, 20)


@pytest.fixture(scope="session")
def wall_cells(tmp_path_factory):
    """Return a small cell for each code; of its three kinds of part, only names matter."""
    folder = tmp_path_factory.mktemp("cell")
    trimesh.creation.box((60, 40, 30)).export(folder / "box.stl")
    parts = [{"mesh": "box.stl", "unit": "mm", "name": name} for name in cells.MATERIALS]
    words = {"parts": parts, "bin": {"material": {}}}
    cell = resolve_cell(Config.model_validate(words), folder)
    rig = cell.scene.rig
    rig = replace(rig, camera=cells.cropped(rig.camera, SIZE_PX))
    cell = replace(cell, scene=replace(cell.scene, rig=rig))
    return {
        code.codec: replace(cell, scanner=Scanner(rig=rig, code=code, sensor=cells.QUIET_SENSOR))
        for code in (cells.GRAY, cells.PHASE)
    }


@dataclass
class Painter:
    """A fake renderer. Each pixel sees one projector column; `white` is the light of each class.

    `shift_px` moves the columns, and the first `blind` rows get no light. The noise has the
    standard deviation `noise / sqrt(samples)`.
    """

    name: str = "mitsuba"
    device: str = "cpu"
    white: tuple[float, ...] = (1.0, 1.0, 1.0, 1.0)
    ambient: float = 0.1
    shift_px: float = 0.0
    blind: int = 0
    noise: float = 0.0
    patterns_per_render: int = 1
    requests: list = field(default_factory=list)
    on_frame: object = None
    denoiser: str = "oidn"
    versions: dict = field(default_factory=dict)

    def close(self):
        pass

    def __enter__(self):
        return self

    def __exit__(self, *error):
        pass

    def render(self, scene, layout, pattern, *, quality, seed):
        self.requests.append((len(pattern), quality, seed))
        w, h = SIZE_PX
        instance = np.tile(np.repeat([-1, 0, 1, 2], w // 4), (h, 1))
        shade = np.array(self.white)[instance]
        shade[: self.blind] = 0
        column = 500 + np.arange(w) + self.shift_px
        left = np.floor(column).astype(int)
        part = column - left
        rng = np.random.default_rng(seed)
        level = (1 - part) * pattern[:, 0, left] + part * pattern[:, 0, left + 1]
        stack = level[:, None, :] / 255 * shade
        sigma = self.noise / np.sqrt(quality.samples)
        stack = np.maximum(stack + sigma * rng.normal(size=stack.shape), 0)
        for done in range(1, len(stack) + 1):
            if self.on_frame is not None:
                self.on_frame(done, len(stack))
        other = np.full(shade.shape, self.ambient)
        radiance = Radiance(
            pattern=stack.astype(np.float32),
            white=shade.astype(np.float32),
            ambient=other.astype(np.float32),
            white_rgb=np.repeat(shade[..., None], 3, axis=-1).astype(np.float32),
            ambient_rgb=np.repeat(other[..., None], 3, axis=-1).astype(np.float32),
            albedo=np.full((*shade.shape, 3), 0.5, dtype=np.float32),
        )
        towards = np.zeros((h, w, 3))
        towards[..., 2] = -1.0
        truth = GroundTruth(
            depth_m=np.full((h, w), 0.8), normal=towards, instance=instance, amodal=()
        )
        return Rendering(radiance=radiance, truth=truth)


@pytest.fixture
def painted(monkeypatch, wall_cells):
    """Make the studies use the wall, without physics and without scenes of their own."""
    layout = Layout(T_world_part=np.tile(np.eye(4), (3, 1, 1)), part_index=np.arange(3))
    gray_cell, phase_cell = (wall_cells[name] for name in ("gray", "gray_phase"))
    for study in (agree, denoise, renderers):
        monkeypatch.setattr(study, "dropped", lambda cell, each, *, seed: layout)
    monkeypatch.setattr(agree, "materials_cell", lambda size_px: phase_cell)
    monkeypatch.setattr(denoise, "bracket_cell", lambda *arguments, **words: gray_cell)
    monkeypatch.setattr(renderers, "bracket_cell", lambda *arguments, **words: phase_cell)
    monkeypatch.setattr(convergence.time, "perf_counter", Clock())
    return Painter


class Clock:
    """A clock that advances by one second at every call."""

    def __init__(self):
        self.now_s = 0.0

    def __call__(self):
        self.now_s += 1.0
        return self.now_s
