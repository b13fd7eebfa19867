"""Scene folders, read as bop_toolkit's `inout` does, compared with closed forms."""

import io
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image
from prisms import SCALE_MM, box_part, build_sample, wedge_part

from graycast.base.errors import DatasetError
from graycast.base.frames import inverse, pixel_grid, transform_points
from graycast.camera.decode import Reason
from graycast.dataset.write.bop import scene_files
from graycast.dataset.write.models import diameter, model_files, models_info
from graycast.dataset.write.picture_bytes import depth_scale_mm
from graycast.rig.optics import project, rays


def load_json(path: Path):
    """Do the same as bop_toolkit's `load_json(..., keys_to_int=True)`."""
    return json.loads(
        path.read_text(),
        object_hook=lambda x: {int(k) if k.lstrip("-").isdigit() else k: v for k, v in x.items()},
    )


def load_image(path: Path):
    with Image.open(path) as image:
        return image.mode, np.array(image)


def load_ply(path: Path):
    """Read an ASCII file by the rules of bop_toolkit's `load_ply` for names and order."""
    lines = path.read_text().splitlines()
    end = lines.index("end_header")
    section, props, count, texture = "", [], {}, None
    for line in lines[:end]:
        if line.startswith("comment TextureFile"):
            texture = line.split()[-1]
        elif line.startswith("element"):
            section = line.split()[1]
            count[section] = int(line.split()[2])
        elif line.startswith("property") and section == "vertex":
            props.append(line.split()[-1])
    body = lines[end + 1 :]
    assert len(body) == count["vertex"] + count["face"]
    vertex = np.array([line.split() for line in body[: count["vertex"]]], dtype=float)
    face = np.array([line.split() for line in body[count["vertex"] :]], dtype=int)
    assert (face[:, 0] == 3).all()
    column = dict(zip(props, vertex.T, strict=True))
    return column, face[:, 1:], texture


@pytest.fixture
def scene(dataset):
    return dataset / "train" / "000000"


def test_model_points_are_projected_to_their_place_in_the_world(scene, dataset, samples):
    """Oracle: BOP's s p = K [R|t] p_m with the files' numbers; ours goes through the world."""
    sample = samples[0]
    view = load_json(scene / "scene_camera.json")[0]
    K = np.array(view["cam_K"]).reshape(3, 3)
    for i, gt in enumerate(load_json(scene / "scene_gt.json")[0]):
        column, _, _ = load_ply(dataset / "models" / f"obj_{gt['obj_id']:06d}.ply")
        point_mm = np.stack([column["x"], column["y"], column["z"]])
        R = np.array(gt["cam_R_m2c"]).reshape(3, 3)
        s, t = K @ (R @ point_mm + np.array(gt["cam_t_m2c"]).reshape(3, 1)), None
        T_world_part = sample.layout.T_world_part[i]
        world_m = point_mm.T / 1000 @ T_world_part[:3, :3].T + T_world_part[:3, 3]
        t = np.linalg.solve(sample.scene.T_world_cam[:3, :3], (world_m - origin(sample)).T)
        expected = project(sample.scene.rig.camera, t.T)
        assert np.abs((s[:2] / s[2]).T - expected).max() < 1e-5
        # cam_R_w2c must give the same points.
        R_w2c = np.array(view["cam_R_w2c"]).reshape(3, 3)
        w2c = R_w2c @ (1000 * world_m.T) + np.array(view["cam_t_w2c"]).reshape(3, 1)
        assert np.abs(w2c - 1000 * t).max() < 1e-5


def origin(sample):
    return sample.scene.T_world_cam[:3, 3]


def test_depth_pictures_times_their_scale_are_the_depth(scene, samples):
    scale = load_json(scene / "scene_camera.json")[0]["depth_scale"]
    scanner = samples[0].scanner_depth
    for name, depth_m in (("depth", samples[0].truth.depth_m), ("depth_sl", scanner.depth_m)):
        mode, steps = load_image(scene / name / "000000.png")
        assert mode == "I;16"
        assert np.array_equal(steps == 0, np.isnan(depth_m))
        known = steps > 0
        assert np.abs(steps[known] * scale - 1000 * depth_m[known]).max() <= scale / 2 + 1e-9
    assert np.array_equal(load_image(scene / "reason_sl" / "000000.png")[1], scanner.reason)


