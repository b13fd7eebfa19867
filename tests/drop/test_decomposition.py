import os
import subprocess
import sys

import numpy as np
import pytest
import trimesh

from graycast.drop import cache_folder, convex_hulls, decomposition

from .conftest import RING_HEIGHT_M, RING_INNER_M, RING_OUTER_M, box_part


def same(a, b) -> bool:
    pairs = zip(a, b, strict=True)
    return all(np.array_equal(v, w) and np.array_equal(f, g) for (v, f), (w, g) in pairs)


def test_a_box_is_one_hull_of_its_own_volume_and_never_reaches_coacd(tmp_path, monkeypatch):
    monkeypatch.setattr(decomposition, "_coacd", lambda mesh: pytest.fail("CoACD was run"))
    ((vertices, faces),) = convex_hulls(box_part((0.04, 0.05, 0.06)).mesh, folder=tmp_path)
    volume = np.linalg.det(vertices[faces]).sum() / 6  # negative if faces look inwards
    assert volume == pytest.approx(0.04 * 0.05 * 0.06, rel=1e-12)


def test_hulls_of_a_ring_leave_its_hole_open_and_fill_its_body(ring_hulls):
    """Oracle: the ring's closed form. Samples on all hulls, and points well inside the ring."""
    hull_m = np.vstack(
        [
            trimesh.sample.sample_surface(trimesh.Trimesh(v, f), 2000, seed=1)[0]
            for v, f in ring_hulls
        ]
    )
    radius = np.hypot(hull_m[:, 0], hull_m[:, 1])
    assert RING_INNER_M - radius.min() < 0.5e-3
    assert radius.max() - RING_OUTER_M < 1e-6
    assert np.abs(hull_m[:, 2]).max() - RING_HEIGHT_M / 2 < 1e-6
    rng = np.random.default_rng(3)
    r, turn = rng.uniform(0.0153, 0.0247, 5000), rng.uniform(0, 2 * np.pi, 5000)
    z = rng.uniform(-0.0047, 0.0047, 5000)
    body = np.column_stack([r * np.cos(turn), r * np.sin(turn), z])
    held = [trimesh.Trimesh(*hull) for hull in ring_hulls]
    depth = [
        ((body @ h.face_normals.T) - (h.face_normals * h.triangles[:, 0]).sum(axis=1)).max(axis=1)
        for h in held
    ]
    assert np.min(depth, axis=0).max() < 0.05e-3
    assert len(ring_hulls) <= 40


def test_the_measure_of_deviation_is_the_depth_of_a_filled_notch():
    """A point at the bottom of a 3 mm deep notch that one hull bridges is 3 mm deep."""
    hull = decomposition._hull(np.array(trimesh.creation.box((0.1, 0.1, 0.02)).vertices))
    bottom_of_notch = np.array([[0.0, 0.0, 0.007], [0.05, 0.0, 0.0]])
    assert decomposition.deviation_m(bottom_of_notch, (hull,)) == pytest.approx(3e-3)
    lost_corner = np.array([[0.052, 0.0, 0.0]])
    assert decomposition.deviation_m(lost_corner, (hull,)) == pytest.approx(2e-3)


@pytest.mark.parametrize("damage", ["flipped bit", "cut short", "empty", "words"])
def test_a_damaged_cache_file_is_made_anew(tmp_path, damage):
    mesh = box_part((0.04, 0.05, 0.06)).mesh
    good = convex_hulls(mesh, folder=tmp_path)
    (file,) = tmp_path.iterdir()
    data = bytearray(file.read_bytes())
    at = data.index(b"NUMPY") + 150  # among the vertices
    match damage:
        case "flipped bit":
            data[at] ^= 16
        case "cut short":
            data = data[: len(data) // 2]
        case "empty":
            data = b""
        case "words":
            data = b"not a cache file"
    file.write_bytes(data)
    assert same(convex_hulls(mesh, folder=tmp_path), good)
    assert decomposition._read(file) is not None
    assert list(tmp_path.iterdir()) == [file]


def test_a_second_call_reads_the_file_and_another_mesh_has_its_own(tmp_path, monkeypatch):
    mesh = box_part((0.04, 0.05, 0.06)).mesh
    first = convex_hulls(mesh, folder=tmp_path)
    convex_hulls(box_part((0.04, 0.05, 0.06 + 1e-10)).mesh, folder=tmp_path)
    assert len(list(tmp_path.iterdir())) == 2
    monkeypatch.setattr(decomposition, "decompose", lambda mesh: pytest.fail("not from the cache"))
    assert same(convex_hulls(mesh, folder=tmp_path), first)


def test_the_cache_lies_where_xdg_says(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_folder() == tmp_path / "graycast" / "hulls"
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert cache_folder() == tmp_path / ".cache" / "graycast" / "hulls"


@pytest.mark.slow
def test_a_fresh_process_with_one_thread_makes_the_same_bits(ring_part, ring_hulls, tmp_path):
    np.savez(tmp_path / "ring.npz", v=ring_part.mesh.vertices_m, f=ring_part.mesh.faces)
    program = (
        "import numpy as np; from graycast.drop import convex_hulls;"
        "from graycast.parts import Mesh;"
        f"d = np.load({str(tmp_path / 'ring.npz')!r});"
        f"convex_hulls(Mesh(vertices_m=d['v'], faces=d['f']), folder=__import__('pathlib')"
        f".Path({str(tmp_path / 'cache')!r}))"
    )
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    subprocess.run([sys.executable, "-c", program], check=True, env=environment)
    assert same(convex_hulls(ring_part.mesh, folder=tmp_path / "cache"), ring_hulls)
    assert len(list((tmp_path / "cache").iterdir())) == 1
