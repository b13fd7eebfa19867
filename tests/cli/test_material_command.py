"""The command real material: from a simulated scan to a material file, and its errors."""

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

import graycast as gc
from graycast.cli import main
from graycast.real import material
from graycast.real.material import fit_material

MATT = {"base_color": (0.5, 0.5, 0.5), "specular": 0.0, "roughness": 1.0}


@pytest.fixture(scope="module")
def scene(tmp_path_factory, cpu_device):
    """A scene of 20 brackets of steel in a matt bin, with its pictures and a mask of the bin."""
    config = gc.Config(
        parts=(gc.PartSection(builtin="metal_workpiece_1", material="steel"),),
        count=20,
        rig="like-phoxi-m",
        resolution="small",
        bin={"inner_m": (0.30, 0.22, 0.08), "material": MATT},
        table=MATT,
        store={"frames": True},
    )
    out = tmp_path_factory.mktemp("material") / "steel"
    gc.generate(gc.load_cell(config), out, scenes=1, seed=5)
    folder = out / "train" / "000000"
    parts = np.maximum.reduce([cv2.imread(str(mask), 0) for mask in masks(folder)])
    cv2.imwrite(str(folder / "white.png"), 255 - cv2.dilate(parts, np.ones((9, 9))))
    return folder


def masks(folder):
    return sorted((folder / "mask_sl").glob("000000_*.png"))


def run(stack, *words):
    return main(["real", "material", str(stack), *map(str, words)])


@pytest.mark.slow
def test_the_material_of_steel_brackets_is_recovered_from_a_scan(scene, tmp_path, capsys):
    """Oracle: the simulated material, of roughness 0.4 and base colour 0.4."""
    out = tmp_path / "material.yaml"
    white = ("--reference", scene / "white.png", "--reflectance", 0.5)
    assert not run(scene / "frames", "--mask", *masks(scene), *white, "--out", out)
    steel = yaml.safe_load(out.read_text())
    assert steel["metallic"] == 1.0
    assert steel["roughness"] == pytest.approx(0.4, abs=0.05)
    assert steel["base_color"] == pytest.approx([0.4] * 3, rel=0.1)
    assert out.with_suffix(".png").stat().st_size > 10_000
    assert "kind           metal" in capsys.readouterr().out
    cell = tmp_path / "cell"
    assert not main(
        ["new", str(cell), "--builtin", "metal_workpiece_1", "--surface-from", str(out)]
    )
    (part,) = gc.load_cell(cell / "cell.yaml").scene.parts
    assert part.material.roughness == steel["roughness"]
    assert run(scene / "frames", "--out", out) == 1
    assert "exists already" in capsys.readouterr().err


@pytest.mark.slow
def test_python_and_the_command_fit_the_same_material(scene, tmp_path):
    """The command rounds its numbers to three places."""
    white = cv2.imread(str(scene / "white.png"), 0) > 0
    parts = np.logical_or.reduce([cv2.imread(str(mask), 0) > 0 for mask in masks(scene)])
    words = ("--mask", *masks(scene), "--reference", scene / "white.png", "--reflectance", 0.5)
    assert not run(scene / "frames", *words, "--out", tmp_path / "m.yaml")
    written = yaml.safe_load((tmp_path / "m.yaml").read_text())
    scan = gc.open_scan(str(scene / "frames"))
    fit = gc.fit_material(scan.observations(parts), scale=scan.scale(white, 0.5), seed=0)
    assert round(fit.roughness.value, 3) == written["roughness"]
    assert round(fit.color.value, 3) == written["base_color"][0]
    assert (fit.material.roughness, fit.material.metallic) == (fit.roughness.value, 1.0)
    with pytest.raises(gc.GraycastError, match=r"observations is .*: give a Reflections"):
        gc.fit_material(scan, seed=0)


