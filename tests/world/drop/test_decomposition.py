import os
import pwd
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from operator import attrgetter

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull

from benchmarks.zoo_parts import ZOO, wavy_ring, zoo_part
from graycast.base.errors import GraycastError
from graycast.base.progress import Stages
from graycast.world.drop import decomposition, hull_notes, prepare
from graycast.world.drop.decomposition import (
    decompose,
    hull_of,
    hull_store,
    measure,
    mesh_hulls,
    tolerance_m,
)
from graycast.world.drop.decomposition.cache import read_decomposition
from graycast.world.parts import Mesh

from .conftest import RING_HEIGHT_M, RING_INNER_M, RING_OUTER_M, as_part, box_part, convex_hulls


def same(a, b) -> bool:
    pairs = zip(a, b, strict=True)
    return all(np.array_equal(v, w) and np.array_equal(f, g) for (v, f), (w, g) in pairs)


def mesh_of(shape: trimesh.Trimesh) -> Mesh:
    return as_part(shape, "part").mesh


def in_hulls(hulls, point) -> np.ndarray:
    """Return which points are in a hull, independently, by the planes of Qhull."""
    planes = [ConvexHull(vertices).equations for vertices, _ in hulls]
    return np.any([(point @ p[:, :3].T + p[:, 3] < 0).all(axis=1) for p in planes], axis=0)


def test_a_box_becomes_one_hull_of_equal_volume_without_a_child_process(tmp_path, monkeypatch):
    monkeypatch.setattr(subprocess, "Popen", lambda *_, **__: pytest.fail("a child was run"))
    result = convex_hulls(box_part((0.04, 0.05, 0.06)), tmp_path)
    ((vertices, faces),) = result.hulls
    assert result.worst_m < 1e-9 and not result.coarse
    volume = np.linalg.det(vertices[faces]).sum() / 6  # negative if faces look inwards
    assert volume == pytest.approx(0.04 * 0.05 * 0.06, rel=1e-12)


@pytest.mark.slow
def test_hulls_of_a_ring_leave_its_hole_open_and_fill_its_body(ring_part, ring_hulls):
    """Oracle: the ring's closed form, for samples on all hulls and points inside the ring."""
    hull_m = np.vstack(
        [
            trimesh.sample.sample_surface(trimesh.Trimesh(v, f), 2000, seed=1)[0]
            for v, f in ring_hulls
        ]
    )
    radius = np.hypot(hull_m[:, 0], hull_m[:, 1])
    assert RING_INNER_M - radius.min() < tolerance_m(ring_part.mesh)
    assert radius.max() - RING_OUTER_M < 1e-6
    assert np.abs(hull_m[:, 2]).max() - RING_HEIGHT_M / 2 < 1e-6
    rng = np.random.default_rng(3)
    r, turn = rng.uniform(0.0153, 0.0247, 5000), rng.uniform(0, 2 * np.pi, 5000)
    z = rng.uniform(-0.0047, 0.0047, 5000)
    body = np.column_stack([r * np.cos(turn), r * np.sin(turn), z])
    # There are gaps of about 50 nm between the wedges, and a point may be in a gap.
    assert in_hulls(ring_hulls, body).mean() > 0.9995
    assert len(ring_hulls) <= 40


@pytest.mark.parametrize("thickness_m", [0.4e-3, pytest.param(0.8e-3, marks=pytest.mark.slow)])
def test_hulls_of_a_thin_washer_leave_its_hole_open(thickness_m):
    """A hull that fills the hole has no point deeper in it than half the thickness."""
    mesh = mesh_of(trimesh.creation.annulus(4e-3, 8e-3, thickness_m, sections=48))
    hulls = decompose(mesh)
    rng = np.random.default_rng(0)
    r, turn = 3.5e-3 * np.sqrt(rng.random(2000)), rng.uniform(0, 2 * np.pi, 2000)
    z = rng.uniform(-0.5, 0.5, 2000) * thickness_m
    assert not in_hulls(hulls, np.column_stack([r * np.cos(turn), r * np.sin(turn), z])).any()
    assert measure(mesh, hulls).worst_m < tolerance_m(mesh)


