"""The claim of a dataset: no change of a part may leave its fingerprint unchanged."""

from dataclasses import fields, replace

import numpy as np
import pytest
from prisms import box_part, make_rig

from graycast.dataset.write.claim import described_values, fingerprint, make_claim, rig_of
from graycast.world.parts import Grain, Material, Mesh, Part, Symmetry

BOX = box_part()
MESH, MATERIAL, MOTIONS = BOX.mesh, BOX.material, BOX.symmetry
TURN = MOTIONS.discrete[0]
AXIS = ((0.0, 0.0, 1.0), (0.0, 0.0, 0.0))
GRAIN = Grain(axis=(1.0, 0.0, 0.0))
GROOVED = replace(MATERIAL, metallic=1.0, anisotropy=0.5, grain=GRAIN)
METAL = replace(MATERIAL, metallic=1.0)
VARIED = replace(MATERIAL, roughness_map=np.full((2, 3), 200, dtype=np.uint8))
MOTTLED = replace(MATERIAL, texture=None, mottle=0.1)
GLASS = replace(MATERIAL, texture=None, metallic=0.0, transparent="solid")
CHANGES = {
    "vertices_m": replace(MESH, vertices_m=MESH.vertices_m + 1e-6),
    "faces": replace(MESH, faces=np.roll(MESH.faces, 1, axis=1)),
    "corner_uv": replace(MESH, corner_uv=MESH.corner_uv + 1e-6),
    "corner_normals": replace(MESH, corner_normals=None),
    "base_color": replace(MATERIAL, base_color=(0.5, 0.5, 0.51)),
    "texture": replace(MATERIAL, texture=MATERIAL.texture // 2),
    "metallic": replace(MATERIAL, metallic=1.0),
    "roughness": replace(MATERIAL, roughness=0.51),
    "specular": replace(MATERIAL, specular=0.0),
    "projector_reflectance": replace(MATERIAL, projector_reflectance=0.5),
    "anisotropy": replace(GROOVED, anisotropy=0.51),
    "grain": replace(GROOVED, grain=replace(GRAIN, turned=True)),
    "transparent": replace(GLASS, transparent="thin"),
    "color_depth_m": replace(GLASS, color_depth_m=0.02),
    "roughness_map": replace(VARIED, roughness_map=np.full((3, 2), 200, dtype=np.uint8)),
    "film": replace(METAL, film=0.05),
    "diffuse": replace(METAL, diffuse=0.3),
    "mottle": replace(MOTTLED, mottle=0.11),
    "mottle_length_m": replace(MOTTLED, mottle_length_m=0.001),
    "density_kg_m3": replace(BOX, density_kg_m3=801.0),
    "friction": replace(BOX, friction=0.51),
    "discrete": replace(MOTIONS, discrete=(TURN @ TURN,)),
    "continuous": replace(MOTIONS, continuous=(AXIS,)),
    "name": replace(BOX, name="crate"),
    "labelled": replace(BOX, labelled=False),
}


def before(field):
    if field in ("anisotropy", "grain"):
        return replace(BOX, material=GROOVED)
    if field in ("mottle", "mottle_length_m"):
        return replace(BOX, material=MOTTLED)
    if field in ("film", "diffuse"):
        return replace(BOX, material=METAL)
    if field == "roughness_map":
        return replace(BOX, material=VARIED)
    glass = field in ("transparent", "color_depth_m")
    return replace(BOX, material=GLASS) if glass else BOX


def changed(field):
    match CHANGES[field]:
        case Mesh() as mesh:
            return replace(BOX, mesh=mesh)
        case Material() as material:
            return replace(BOX, material=material)
        case Symmetry() as symmetry:
            return replace(BOX, symmetry=symmetry)
        case part:
            return part


def claimed(part):
    return make_claim({}, 7, (part,), make_rig(), 0.02)


def test_every_field_of_a_part_is_covered_by_a_change():
    """A new field must be added above, and to the claim."""
    known = {field.name for kind in (Part, Mesh, Material, Symmetry) for field in fields(kind)}
    assert set(CHANGES) == known - {"mesh", "material", "symmetry", "source"}


def test_the_claim_depends_on_each_texel_of_a_map():
    varied = np.full((2, 3), 200, dtype=np.uint8)
    varied[1, 2] = 201
    looks = [MATERIAL, VARIED, replace(MATERIAL, roughness_map=varied)]
    prints = {claimed(replace(BOX, material=look))["fingerprint"] for look in looks}
    assert len(prints) == 3


@pytest.mark.parametrize("field", CHANGES)
def test_a_changed_part_changes_the_claim(field):
    old, new = claimed(before(field)), claimed(changed(field))
    assert old["fingerprint"] != new["fingerprint"]
    assert old["fingerprint"] == fingerprint(old)


def test_the_origin_of_a_part_is_recorded_but_does_not_change_the_claim():
    moved = claimed(replace(BOX, source="elsewhere/box.stl"))
    assert moved["sources"] == ["elsewhere/box.stl"]
    assert moved["fingerprint"] == claimed(BOX)["fingerprint"]


def test_a_rig_is_stored_with_all_its_fields_and_read_back():
    rig = replace(make_rig(), speckle_volume=2.0)
    values = described_values(rig)
    assert set(values) == {field.name for field in fields(rig)}
    assert values["line_noise_length_m"] == "inf"
    read = rig_of(values | {"T_cam_proj": values["T_cam_proj"].tolist()})
    assert read.speckle_volume == 2.0 and read.line_noise_length_m == np.inf
