"""A part of the user, from its mesh to a dataset: a hexagon nut, made here and saved as a file.

A dataset records its sources, so the part must come from a file that the configuration names.

Run: .venv/bin/python examples/05_own_part.py out/nuts
"""

import sys
from pathlib import Path

import trimesh
from manifold3d import CrossSection, Manifold

import graycast

ACROSS_FLATS_MM, HOLE_MM, HEIGHT_MM = 46.0, 30.0, 24.0  # an M30 nut without its thread


def nut() -> trimesh.Trimesh:
    """Six corners, a round hole; its length unit is the millimetre."""
    corner_mm = ACROSS_FLATS_MM / 3**0.5  # from the middle to a corner
    outline = CrossSection.circle(corner_mm, 6) - CrossSection.circle(HOLE_MM / 2, 48)
    mesh = Manifold.extrude(outline, HEIGHT_MM).to_mesh()
    return trimesh.Trimesh(mesh.vert_properties[:, :3], mesh.tri_verts)


def main(out: Path, samples: int) -> None:
    out.mkdir(parents=True, exist_ok=True)
    nut().export(out / "nut.stl")
    steel = {"metallic": 1, "base_color": [0.56, 0.54, 0.52], "roughness": 0.45}
    config = graycast.Config.model_validate(
        {
            "parts": [{"mesh": "nut.stl", "unit": "mm", "material": steel}],
            "count": 12,
            "rig": "phoxi-m",
            "resolution": "small",
            "render": {"samples": samples},
        }
    )
    cell = graycast.resolve_cell(config, out)
    print("\n".join(cell.notes) or "the mesh is closed, and there are no notes on it")
    with graycast.open_cell_renderer(cell) as renderer:
        shot = graycast.make_scene(cell, 0, seed=1, renderer=renderer)
    saved = graycast.save_scene(cell, shot, out / "dataset")
    print(f"{saved}: {len(shot.sample.layout.part_index)} nuts")


if __name__ == "__main__":
    main(Path(sys.argv[1]), samples=int(sys.argv[2]) if len(sys.argv) > 2 else 16)
