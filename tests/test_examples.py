"""Each example runs as its first lines state, and is short enough to read."""

import math
import re
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh
from drawn import shares_of
from learn.detect.drawn import write_shapes
from pictured import write_dataset
from stage import DARK, centred, lambert, make_rig, wall

import graycast as gc
from graycast.camera.rig_file import save_scanner
from graycast.camera.scanner import Scanner, take
from graycast.dataset.check.checking import validate
from graycast.dataset.export import Options, export
from graycast.rendering import Quality, open_renderer
from graycast.rig.pattern import CodeSpec
from graycast.world.scene import EMPTY_LAYOUT, Scene

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
ARGUMENTS = {
    "01_make_a_mesh.py": [],
    "02_one_scene.py": ["1"],
    "03_codes_in_a_bowl.py": ["codes.png", "2"],
    "04_own_code.py": ["4"],
    "05_own_part.py": ["nuts", "2"],
    "06_own_renderer.py": ["2"],
    "07_read_a_dataset.py": ["prisms"],
    "08_decode_own_pictures.py": ["pictures", "rig.yaml", "out/cloud.ply"],
    "09_own_detector.py": ["shapes/dataset", "run", "1"],
    "10_virtual_scanner.py": ["4", "4"],
}
WALL_M = 0.7


def run(name, folder, *more):
    command = [sys.executable, EXAMPLES / name, *ARGUMENTS[name], *more]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_every_example_is_tested_and_shorter_than_80_lines():
    files = sorted(EXAMPLES.glob("*.py"))
    assert [file.name for file in files] == sorted(ARGUMENTS)
    assert all(len(file.read_text().splitlines()) < 80 for file in files)


