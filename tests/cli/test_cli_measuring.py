"""The commands of rigs and of real scans, as a user runs them."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
import trimesh
import yaml
from camera.stack import simulated
from drawn import axes_of, figures_of, lines_of, no_pixels, shares_of
from matplotlib.colors import to_rgb
from PIL import Image
from real.calibrate.test_calibrate import (  # noqa: F401 (fixtures)
    CHESSBOARD,
    RIG,
    SIZE,
    camera_rays,
    chess_albedo,
    code_of,
    photograph,
    truth_poses,
)
from score.metrology.test_certify import small_scanner

from graycast.base.errors import GraycastError
from graycast.base.folder import whole_folder
from graycast.camera.decode import REASON_COLOR, FilterSpec, Reason
from graycast.camera.faults import FaultSpec
from graycast.camera.rig_file import load_scanner, save_scanner
from graycast.camera.scanner import Scanner
from graycast.camera.stack import stack_sheet
from graycast.cli import main
from graycast.real.realism import depth_curves
from graycast.rig.pattern import AXES, CODECS, CodeSpec, gray, gray_phase, level_share


def run(capsys, *arguments):
    """Return the output of a command that succeeds."""
    code = main([str(argument) for argument in arguments])
    printed, complaint = capsys.readouterr()
    assert code == 0, complaint
    return printed


@pytest.fixture(scope="module")
def decoded(tmp_path_factory):
    """Return a simulated scanner's pictures, its rig file, and the files of `decode`."""
    folder = tmp_path_factory.mktemp("scanned")
    rig = simulated.small_rig()
    code = gray_phase(128, 96, axes=AXES, period_px=16.0)
    stack = simulated.save(folder, simulated.describe(code), simulated.shoot(rig, code))
    save_scanner(Scanner(rig=rig), folder / "rig.yaml")
    out = folder / "out"
    with no_pixels(), figures_of(stack_sheet) as figures:
        words = ["rig", "decode", str(stack), "--rig", str(folder / "rig.yaml"), "--out", str(out)]
        assert main(words) == 0
    return rig, folder, out, *figures


def test_decode_writes_the_files_in_the_documentation(decoded):
    rig, _, out, _ = decoded
    truth = simulated.view_of(rig)
    codes = np.load(out / "code.npz")
    for name in ("column", "row", "sigma_column", "sigma_row", "modulation"):
        assert codes[name].shape == truth.column.shape
        assert codes[name].dtype == np.float32
    assert codes["reason"].dtype == np.uint8
    assert [name.lower() for name in codes["reasons"]] == [reason.name.lower() for reason in Reason]
    known = codes["reason"] == Reason.DECODED
    assert known.mean() > 0.4
    light = np.load(out / "light.npz")
    lit = light["direct"][known]
    assert np.median(np.abs(light["global"][known]) / lit) < 0.1  # only a wall and a ball
    # Pixels of the simulated projector are sharp, so the error is half a pixel plus noise.
    for name in AXES:
        assert np.abs(codes[name] - getattr(truth, name))[known].max() < 0.7
    depth_m, sigma_m = np.load(out / "depth.npy"), np.load(out / "sigma_depth.npy")
    assert np.nanmedian(np.abs(depth_m - truth.depth_m)) < 0.01
    assert (np.isfinite(depth_m) == np.isfinite(sigma_m)).all()
    cloud = trimesh.load(out / "cloud.ply")
    assert len(cloud.vertices) == np.isfinite(depth_m).sum()
    assert np.nanmedian(cloud.vertices[:, 2]) == pytest.approx(np.nanmedian(depth_m), rel=1e-4)


def test_the_preview_shows_picture_positions_reasons_and_depth(decoded):
    """Oracle: the scene's closed form, and the inverse of the colours' own tables."""
    rig, folder, out, figure = decoded
    tile = {title: ax.images[0].get_array() for title, ax in axes_of(figure).items()}
    white = np.array(Image.open(folder / "white.png"))
    assert np.array_equal(tile["picture"], np.repeat(white[..., None], 3, axis=-1))
    codes, truth = np.load(out / "code.npz"), simulated.view_of(rig)
    known = codes["reason"] == Reason.DECODED
    for axis, last in (("column", 127), ("row", 95)):
        index_px = last * shares_of(tile[f"decoded {axis}"], "viridis")
        assert (np.isfinite(index_px) == known).all()
        off_px = np.abs(index_px - getattr(truth, axis))[known]
        assert off_px.max() < 0.7 + last / 255  # half a pixel, noise, and a step of the colours
    depth_m = np.load(out / "depth.npy")
    reason = np.where(known & np.isnan(depth_m), Reason.OUTLIER, codes["reason"])
    colors = np.array([to_rgb(color) for color in REASON_COLOR.values()])
    assert np.array_equal(tile["reasons"], colors[reason])
    shares = shares_of(tile["depth"], "viridis_r")
    low_m, high_m = np.nanpercentile(depth_m, (1, 99))
    off_m = np.abs(low_m + shares * (high_m - low_m) - np.clip(depth_m, low_m, high_m))
    assert np.nanmax(off_m) <= (high_m - low_m) / 255
    assert (np.isfinite(shares) == np.isfinite(depth_m)).all()