def test_pictures_and_masks_have_the_colour_modes_that_readers_expect(scene, samples):
    for name, mode, image in (("rgb", "RGB", samples[0].rgb), ("gray_sl", "L", samples[0].gray)):
        read_mode, pixels = load_image(scene / name / "000000.png")
        assert read_mode == mode
        assert np.array_equal(pixels, image)
    for path in (scene / "mask_visib").iterdir():
        mode, mask = load_image(path)
        assert mode == "L"
        assert set(np.unique(mask)) <= {0, 255}


def test_modulation_is_read_back_by_its_scale(scene, samples):
    scale = load_json(scene / "scene_sl.json")[0]["modulation_scale"]
    _, steps = load_image(scene / "modulation_sl" / "000000.png")
    assert np.abs(steps * scale - samples[0].modulation).max() <= scale / 2
    assert scale < 2 * samples[0].modulation.max() / 65535


def test_scene_info_has_the_same_counts_as_calc_gt_info(scene, samples):
    """Oracle: bop_toolkit's definitions on the ray-traced layers, on a canvas of three images."""
    sample = samples[0]
    h, w = sample.truth.instance.shape
    visible = np.full((3 * h, 3 * w), -1)
    visible[h : 2 * h, w : 2 * w] = sample.truth.instance
    for suffix, depth_m in (("", sample.truth.depth_m), ("_sl", sample.scanner_depth.depth_m)):
        infos = load_json(scene / f"scene_gt_info{suffix}.json")[0]
        assert len(infos) == 8
        for i, info in enumerate(infos):
            large = np.zeros((3 * h, 3 * w), dtype=bool)
            crop = sample.truth.amodal[i]
            top, left = h + crop.top_px, w + crop.left_px
            large[top : top + crop.mask.shape[0], left : left + crop.mask.shape[1]] = crop.mask
            mask = visible == i
            valid = large[h : 2 * h, w : 2 * w] & ~np.isnan(depth_m)
            box, box_visib = [-1] * 4, [-1] * 4
            if mask.any():
                (y, x), (yv, xv) = large.nonzero(), mask.nonzero()
                box = [x.min() - w, y.min() - h, np.ptp(x), np.ptp(y)]
                box_visib = [xv.min() - w, yv.min() - h, np.ptp(xv), np.ptp(yv)]
            assert info == {
                "px_count_all": large.sum(),
                "px_count_valid": valid.sum(),
                "px_count_visib": mask.sum(),
                "visib_fract": pytest.approx(mask.sum() / large.sum(), abs=1e-12),
                "bbox_obj": box,
                "bbox_visib": box_visib,
            }


def test_masks_are_the_silhouettes_inside_the_image(scene, samples):
    truth = samples[0].truth
    for i, silhouette in enumerate(truth.amodal):
        for suffix in ("", "_sl"):
            _, mask = load_image(scene / f"mask{suffix}" / f"000000_{i:06d}.png")
            _, visible = load_image(scene / f"mask_visib{suffix}" / f"000000_{i:06d}.png")
            assert np.array_equal(mask > 0, silhouette.in_image(*truth.instance.shape))
            assert np.array_equal(visible > 0, truth.instance == i)


def test_boxes_in_space_are_tight_around_the_placed_parts(scene, samples):
    """Oracle: in the box's own frame, the placed vertices span its size about its centre."""
    sample = samples[0]
    for i, box in enumerate(load_json(scene / "scene_gt_box3d.json")[0]):
        part = sample.scene.parts[sample.layout.part_index[i]]
        T = inverse(sample.scene.T_world_cam) @ sample.layout.T_world_part[i]
        posed_mm = 1000 * transform_points(T, part.mesh.vertices_m)
        local = (posed_mm - box["center"]) @ np.array(box["R"]).reshape(3, 3)
        assert np.abs(local.max(axis=0) - np.array(box["size"]) / 2).max() < 1e-6
        assert np.abs(local.min(axis=0) + np.array(box["size"]) / 2).max() < 1e-6


def test_a_vertex_without_a_face_is_not_written(rig):
    """Some mesh files have such vertices, but the part has no surface there."""
    parts = box_part(), wedge_part()
    loose = []
    for part in parts:
        vertices_m = np.vstack([part.mesh.vertices_m, [[0.3, -0.4, 0.5]]])
        loose.append(replace(part, mesh=replace(part.mesh, vertices_m=vertices_m)))
    expected, result = (
        (
            dict(scene_files([build_sample(0, parts=tuple(p), rig=rig)], SCALE_MM)),
            model_files(tuple(p)),
            models_info(tuple(p)),
        )
        for p in (parts, loose)
    )
    assert result == expected
    assert "scene_gt_box3d.json" in result[0]