@pytest.mark.slow
def test_hulls_of_a_thin_cup_leave_it_open():
    """With walls of 0.3 mm, no point is deep below its hull, but a ball of 30 mm fits into it."""
    outer = trimesh.creation.cylinder(0.018, 0.04, sections=32)
    inner = trimesh.creation.cylinder(0.0177, 0.04, sections=32)
    inner.apply_translation((0, 0, 0.3e-3))
    mesh = mesh_of(trimesh.boolean.difference([outer, inner], engine="manifold"))
    hulls = decompose(mesh)
    rng = np.random.default_rng(0)
    r, turn = 0.016 * np.sqrt(rng.random(2000)), rng.uniform(0, 2 * np.pi, 2000)
    z = rng.uniform(-0.018, 0.02, 2000)
    assert not in_hulls(hulls, np.column_stack([r * np.cos(turn), r * np.sin(turn), z])).any()


def test_a_bolt_becomes_hulls_of_a_hexagonal_prism_and_a_round_shank():
    """The hulls are exact: twelve vertices of the head, and a shank with the mesh's own rings."""
    mesh = zoo_part("hex_bolt").mesh
    hulls = sorted(decompose(mesh), key=lambda hull: len(hull[0]))
    head, shank = hulls[0][0], hulls[1][0]
    assert len(hulls) == 2 and len(head) == 12
    flats = np.hypot(head[:, 0], head[:, 1])
    assert flats == pytest.approx(np.full(12, 6.5e-3 * 2 / np.sqrt(3)), abs=1e-7)
    assert np.ptp(head[:, 2]) == pytest.approx(5.3e-3, abs=1e-7)
    radius = np.hypot(shank[:, 0], shank[:, 1]) * 1e3
    assert np.minimum(np.abs(radius - 4), np.abs(radius - 2.75)).max() < 1e-4
    error = measure(mesh, tuple(hulls))
    assert error.filled_m < 1e-7 and error.lost_m < 0.003 * 0.037


def test_two_cubes_that_share_an_edge_become_two_hulls():
    one = trimesh.creation.box((0.02,) * 3)
    other = one.copy()
    other.apply_translation((0.02, 0.02, 0))
    both = trimesh.util.concatenate([one, other])
    both.merge_vertices()
    assert len(both.vertices) == 14
    hulls = decompose(mesh_of(both))
    assert [len(vertices) for vertices, _ in hulls] == [8, 8]
    volumes = [ConvexHull(vertices).volume for vertices, _ in hulls]
    assert volumes == pytest.approx([8e-6, 8e-6], rel=1e-5)


def test_hulls_fill_an_inner_cavity():
    outer = trimesh.creation.box((0.04,) * 3)
    inner = trimesh.creation.box((0.03,) * 3)
    inner.invert()
    mesh = mesh_of(trimesh.util.concatenate([outer, inner]))
    assert [len(vertices) for vertices, _ in decompose(mesh)] == [8]


def test_the_error_of_hulls_is_the_depth_of_a_filled_notch_or_a_lost_end():
    """One hull bridges a wide notch that is 3 mm deep; another hull ends 2 mm early."""
    block = trimesh.creation.box((0.1, 0.1, 0.02))
    notch = trimesh.creation.box((0.04, 0.2, 0.006))
    notch.apply_translation((0, 0, 0.01))
    mesh = mesh_of(trimesh.boolean.difference([block, notch], engine="manifold"))
    corners = np.array(block.vertices)
    full = hull_of(corners)
    assert measure(mesh, (full,)).filled_m == pytest.approx(3e-3, rel=0.01)
    assert measure(mesh, (full,)).lost_m == pytest.approx(0, abs=1e-8)
    short = hull_of(np.minimum(corners, [0.048, 1, 1]))
    assert measure(mesh, (short,)).lost_m == pytest.approx(2e-3, rel=0.01)


def test_distances_from_points_to_triangles_agree_with_trimesh():
    rng = np.random.default_rng(1)
    corner, point = rng.normal(size=(300, 3, 3)), rng.normal(size=(300, 3))
    nearest = decomposition.error._nearest_m(point, np.arange(300)[:, None], corner)
    foot = trimesh.triangles.closest_point(corner, point)
    assert nearest == pytest.approx(np.linalg.norm(point - foot, axis=1), abs=1e-12)


@pytest.mark.parametrize("open_or_reversed", ["open", "reversed"])
def test_a_mesh_that_is_not_a_solid_is_refused_with_the_reason(open_or_reversed, tmp_path):
    shape = trimesh.creation.box((0.04,) * 3)
    if open_or_reversed == "open":
        shape.update_faces(np.arange(12) > 0)
    else:
        shape.invert()
    with pytest.raises(ValueError, match=r"close its holes and turn|turn its faces outward"):
        convex_hulls(as_part(shape, "part"), tmp_path)