@pytest.mark.slow
def test_equal_tiles_with_units_fill_the_sheet_of_the_preview(decoded):
    """Six tiles form two rows of three; every bar has a unit, and all lengths are in mm."""
    figure = decoded[3]
    figure.draw_without_rendering()
    boxes = [ax.get_window_extent() for ax in axes_of(figure).values()]
    assert len(boxes) == 6
    assert np.ptp([(box.width, box.height) for box in boxes], axis=0) == pytest.approx((0, 0))
    assert len({round(box.x0) for box in boxes}) == 3 and len({round(box.y0) for box in boxes}) == 2
    assert boxes[0].width / boxes[0].height == pytest.approx(160 / 120, rel=0.01)
    bars = [bar for ax in figure.axes for bar in ax.child_axes]
    labels = [text.get_text() for bar in bars for text in bar.texts]
    assert sorted(label.split()[-1] for label in labels) == ["[mm]"] * 2 + ["[px]"] * 2
    words = [
        text.get_window_extent() for bar in bars for text in (*bar.texts, *bar.get_xticklabels())
    ]
    legend = axes_of(figure)["reasons"].get_legend()
    for box in [*words, legend.get_window_extent()]:
        assert not any(box.overlaps(tile) for tile in boxes)
    depth_bar = next(bar for bar in bars if bar.texts[0].get_text() == "depth [mm]")
    assert 500 < depth_bar.get_xlim()[0] < depth_bar.get_xlim()[1] < 1000  # a wall at 800 mm


def test_the_preview_does_not_call_empty_space_shadow(decoded):
    """A dark, empty background does not count among the pixels that can be decoded."""
    _, _, out, figure = decoded
    reason = np.load(out / "code.npz")["reason"]
    dark = 100 * (reason == Reason.SHADOW).mean()
    legend = [text.get_text() for text in axes_of(figure)["reasons"].get_legend().get_texts()]
    assert f"not lit: shadow or empty, {dark:.1f} % of the picture" in legend
    shares = [float(text.split()[-2]) for text in legend if "not lit" not in text]
    assert sum(shares) == pytest.approx(100, abs=0.1)


@pytest.mark.parametrize("command", ["decode", "certify", "measure"])
def test_a_folder_of_other_files_is_refused_before_any_work(capsys, tmp_path, command):
    """The requested stack does not exist, so the refusal of the folder comes first."""
    (tmp_path / "letters").mkdir()
    (tmp_path / "letters" / "dear.txt").write_text("mine")
    arguments = {
        "decode": ["rig", "decode", "paper", "--rig", "paper"],
        "certify": ["rig", "certify", "paper"],
        "measure": ["real", "measure", tmp_path / "gone.npy", "--intrinsics", "1,1,0,0"],
    }
    message = refused(capsys, *arguments[command], "--out", tmp_path / "letters")
    assert (
        "letters: is not empty and holds no earlier result of this command (it has dear.t"
        in message
    )
    assert [path.name for path in (tmp_path / "letters").iterdir()] == ["dear.txt"]


@pytest.mark.slow
def test_decode_averages_to_one_point_per_projector_pixel(decoded, capsys, tmp_path):
    _, folder, out, _ = decoded
    with no_pixels():
        printed = run(capsys, "rig", "decode", folder / "STACK.yaml", "--rig", folder / "rig.yaml",
                      "--average", "--out", tmp_path)  # fmt: skip
    assert "epipolar residual" in printed
    averaged = len(trimesh.load(tmp_path / "cloud.ply").vertices)
    codes = np.load(out / "code.npz")
    known = codes["reason"] == Reason.DECODED
    pixels = np.stack([np.rint(codes[axis][known]) for axis in AXES], axis=1)
    assert 0.8 * len(np.unique(pixels, axis=0)) < averaged <= len(np.unique(pixels, axis=0))


