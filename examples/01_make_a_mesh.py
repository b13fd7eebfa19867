"""Make the mesh of configs/own_part.yaml: an aluminium plate with two bores and a slot.

Run: .venv/bin/python examples/01_make_a_mesh.py out/plate.stl
"""

import sys
from pathlib import Path

import trimesh
from manifold3d import CrossSection, Manifold

SEGMENTS = 64


def plate() -> trimesh.Trimesh:
    """Return a plate of 80 x 45 x 12 mm; the unit of length is the millimetre."""
    outline = CrossSection.square((70, 35), center=True).offset(5)
    bore = CrossSection.circle(7, SEGMENTS)
    slot = CrossSection.batch_hull([bore.scale((0.6, 0.6)).translate((x, 0)) for x in (-8, 8)])
    holes = bore.translate((-27, 0)) + bore.translate((27, 0)) + slot
    base = Manifold.extrude(outline - holes, 8)
    rim = Manifold.extrude(outline - outline.offset(-4), 12)
    mesh = (base + rim).to_mesh()
    return trimesh.Trimesh(mesh.vert_properties[:, :3], mesh.tri_verts)


if __name__ == "__main__":
    path = Path(sys.argv[1] if len(sys.argv) > 1 else "out/plate.stl")
    path.parent.mkdir(parents=True, exist_ok=True)
    shape = plate()
    shape.export(path)
    print(f"{path}: {len(shape.faces)} faces, {shape.extents} mm, watertight {shape.is_watertight}")
