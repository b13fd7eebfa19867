"""The shelf: each scanner has its maker's geometry, and each number has a source."""

import math
import re
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from graycast.base.errors import ConfigError
from graycast.base.frames import inverse, transform_points
from graycast.rig.optics import in_picture, project, rays
from graycast.rig.pair import PRESETS, RESOLUTIONS, best_depth_m, preset_rig
from graycast.rig.shelf import (
    NAMES,
    SHELF,
    class_of,
    entry,
    measured,
    no_rig,
    shelf_entry,
    sources,
    stated_numbers,
)
from graycast.rig.shelf.entry import DeviceSection

EVERY = pytest.mark.parametrize("name", SHELF)
# With their makers' angles, the axes of these cross beyond the range, at 278 mm and at 1.3 m.
CROSS_BEYOND = {
    "like-phoxi-xs": 0.085 / math.tan(math.radians(17)),
    "like-zivid-2plus-m60": 0.0079 + 0.1112 / math.tan(0.085),
    "like-zivid-2plus-mr60": 0.0079 + 0.1112 / math.tan(0.085),
}
# relative differences of the common field from the quoted one, in width and in height
OTHER_FIELD = {"like-phoxi-xs": (-0.13, -0.01), "like-phoxi-s": (0.047, 0.12)}
SOURCE = re.compile(r"  # (source: \S|quoted: \S|our choice|from memory of \S)")


def lines_of(name):
    """Return the lines of a scanner's file, and the lines of its base for keys that it lacks."""
    lines = files("graycast.rig.shelf").joinpath(f"{name}.yaml").read_text().splitlines()
    for base in [line.split()[1] for line in lines if line.startswith("base: ")]:
        own, keep = {line.split(":")[0] for line in lines if line[0].isalpha()}, False
        for line in lines_of(base):
            keep = line.split(":")[0] not in own if line[0].isalpha() else keep and line[0] == " "
            lines += [line] if keep else []
    return lines


def test_the_shelf_has_exactly_one_file_for_each_scanner():
    names = {path.name for path in files("graycast.rig.shelf").iterdir()}
    own = {name for name in names if name.endswith(".yaml")} - {"measured.yaml"}
    assert own == {f"{name}.yaml" for name in SHELF}
    assert PRESETS == NAMES == ("paper", *SHELF)


@EVERY
def test_every_number_in_a_scanner_s_file_states_its_class_of_source(name):
    """Oracle: the lines of the file that look like numbers, without a parser of YAML."""
    stated = [line for line in lines_of(name) if re.match(r"^\s*(- )?\w+: *(\[|-?\d)", line)]
    light = [line for line in lines_of(name) if line.startswith("light:")]
    numbers = stated_numbers(name)
    assert len(stated) >= 10 and len(light) == 1
    assert len(numbers) == len(stated) + 1
    for line in stated + light:
        assert SOURCE.search(line), line
        key, value = line.split("#")[0].strip().removeprefix("- ").split(": ")
        matching = [n for n in numbers.values() if n.key.split(".")[-1] == key]
        assert value in [number.text for number in matching]
    if name.startswith("like-"):
        assert "not the maker's product" in lines_of(name)[0]


@EVERY
def test_the_head_of_each_scanner_file_explains_its_abbreviated_sources(name):
    head = " ".join(line for line in lines_of(name) if line.startswith("#")).lower()
    names = {
        word
        for number in stated_numbers(name).values()
        if number.kind in ("source", "quoted")
        for word in re.findall(r"^\w+: ([\w-]+)(?=,|$|:| and)", number.comment)
    }
    assert {word for word in names if word.lower() not in head} == set()


def test_a_number_without_a_class_of_source_is_refused(monkeypatch, tmp_path):
    (tmp_path / "like-phoxi-m.yaml").write_text("fx_px: 1785  # a good value\n")
    monkeypatch.setattr(sources, "files", lambda package: tmp_path)
    with pytest.raises(ValueError, match="fx_px has no class: state where 1785 is from"):
        stated_numbers.__wrapped__("like-phoxi-m")


@pytest.mark.parametrize("base", ["like-phoxi-n", "like-phoxi-m", "like-zivid-2plus-mr60"])
def test_a_base_file_that_is_unknown_or_has_its_own_base_is_refused(monkeypatch, tmp_path, base):
    for name in ("like-phoxi-m", "like-zivid-2plus-mr60"):  # both have a base: a cycle, a chain
        (tmp_path / f"{name}.yaml").write_text(f"base: {base}\n")
    monkeypatch.setattr(entry, "files", lambda package: tmp_path)
    with pytest.raises(ConfigError, match=rf"like-phoxi-m\.yaml: base is '{base}': name a"):
        shelf_entry.__wrapped__("like-phoxi-m")


