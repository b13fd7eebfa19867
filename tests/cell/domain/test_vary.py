"""A record alone makes the scene, and the scene has the values of the record."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cells import AZIMUTH_RAD, DISTANCE_M, TARGET_M, TILT_RAD, cell, differences, domain
from PIL import Image
from scipy import integrate

from graycast.base.errors import ConfigError
from graycast.base.frames import axis_rotation, inverse, rigid, transform_points
from graycast.cell.domain import draw, resolve_domain, vary
from graycast.cell.domain.vary import lamp_of, shared_out
from graycast.dataset.files.json_text import json_bytes
from graycast.rig.pair import frame_in_camera, place
from graycast.world.parts import Material
from graycast.world.scene import lamp_quad
from studies.crates import Crate

NO_TOLERANCE = {
    "kind": "adapted",
    "camera": {"position_m": 0, "rotation_deg": 0},
    "bin": {"position_m": 0, "rotation_deg": 0},
    "lamps": {"position_m": 0, "level": 0, "environment_level": 0},
    "parts": {"reflectance": 0, "roughness": 0},
}
STILL = {"distance_factor": 1.0, "tilt_rad": 0.0, "azimuth_rad": 0.0, "roll_rad": 0.0,
         "shift_m": [0.0, 0.0, 0.0]}  # fmt: skip


def textured():
    """Return a cell with a textured part and one with a reflectance at the projector's line."""
    picture = np.random.default_rng(5).integers(0, 256, (8, 8, 3), dtype=np.uint8)
    return cell((Material(texture=picture), Material(projector_reflectance=0.4)))


@pytest.fixture
def full(tmp_path):
    """Return a cell and a domain that uses every section and every kind of file."""
    for folder, name in (("skies", "a.exr"), ("skies", "b.hdr")):
        (tmp_path / folder).mkdir(exist_ok=True)
        (tmp_path / folder / name).write_bytes(b"read by a renderer alone")
    (tmp_path / "wood").mkdir()
    for name in ("ash.png", "oak.png"):
        picture = np.random.default_rng(len(name)).integers(0, 256, (4, 4, 3), dtype=np.uint8)
        Image.fromarray(picture).save(tmp_path / "wood" / name)
    scene = textured()
    settings = {
        "kind": "randomized",
        "camera": {"roll_deg": [-5, 5]},
        "environment": {"maps": "skies"},
        "bin": {"textures": "wood", "size_factor": [0.9, 1.1], "metal_share": 0.5},
        "table": {"textures": "wood"},
        "parts": {"metallic": [-0.2, 0.2], "repainted_share": 0.3},
        "distractors": {"count": [1, 5]},
    }
    return scene, domain(scene, settings, tmp_path)


def test_the_record_of_a_random_scene_reproduces_the_scene(full):
    """The record is written as JSON and read back, so a value that it omits would be missing."""
    scene, own = full
    places = set()
    for seed in range(8):
        record = draw(own, scene, (7, 0), np.random.default_rng(seed))
        once = vary(own, scene, (7, 0), record)
        again = vary(own, scene, (7, 0), json.loads(json_bytes({"domain": record}))["domain"])
        assert differences(once.scene, again.scene) == []
        assert once.counts == again.counts
        assert differences(once.scene, vary(own, scene, (7, 0), record).scene) == []
        places |= set(differences(scene, once.scene))
    changed = {place.replace("scene", "").split("[")[0] for place in places}
    assert {".T_world_cam", ".lamps", ".environment.map_file", ".bin.inner_m", ".parts"} <= changed
    assert {".table_texture_m", ".environment.rotation_rad", ".bin.texture_size_m"} <= changed
    assert not changed & {".rig", ".surfaces", ".bin.friction", ".bin.wall_m"}


def test_at_least_one_part_of_each_kind_remains_however_small_the_share():
    """Computed by hand: a fifth of 40, 7, 1 and 0, rounded, but at least one part of each kind."""
    assert shared_out((40, 7, 1, 0), 0.2) == (8, 1, 1, 0)


