"""What a dataset is claimed for: nothing of a part may change behind a fingerprint's back."""

from dataclasses import fields, replace

import numpy as np
import pytest
from prisms import box_part, make_rig

from graycast.camera.decode import DecodeSpec, FilterSpec
from graycast.camera.rig_file.scanner_sections import FilterSection
from graycast.dataset.claim import described_values, fingerprint, make_claim, rig_of
from graycast.world.parts import Material, Mesh, Part, Symmetry

BOX = box_part()
MESH, MATERIAL, MOTIONS = BOX.mesh, BOX.material, BOX.symmetry
TURN = MOTIONS.discrete[0]
AXIS = ((0.0, 0.0, 1.0), (0.0, 0.0, 0.0))
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
    "density_kg_m3": replace(BOX, density_kg_m3=801.0),
    "friction": replace(BOX, friction=0.51),
    "discrete": replace(MOTIONS, discrete=(TURN @ TURN,)),
    "continuous": replace(MOTIONS, continuous=(AXIS,)),
    "name": replace(BOX, name="crate"),
    "labelled": replace(BOX, labelled=False),
}


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


def test_every_field_of_a_part_is_changed_once():
    """A new one is added above, and to what the claim covers."""
    known = {field.name for kind in (Part, Mesh, Material, Symmetry) for field in fields(kind)}
    assert set(CHANGES) == known - {"mesh", "material", "symmetry", "source"}


@pytest.mark.parametrize("field", CHANGES)
def test_a_part_that_changes_is_another_dataset(field):
    before, after = claimed(BOX), claimed(changed(field))
    assert before["fingerprint"] != after["fingerprint"]
    assert before["fingerprint"] == fingerprint(before)


def test_where_a_part_came_from_is_told_and_is_no_other_dataset():
    moved = claimed(replace(BOX, source="elsewhere/box.stl"))
    assert moved["sources"] == ["elsewhere/box.stl"]
    assert moved["fingerprint"] == claimed(BOX)["fingerprint"]


def test_settings_that_came_later_are_told_where_they_are_on_and_only_there():
    """An older dataset, whose claim lacks them, goes on; one with them on is another."""
    for off, on in (
        (DecodeSpec(), DecodeSpec(min_sigmas=5.0, settling_votes=14, min_visibility=0.5)),
        (
            FilterSpec(),
            FilterSpec(outlier_repair=True, hidden_sigmas=3.0),
        ),
        (
            make_rig(),
            replace(
                make_rig(),
                speckle_volume=2.0,
                speckle_unevenness=0.2,
                line_noise=0.01,
                line_noise_length_m=0.004,
            ),
        ),
    ):
        older = {"min_sigmas", "outlier_repair", "hidden_sigmas"}
        older |= {
            "settling_votes",
            "min_visibility",
            "speckle_volume",
            "speckle_unevenness",
            "line_noise",
            "line_noise_length_m",
        }
        assert not older & set(described_values(off))
        assert set(described_values(on)) == {field.name for field in fields(on)}
    told = described_values(replace(make_rig(), speckle_volume=2.0))
    told["T_cam_proj"] = told["T_cam_proj"].tolist()
    assert rig_of(told).speckle_volume == 2.0
    said = FilterSection(flying_angle_deg=70.0).model_dump(mode="json")
    assert "outlier_repair" not in said and said["flying_angle_deg"] == 70.0
    assert FilterSection(hidden_sigmas=0.0).model_dump()["hidden_sigmas"] == 0.0