@pytest.mark.parametrize("damage", ["flipped bit", "cut short", "empty", "words"])
def test_a_damaged_cache_file_of_hulls_is_replaced(tmp_path, damage):
    part = box_part((0.04, 0.05, 0.06))
    good = convex_hulls(part, tmp_path).hulls
    (file,) = tmp_path.iterdir()
    data = bytearray(file.read_bytes())
    at = data.index(b"NUMPY") + 150  # This position is among the vertices.
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
    assert same(convex_hulls(part, tmp_path).hulls, good)
    assert read_decomposition(file) is not None
    assert list(tmp_path.iterdir()) == [file]


def test_hulls_are_read_from_the_cache_and_each_mesh_has_its_own_file(tmp_path, monkeypatch):
    part = box_part((0.04, 0.05, 0.06))
    first = convex_hulls(part, tmp_path)
    convex_hulls(box_part((0.04, 0.05, 0.06 + 1e-10)), tmp_path)
    assert len(list(tmp_path.iterdir())) == 2
    monkeypatch.setattr(hull_store, "decompose", lambda mesh: pytest.fail("not from the cache"))
    again = convex_hulls(part, tmp_path)
    assert same(again.hulls, first.hulls)
    figures = attrgetter("filled_m", "lost_m", "tolerance_m")
    assert figures(again) == figures(first)


def test_the_cache_of_hulls_is_in_the_xdg_cache_folder(tmp_path, monkeypatch):
    part = box_part((0.04, 0.05, 0.06))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    prepare((part,))
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path))
    prepare((part,))
    for folder in (tmp_path / "graycast" / "hulls", tmp_path / ".cache" / "graycast" / "hulls"):
        assert [file.suffix for file in folder.iterdir()] == [".npz"]


@pytest.mark.parametrize("home", ["a file", "a folder that may not be made", "none"])
def test_hulls_are_computed_even_if_they_cannot_be_stored(tmp_path, monkeypatch, home):
    """A container's user has no home, and this default folder must not cause an error."""
    part = box_part((0.04, 0.05, 0.06))
    good = convex_hulls(part, tmp_path / "hulls").hulls
    file = tmp_path / "file"
    file.write_text("in the place of a folder")
    monkeypatch.setenv("XDG_CACHE_HOME", "/proc/none" if "may not" in home else str(file))
    if home == "none":
        monkeypatch.delenv("XDG_CACHE_HOME")
        monkeypatch.delenv("HOME", raising=False)
        monkeypatch.setattr(pwd, "getpwuid", lambda user: {}[user])
    (result,) = prepare((part,))
    assert same(result.hulls, good)


@pytest.mark.slow
def test_decomposing_a_single_part_reports_its_stages(tmp_path):
    part, stages = zoo_part("nut"), []
    (result,) = prepare((part,), hull_folder=tmp_path, progress=Stages(stages.append))
    assert len(result.hulls) > 1
    assert result.worst_m == measure(part.mesh, result.hulls).worst_m and not result.coarse
    assert stages[0] == "nut: building a solid from 552 faces" and len(stages) < 20
    assert stages[-1].startswith("nut: measuring")


@pytest.fixture
def children(monkeypatch, tmp_path):
    """Return all child processes in the order of their starts; two processors are available.

    Temporary folders are in `tmp_path / "aside"`.
    """
    started = []

    class Recorded(subprocess.Popen):
        def __init__(self, *args, **named):
            super().__init__(*args, **named)
            started.append(self)

    monkeypatch.setattr(subprocess, "Popen", Recorded)
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: {0, 1})
    (tmp_path / "aside").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "aside"))
    yield started
    assert not any(_alive(child.pid) for child in started)
    assert list((tmp_path / "aside").iterdir()) == []