@pytest.mark.slow
def test_decode_ignores_the_faults_of_a_rig(decoded, capsys, tmp_path):
    rig, folder, out, _ = decoded
    faulty = Scanner(rig=rig, faults=FaultSpec(raster_px=1.0))
    save_scanner(faulty, tmp_path / "rig.yaml")
    with no_pixels():
        run(capsys, "rig", "decode", folder / "STACK.yaml", "--rig", tmp_path / "rig.yaml",
            "--out", tmp_path / "out")  # fmt: skip
    for name in ("depth.npy", "sigma_depth.npy", "cloud.ply"):
        assert (out / name).read_bytes() == (tmp_path / "out" / name).read_bytes()


@pytest.mark.slow
def test_decode_applies_the_rig_s_filters(decoded, capsys, tmp_path):
    rig, folder, out, _ = decoded
    filtered = Scanner(rig=rig, filters=FilterSpec(smoothing_px=0.8))
    save_scanner(filtered, tmp_path / "rig.yaml")
    run(capsys, "rig", "decode", folder / "STACK.yaml", "--rig", tmp_path / "rig.yaml",
        "--out", tmp_path / "out")  # fmt: skip
    rough, smooth = (np.load(f / "sigma_depth.npy") for f in (out, tmp_path / "out"))
    # Where the surface bends, as at edges of cells, smoothing does not reduce sigma.
    assert np.nanquantile(smooth / rough, 0.1) < 0.6