@pytest.mark.slow
def test_parts_and_bin_are_separated_without_masks(scene, tmp_path, capsys):
    """Oracle: the simulated masks and materials of the steel parts and of the matt grey bin."""
    out = tmp_path / "m.yaml"
    white = ("--reference", scene / "white.png", "--reflectance", 0.5)
    assert not run(scene / "frames", *white, "--out", out)
    text = capsys.readouterr().out
    assert "2 classes of material" in text
    assert text.count("the surface of --reference") == 1
    bin_, steel = (yaml.safe_load((tmp_path / f"m_{k}.yaml").read_text()) for k in (1, 2))
    assert bin_ == MATT | {"base_color": [0.5] * 3, "metallic": 0.0}
    assert "the class reflects 0.5" in text or "the class reflects 0.49" in text
    assert steel["metallic"] == 1.0
    assert steel["roughness"] == pytest.approx(0.4, abs=0.05)
    assert steel["base_color"] == pytest.approx([0.4] * 3, rel=0.1)
    picture = cv2.imread(str(tmp_path / "m_classes.png")).astype(int)
    parts = np.maximum.reduce([cv2.imread(str(mask), 0) for mask in masks(scene)]) > 0
    orange = picture[..., 2] > picture[..., 0] + 20
    blue = picture[..., 0] > picture[..., 2] + 20
    right = (orange & parts).sum() + (blue & ~parts).sum()
    assert right / (orange | blue).sum() > 0.98
    assert (orange & parts).sum() > 0.95 * ((orange | blue) & parts).sum() > 500


@pytest.mark.slow
def test_a_run_that_is_stopped_between_two_classes_leaves_no_file(scene, tmp_path, monkeypatch):
    """The files of the first class would make the next run refuse its output."""
    fits = []

    def stopped(observations, **options):
        fits.append(fit_material(observations, **options))
        if len(fits) == 2:
            raise KeyboardInterrupt
        return fits[0]

    monkeypatch.setattr(material, "fit_material", stopped)
    assert run(scene / "frames", "--out", tmp_path / "m.yaml") == 130
    assert len(fits) == 2 and not list(tmp_path.iterdir())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--rig", "like-phoxi-l", "--resolution", "small"), "give the rig of this scan"),
        (("--rig", "paper", "--resolution", "full"), "give the rig of this stack"),
    ],
)
def test_the_rig_of_another_scanner_is_refused(scene, tmp_path, capsys, words, message):
    assert run(scene / "frames", *words, "--out", tmp_path / "m.yaml") == 1
    assert message in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("gain", "message"), [(0.0, "no pixel is lit"), (60.0, "saturated")], ids=["dark", "bright"]
)
def test_a_scan_that_is_too_dark_or_too_bright_is_refused(scene, tmp_path, capsys, gain, message):
    """The light above the black level is multiplied by `gain` in all pictures of the scene."""
    frames = tmp_path / "frames"
    shutil.copytree(scene / "frames", frames)
    (frames / "exposure.png").unlink()
    for file in sorted(frames.glob("0*.png")):
        image = cv2.imread(str(file), -1)
        brighter = np.clip(image.astype(float) * gain + 40 * (gain == 0), 0, 4095)
        cv2.imwrite(str(file), brighter.astype(image.dtype))
    assert run(frames, "--mask", *masks(scene), "--out", tmp_path / "m.yaml") == 1
    assert message in capsys.readouterr().err
    assert not (tmp_path / "m.yaml").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--reference", "w.png"), "--reference and --reflectance belong together"),
        (("--reference", "w.png", "--reflectance", "80"), "give a share from 0 to 1"),
        (("--resolution", "low"), "--resolution applies only to a preset"),
        (("--mask", "none.png"), "none.png: "),
    ],
)
def test_options_that_do_not_fit_are_refused(tmp_path, capsys, words, message):
    assert run("stack.yaml", *words, "--out", tmp_path / "m.yaml") == 1
    assert message in capsys.readouterr().err


def test_a_mask_without_a_pixel_is_refused(tmp_path, capsys):
    cv2.imwrite(str(tmp_path / "mask.png"), np.zeros((4, 4), np.uint8))
    path = Path(tmp_path / "mask.png")
    assert run("stack.yaml", "--mask", path, "--out", tmp_path / "m.yaml") == 1
    assert "no pixel is inside the mask" in capsys.readouterr().err