@pytest.mark.slow
def test_two_child_processes_make_the_same_hulls_as_one_process(children, tmp_path):
    box = box_part((0.04, 0.05, 0.06))
    nut, *others = (zoo_part(name) for name in ("nut", "washer", "hex_bolt"))
    parts = (box, nut, *others, replace(nut, name="another nut"))
    stages, starts = [], []

    def note(stage):
        stages.append(stage)
        starts.append(len(children))
        assert sum(_alive(child.pid) for child in children) <= 2

    results = prepare(parts, hull_folder=tmp_path / "cache", progress=Stages(note))
    assert starts[0] == 2 and len(children) == 3
    for part, one in zip(parts, results, strict=True):
        hulls = decompose(part.mesh)
        assert same(one.hulls, hulls) and one.worst_m == measure(part.mesh, hulls).worst_m
    counts = [f"collision hulls: {number} of 4 kinds are ready" for number in (1, 2, 3)]
    assert list(dict.fromkeys(stage for stage in stages if "kinds" in stage)) == counts
    last = stages[stages.index(counts[-1]) + 1 :]
    assert len({stage.split(": ")[0] for stage in last}) <= 1

    again = prepare(parts, hull_folder=tmp_path / "cache", progress=Stages(pytest.fail))
    assert all(same(a.hulls, b.hulls) for a, b in zip(results, again, strict=True))
    assert len(list((tmp_path / "cache").iterdir())) == 4 and len(children) == 3


@pytest.mark.slow
def test_an_error_in_one_part_ends_all_child_processes_and_keeps_finished_hulls(children, tmp_path):
    parts = [box_part((0.04, 0.05, 0.06)), *map(zoo_part, ("washer", "nut", "hex_bolt"))]

    def stop(stage):
        assert stage == "collision hulls: 1 of 4 kinds are ready"
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        prepare(parts, hull_folder=tmp_path / "cache", progress=Stages(stop))
    assert [child.returncode for child in children] == [-signal.SIGKILL] * 2
    assert len(list((tmp_path / "cache").iterdir())) == 1


@pytest.mark.slow
def test_a_killed_child_gives_an_error_and_ends_all_children(children, tmp_path):
    with pytest.raises(GraycastError, match=r"cuts tee .* was killed by signal 9.*free memory"):
        prepare(
            [zoo_part("tee"), zoo_part("nut")],
            hull_folder=tmp_path / "cache",
            progress=Stages(lambda stage: children[0].kill()),
        )
    assert [child.returncode for child in children] == [-signal.SIGKILL] * 2


WAIT = """
import signal, sys
import numpy as np
from pathlib import Path
from graycast.base.progress import Stages
from graycast.world.drop import prepare
from graycast.world.parts import Material, Mesh, Part
signal.signal(signal.SIGTERM, lambda *_: sys.exit(7))
data = np.load({mesh!r})
mesh = Mesh(vertices_m=data["v"], faces=data["f"])
print("start", flush=True)
meter = Stages(lambda stage: print(stage, flush=True))
part = Part(name="ring", mesh=mesh, material=Material(), density_kg_m3=1000.0, friction=0.4)
prepare((part,), hull_folder=Path({folder!r}), progress=meter)
"""


@pytest.mark.slow
@pytest.mark.parametrize("stage", ["start", "building", "cutting", "joining"])
def test_a_batch_system_s_stop_signal_ends_decomposition_at_any_stage(stage, tmp_path):
    """The process ends within 2 s, and leaves no child process."""
    mesh = wavy_ring(330_000)
    np.savez(tmp_path / "mesh.npz", v=mesh.vertices_m, f=mesh.faces)
    program = WAIT.format(mesh=str(tmp_path / "mesh.npz"), folder=str(tmp_path / "cache"))
    process = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
    with process:
        assert any(line.removeprefix("ring: ").startswith(stage) for line in process.stdout)
        children = _children(process.pid)
        stopped = time.perf_counter()
        process.send_signal(signal.SIGTERM)
        assert process.wait(timeout=60) == 7
        seconds = time.perf_counter() - stopped
    assert stage == "start" or children
    assert not any(_alive(pid) for pid in children)
    print(f"{stage}: {seconds:.2f} s")
    assert seconds < 2


@pytest.mark.slow
def test_the_decomposing_child_ends_if_its_parent_is_killed(tmp_path):
    mesh = wavy_ring(80_000)
    np.savez(tmp_path / "mesh.npz", v=mesh.vertices_m, f=mesh.faces)
    program = WAIT.format(mesh=str(tmp_path / "mesh.npz"), folder=str(tmp_path / "cache"))
    process = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
    with process:
        assert any(line.startswith("ring: cutting") for line in process.stdout)
        (pid,) = _children(process.pid)
        process.kill()
        process.wait()
    until = time.perf_counter() + 5
    while _alive(pid) and time.perf_counter() < until:
        time.sleep(0.05)
    assert not _alive(pid)