def test_an_independent_reader_reads_the_models_in_millimetres(dataset, parts):
    for obj_id, part in enumerate(parts, start=1):
        mesh = trimesh.load_mesh(dataset / "models" / f"obj_{obj_id:06d}.ply", process=False)
        mesh.merge_vertices(merge_tex=True, merge_norm=True)
        assert mesh.is_watertight
        own = trimesh.Trimesh(part.mesh.vertices_m, part.mesh.faces)
        assert mesh.volume == pytest.approx(1e9 * own.volume, rel=1e-6)
        assert np.allclose(mesh.bounds, 1000 * own.bounds, atol=1e-5)


def test_every_face_corner_keeps_its_texture_coordinates_and_normal(dataset, parts):
    """Oracle: each face of the file, looked up by corner, has the mesh's own uv and normals."""
    column, faces, texture = load_ply(dataset / "models" / "obj_000001.ply")
    mesh = parts[0].mesh
    uv = np.stack([column["texture_u"], column["texture_v"]], axis=-1)[faces]
    normal = np.stack([column["nx"], column["ny"], column["nz"]], axis=-1)[faces]
    vertex = np.stack([column["x"], column["y"], column["z"]], axis=-1)[faces]
    assert np.allclose(vertex, 1000 * mesh.vertices_m[mesh.faces], atol=1e-6)
    assert np.allclose(uv, mesh.corner_uv, atol=1e-6)
    assert np.allclose(normal, mesh.corner_normals, atol=1e-6)
    assert np.array_equal(load_image(dataset / "models" / texture)[1], parts[0].material.texture)
    loaded = trimesh.load_mesh(dataset / "models" / "obj_000001.ply", process=False)
    assert loaded.visual.material.image.size == (4, 8)
    assert np.allclose(loaded.visual.uv[loaded.faces], mesh.corner_uv, atol=1e-6)


def test_vertex_normals_of_a_plain_mesh_are_weighted_by_the_angles_of_faces(dataset, parts):
    """Oracle: trimesh's own angle-weighted vertex normals."""
    column, faces, texture = load_ply(dataset / "models" / "obj_000002.ply")
    mesh = parts[1].mesh
    own = trimesh.Trimesh(mesh.vertices_m, mesh.faces, process=False)
    weighted = trimesh.geometry.weighted_vertex_normals(
        len(own.vertices), own.faces, own.face_normals, own.face_angles
    )
    normal = np.stack([column["nx"], column["ny"], column["nz"]], axis=-1)[faces]
    assert np.allclose(normal, weighted[own.faces], atol=2e-6)
    assert texture is None
    # 0.5 linear is 188 of 255 in sRGB, 0.2 is 124.
    assert (column["red"][0], column["green"][0], column["blue"][0]) == (188, 124, 0)


def test_models_info_has_the_true_diameter_and_symmetries_in_millimetres(dataset):
    info = load_json(dataset / "models" / "models_info.json")
    assert info[1]["diameter"] == pytest.approx(np.sqrt(30**2 + 40**2 + 60**2))
    assert info[2]["diameter"] == pytest.approx(np.sqrt(50**2 + 30**2 + 40**2))
    assert [info[2][f"min_{a}"] for a in "xyz"] == pytest.approx([0, 0, -12])
    assert [info[2][f"size_{a}"] for a in "xyz"] == pytest.approx([50, 30, 40])
    turn = np.array(info[1]["symmetries_discrete"]).reshape(-1, 4, 4)
    # Half a turn about z through (0.5, 0) mm takes the point (3, 4, 5) to (-2, -4, 5).
    assert np.allclose(turn @ [3, 4, 5, 1], [[-2, -4, 5, 1]])
    assert info[2]["symmetries_continuous"] == [{"axis": [0, 0, 1], "offset": [0, 2.0, 0]}]
    assert "symmetries_continuous" not in info[1]


@pytest.mark.parametrize("flat", [False, True])
def test_the_diameter_is_the_largest_distance_between_two_vertices(flat):
    points = np.random.default_rng(5).normal(size=(400, 3)) * [1, 2, 0 if flat else 0.5]
    brute = np.linalg.norm(points[:, None] - points[None], axis=-1).max()
    assert diameter(points) == pytest.approx(brute, rel=1e-12)


