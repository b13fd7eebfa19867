import re
import subprocess
import sys
from dataclasses import fields

import numpy as np
import pytest
import trimesh

from graycast.base.errors import DropError
from graycast.world.drop import DropLimits, drop, flaws
from graycast.world.scene import Layout

from .conftest import box_part

LIMITS = DropLimits()


@pytest.mark.slow
def test_equal_seeds_give_equal_layouts(scene_of, angle_part, hull_folder):
    scene = scene_of((angle_part,))
    one, again, other = (
        drop(scene, (12,), seed=seed, limits=LIMITS, hull_folder=hull_folder) for seed in (0, 0, 1)
    )
    assert one.T_world_part.tobytes() == again.T_world_part.tobytes()
    assert not np.allclose(one.T_world_part, other.T_world_part, atol=1e-3)


@pytest.mark.slow
def test_a_new_process_with_an_empty_cache_gives_a_bit_identical_layout(
    scene_of, angle_part, hull_folder, tmp_path
):
    here = drop(scene_of((angle_part,)), (12,), seed=5, limits=LIMITS, hull_folder=hull_folder)
    np.savez(tmp_path / "mesh.npz", v=angle_part.mesh.vertices_m, f=angle_part.mesh.faces)
    program = f"""
import numpy as np
from pathlib import Path
from graycast.world.drop import DropLimits, drop
from graycast.world.parts import Material, Mesh, Part
from graycast.rig.pair import preset_rig
from graycast.world.scene import Bin, Scene
folder = Path({str(tmp_path)!r})
data = np.load(folder / "mesh.npz")
part = Part(name="angle", mesh=Mesh(vertices_m=data["v"], faces=data["f"]), material=Material(),
            density_kg_m3=2700.0, friction=0.4)
scene = Scene(rig=preset_rig("paper"), T_world_cam=np.eye(4), parts=(part,),
              bin=Bin(inner_m=(0.4, 0.3, 0.2)))
layout = drop(scene, (12,), seed=5, limits=DropLimits(), hull_folder=folder / "cache")
np.save(folder / "there.npy", layout.T_world_part)
"""
    subprocess.run([sys.executable, "-c", program], check=True)
    assert np.load(tmp_path / "there.npy").tobytes() == here.T_world_part.tobytes()


@pytest.mark.slow
def test_the_true_surfaces_of_parts_in_a_heap_do_not_overlap(scene_of, angle_part, hull_folder):
    """Oracle: the angle is two boxes, so depth below its surface has a closed form.

    Points of every true mesh are tested in every other part, not in its hulls.
    """
    layout = drop(
        scene_of((angle_part,), (0.15, 0.15, 0.2)), (30,), seed=3, limits=LIMITS,
        hull_folder=hull_folder,
    )  # fmt: skip
    shape = trimesh.Trimesh(angle_part.mesh.vertices_m, angle_part.mesh.faces)
    sample = trimesh.sample.sample_surface(shape, 3000, seed=1)[0]
    sample = np.vstack([sample, shape.vertices])
    centers = np.array([[0, 0, 0], [-0.021, 0, 0.025]])
    halves = np.array([[0.05, 0.03, 0.008], [0.008, 0.03, 0.042]]) / 2
    T = layout.T_world_part
    assert flaws(layout, LIMITS) == () and T[:, 2, 3].max() > 0.05  # a heap, not a layer
    deepest, touching = 0.0, 0
    for a in range(len(T)):
        world = sample @ T[a, :3, :3].T + T[a, :3, 3]
        deepest = max(deepest, -world[:, 2].min(), np.abs(world[:, :2]).max() - 0.075)
        for b in set(range(len(T))) - {a}:
            local = (world - T[b, :3, 3]) @ T[b, :3, :3]
            depth = (halves - np.abs(local[:, None] - centers)).min(axis=-1).max()
            deepest, touching = max(deepest, depth), touching + (depth > -0.5e-3)
    assert deepest < LIMITS.penetration_m
    assert touching >= 30  # some parts touch each other


def test_a_kind_with_number_zero_is_ignored_and_others_are_dropped(scene_of, hull_folder):
    never_closed = trimesh.Trimesh(*_one_triangle(), process=False)
    from .conftest import as_part

    parts = (box_part((0.03,) * 3), as_part(never_closed, "open"), box_part((0.05, 0.02, 0.02)))
    layout = drop(scene_of(parts), (5, 0, 7), seed=2, limits=LIMITS, hull_folder=hull_folder)
    assert np.bincount(layout.part_index).tolist() == [5, 0, 7]
    height = layout.T_world_part[:, 2, 3]
    assert (height[layout.part_index == 0] > 0.0148).all()  # half of their smallest side
    assert (height[layout.part_index == 2] > 0.0098).all()


def _one_triangle():
    return np.eye(3) * 0.1, np.array([[0, 1, 2]])


