"""The list of scanners that measure a field at a distance with a limited noise."""

import re
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from backends import slow

from graycast.base.frames import inverse, transform_points
from graycast.rig.optics import Optics, in_picture, project
from graycast.rig.pair import PRESETS, Rig, preset_rig
from graycast.rig.shelf import class_of, measured, source_lines, stated_numbers
from graycast.show.report import shelf_list
from graycast.show.report.shelf_list import covers, shelf_lines, stored_noise_m


def names(**wish):
    return [line.split()[0] for line in shelf_lines(**wish)]


def parallel_rig():
    """Return a rig with fields of 1 z by 0.5 z; the projector is 0.2 m to the right."""
    lens = Optics(width_px=200, height_px=100, fx_px=200.0, fy_px=200.0, cx_px=99.5, cy_px=49.5)
    T = np.eye(4)
    T[0, 3] = 0.2
    return Rig(name="two", camera=lens, projector=lens, T_cam_proj=T, near_m=0.5, far_m=2.0)


@pytest.mark.parametrize(
    ("field_m", "fits"),
    [((0.79, 0.49), True), ((0.81, 0.49), False), ((0.79, 0.51), False), ((0.49, 0.79), True)],
)
def test_a_rectangle_up_to_the_overlap_of_the_two_fields_fits(field_m, fits):
    """Oracle: at 1 m, the common field is 1 m minus the baseline of 0.2 m wide, and 0.5 m high."""
    assert covers(parallel_rig(), field_m, 1.0) is fits


@pytest.mark.slow
@pytest.mark.parametrize("ratio", [0.6, slow(1.0), slow(2.0)])
def test_the_largest_rectangle_in_a_slanted_field_agrees_with_a_search(ratio):
    """Oracle: rectangles around a grid of points, whose corners are projected into both pictures.

    The common field is a keystone on two sides: only the sides of the camera's field are parallel.
    """
    rig, z_m = preset_rig("lab-lightcrafter-4500"), 0.8
    middles = np.stack(np.meshgrid(*[np.linspace(-0.3, 0.3, 121)] * 2), axis=-1).reshape(-1, 2)

    def placed(width_m, height_m):
        fitting = np.column_stack([middles, np.full(len(middles), z_m)])
        for u, v in product((-0.5, 0.5), repeat=2):
            aside = np.array([u * width_m, v * height_m, 0.0])
            corner = fitting + aside
            fitting = fitting[in_picture(rig.camera, project(rig.camera, corner))]
            beside = transform_points(inverse(rig.T_cam_proj), fitting + aside)
            fitting = fitting[in_picture(rig.projector, project(rig.projector, beside))]
        return len(fitting) > 0

    scales = np.arange(0.3, 0.6, 0.005)
    size = (ratio**0.5, ratio**-0.5)
    largest = next(s for s in scales[::-1] if placed(s * size[0], s * size[1])
                   or placed(s * size[1], s * size[0]))  # fmt: skip
    assert covers(rig, (0.98 * largest * size[0], 0.98 * largest * size[1]), z_m)
    assert not covers(rig, (1.03 * largest * size[0], 1.03 * largest * size[1]), z_m)


def test_no_rectangle_fits_if_the_fields_do_not_overlap():
    rig = parallel_rig()
    T = rig.T_cam_proj.copy()
    T[0, 3] = 3.0
    assert not covers(replace(rig, T_cam_proj=T), (0.01, 0.01), 1.0)


def test_all_scanners_are_listed_without_a_condition():
    assert names() == list(PRESETS)


def test_only_scanners_with_a_large_field_at_one_metre_are_listed():
    """Computed by hand: at 1 m, 600 x 400 mm is too large for an XS, S, nano or M60, and an XL
    cannot measure so near. The field of the M130 is 2448 / 4028 m wide and 2048 / 4028 m high."""
    listed = names(field_m=(0.6, 0.4), at_m=1.0)
    assert {"like-phoxi-m", "like-phoxi-l", "like-zivid-2-l100", "like-zivid-2plus-m130"} <= set(
        listed
    )
    assert not {"like-phoxi-s", "like-phoxi-xs", "like-phoxi-xl", "like-mech-eye-nano"} & set(
        listed
    )
    assert "like-zivid-2plus-m130" not in names(field_m=(0.62, 0.4), at_m=1.0)


def test_noise_between_measured_distances_is_interpolated_quadratically(monkeypatch):
    """Oracle: a scanner whose noise is 1e-4 times the squared distance."""
    own = measured().scanners["like-phoxi-m"]
    for z_m, noise_m in zip(own.z_m, own.noise_m, strict=True):
        assert stored_noise_m("like-phoxi-m", z_m) == pytest.approx(noise_m)
    assert stored_noise_m("paper", 1.0) is None
    square = own.model_copy(update={"noise_m": tuple(1e-4 * z_m**2 for z_m in own.z_m)})
    table = measured().model_copy(update={"scanners": {"like-phoxi-m": square}})
    monkeypatch.setattr(shelf_list, "measured", lambda: table)
    for z_m in (0.3, 0.6, 0.9, 1.5):
        assert stored_noise_m("like-phoxi-m", z_m) == pytest.approx(1e-4 * z_m**2)


def test_a_stricter_condition_lists_fewer_scanners():
    listed = [set(names(at_m=1.0, noise_m=noise_m)) for noise_m in (1e-2, 1.5e-4, 1e-9)]
    assert listed[0] > listed[1] > listed[2] == set()
    assert listed[0] == set(names(at_m=1.0)) - {"paper"}
    for name in listed[1]:
        assert stored_noise_m(name, 1.0) <= 1.5e-4
        assert preset_rig(name).near_m <= 1.0 <= preset_rig(name).far_m


@pytest.mark.parametrize("name", PRESETS)
def test_each_number_in_the_list_has_the_class_of_its_source(name):
    """Oracle: the class in the text after each number; without a class, its unit follows."""
    line = next(line for line in shelf_lines() if line.split()[0] == name)
    kinds = {
        r" m \[(\w+)\], baseline": class_of(name, "near_m", "far_m"),
        r" mm \[(\w+)\]": class_of(name, "baseline_m", "t_cam_proj_m"),
        r" pixels \[(\w+)\]": class_of(name, "camera.size_px"),
    }
    assert {words: re.findall(words, line) for words in kinds} == {
        words: [kind] for words, kind in kinds.items()
    }


def test_a_scanner_s_sources_are_printed_with_each_number():
    lines = source_lines("like-mech-eye-nano")
    assert lines[0].startswith("Like the Mech-Mind Mech-Eye NANO, and not the maker's product")
    baseline = next(line for line in lines if line.startswith("baseline_m: "))
    assert baseline.startswith("baseline_m: 0.068  # from memory of docs.mech-mind.net")
    stated = [line for line in lines if "  # " in line]
    assert len(stated) == len(stated_numbers("like-mech-eye-nano"))


def test_the_rig_of_the_paper_has_sources_for_its_geometry_only():
    lines = source_lines("paper")
    assert lines[0].startswith("The geometry is that of like-phoxi-m")
    assert not any(line.startswith(("light", "claims", "f_number")) for line in lines)
    assert "baseline_m: 0.35  # source: header" in lines
