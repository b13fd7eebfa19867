"""Stored frames and code maps are decoded to the stored depth, to the last bit."""

import json
import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest
import yaml
from captured import scanned, toed_in
from prisms import SCALE_MM, build_sample
from small_cell import content, write_cell

from graycast.camera.decode import CodeMap, DecodeSpec, FilterSpec, Reason, triangulate
from graycast.camera.rig_file import load_scanner
from graycast.camera.scanner import ExposureSpec, Scanner
from graycast.camera.sensor import SensorSpec
from graycast.camera.stack import decode_stack
from graycast.cli import main
from graycast.dataset.check.checking import validate
from graycast.dataset.check.raw_check import raw_problems
from graycast.dataset.files import records
from graycast.dataset.files.safe_reading import read_json
from graycast.dataset.files.sample import Raw
from graycast.dataset.files.scene_folder import SceneFolder
from graycast.dataset.write.bop import scene_files
from graycast.dataset.write.raw import read_capture, read_code_maps
from graycast.rig.pattern import CodeSpec

LENS = (-0.12, 0.05, 0.001, -0.0007, 0.0)
PHASES = CodeSpec(codec="gray_phase", axes=("column",), period_px=16.0, steps=4)
FILTERS = FilterSpec(flying_angle_deg=75.0, outlier_sigmas=4.0, island_px=9, smoothing_px=0.55)


def scanner_of(rig, case):
    rig = toed_in(rig)
    match case:
        case "as the paper's":
            return Scanner(rig=rig, decode=DecodeSpec(max_epipolar_px=0.0))
        case "phases, filtered":
            return Scanner(rig=rig, code=PHASES, filters=FILTERS, decode=DecodeSpec(fine_bits=2))
        case "exposures merged":
            return Scanner(rig=rig, exposure=ExposureSpec(factors=(4.0, 1.0)))
        case "outliers off their epipolar lines":
            code = replace(PHASES, axes=("column", "row"))
            return Scanner(rig=rig, code=code, decode=DecodeSpec(max_epipolar_px=0.1))
        case "doubt counts":
            doubting = DecodeSpec(fine_bits=0, doubt=0.3, min_contrast=0.4)
            return Scanner(rig=rig, sensor=SensorSpec(read_noise_e=500.0), decode=doubting)
        case "8 bits":
            sensor = SensorSpec(bit_depth=8, gain_dn_per_e=0.025, offset_dn=3.3)
            return Scanner(rig=rig, sensor=sensor)
        case "bent lenses, many periods":
            camera = replace(rig.camera, distortion=LENS)
            rig = replace(rig, camera=camera, projector=replace(rig.projector, distortion=LENS))
            return Scanner(rig=rig, code=CodeSpec(codec="multi_frequency", axes=("column",)))
        case "exclusive-or":
            return Scanner(rig=rig, code=CodeSpec(codec="xor_gray"))
    raise ValueError(case)


CASES = (
    "as the paper's",
    "phases, filtered",
    "exposures merged",
    "outliers off their epipolar lines",
    "doubt counts",
    "8 bits",
    "bent lenses, many periods",
    "exclusive-or",
)


@pytest.fixture(scope="session")
def dataset_of(tmp_path_factory, opened, parts, rig):
    """Return a dataset of one scene per case, made at the first call."""
    datasets = {}

    def make(case):
        if case not in datasets:
            scanner = scanner_of(rig, case)
            plain = build_sample(0, parts=parts, rig=rig)
            sample = scanned(plain, scanner, seed=5, roll_rad=0.003 if "outliers" in case else 0.0)
            out = tmp_path_factory.mktemp("kept") / "out"
            with opened(out, rig=scanner.rig) as store:
                store.write(0, [sample])
                store.finish([0])
            datasets[case] = out, sample
        return datasets[case]

    return make