@pytest.mark.slow
def test_measure_reads_results_of_decode_and_compare_shows_several_sets(decoded, capsys, tmp_path):
    rig, _, out, _ = decoded
    camera = rig.camera
    K = f"{camera.fx_px},{camera.fy_px},{camera.cx_px},{camera.cy_px}"
    folder = tmp_path / "measured"
    with no_pixels(), figures_of(depth_curves) as figures:
        printed = run(
            capsys, "real", "measure", out / "depth.npy", "--intrinsics", K, "--out", folder
        )
    assert "missing pixels" in printed
    share = float(np.isnan(np.load(out / "depth.npy")).mean())
    record = json.loads((folder / "realism.json").read_text())
    assert record["missing"]["share"] == pytest.approx(share, abs=1e-6)
    (figure,) = figures
    ((sigma_mm, _),) = lines_of(axes_of(figure)["noise about planes"])
    assert sigma_mm == pytest.approx(1e3 * np.array(record["noise"]["percentiles_m"]))
    assert (folder / "plots.png").is_file()
    both = run(capsys, "real", "compare", folder, folder)
    assert both.count("measured") >= 2
    maps = tmp_path / "maps"
    maps.mkdir()
    shutil.copy(out / "depth.npy", maps)
    fresh = run(capsys, "real", "compare", folder, maps, "--intrinsics", K)
    row = next(line for line in fresh.splitlines() if line.strip().startswith("median depth"))
    assert len(set(row.split()[2:])) == 2  # Both sets have the same value and unit.


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["real", "measure", "gone.npy", "--intrinsics", "1,1,0,0", "--out", "o"], "gone.npy"),
        (["rig", "decode", "gone.yaml", "--out", "o"], "gone.yaml"),
        (["rig", "calibrate", "gone.yaml", "--board", "chess:1", "--out", "r"], "chessboard:"),
    ],
)
def test_a_missing_input_is_named(capsys, tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 1
    assert message in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def refused(capsys, *arguments):
    """Return the one line of a command that fails."""
    assert main([str(argument) for argument in arguments]) == 1
    complaint = capsys.readouterr().err
    assert complaint.count("\n") == 1
    return complaint


K_TEXT = "190,190,79.5,59.5"


@pytest.mark.parametrize(
    ("array", "message"),
    [
        (np.full((40, 50), 0.8 + 1j), "complex128 numbers"),
        (np.ones((40, 50), bool), "bool numbers"),
        (np.full((40, 50), 800, np.uint16), "--scale 0.001"),
        (np.full((2, 40, 50), 0.8), "give a depth map with rows and columns"),
    ],
)
def test_a_refused_depth_map_leaves_no_output_folder(capsys, tmp_path, array, message):
    np.save(tmp_path / "z.npy", array)
    out = tmp_path / "deep" / "out"
    text = refused(
        capsys, "real", "measure", tmp_path / "z.npy", "--intrinsics", K_TEXT, "--out", out
    )
    assert message in text
    assert [path.name for path in tmp_path.iterdir()] == ["z.npy"]


@pytest.mark.parametrize("scale", ["0", "-0.001", "nan", "inf", "mm"])
def test_an_invalid_depth_scale_is_refused(capsys, scale):
    with pytest.raises(SystemExit):
        main(["real", "measure", "z.png", "--scale", scale, "--intrinsics", K_TEXT, "--out", "o"])
    assert "is not a number greater than 0" in capsys.readouterr().err


@pytest.mark.parametrize("content", ["{}", "[1]", '{"fx": NaN, "fy": 1, "cx": 0, "cy": 0}'])
def test_invalid_intrinsics_are_named(capsys, tmp_path, content):
    np.save(tmp_path / "z.npy", np.full((40, 50), 0.8))
    (tmp_path / "K.json").write_text(content)
    options = ("--intrinsics", tmp_path / "K.json", "--out", tmp_path / "o")
    text = refused(capsys, "real", "measure", tmp_path / "z.npy", *options)
    assert "K.json" in text
    assert "give fx,fy,cx,cy" in text


@pytest.mark.parametrize(
    ("lines", "problem"),
    [
        (
            "element vertex many\nproperty float x\nproperty float y\nproperty float z",
            "cannot be read (invalid literal for int() with base 10: 'many')",
        ),
        ("element vertex 2\nproperty", "have no x, y, z"),
    ],
)
def test_a_damaged_ply_header_is_reported_in_one_line(capsys, tmp_path, lines, problem):
    (tmp_path / "p.ply").write_text(f"ply\nformat ascii 1.0\n{lines}\nend_header\n")
    text = refused(capsys, "real", "measure", tmp_path / "p.ply", "--out", tmp_path / "o")
    assert f"p.ply: its vertices {problem}" in text


def test_compare_does_not_overwrite_a_measured_set(capsys, tmp_path):
    (tmp_path / "realism.json").write_text("{}")
    text = refused(capsys, "real", "compare", "a", "b", "--out", tmp_path)
    assert "is itself one of the measured sets" in text


def test_an_empty_folder_of_pictures_is_an_error(capsys, tmp_path):
    np.save(tmp_path / "z.npy", np.full((40, 50), 0.8))
    (tmp_path / "gray").mkdir()
    text = refused(capsys, "real", "measure", tmp_path / "z.npy", "--intrinsics", K_TEXT,
                   "--gray", tmp_path / "gray", "--out", tmp_path / "o")  # fmt: skip
    assert "is an empty folder" in text


@pytest.mark.parametrize("fault", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_a_folder_is_written_completely_or_not_at_all(tmp_path, fault):
    existing = tmp_path / "there"
    existing.mkdir()
    (existing / "old").write_text("old")
    for out in (existing, tmp_path / "new" / "deeper"):
        with pytest.raises((GraycastError, KeyboardInterrupt)), whole_folder(out) as folder:
            (folder / "old").write_text("half")
            raise fault
    assert [path.relative_to(tmp_path).as_posix() for path in sorted(tmp_path.rglob("*"))] == [
        "there",
        "there/old",
    ]
    assert (existing / "old").read_text() == "old"
    with whole_folder(existing) as folder:
        (folder / "old").write_text("new")
    assert [(path.name, path.read_text()) for path in existing.iterdir()] == [("old", "new")]


def test_certify_checks_its_folder_before_it_starts(capsys, tmp_path, monkeypatch):
    (tmp_path / "file").write_text("x")
    monkeypatch.setattr(
        "graycast.score.metrology.certify", lambda *_, **__: pytest.fail("it worked")
    )
    assert "file: is a file" in refused(
        capsys, "rig", "certify", "paper", "--out", tmp_path / "file"
    )


def test_the_message_of_a_stopped_command_without_scenes_mentions_none(capsys, monkeypatch):
    def stop(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("graycast.camera.stack.decode_stack", stop)
    assert main(["rig", "decode", "s.yaml", "--rig", "paper", "--out", "o"]) == 130
    assert capsys.readouterr().err == "graycast: the command was stopped; nothing was written\n"


@pytest.mark.slow
def test_patterns_of_the_rig_s_own_codec_keep_its_period(capsys, tmp_path):
    """like-phoxi-s shows periods of 48 px; naming its codec once gave the codec's default of 16."""
    run(capsys, "rig", "patterns", "like-phoxi-s", "--codec", "gray_phase", "--out", tmp_path)
    assert list(tmp_path.glob("*_phase_48px_step00.png"))


@pytest.mark.slow
def test_patterns_of_two_codes_are_not_mixed_in_one_folder(capsys, tmp_path):
    run(capsys, "rig", "patterns", "like-phoxi-s", "--out", tmp_path)
    before = sorted(tmp_path.iterdir())
    text = refused(
        capsys, "rig", "patterns", "like-phoxi-s", "--codec", "xor_gray", "--out", tmp_path
    )
    assert "holds pictures of another code" in text
    assert sorted(tmp_path.iterdir()) == before


def test_a_resolution_with_a_rig_file_is_refused(capsys, tmp_path):
    save_scanner(Scanner(rig=simulated.small_rig()), tmp_path / "rig.yaml")
    text = refused(capsys, "rig", "show", tmp_path / "rig.yaml", "--resolution", "full")
    assert "--resolution applies only to a preset" in text


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"code": {"codec": "gray_phase", "period_px": 5000}}, "code: column: one period spans"),
        ({"code": {"codec": "gray_phase", "period_px": 1}}, "code: "),
        ({"code": {"axes": []}}, "code: axes are ()"),
        ({"sensor": {"wavelength_m": 525}}, "sensor.wavelength_m is 525"),
        ({"sensor": {"pixel_pitch_m": 3.45}}, "sensor.pixel_pitch_m is 3.45"),
    ],
)
def test_a_rig_file_whose_numbers_make_no_scanner_is_refused_on_reading(
    capsys, tmp_path, changes, message
):
    path = tmp_path / "rig.yaml"
    save_scanner(Scanner(rig=simulated.small_rig()), path)
    path.write_text(yaml.safe_dump(yaml.safe_load(path.read_text()) | changes))
    assert f"{path}: {message}" in refused(capsys, "rig", "show", path)