def test_the_camera_file_describes_the_camera(dataset, rig):
    c = json.loads((dataset / "camera.json").read_text())
    K = [[c["fx"], 0, c["cx"]], [0, c["fy"], c["cy"]], [0, 0, 1]]
    assert np.array_equal(K, rig.camera.K)
    assert (c["width"], c["height"], c["depth_scale"]) == (160, 120, SCALE_MM)


@pytest.mark.parametrize(
    ("reach_m", "scale_mm"),
    [
        (0.05, 0.001),
        (0.52, 0.01),
        (1.118, 0.02),
        (1.3106, 0.02),
        (1.3107, 0.05),
        (1.311, 0.05),
        (65.0, 1.0),
    ],
)
def test_the_depth_scale_spreads_16_bits_over_the_range(reach_m, scale_mm):
    assert depth_scale_mm(reach_m) == scale_mm


def test_the_depth_scale_wastes_at_most_a_factor_of_two_and_a_half():
    for reach_m in np.geomspace(0.03, 65.5, 200):
        steps = reach_m * 1e3 / depth_scale_mm(float(reach_m))
        assert 65534 / 2.5 - 1 < steps <= 65534


def test_an_impossible_range_of_depth_is_refused():
    with pytest.raises(ValueError, match="65"):
        depth_scale_mm(70.0)
    with pytest.raises(ValueError, match="above 0"):
        depth_scale_mm(0.0)


def test_equal_samples_give_equal_bytes(samples, parts, rig):
    first = dict(scene_files([samples[0]], 0.1))
    turned = dict(reversed(samples[0].manifest.items()))
    copied = replace(samples[0], rgb=samples[0].rgb.copy(), manifest=turned)
    assert dict(scene_files([copied], 0.1)) == first
    assert not any(name.startswith("/") or ".." in name for name in first)


def test_a_part_beyond_the_depth_scale_is_refused_and_a_wall_there_is_unknown(samples):
    truth = samples[0].truth
    part = truth.instance >= 0
    far_wall = replace(truth, depth_m=np.where(part, truth.depth_m, 1e3))
    files = dict(scene_files([replace(samples[0], truth=far_wall)], 0.1))
    steps = np.array(Image.open(io.BytesIO(files["depth/000000.png"])))
    assert np.array_equal(steps > 0, part)
    far_part = replace(truth, depth_m=np.where(part, 7.0, truth.depth_m))
    with pytest.raises(DatasetError, match=r"7 m does not fit .* {depth_step_mm: 0.2}"):
        dict(scene_files([replace(samples[0], truth=far_part)], 0.1))


def test_a_measured_depth_beyond_the_scale_is_refused(samples):
    depth_m = samples[0].scanner_depth.depth_m.copy()
    depth_m[samples[0].scanner_depth.reason == Reason.DECODED] = 6.6
    scanner = replace(samples[0].scanner_depth, depth_m=depth_m)
    with pytest.raises(DatasetError, match=r"6\.6 m does not fit"):
        dict(scene_files([replace(samples[0], scanner_depth=scanner)], 0.1))


def test_images_that_differ_from_the_camera_in_size_are_refused(samples, rig):
    wide = replace(rig, camera=replace(rig.camera, width_px=161))
    sample = replace(samples[0], scene=replace(samples[0].scene, rig=wide))
    with pytest.raises(ValueError, match=r"rgb is \(120, 160\), the camera has \(120, 161\)"):
        dict(scene_files([sample], 0.1))


def test_a_manifest_writes_nan_as_null_and_refuses_values_without_a_json_form(samples):
    sample = replace(samples[0], manifest={"noise": np.float32("nan"), "at": Path("a/b")})
    manifest = json.loads(dict(scene_files([sample], 0.1))["manifest.json"])
    assert {key: manifest[key] for key in sample.manifest} == {"noise": None, "at": "a/b"}
    with pytest.raises(ValueError, match="no JSON form"):
        dict(scene_files([replace(samples[0], manifest={"rig": object()})], 0.1))


def test_back_projected_depth_pixels_are_on_the_wall(scene, samples):
    """Oracle: the wall's plane; half a pixel of shift would move these points by 0.5 mm."""
    _, steps = load_image(scene / "depth" / "000000.png")
    wall = samples[0].truth.instance == -1
    ray = rays(samples[0].scene.rig.camera, pixel_grid(*steps.shape))
    point_m = (ray * (steps * SCALE_MM / 1e3)[..., None])[wall]
    off_m = point_m @ [0.1, -0.2, 1.0] - 0.62
    assert np.abs(off_m).max() < 0.5 * SCALE_MM / 1e3 * 1.2