def test_a_repainted_surface_keeps_nothing_of_its_old_material(full):
    """It loses its texture, its reflectance at the projector's line, and its floor."""
    scene, own = full
    scene = replace(scene, bin=replace(scene.bin, floor=Material(base_color=(0.9, 0.1, 0.1))))
    record = draw(own, scene, (7, 7), np.random.default_rng(1))
    for name in ("box0", "box1"):
        record["parts"][name]["color"] = {"hue_deg": 10.0, "saturation": 0.5, "value": 0.5}
    varied = vary(own, scene, (7, 7), record).scene
    pictured, known = (part.material for part in scene.parts)
    assert pictured.texture is not None and known.projector_reflectance == 0.4
    for part in varied.parts[:2]:
        assert part.material.texture is None and part.material.projector_reflectance is None
    assert varied.bin.floor is None
    assert varied.bin.material.roughness == record["bin"]["roughness"]


def test_an_environment_map_gets_the_drawn_radiance_instead_of_its_own(full):
    """The record has the brightness of the sky; the file of the map has its distribution."""
    scene, own = full
    record = draw(own, scene, (7, 7), np.random.default_rng(1))
    sky = vary(own, scene, (7, 7), record).scene.environment
    assert sky.levelled
    assert sky.radiance == pytest.approx([record["environment"]["radiance"]] * 3)
    assert sky.map_file.name == record["environment"]["map"]


def test_a_mesh_bin_is_scaled_and_painted_like_a_box_bin(full, tmp_path):
    scene, own = full
    crate = replace(Crate().bin(tmp_path), own_texture=True)
    scene = replace(scene, bin=crate)
    record = draw(own, scene, (7, 0), np.random.default_rng(1))
    box, factor = vary(own, scene, (7, 0), record).scene.bin, record["bin"]["size_factor"]
    assert factor != 1
    assert box.inner_m == pytest.approx(tuple(factor * size for size in crate.inner_m))
    assert box.bounds_m == pytest.approx(factor * crate.bounds_m)
    assert box.floor_m == pytest.approx(factor * crate.floor_m)
    assert box.material.roughness == record["bin"]["roughness"]
    assert not box.own_texture


def test_the_record_of_an_adapted_scene_reproduces_the_scene():
    scene = textured()
    own = domain(scene, "adapted")
    record = draw(own, scene, (7, 0), np.random.default_rng(3))
    once = vary(own, scene, (7, 0), record)
    again = vary(own, scene, (7, 0), json.loads(json_bytes({"domain": record}))["domain"])
    assert differences(once.scene, again.scene) == []
    assert once.counts == (7, 0)
    assert differences(scene, once.scene) != []


def test_a_scene_without_any_tolerance_equals_the_cell_in_every_bit():
    """Even the sign of a zero is kept, which a product with the identity would lose."""
    down = -np.diag([-1.0, 1.0, 1.0, -1.0])
    down[2, 3] = 0.8
    assert np.signbit(down[0, 1])
    scene = replace(textured(), T_world_cam=down)
    own = domain(scene, NO_TOLERANCE)
    record = draw(own, scene, (7, 0), np.random.default_rng(3))
    assert differences(scene, vary(own, scene, (7, 0), record).scene) == []
    for section in ("camera", "bin", "lamps", "parts"):
        some = {key: value for key, value in NO_TOLERANCE.items() if key != section}
        own = domain(scene, some)
        record = draw(own, scene, (7, 0), np.random.default_rng(3))
        assert differences(scene, vary(own, scene, (7, 0), record).scene) != [], section


def test_a_domain_whose_sections_are_null_varies_only_the_counts():
    scene = cell()
    names = ("camera", "environment", "lamps", "bin", "table", "parts", "distractors")
    own = domain(scene, {"kind": "randomized"} | dict.fromkeys(names))
    record = draw(own, scene, (40, 0), np.random.default_rng(1))
    varied = vary(own, scene, (40, 0), record)
    assert differences(scene, varied.scene) == []
    assert varied.counts == (round(40 * record["count_share"]), 0)
    assert 20 <= varied.counts[0] <= 40