def test_an_offset_above_saturation_is_refused_and_not_clamped(capsys, decoded, tmp_path):
    _, folder, _, _ = decoded
    content = yaml.safe_load((folder / "STACK.yaml").read_text())
    content["levels"] = {"offset_dn": 300, "saturation_dn": 255}
    path = folder / "exchanged.yaml"
    path.write_text(yaml.safe_dump(content))
    text = refused(capsys, "rig", "decode", path, "--out", tmp_path / "o")
    assert f"{path}: levels.offset_dn is 300" in text
    assert not (tmp_path / "o").exists()


@pytest.mark.slow
@pytest.mark.parametrize("codec", CODECS)
def test_decoding_the_patterns_themselves_gives_the_projector_pixels(capsys, tmp_path, codec):
    """A camera identical to the projector sees its own column and row in each pixel."""
    rig = replace(simulated.small_rig(), name="small")
    scanner = Scanner(rig=rig, code=CodeSpec(codec=codec, axes=AXES))
    save_scanner(scanner, tmp_path / "rig.yaml")
    run(capsys, "rig", "patterns", tmp_path / "rig.yaml", "--out", tmp_path / "shown")
    for path in (tmp_path / "shown").glob("*.png"):
        with Image.open(path) as image:
            level = np.array(image)
        Image.fromarray(np.rint(0.8 * level + 10).astype(np.uint8)).save(path)
    run(capsys, "rig", "decode", tmp_path / "shown" / "stack.yaml", "--out", tmp_path / "read")
    codes = np.load(tmp_path / "read" / "code.npz")
    row, column = np.mgrid[0:96, 0:128]
    known = codes["reason"] == Reason.DECODED
    assert known.mean() > 0.95
    assert np.abs(codes["column"] - column)[known].max() < 0.1
    assert np.abs(codes["row"] - row)[known].max() < 0.1


@pytest.mark.slow
def test_the_command_calibrate_recovers_the_rig(capsys, tmp_path, camera_rays, truth_poses):  # noqa: F811
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
    for estimate, true in ((rig.camera, RIG.camera), (rig.projector, RIG.projector)):
        assert estimate.fx_px == pytest.approx(true.fx_px, rel=1e-3)
        assert estimate.fy_px == pytest.approx(true.fy_px, rel=1e-3)


@pytest.mark.slow
def test_the_command_certify_writes_a_sheet(capsys, tmp_path, cpu_device):
    save_scanner(small_scanner(), tmp_path / "rig.yaml")
    printed = run(capsys, "rig", "certify", tmp_path / "rig.yaml", "--out", tmp_path / "sheet")
    assert "temporal noise" in printed.lower()
    assert (tmp_path / "sheet" / "certificate.html").read_text().startswith("<!doctype html>")
    assert json.loads((tmp_path / "sheet" / "certificate.json").read_text())