@pytest.mark.parametrize(
    "case",
    [c if k == 0 else pytest.param(c, marks=pytest.mark.slow) for k, c in enumerate(CASES)],
)
def test_decoding_stored_frames_gives_exactly_the_stored_depth(dataset_of, case):
    """Oracle: the simulated measurement, in memory and in its PNGs, from the files alone."""
    out, sample = dataset_of(case)
    scene = out / "train/000000"
    scanner = load_scanner(scene / "frames/rig.yaml")
    result = decode_stack(scene / "frames/stack.yaml", scanner.rig, filters=scanner.filters)
    np.testing.assert_array_equal(result.depth.depth_m, sample.scanner_depth.depth_m)
    np.testing.assert_array_equal(result.depth.sigma_m, sample.scanner_depth.sigma_m)
    np.testing.assert_array_equal(result.depth.reason, sample.scanner_depth.reason)
    step = cv2.imread(str(scene / "depth_sl/000000.png"), cv2.IMREAD_UNCHANGED)
    depth_m = np.nan_to_num(result.depth.depth_m.astype(np.float64))
    np.testing.assert_array_equal(np.rint(depth_m * (1e3 / SCALE_MM)), step)
    assert (step > 0).mean() > 0.4
    assert (sample.scanner_depth.reason == Reason.OUTLIER).any() == (
        "outliers" in case or "filt" in case
    )


@pytest.mark.slow
@pytest.mark.parametrize("case", ["as the paper's", "exposures merged", "8 bits"])
def test_a_capture_is_read_back_unchanged(dataset_of, case):
    out, sample = dataset_of(case)
    stored = read_capture(out / "train/000000")
    capture = sample.raw.capture
    np.testing.assert_array_equal(stored.capture.frames, capture.frames)
    np.testing.assert_array_equal(stored.capture.exposure_s, capture.exposure_s)
    assert stored.capture.frames.dtype == (np.uint8 if case == "8 bits" else np.uint16)
    assert stored.scanner.light_code() == sample.raw.scanner.light_code()
    assert stored.capture.sensor == capture.sensor
    assert (len(np.unique(capture.exposure_s)) == 2) == ("merged" in case)


def test_opencv_reads_code_maps_and_recomputes_the_depth_from_them(dataset_of):
    """Oracles: a reader other than Pillow; the triangulation of the decoded positions."""
    out, sample = dataset_of("as the paper's")
    maps = {
        name: cv2.imread(str(out / f"train/000000/{folder}/000000.tiff"), cv2.IMREAD_UNCHANGED)
        for name, folder in (
            ("column", "column_sl"),
            ("sigma_column", "column_sigma_sl"),
            ("row", "row_sl"),
            ("sigma_row", "row_sigma_sl"),
        )
    }
    for name, image in maps.items():
        np.testing.assert_array_equal(image, getattr(sample.raw.codes, name))
        np.testing.assert_array_equal(read_code_maps(out / "train/000000")[name], image)
    reason = np.where(np.isfinite(maps["column"]), 0, Reason.SHADOW).astype(np.uint8)
    codes = CodeMap(**maps, modulation=sample.modulation, reason=reason)
    depth = triangulate(codes, sample.scene.rig)
    np.testing.assert_array_equal(depth.depth_m, sample.scanner_depth.depth_m)


@pytest.mark.slow
def test_a_code_for_one_axis_has_maps_for_that_axis_only(dataset_of):
    out, _ = dataset_of("phases, filtered")
    assert list(read_code_maps(out / "train/000000")) == ["column", "sigma_column"]
    assert not (out / "train/000000/row_sl").exists()


@pytest.mark.slow
def test_a_scene_without_stored_frames_has_the_same_bytes_as_before(parts, rig):
    sample = build_sample(0, parts=parts, rig=rig)
    scanner = Scanner(rig=toed_in(rig))
    before = dict(scene_files([sample], 0.1))
    assert dict(scene_files([replace(sample, raw=Raw(scanner=scanner))], 0.1)) == before
    after = dict(scene_files([scanned(sample, scanner, seed=5)], 0.1))
    assert {name.split("/")[0] for name in set(after) - set(before)} == {
        "frames", "column_sl", "column_sigma_sl", "row_sl", "row_sigma_sl"
    }  # fmt: skip
    manifest = json.loads(after["manifest.json"])
    assert set(manifest) - set(json.loads(before["manifest.json"])) == {"frames", "code_maps"}
    patterns = manifest["frames"]["shown"]
    assert patterns[:2] == [
        {"file": "0000.png", "kind": "white"},
        {"file": "0001.png", "kind": "black"},
    ]
    assert patterns[2] == {"file": "0002.png", "kind": "gray", "axis": "column", "bit": 7}