def sheet_medians_mm(path):
    """Return the median error, in mm, in the colours of each large picture on a sheet, by row.

    Red and blue mean errors of 5 mm; white means no error.
    """
    picture = cv2.imread(str(path))[..., ::-1]
    inked = (picture < 255).any(axis=-1).astype(np.uint8)
    inked = cv2.morphologyEx(inked, cv2.MORPH_OPEN, np.ones((9, 9), np.uint8))
    count, label, box, _ = cv2.connectedComponentsWithStats(inked)
    large = [k for k in range(1, count) if box[k, cv2.CC_STAT_AREA] > 0.05 * inked.size]
    large.sort(key=lambda k: (box[k, cv2.CC_STAT_TOP] // 50, box[k, cv2.CC_STAT_LEFT]))
    share = [shares_of(picture[label == k] / 255, "RdBu_r", within=0.02) for k in large]
    return [float(np.nanmedian(np.abs(10 * of - 5))) for of in share]


@pytest.mark.slow
def test_the_example_reproduces_its_stored_mesh_exactly(tmp_path):
    """The example writes the mesh into `out`, which git ignores."""
    run("01_make_a_mesh.py", tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    assert (tmp_path / "out/plate.stl").read_bytes() == (EXAMPLES / "data/plate.stl").read_bytes()


@pytest.mark.slow
def test_the_example_compares_one_scene_with_its_truth(tmp_path):
    text = run("02_one_scene.py", tmp_path)
    shares = [float(share) for share in re.findall(r"([\d.]+)%", text)]
    assert len(shares) == 9 and abs(sum(shares) - 100) < 0.5  # Every pixel has one reason.
    assert float(re.search(r"median error ([\d.]+) mm", text)[1]) < 1


@pytest.mark.slow
def test_plain_gray_code_fails_in_a_bowl_and_micro_phases_do_not(tmp_path):
    """M. Gupta and S. Nayar reported this (CVPR 2012); two samples add noise to both codes."""
    text = run("03_codes_in_a_bowl.py", tmp_path)
    off = {line.split()[0]: float(line.split()[3][:-1]) for line in text.splitlines()[1:]}
    assert off["gray"] > 2 * off["micro_phase"]
    printed_mm = [float(line.split()[-2]) for line in text.splitlines()[1:]]
    sheet_mm = sheet_medians_mm(tmp_path / "codes.png")
    # The sheet is smaller than the pictures, and means of up to four pixels have smaller errors.
    for on_sheet, printed in zip(sheet_mm, printed_mm, strict=True):
        assert printed / 2 < on_sheet < printed + 10 / 255


@pytest.mark.slow
def test_a_scanner_measures_depth_with_a_user_s_own_code(tmp_path):
    """One coded axis is less evidence than two, so the preset's limit removes more depth."""
    text = run("04_own_code.py", tmp_path)
    assert "11 frames" in text
    assert float(re.search(r"([\d.]+)% of the pixels", text)[1]) > 40
    assert float(re.search(r"median error ([\d.]+) mm", text)[1]) < 1


@pytest.mark.slow
def test_a_part_of_the_user_becomes_a_dataset(tmp_path):
    """A hexagon minus a circle is `sqrt(3)/2 s^2 - pi r^2`; 48 corners lack 0.3 % of a circle."""
    run("05_own_part.py", tmp_path)
    area_mm2 = math.sqrt(3) / 2 * 46**2 - math.pi * 15**2
    assert trimesh.load(tmp_path / "nuts/nut.stl").volume == pytest.approx(24 * area_mm2, rel=5e-3)
    assert not validate(tmp_path / "nuts/dataset")


@pytest.mark.slow
def test_fog_in_a_renderer_of_the_user_multiplies_the_exposure(tmp_path):
    """Equal steps of density multiply the exposure by equal factors, as an exponential does."""
    text = run("06_own_renderer.py", tmp_path)
    clear, thin, thick = (float(number) for number in re.findall(r"([\d.]+) ms", text))
    assert thin > 1.5 * clear
    assert thick / thin == pytest.approx(thin / clear, rel=0.05)


@pytest.mark.slow
def test_the_example_reads_a_dataset(tmp_path):
    samples = write_dataset(tmp_path / "prisms")
    lines = run("07_read_a_dataset.py", tmp_path).splitlines()[2:]
    per_scene = [np.unique(sample.truth.instance) for sample in samples.values()]
    assert len(lines) == sum((instances >= 0).sum() for instances in per_scene)
    assert {line.split()[2] for line in lines} == {"box", "wedge"}


@pytest.mark.slow
def test_the_example_converts_pictures_of_a_wall_to_a_cloud(tmp_path):
    """The reference renderer makes the pictures; the example reads only these and the rig."""
    rig = make_rig(centred(160, 120, 200), centred(128, 96, 160))
    scanner = Scanner(rig=rig, code=CodeSpec(codec="gray_phase", axes=("column",)))
    scene = Scene(
        rig=rig, T_world_cam=np.eye(4), surfaces=(wall(WALL_M, lambert(0.6)),), environment=DARK
    )
    quality = Quality(samples=4, depth=1)
    rendering = open_renderer("reference").render(
        scene, EMPTY_LAYOUT, scanner.light_code().render(), quality=quality, seed=0
    )
    capture = take(scanner, rendering.radiance, seed=1)
    (tmp_path / "pictures").mkdir()
    for k, frame in enumerate(capture.frames):
        cv2.imwrite(str(tmp_path / f"pictures/{k:02d}.png"), frame)
    save_scanner(scanner, tmp_path / "rig.yaml")
    run("08_decode_own_pictures.py", tmp_path)
    z_m = trimesh.load(tmp_path / "out/cloud.ply").vertices[:, 2]
    column_m = WALL_M**2 / (160 * 0.1)  # depth per projector column
    assert len(z_m) > 5000 and abs(np.median(z_m) - WALL_M) < 0.1 * column_m  # depth has steps


# An array type of pycocotools 2.0.11 is older than NumPy 2, which warns about it.
@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")
@pytest.mark.slow
def test_a_detector_of_another_library_is_trained_and_detects_boxes(tmp_path):
    """If rfdetr is not installed, which is usual, the example reports that it is missing."""
    pytest.importorskip("torch", reason="needs torch: pip install 'graycast[detect]'")
    write_shapes(tmp_path / "shapes", 10)
    done = subprocess.run(
        [sys.executable, EXAMPLES / "09_own_detector.py", *ARGUMENTS["09_own_detector.py"]],
        cwd=tmp_path, capture_output=True, text=True, timeout=600,
    )  # fmt: skip
    if find_spec("rfdetr") is None:
        assert done.stderr.splitlines()[-1].endswith("No module named 'rfdetr'")
    else:
        assert re.search(r"[1-9]\d* boxes: see run_boxes", done.stdout), done.stderr


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")  # pycocotools'
def test_a_program_without_the_truth_empties_the_bin_of_a_virtual_scanner_and_reads_a_bag(tmp_path):
    """Every lift needs a pose within 5 mm of a part; four scans of 26 pictures take over 1 s.

    Scene 0 of a dataset with the example's seed is its first frame, except that depth is rounded.
    """
    name = "10_virtual_scanner.py"
    *lifts, end = run(name, tmp_path).splitlines()
    assert len(lifts) == 4 and all("lifted a part" in line for line in lifts)
    assert end.startswith("4 parts in ")
    assert "truth()" not in (EXAMPLES / name).read_text()
    config = gc.Config(
        parts=(gc.PartSection(builtin="yellow_salt_cube"),), count=4, rig="like-phoxi-m",
        resolution="small", render=gc.RenderSection(samples=4),
        exposure=gc.ExposureSection(auto=True), decode={"max_p_wrong": 0.2},
    )  # fmt: skip
    gc.generate(gc.load_cell(config), tmp_path / "out", scenes=2, seed=1, device="cpu")
    for form in ("ros2bag", "mcap"):
        export(tmp_path / "out", tmp_path / form, Options(format=form))
        first, second, stop, end = run(name, tmp_path, "--bag", f"{form}/train").splitlines()
        place_m = [
            np.array(line[line.index("[") + 1 : -3].split(), float) for line in (first, lifts[0])
        ]
        assert np.abs(place_m[0] - place_m[1]).max() < 1.5e-3
        assert second.startswith("frame 1: lifted a part at ") and "no further picture" in stop
        assert end.startswith("2 parts in ")