def test_flaws_of_a_layout_are_reported_with_the_number_of_parts():
    pose = np.eye(4)[None]
    good = dict(T_world_part=pose, part_index=np.zeros(1, int))
    assert flaws(Layout(**good, deepest_penetration_m=0.49e-3), LIMITS) == ()
    (text,) = flaws(Layout(**good, deepest_penetration_m=0.51e-3), LIMITS)
    assert "0.51 mm" in text and "0.50 mm" in text
    (text,) = flaws(Layout(**good, outside=1), LIMITS)
    assert "1 of 1 parts lie outside" in text
    (text,) = flaws(Layout(**good, at_rest=False, last_motion_m=0.012, simulated_s=10.0), LIMITS)
    assert "12.00 mm" in text and "10.0 s" in text
    assert len(flaws(Layout(**good, outside=1, at_rest=False), LIMITS)) == 2
    assert flaws(Layout(**good, deepest_penetration_m=float("nan")), LIMITS)


def test_a_drop_is_repeated_with_new_seeds_until_a_layout_has_no_flaw(
    scene_of, hull_folder, monkeypatch
):
    from graycast.world.drop import settle

    starts, real = [], settle.simulate

    def first_two_tremble(box, bodies, start, index, *, simulated_s):
        starts.append(start)
        short = 0.08 if len(starts) <= 2 else simulated_s
        return real(box, bodies, start, index, simulated_s=short)

    monkeypatch.setattr(settle, "simulate", first_two_tremble)
    layout = drop(
        scene_of((box_part((0.03,) * 3),)), (4,), seed=0, limits=LIMITS, hull_folder=hull_folder
    )
    assert layout.attempt == 2 and len(starts) == 3
    assert not np.allclose(starts[0], starts[1]) and not np.allclose(starts[1], starts[2])


@pytest.mark.parametrize(
    "count, end, message, absent",
    [
        (4, dict(at_rest=False), "drop.simulated_s, now 7 s", "larger bin"),
        (1, dict(at_rest=False), "more friction", "fewer|attempts \\(drop"),
        (4, dict(outside=2), "larger bin or fewer parts.*drop.attempts, now 2", "simulated_s"),
        (1, dict(outside=1), "take a larger bin; allow more", "fewer"),
        (4, dict(deepest_penetration_m=1e-3), "drop.penetration_m, now 0.0005 m", "larger bin"),
    ],
)
def test_the_error_for_a_failed_drop_names_a_fitting_remedy_with_existing_keys(
    scene_of, hull_folder, monkeypatch, count, end, message, absent
):
    from graycast.world.drop import settle

    def simulate(box, bodies, start, index, **_):
        return Layout(T_world_part=start, part_index=index, **end)

    monkeypatch.setattr(settle, "simulate", simulate)
    scene, limits = scene_of((box_part((0.03,) * 3),)), DropLimits(simulated_s=7.0, attempts=2)
    with pytest.raises(
        DropError, match=f"^{count} part.*2 attempts; the best: .*{message}"
    ) as caught:
        drop(scene, (count,), seed=0, limits=limits, hull_folder=hull_folder)
    assert not re.search(absent, str(caught.value))
    keys = {field.name for field in fields(DropLimits)}
    assert set(re.findall(r"drop\.(\w+)", str(caught.value))) <= keys


def test_a_bin_without_parts_needs_no_simulation(scene_of, hull_folder, monkeypatch):
    from graycast.world.drop import settle

    monkeypatch.setattr(settle, "simulate", None)  # a call would fail the test
    parts = (box_part((0.03,) * 3), box_part((0.5,) * 3))  # the second does not fit into the bin
    layout = drop(scene_of(parts), (0, 0), seed=0, limits=LIMITS, hull_folder=hull_folder)
    assert layout.T_world_part.shape == (0, 4, 4) and layout.part_index.shape == (0,)
    assert not flaws(layout, LIMITS)


@pytest.mark.parametrize(
    "size_m, counts, message",
    [
        ((0.03,) * 3, (256,), "0 to 255"),
        ((0.03,) * 3, (-1,), "0 or more"),
        ((0.03,) * 3, (1, 1), "for each of: box"),
        ((0.5, 0.5, 0.5), (1,), "500 x 500 x 500 mm and does not fit.*unit"),
        ((0.08,) * 3, (200,), "do not fit into a bin of 24 litres: drop 35"),
        ((0.5, 0.2, 0.02), (1,), None),
    ],
)
def test_impossible_drops_are_refused_before_the_simulation(
    scene_of, hull_folder, size_m, counts, message
):
    scene = scene_of((box_part(size_m),))
    if message is None:  # longer than the bin, but it fits upright
        layout = drop(scene, counts, seed=0, limits=LIMITS, hull_folder=hull_folder)
        assert layout.outside == 0
        return
    with pytest.raises(ValueError, match=message):
        drop(scene, counts, seed=0, limits=LIMITS, hull_folder=hull_folder)
