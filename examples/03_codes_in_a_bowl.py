"""Compare codes under interreflections in a white bowl, with a table and a picture of errors.

The decoder accepts uncertain pixels in this example, so that wrong values are visible.

Run: .venv/bin/python examples/03_codes_in_a_bowl.py out/codes.png
"""

import sys
from dataclasses import replace
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from graycast.camera.decode import DecodeSpec
from graycast.camera.scanner import Scanner, scan
from graycast.rendering import Quality, open_renderer
from graycast.rig.pair import place, preset_rig
from graycast.rig.pattern import CODECS, CodeSpec
from graycast.world.parts import Material, Mesh, Part
from graycast.world.parts.shapes import revolve
from graycast.world.scene import Environment, Layout, Scene

RADIUS_M, WALL_M, ALBEDO = 0.09, 0.006, 0.95


def bowl() -> Part:
    """Return half of a hollow ball, open at the top, white and matt."""
    angle = np.linspace(0.02, np.pi / 2, 60)
    outer = (RADIUS_M + WALL_M) * np.stack([np.sin(angle), -np.cos(angle)], axis=-1)
    inner = RADIUS_M * np.stack([np.sin(angle), -np.cos(angle)], axis=-1)[::-1]
    vertices, faces = revolve(np.concatenate([outer, inner]), 160)
    white = Material(base_color=(ALBEDO, ALBEDO, ALBEDO), specular=0.0)
    mesh = Mesh(vertices_m=vertices, faces=faces)
    return Part(name="bowl", mesh=mesh, material=white, density_kg_m3=2400.0, friction=0.5)


def main(path: Path, samples: int) -> None:
    renderer = open_renderer()
    rig = preset_rig("like-phoxi-m")
    camera = replace(rig.camera, width_px=320, height_px=260, cx_px=159.5, cy_px=129.5)
    camera = replace(camera, fx_px=0.55 * camera.fx_px, fy_px=0.55 * camera.fy_px)
    rig = replace(rig, camera=camera)
    pose = place(rig, target_m=np.zeros(3), distance_m=0.6, tilt_rad=0.0, azimuth_rad=0.0)
    dark = Environment(radiance=(0.0, 0.0, 0.0))
    scene = Scene(rig=rig, T_world_cam=pose, parts=(bowl(),), environment=dark)
    layout = Layout(T_world_part=np.eye(4)[None].copy(), part_index=np.zeros(1, dtype=int))
    quality = Quality(samples=samples, depth=12)
    figure, axes = plt.subplots(2, 3, figsize=(13, 8.4), layout="constrained")
    print("code              frames  decoded  off by > 2 mm  median |error|")
    for codec, ax in zip(CODECS, axes.flat, strict=True):
        spec = CodeSpec(codec=codec, axes=("column",))
        scanner = Scanner(rig=rig, code=spec, decode=DecodeSpec(doubt=0.0, min_contrast=0.005))
        code = scanner.light_code()
        rendering = renderer.render(scene, layout, code.render(), quality=quality, seed=1)
        depth = scan(scanner, rendering.radiance, seed=1).depth.depth_m
        inside = rendering.truth.instance == 0
        error_mm = np.where(inside, 1e3 * (depth - rendering.truth.depth_m), np.nan)
        known = error_mm[np.isfinite(error_mm)]
        off, median = np.mean(np.abs(known) > 2), np.median(np.abs(known))
        share = known.size / inside.sum()
        print(f"{codec:16} {len(code.frames):7} {share:8.1%} {off:14.2%} {median:12.3f} mm")
        rows, columns = np.nonzero(inside)
        crop = np.s_[rows.min() : rows.max(), columns.min() : columns.max()]
        ax.imshow(error_mm[crop], cmap="RdBu_r", vmin=-5, vmax=5)
        ax.set(title=f"{codec}: {off:.1%} off by > 2 mm", xticks=[], yticks=[], facecolor="0.6")
    figure.colorbar(axes[0, 0].images[0], ax=axes, label="depth error [mm], grey: none", shrink=0.6)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=80)


if __name__ == "__main__":
    main(Path(sys.argv[1]), samples=int(sys.argv[2]) if len(sys.argv) > 2 else 128)