def test_drawn_tilt_azimuth_and_distance_modify_the_configured_view():
    """Oracle: `place` with the sums gives the pose of the record's camera."""
    scene = cell()
    own = domain(scene, {"kind": "randomized", "bin": None})
    moved = {"distance_factor": 1.2, "tilt_rad": 0.15, "azimuth_rad": -0.9, "roll_rad": 0.0,
             "shift_m": [0.02, 0.01, -0.03]}  # fmt: skip
    record = {"kind": "randomized", "camera": moved, "count_share": 1.0, "distractors": {}}
    pose = vary(own, scene, (1, 1), record).scene.T_world_cam
    expected = place(
        scene.rig,
        target_m=np.array(TARGET_M) + moved["shift_m"],
        distance_m=1.2 * DISTANCE_M,
        tilt_rad=TILT_RAD + 0.15,
        azimuth_rad=AZIMUTH_RAD - 0.9,
    )
    assert pose == pytest.approx(expected, abs=1e-12)


def test_drawn_roll_rotates_the_rig_about_its_axis_without_moving_the_rig():
    scene = cell()
    own = domain(scene, {"kind": "randomized", "bin": None})
    record = {"kind": "randomized", "camera": STILL | {"roll_rad": 0.3}, "count_share": 1.0,
              "distractors": {}}  # fmt: skip
    T_cam_rig = frame_in_camera(scene.rig)
    before = scene.T_world_cam @ T_cam_rig
    after = vary(own, scene, (1, 1), record).scene.T_world_cam @ T_cam_rig
    assert after[:3, 3] == pytest.approx(before[:3, 3], abs=1e-12)
    turn = before[:3, :3].T @ after[:3, :3]
    assert turn == pytest.approx(axis_rotation("z", 0.3), abs=1e-12)


def test_moving_the_bin_moves_the_rest_of_the_world_in_the_opposite_direction():
    """The world's origin is on the bin's floor; relative to the cell, camera and lamps stay."""
    scene = replace(cell(), environment=replace(cell().environment, rotation_rad=0.4))
    own = domain(scene, {**NO_TOLERANCE, "bin": {"position_m": 0.05, "rotation_deg": 20}})
    record = draw(own, scene, (1, 1), np.random.default_rng(8))
    varied = vary(own, scene, (1, 1), record).scene
    dx, dy = record["bin"]["offset_m"]
    turn = record["bin"]["turn_rad"]
    T_cell_bin = rigid(axis_rotation("z", turn), np.array([dx, dy, 0.0]))
    assert T_cell_bin @ varied.T_world_cam == pytest.approx(scene.T_world_cam, abs=1e-12)
    for lamp, still in zip(varied.lamps, scene.lamps, strict=True):
        points = np.array([lamp.center_m, lamp.target_m])
        assert transform_points(T_cell_bin, points) == pytest.approx(
            np.array([still.center_m, still.target_m]), abs=1e-12
        )
        assert replace(lamp, center_m=still.center_m, target_m=still.target_m) == still
    # A map's feature at angle a in the world is at a + rotation in the cell, its former place.
    assert varied.environment.rotation_rad + turn == pytest.approx(0.4, abs=1e-12)
    assert varied.bin == scene.bin


def test_the_pose_of_the_rig_is_within_its_tolerance():
    scene = cell()
    settings = {**NO_TOLERANCE, "camera": {"position_m": 0.01, "rotation_deg": 2}}
    own = domain(scene, settings)
    for seed in range(20):
        record = draw(own, scene, (1, 1), np.random.default_rng(seed))
        T = vary(own, scene, (1, 1), record).scene.T_world_cam
        off = T[:3, 3] - scene.T_world_cam[:3, 3]
        assert np.abs(off).max() <= 0.01
        assert off == pytest.approx(record["camera"]["offset_m"], abs=1e-12)
        turn = (inverse(scene.T_world_cam) @ T)[:3, :3]
        angle_deg = np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1)))
        assert angle_deg <= 2 * np.sqrt(3) * 1.01