def test_a_stack_with_another_image_size_is_refused(rig, dataset_of):
    _, sample = dataset_of("as the paper's")
    with pytest.raises(ValueError, match="the captured stack is"):
        replace(sample.raw, scanner=Scanner(rig=toed_in(rig), code=PHASES))


# --- validate ----------------------------------------------------------------------------------


def problems(out):
    scene = out / "train/000000"
    camera = read_json(out / "camera.json", records.Camera)
    gray, reason = (
        cv2.imread(str(scene / f"{name}_sl/000000.png"), cv2.IMREAD_UNCHANGED)
        for name in ("gray", "reason")
    )
    return list(raw_problems(SceneFolder(scene), 0, camera, gray=gray, reason=reason))


def repaint(path, change):
    cv2.imwrite(str(path), change(cv2.imread(str(path), cv2.IMREAD_UNCHANGED)))


def edit_yaml(path, change):
    content = yaml.safe_load(path.read_text())
    change(content)
    path.write_text(yaml.safe_dump(content))


def edit_manifest(scene, change):
    path = scene / "manifest.json"
    content = json.loads(path.read_bytes())
    change(content)
    path.write_text(json.dumps(content))


DAMAGE = {
    "a frame missing": (lambda s: (s / "frames/0004.png").unlink(), "tells of 20: see 0004.png"),
    "a frame too many": (
        lambda s: shutil.copy(s / "frames/0004.png", s / "frames/0018.png"),
        "tells of 20: see 0018.png",
    ),
    "a frame cut off": (
        lambda s: (s / "frames/0004.png").write_bytes((s / "frames/0004.png").read_bytes()[:900]),
        "0004.png is cut off",
    ),
    "frames of 8 bits": (
        lambda s: [repaint(p, lambda v: (v >> 4).astype(np.uint8)) for p in s.glob("frames/00*")],
        "the pictures 8 bits",
    ),
    "a frame of another size": (
        lambda s: repaint(s / "frames/0003.png", lambda v: v[:-1]),
        "frames: all input arrays must have the same shape",
    ),
    "a value beyond the converter": (
        lambda s: repaint(s / "frames/0005.png", lambda v: v | 4096),
        "0005.png has the value",
    ),
    "another scene's frame": (
        lambda s: repaint(s / "frames/0000.png", lambda v: v[:, ::-1]),
        "gray_sl is not the first",
    ),
    "two bits exchanged in the stack file": (
        lambda s: edit_yaml(
            s / "frames/stack.yaml",
            lambda c: [c["frames"][k].update(bit=b) for k, b in ((2, 6), (3, 7))],
        ),
        "its frames are not those of manifest.json",
    ),
    "another code in the rig file": (
        lambda s: edit_yaml(s / "frames/rig.yaml", lambda c: c["code"].update(inverses=True)),
        "the captured stack is",
    ),
    "another code in the rig file, as long": (
        lambda s: edit_yaml(s / "frames/rig.yaml", lambda c: c["code"]["axes"].reverse()),
        "its code is not that of stack.yaml",
    ),
    "no rig file": (lambda s: (s / "frames/rig.yaml").unlink(), "rig.yaml"),
    "another bit depth": (
        lambda s: edit_manifest(s, lambda m: m["frames"].update(bit_depth=10)),
        "manifest.json has bit_depth 10",
    ),
    "a manifest that does not tell": (
        lambda s: edit_manifest(s, lambda m: m.pop("frames")),
        "manifest.json tells of 0",
    ),
    "a manifest that tells of no map": (
        lambda s: edit_manifest(s, lambda m: m["code_maps"].remove("row_sl")),
        "row_sl/ is there",
    ),
    "a map missing": (
        lambda s: (s / "column_sl/000000.tiff").unlink(),
        "column_sl/000000.tiff is missing",
    ),
    "half a map": (
        lambda s: (s / "column_sl/000000.tiff").write_bytes(
            (s / "column_sl/000000.tiff").read_bytes()[:3000]
        ),
        "column_sl/000000.tiff is cut off",
    ),
    "a map of whole numbers": (
        lambda s: repaint(s / "row_sl/000000.tiff", lambda v: np.nan_to_num(v).astype(np.uint16)),
        "it must be float32",
    ),
    "a map without gaps": (
        lambda s: repaint(s / "row_sl/000000.tiff", np.nan_to_num),
        "map of row and reason_sl disagree",
    ),
    "half a stack file": (
        lambda s: (s / "frames/stack.yaml").write_text("frames: ["),
        "frames/stack.yaml: ",
    ),
    "frames of another size": (
        lambda s: [
            *(repaint(p, lambda v: v[:-1]) for p in s.glob("frames/00*")),
            edit_yaml(s / "frames/rig.yaml", lambda c: c["camera"].update(height_px=119)),
        ],
        "frames/ has pictures of [119, 160], the camera has [120, 160]",
    ),
    "a map of another size": (
        lambda s: repaint(s / "row_sl/000000.tiff", lambda v: v[:-1]),
        "map of row is",
    ),
    "a map below its first pixel": (
        lambda s: repaint(s / "column_sl/000000.tiff", lambda v: v - 200),
        "under -0.5",
    ),
}  # fmt: skip