def test_a_section_in_a_scanner_file_replaces_the_whole_section_of_its_base():
    """The maker states the noise of the M60, but not of the MR60."""
    own, base = (shelf_entry(f"like-zivid-2plus-{name}") for name in ("mr60", "m60"))
    assert (own.camera, own.t_cam_proj_m, own.far_m) == (base.camera, base.t_cam_proj_m, base.far_m)
    assert base.claims.noise is not None and own.claims.noise is None
    assert not {key for key in stated_numbers("like-zivid-2plus-mr60") if "noise" in key}


def test_the_page_on_the_shelf_counts_the_numbers_from_memory():
    page = Path(__file__).resolve().parents[2] / "docs/reference/shelf.md"
    every = [number for name in SHELF for number in stated_numbers(name).values()]
    count = sum(number.kind == "memory" for number in every)
    assert f" {count} numbers are still from memory" in page.read_text().replace("\n", " ")


def test_several_numbers_together_have_their_weakest_class_of_source():
    assert class_of("like-mech-eye-pro-s", "camera.size_px") == "quoted"
    assert class_of("like-mech-eye-pro-s", "camera.size_px", "claims.capture_s") == "memory"
    assert class_of("like-phoxi-l", "near_m", "far_m", "f_number") == "choice"
    assert class_of("paper", "baseline_m") == "source"


def common_box_m(rig, z_m):
    """Return the sides of the box around the points at a depth that both devices see.

    Oracle: a fine grid of points, projected into both; `show.report` cuts outlines instead.
    """
    half_m = 0.75 * z_m
    x, y = np.meshgrid(*[np.linspace(-half_m, half_m, 401)] * 2)
    point = np.stack([x, y, np.full_like(x, z_m)], axis=-1).reshape(-1, 3)
    point = point[in_picture(rig.camera, project(rig.camera, point))]
    in_projector = transform_points(inverse(rig.T_cam_proj), point)
    point = point[in_picture(rig.projector, project(rig.projector, in_projector))]
    return np.ptp(point[:, :2], axis=0)


@EVERY
def test_the_common_field_of_view_agrees_with_the_maker_s_value(name):
    """The tolerance is 10 %: makers do not say where they measure the field and what its shape is.

    The focal lengths have other sources than the fields, except in the Mech-Eye family, whose focal
    lengths were fitted to them. The sources of the XS and of the S contradict each other.
    """
    rig = preset_rig(name, "full")
    for claim in shelf_entry(name).claims.fields:
        assert rig.near_m <= claim.at_m <= rig.far_m
        off = common_box_m(rig, claim.at_m) / claim.size_m - 1
        if name in OTHER_FIELD:
            assert off == pytest.approx(OTHER_FIELD[name], abs=0.02)
        else:
            assert np.abs(off).max() < 0.10


@EVERY
def test_the_spacing_of_points_agrees_with_the_maker_s_value(name):
    """Oracle: similar triangles; the makers round to 0.01 mm."""
    claim = shelf_entry(name).claims.spacing
    if claim is not None:
        spacing_m = claim.at_m / preset_rig(name, "full").camera.fx_px
        assert spacing_m == pytest.approx(claim.value_m, abs=0.5e-5)


@EVERY
def test_central_rays_of_camera_and_projector_meet_inside_the_range(name):
    """For two scanners, they meet where the makers' angles make a triangle."""
    rig = preset_rig(name, "full")
    middle = [np.array([[(o.width_px - 1) / 2, (o.height_px - 1) / 2]]) for o in
              (rig.camera, rig.projector)]  # fmt: skip
    camera = rays(rig.camera, middle[0])[0]
    projector = rig.T_cam_proj[:3, :3] @ rays(rig.projector, middle[1])[0]
    origin = rig.T_cam_proj[:3, 3]
    along, _, _, _ = np.linalg.lstsq(np.stack([camera, -projector], 1), origin, rcond=None)
    meeting_m = along[0] * camera[2]
    gap_m = np.linalg.norm(along[0] * camera - origin - along[1] * projector)
    assert gap_m < 1e-3 * meeting_m
    if name in CROSS_BEYOND:
        assert meeting_m == pytest.approx(CROSS_BEYOND[name], rel=1e-6)
        assert best_depth_m(rig) == rig.far_m
    else:
        assert rig.near_m < meeting_m < rig.far_m
        assert best_depth_m(rig) == pytest.approx(meeting_m, rel=1e-6)