@pytest.mark.parametrize(("share", "less"), [(0.05, 0.005), (0.5, 0.085)])
def test_a_drawn_lamp_gives_the_stated_irradiance(share, less):
    """Oracle: radiance integrated over the lamp's square, L cos cos / r^2, at the bin's middle."""
    scene = cell()
    record = {"distance_m": 1.6, "elevation_rad": 0.7, "azimuth_rad": 2.0, "size_m": 1.6 * share,
             "irradiance": 3.0, "color_temperature_k": 4000.0}  # fmt: skip
    lamp = lamp_of(record, scene)
    quad = lamp_quad(lamp)
    center, u, v = (np.array(x) for x in (quad.center_m, quad.half_u_m, quad.half_v_m))
    target = np.array([0.0, 0.0, 0.05])
    front = np.cross(u, v) / np.linalg.norm(np.cross(u, v))

    def integrand(s, t):
        away = center + s * u + t * v - target
        r2 = away @ away
        return (away @ -front) ** 2 / r2 / r2 * np.linalg.norm(np.cross(u, v))

    geometry, _ = integrate.dblquad(integrand, -1, 1, -1, 1, epsabs=1e-10)
    irradiance = np.mean(lamp.radiance) * geometry
    assert 3.0 * (1 - less) <= irradiance <= 3.0
    away = center - target
    assert np.linalg.norm(away) == pytest.approx(1.6)
    assert np.arctan2(away[1], away[0]) == pytest.approx(2.0)
    assert np.arcsin(away[2] / 1.6) == pytest.approx(0.7)


def test_distractors_follow_the_parts_and_have_no_label(full):
    scene, own = full
    record = draw(own, scene, (3, 4), np.random.default_rng(0))
    varied = vary(own, scene, (3, 4), record)
    names = [part.name for part in varied.scene.parts]
    assert names == ["box0", "box1", "metal_workpiece_1", "metal_workpiece_2"]
    assert [part.labelled for part in varied.scene.parts] == [True, True, False, False]
    assert varied.counts[2:] == tuple(record["distractors"].values())
    assert sum(varied.counts[2:]) >= 1


def test_a_distractor_that_equals_a_part_of_the_cell_is_refused_or_omitted():
    scene = cell()
    part = replace(scene.parts[0], name="metal_workpiece_1")
    scene = replace(scene, parts=(part,))
    own = domain(scene, "randomized")
    assert [part.name for part in own.distractors] == ["metal_workpiece_2"]
    settings = {"kind": "randomized", "distractors": {"parts": [{"builtin": "metal_workpiece_1"}]}}
    with pytest.raises(ConfigError, match="another part metal_workpiece_1"):
        domain(scene, settings)


def test_default_distractors_that_are_too_large_for_the_bin_are_omitted():
    scene = cell()
    scene = replace(scene, bin=replace(scene.bin, inner_m=(0.4, 0.11, 0.1)))
    assert [part.name for part in domain(scene, "randomized").distractors] == ["metal_workpiece_2"]


def test_files_of_a_domain_are_sorted_by_name(full, monkeypatch, tmp_path):
    own = full[1]
    assert [file.name for file in own.maps] == ["a.exr", "b.hdr"]
    listed = Path.iterdir
    monkeypatch.setattr(Path, "iterdir", lambda folder: sorted(listed(folder), reverse=True))
    again = resolve_domain(own.section, tmp_path, scene=full[0])
    assert (again.maps, again.bin_textures) == (own.maps, own.bin_textures)


def test_the_error_for_a_file_missing_from_the_domain_names_the_file(full):
    scene, own = full
    record = draw(own, scene, (1, 1), np.random.default_rng(0))
    record["environment"]["map"] = "gone.exr"
    with pytest.raises(ConfigError, match=r"no file gone\.exr"):
        vary(own, scene, (1, 1), record)