def test_an_undamaged_dataset_with_frames_is_valid(dataset_of):
    assert problems(dataset_of("as the paper's")[0]) == []


@pytest.mark.slow
@pytest.mark.parametrize("case", [c for c in CASES if "bent" not in c])  # its true pose is straight
def test_every_kind_of_stack_is_valid(dataset_of, case):
    assert validate(dataset_of(case)[0]) == ()


@pytest.mark.slow
@pytest.mark.parametrize("damage", DAMAGE)
def test_damage_in_frames_and_maps_is_detected(dataset_of, tmp_path, damage):
    do, reason = DAMAGE[damage]
    out = shutil.copytree(dataset_of("as the paper's")[0], tmp_path / "out")
    do(out / "train/000000")
    texts = problems(out)
    assert any(reason in text for text in texts), texts


# --- all steps -----------------------------------------------------------------------------------


def decoded(capsys, *arguments):
    assert main(["rig", "decode", *map(str, arguments)]) == 0
    capsys.readouterr()


@pytest.mark.slow
def test_the_stack_file_is_found_in_its_folder_and_names_its_rig(dataset_of, capsys, tmp_path):
    out, sample = dataset_of("phases, filtered")
    decoded(capsys, out / "train/000000/frames", "--out", tmp_path)
    np.testing.assert_array_equal(np.load(tmp_path / "depth.npy"), sample.scanner_depth.depth_m)


@pytest.mark.slow
def test_a_missing_rig_file_is_named(dataset_of, tmp_path, capsys):
    folder = shutil.copytree(
        dataset_of("as the paper's")[0] / "train/000000/frames", tmp_path / "frames"
    )
    (folder / "rig.yaml").unlink()
    assert main(["rig", "decode", str(folder), "--out", str(tmp_path / "o")]) != 0
    assert "rig.yaml" in capsys.readouterr().err


@pytest.mark.slow
def test_stored_frames_of_a_generated_dataset_can_be_decoded(capsys, tmp_path):
    """With the renderer's light and all steps: graycast generate, validate, decode."""
    for name, store in (("plain", {}), ("kept", {"frames": True, "columns": True})):
        folder = tmp_path / name
        folder.mkdir()
        cell = write_cell(folder, store=store, scenes=1)
        out = folder / "out"
        assert main(["generate", str(cell), "--out", str(out), "--device", "cpu"]) == 0
    plain, with_raw = (content(tmp_path / name / "out") for name in ("plain", "kept"))
    assert validate(tmp_path / "kept/out") == ()
    new = {name.split("/")[2] for name in set(with_raw) - set(plain)}
    assert new >= {"frames", "column_sl"} and not set(plain) - set(with_raw)
    pictures = [name for name in plain if name.endswith(".png") and "train" in name]
    assert all(plain[name] == with_raw[name] for name in pictures) and len(pictures) > 10
    scene = tmp_path / "kept/out/train/000000"
    decoded(capsys, scene / "frames", "--out", tmp_path / "decoded")
    step = cv2.imread(str(scene / "depth_sl/000000.png"), cv2.IMREAD_UNCHANGED)
    depth_m = np.load(tmp_path / "decoded/depth.npy").astype(np.float64)
    scale_mm = json.loads((scene / "scene_camera_sl.json").read_bytes())["0"]["depth_scale"]
    np.testing.assert_array_equal(np.rint(np.nan_to_num(depth_m * (1e3 / scale_mm))), step)