@EVERY
@pytest.mark.parametrize("resolution", RESOLUTIONS)
def test_binning_does_not_change_the_camera_s_field_of_view(name, resolution):
    """The outer borders of the corner pixels keep their rays, and no pixel is left over."""
    full, binned = preset_rig(name, "full").camera, preset_rig(name, resolution).camera
    assert full.width_px % binned.width_px == full.height_px % binned.height_px == 0
    for x, y in ((0, 0), (1, 1)):
        ends = [
            rays(o, np.array([[x * o.width_px - 0.5, y * o.height_px - 0.5]]))
            for o in (full, binned)
        ]
        np.testing.assert_allclose(*ends, atol=1e-12)


def test_binning_does_not_change_the_field_of_a_lens_with_an_offset():
    device = DeviceSection(size_px=(8, 8), fx_px=10.0, cy_px=6.0)
    ends = [
        rays(device.optics(binning), np.array([[-0.5, -0.5], [8 / binning - 0.5] * 2]))
        for binning in (1, 2)
    ]
    np.testing.assert_allclose(*ends, atol=1e-12)


def test_a_dlp4500_has_mirrors_of_aspect_two_and_its_picture_above_the_axis():
    """Oracle: a throw ratio of 1.2, 16:10, and an offset of 100 %, on a wall one metre away."""
    projector = preset_rig("lab-lightcrafter-4500").projector
    assert projector.fy_px / projector.fx_px == pytest.approx(2, rel=1e-3)
    corners = np.array([[-0.5, -0.5], [911.5, 1139.5]])
    upper_left, lower_right = rays(projector, corners)[:, :2]
    width, height = lower_right - upper_left
    assert (width, height) == pytest.approx((1 / 1.2, 1 / 1.2 / 1.6), rel=1e-3)
    assert lower_right[1] == pytest.approx(0, abs=1e-12)


def test_an_office_projector_casts_its_picture_above_its_lens():
    """The middle of the picture is 115 % of half its height above the axis."""
    projector = preset_rig("office-projector").projector
    top, bottom = rays(projector, np.array([[511.5, -0.5], [511.5, 767.5]]))[:, 1]
    assert -(top + bottom) / (bottom - top) == pytest.approx(1.15, rel=1e-3)


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("realsense-d435", "stereo of two cameras"),
        ("d435i", "stereo of two cameras"),
        ("zed2", "stereo of two cameras"),
        ("Ensenso_N35", "stereo of two cameras"),
        ("orbbec-gemini-2", "stereo of two cameras"),
        ("femto", "time of flight"),
        ("azure-kinect", "time of flight"),
        ("helios2", "time of flight"),
        ("motioncam-3d-m", "lists what is missing"),
        ("cognex-3d-a5000", "lists what is missing"),
    ],
)
def test_a_device_that_projects_no_coded_light_is_refused_with_the_reason(name, reason):
    assert reason in no_rig(name)
    assert "choose one of" not in no_rig(name)
    with pytest.raises(ValueError, match=reason):
        preset_rig(name)


@pytest.mark.parametrize("name", ["customized", "like-zivid-3", "oval", "structured-light"])
def test_the_error_for_an_unknown_scanner_lists_the_known_scanners(name):
    assert f"no rig {name!r}: choose one of paper, like-phoxi-s" in no_rig(name)


def test_the_measured_noise_is_similar_to_the_maker_s_value():
    """The tolerance is a factor of three, because code, lens and light are our choice.

    A wrong focal length, baseline or unit would differ more.
    """
    assert set(measured().scanners) == set(SHELF)
    for name, own in measured().scanners.items():
        claim = shelf_entry(name).claims.noise
        if claim is not None:
            here_m = np.interp(claim.at_m, own.z_m, own.noise_m)
            assert 1 / 3 < here_m / claim.value_m < 3, name
        assert own.z_m == tuple(sorted(own.z_m))
        assert own.noise_m == tuple(sorted(own.noise_m))  # Noise grows with the distance.


@EVERY
def test_a_projector_emits_light_in_the_band_of_its_wavelength(name):
    """Symptom: blue scanners emit red light, which changes brass, copper and coloured parts.

    The bands stand for 610, 550 and 465 nm. White is the mean of all three.
    """
    entry, rig = shelf_entry(name), preset_rig(name)
    assert rig.band_weights == entry.band_weights
    assert sum(rig.band_weights) == pytest.approx(1)
    if entry.light == "white":
        assert np.ptp(rig.band_weights) == 0
        return
    nearest = int(np.abs(np.array([610e-9, 550e-9, 465e-9]) - entry.wavelength_m).argmin())
    assert rig.band_weights == tuple(float(band == nearest) for band in range(3))