def _children(pid: int) -> list[int]:
    with open(f"/proc/{pid}/task/{pid}/children") as file:
        return [int(number) for number in file.read().split()]


def _alive(pid: int) -> bool:
    try:
        with open(f"/proc/{pid}/stat") as file:
            return file.read().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.slow
@pytest.mark.parametrize("name", ZOO)
def test_hulls_of_each_part_in_the_zoo_are_within_their_error_bound(name):
    mesh = zoo_part(name).mesh
    assert measure(mesh, decompose(mesh)).worst_m <= tolerance_m(mesh)


@pytest.mark.slow
def test_hulls_of_a_part_with_half_a_million_faces_keep_bound_and_hole():
    """The bound includes the simplification, since hulls are compared with the original mesh."""
    mesh = wavy_ring(500_000)
    hulls = decompose(mesh)
    assert measure(mesh, hulls).worst_m <= tolerance_m(mesh)
    turn = np.linspace(0, 2 * np.pi, 500)
    for radius_m in (0.0, 0.005, 0.01):  # the hole is at least 11.5 mm wide
        circle = [radius_m * np.cos(turn), radius_m * np.sin(turn), 0 * turn]
        assert not in_hulls(hulls, np.stack(circle, axis=1)).any()


@pytest.mark.slow
def test_a_part_with_too_much_detail_is_decomposed_coarsely_with_a_note(monkeypatch):
    stages = []
    monkeypatch.setattr(mesh_hulls, "MOST_PIECES", 4)
    hulls = decompose(zoo_part("nut").mesh, progress=Stages(stages.append))
    assert 1 <= len(hulls) <= 4
    assert any(
        stage.startswith("the mesh is too detailed for this bound: cutting within 1.00 mm")
        for stage in stages
    )


@pytest.mark.slow
def test_hulls_beyond_their_error_bound_cause_a_note_with_the_measured_error():
    """A washer as one hull. Oracle: the middle of its hole is 4 mm from the wall.

    About nine of the 1000 samples are within 0.5 mm of the hole's axis.
    """
    shape = trimesh.creation.annulus(4e-3, 8e-3, 3e-3, sections=48)
    part = as_part(shape, "washer")
    full = hull_of(np.array(shape.vertices))
    result = measure(part.mesh, (full,))
    assert result.coarse and 3.5e-3 < result.filled_m < 4e-3
    (note,) = hull_notes((part,), (result,))
    assert (
        note.startswith("washer: its collision hulls are too coarse")
        and "the bound is 0.50 mm." in note
    )
    assert f"{1e3 * result.worst_m:.2f} mm from its surface" in note
    fine = measure(part.mesh, decompose(part.mesh))
    assert not fine.coarse and hull_notes((part,), (fine,)) == ()


@pytest.mark.slow
def test_hulls_of_a_spring_leave_its_inside_open():
    """Oracle: the inner radius is 6 mm; wire, facets and the tolerance reduce it by 0.5 mm."""
    hulls = decompose(zoo_part("spring").mesh)
    rng = np.random.default_rng(0)
    r, turn = 5.5e-3 * np.sqrt(rng.random(5000)), rng.uniform(0, 2 * np.pi, 5000)
    inside = np.column_stack([r * np.cos(turn), r * np.sin(turn), rng.uniform(-0.02, 0.02, 5000)])
    assert not in_hulls(hulls, inside).any()


@pytest.mark.slow
def test_a_new_process_with_one_thread_makes_bit_identical_hulls(ring_part, ring_hulls, tmp_path):
    np.savez(tmp_path / "ring.npz", v=ring_part.mesh.vertices_m, f=ring_part.mesh.faces)
    program = (
        "import numpy as np; from pathlib import Path; from graycast.world.drop import prepare;"
        "from graycast.world.parts import Material, Mesh, Part;"
        f"d = np.load({str(tmp_path / 'ring.npz')!r});"
        "mesh = Mesh(vertices_m=d['v'], faces=d['f']);"
        "part = Part(name='', mesh=mesh, material=Material(), density_kg_m3=1.0, friction=0.0);"
        f"prepare((part,), hull_folder=Path({str(tmp_path / 'cache')!r}))"
    )
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    subprocess.run([sys.executable, "-c", program], check=True, env=environment)
    assert same(convex_hulls(ring_part, tmp_path / "cache").hulls, ring_hulls)
    assert len(list((tmp_path / "cache").iterdir())) == 1
