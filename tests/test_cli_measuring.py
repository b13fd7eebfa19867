"""`graycast decode`, `realism`, `certify` and `rig calibrate` as a user runs them."""

import json

import numpy as np
import pytest
import trimesh
from metrology.test_certify import small_scanner
from stack import simulated
from test_calibrate import (  # noqa: F401 (fixtures)
    CHESSBOARD,
    RIG,
    SIZE,
    camera_rays,
    chess_albedo,
    code_of,
    photograph,
    truth_poses,
)

from graycast.cli import main
from graycast.decode import Reason
from graycast.pattern import AXES, gray, gray_phase, level_share
from graycast.rig_file import load_scanner, save_scanner
from graycast.scanner import Scanner


def run(capsys, *arguments):
    """What a command that ends well prints."""
    code = main([str(argument) for argument in arguments])
    printed, complaint = capsys.readouterr()
    assert code == 0, complaint
    return printed


@pytest.fixture(scope="module")
def decoded(tmp_path_factory):
    """A simulated scanner's pictures, its rig file, and what `decode` made of them."""
    folder = tmp_path_factory.mktemp("scanned")
    rig = simulated.small_rig()
    code = gray_phase(128, 96, axes=AXES, period_px=16.0)
    stack = simulated.save(folder, simulated.describe(code), simulated.shoot(rig, code))
    save_scanner(Scanner(rig=rig), folder / "rig.yaml")
    out = folder / "out"
    assert main(["decode", str(stack), "--rig", str(folder / "rig.yaml"), "--out", str(out)]) == 0
    return rig, folder, out


def test_decode_writes_what_the_documentation_lists(decoded):
    rig, _, out = decoded
    truth = simulated.seen(rig)
    codes = np.load(out / "code.npz")
    for name in ("column", "row", "sigma_column", "sigma_row", "modulation"):
        assert codes[name].shape == truth.column.shape
        assert codes[name].dtype == np.float32
    assert codes["reason"].dtype == np.uint8
    assert [name.lower() for name in codes["reasons"]] == [reason.name.lower() for reason in Reason]
    known = codes["reason"] == Reason.DECODED
    assert known.mean() > 0.4
    # Pixels of the simulated projector are sharp: half a pixel, and noise.
    for name in AXES:
        assert np.abs(codes[name] - getattr(truth, name))[known].max() < 0.7
    depth_m, sigma_m = np.load(out / "depth.npy"), np.load(out / "sigma_depth.npy")
    assert np.nanmedian(np.abs(depth_m - truth.depth_m)) < 0.01
    assert (np.isfinite(depth_m) == np.isfinite(sigma_m)).all()
    cloud = trimesh.load(out / "cloud.ply")
    assert len(cloud.vertices) == np.isfinite(depth_m).sum()
    assert np.nanmedian(cloud.vertices[:, 2]) == pytest.approx(np.nanmedian(depth_m), rel=1e-4)
    assert (out / "preview.png").stat().st_size > 1000


def test_decode_averages_to_one_point_per_projector_pixel(decoded, capsys, tmp_path):
    _, folder, out = decoded
    printed = run(capsys, "decode", folder / "STACK.yaml", "--rig", folder / "rig.yaml",
                  "--average", "--out", tmp_path)  # fmt: skip
    assert "epipolar residual" in printed
    averaged = len(trimesh.load(tmp_path / "cloud.ply").vertices)
    codes = np.load(out / "code.npz")
    known = codes["reason"] == Reason.DECODED
    pixels = np.stack([np.rint(codes[axis][known]) for axis in AXES], axis=1)
    assert 0.8 * len(np.unique(pixels, axis=0)) < averaged <= len(np.unique(pixels, axis=0))


def test_realism_measures_what_decode_made_and_compares(decoded, capsys, tmp_path):
    rig, _, out = decoded
    camera = rig.camera
    K = f"{camera.fx_px},{camera.fy_px},{camera.cx_px},{camera.cy_px}"
    made = tmp_path / "measured"
    printed = run(capsys, "realism", out / "depth.npy", "--intrinsics", K, "--out", made)
    assert "missing pixels" in printed
    share = float(np.isnan(np.load(out / "depth.npy")).mean())
    record = json.loads((made / "realism.json").read_text())
    assert record["missing"]["share"] == pytest.approx(share, abs=1e-6)
    assert (made / "plots.png").stat().st_size > 1000
    both = run(capsys, "realism", "--compare", made, made)
    assert both.count("measured") >= 2


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["realism"], "give depth maps to measure, or --compare"),
        (["realism", "x.npy"], "say with --out"),
        (["realism", "gone.npy", "--intrinsics", "1,1,0,0", "--out", "o"], "gone.npy"),
        (["decode", "gone.yaml", "--out", "o"], "gone.yaml"),
        (["rig", "calibrate", "gone.yaml", "--board", "chess:1", "--out", "r"], "chessboard:"),
    ],
)
def test_what_is_missing_is_named(capsys, tmp_path, monkeypatch, arguments, said):
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 1
    assert said in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_calibrate_gives_the_rig_back_from_pictures(capsys, tmp_path, camera_rays, truth_poses):  # noqa: F811
    code = gray(*SIZE, inverses=True)
    stacks = []
    for i, T in enumerate(truth_poses):
        folder = tmp_path / f"pose{i}"
        folder.mkdir()
        albedo = photograph(camera_rays, T, chess_albedo(CHESSBOARD))
        place = code_of(camera_rays, T)
        lit = np.isfinite(place[..., 0])
        frames = []
        for frame in code.frames:
            i_axis = AXES.index(frame.axis) if frame.axis else 0
            share = level_share(frame, SIZE[i_axis] if frame.axis else 1)
            at = np.rint(np.nan_to_num(place[..., i_axis])).astype(int) if frame.axis else 0
            frames.append(np.where(lit, share[at], 0.0) * albedo)
        stack = np.rint(800 + 60000 * np.array(frames)).astype(np.uint16)
        stacks.append(simulated.save(folder, simulated.describe(code), stack))
    printed = run(capsys, "rig", "calibrate", *stacks, "--board", "chessboard:9x7:0.025",
                  "--out", tmp_path / "rig.yaml")  # fmt: skip
    assert "all: RMS camera" in printed
    rig = load_scanner(tmp_path / "rig.yaml").rig
    assert rig.baseline_m == pytest.approx(RIG.baseline_m, rel=1e-3)
    for found, true in ((rig.camera, RIG.camera), (rig.projector, RIG.projector)):
        assert found.fx_px == pytest.approx(true.fx_px, rel=1e-3)
        assert found.fy_px == pytest.approx(true.fy_px, rel=1e-3)


@pytest.mark.slow
def test_certify_writes_a_sheet(capsys, tmp_path, cpu_device):
    save_scanner(small_scanner(), tmp_path / "rig.yaml")
    printed = run(capsys, "certify", tmp_path / "rig.yaml", "--out", tmp_path / "sheet")
    assert "temporal noise" in printed.lower()
    assert (tmp_path / "sheet" / "certificate.html").read_text().startswith("<!doctype html>")
    assert json.loads((tmp_path / "sheet" / "certificate.json").read_text())
