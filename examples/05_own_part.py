"""Make a dataset of your own part: a hexagon nut, whose mesh is made here and saved as a file.

A dataset records its sources, so the part must come from a file that the configuration names.

Run: .venv/bin/python examples/05_own_part.py out/nuts
"""

import sys
from pathlib import Path

import trimesh
from manifold3d import CrossSection, Manifold

import graycast as gc

ACROSS_FLATS_MM, HOLE_MM, HEIGHT_MM = 46.0, 30.0, 24.0  # an M30 nut without a thread


def nut() -> trimesh.Trimesh:
    """Return a nut with six corners and a round hole; the unit of length is the millimetre."""
    corner_mm = ACROSS_FLATS_MM / 3**0.5  # distance from the centre to a corner
    outline = CrossSection.circle(corner_mm, 6) - CrossSection.circle(HOLE_MM / 2, 48)
    mesh = Manifold.extrude(outline, HEIGHT_MM).to_mesh()
    return trimesh.Trimesh(mesh.vert_properties[:, :3], mesh.tri_verts)


def main(out: Path, samples: int) -> None:
    out.mkdir(parents=True, exist_ok=True)
    nut().export(out / "nut.stl")
    steel = gc.MaterialSection(metallic=1, base_color=(0.56, 0.54, 0.52), roughness=0.45)
    config = gc.Config(
        parts=(gc.PartSection(mesh=Path("nut.stl"), unit="mm", material=steel),),
        count=12,
        rig="like-phoxi-m",
        resolution="small",
        render=gc.RenderSection(samples=samples),
    )
    cell = gc.load_cell(config, folder=out)
    print("\n".join(cell.notes) or "the mesh is closed, and there are no notes on it")
    for scene in gc.scenes(cell, 1, seed=1):
        saved = scene.save(out / "dataset")
        print(f"{saved}: {len(scene.layout.part_index)} nuts")


if __name__ == "__main__":
    main(Path(sys.argv[1]), samples=int(sys.argv[2]) if len(sys.argv) > 2 else 16)
