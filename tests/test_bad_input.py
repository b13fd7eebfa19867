"""Wrong input to a command gives one line with fault and remedy, and leaves no partial output."""

import fcntl
import os
import shutil
import subprocess
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh
from backends import slow
from drawn import no_pixels
from PIL import Image
from small_cell import GRAYCAST, write_cell

from graycast.cli import main
from graycast.rendering import device
from graycast.rendering.device import CudaState, examine_cuda


def refusal(capsys, *arguments):
    """Return the single line that a failing command writes to stderr."""
    assert main([str(argument) for argument in arguments]) == 1
    return one_line(capsys.readouterr().err)


def one_line(text):
    assert text.startswith("graycast: error: ")
    assert text.endswith("\n")
    assert text.count("\n") == 1
    assert "Traceback" not in text
    return text


def assert_untouched(out: Path):
    """Check that the folder is missing or not claimed; the lock of the failed run may remain."""
    assert not out.exists() or {entry.name for entry in out.iterdir()} <= {".lock"}


# --- the configuration -------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"scnes": 3}, ["unknown key scnes", "did you mean scenes?"]),
        ({"zebra": 3}, ["unknown key zebra", "the keys are code, exposure"]),
        ({"render": {"sample": 4}}, ["unknown key render.sample", "did you mean samples?"]),
        (
            {"filters": {"raster_px": 0.3}},
            ["unknown key filters.raster_px: it belongs to the section faults, so move it there\n"],
        ),
        (
            {"light": {"lamps": [{"cener_m": [0, 0, 1]}]}},
            ["unknown key light.lamps.0.cener_m", "did you mean center_m?"],
        ),
        (
            {"parts": [{"mesh": "box.stl", "unti": "mm"}]},
            ["unknown key parts.0.unti: did you mean unit?\n"],
        ),
        ({"seed": "many"}, ["seed is 'many'", "it should be a whole number"]),
        (
            {"count": "many"},
            ["count is 'many'", "give one number of parts, or two numbers [lowest, highest]"],
        ),
        ({"count": -1}, ["count is -1", "give a number from 0 to 255"]),
        ({"count": [3, 0]}, ["count is [3, 0]", "[lowest, highest]"]),
        ({"count": 256}, ["count is 256", "give a number from 0 to 255"]),
        ({"count": [5, 2]}, ["count is [5, 2]", "[lowest, highest]"]),
        ({"fill": 0.4, "count": 5}, ["count and fill", "remove one"]),
        ({"render": {"samples": 0}}, ["render.samples is 0", "greater than or equal to 1"]),
        ({"view": {"tilt_deg": 85}}, ["view.tilt_deg is 85", "less than or equal to 80"]),
        ({"view": {"distance_m": float("nan")}}, ["view.distance_m is nan", "finite number"]),
        ({"view": {"azimuth_deg": float("inf")}}, ["view.azimuth_deg is inf", "finite number"]),
        ({"drop": {"penetration_m": 0.5}}, ["drop.penetration_m is 0.5", "less than or equal"]),
        ({"bin": {"inner_m": [0.3, 0.2]}}, ["bin.inner_m.2 is missing: add it"]),
        (
            {"bin": {"inner_m": [25, 2, 1], "material": {}}},
            ["bin.inner_m.0 is 25", "less than or equal to 5"],
        ),
        ({"bin": 3}, ["bin is 3: it should be a section with keys\n"]),
        ({"parts": "box"}, ["parts is 'box': it should be a list\n"]),
        ({"scanners": {"a": 1}}, ["scanners is a mapping: it should be a list\n"]),
        ({"scenes": {"a": 1}}, ["scenes is a mapping: it should be a whole number\n"]),
        ({"render": {"denoise": "maybe"}}, ["denoise is 'maybe': it should be true or false\n"]),
        ({"light": {"environment": {"map": 3}}}, ["map is 3: it should be a path\n"]),
        ({"parts": []}, ["parts is []", "at least 1"]),
        ({"parts": [{"builtin": "bracket"}]}, ["'bracket'", "choose metal_workpiece_1"]),
        (
            {"parts": [{"builtin": "toothpaste", "mesh": "box.stl"}]},
            ["parts.0: give either builtin or mesh, and not both\n"],
        ),
        (
            {"parts": [{"density_kg_m3": 900}]},
            ["parts.0: give either builtin or mesh, and not both\n"],
        ),
        ({"parts": [{"mesh": "box.stl", "unit": "mm"}] * 2}, ["two parts have the name box"]),
        ({"rig": "phoxi-xl"}, ["no rig 'phoxi-xl'", "choose one of paper"]),
        ({"code": {"axes": ["row"]}}, ["code.axes is row", "needs column"]),
        ({"light": {"environment": {"map": "none.exr"}}}, ["light.environment.map", "none.exr"]),
        (
            {"light": {"lamps": [{"center_m": [0, 0, 1], "target_m": [0, 0, 1]}]}},
            ["lamp at (0.0, 0.0, 1.0)", "move target_m"],
        ),
        (
            {"bin": {"material": {"texture": "none.png"}}},
            ["texture", "none.png", "give a PNG or JPEG picture"],
        ),
        (
            {"parts": [{"mesh": "box.stl", "symmetry": {"discrete": [[1.0, 2.0]]}}]},
            ["parts.0.symmetry", "has 2 numbers; give 16"],
        ),
        (
            {"parts": [{"mesh": "box.stl", "symmetry": {"discrete": [list(range(16))]}}]},
            ["parts.0.symmetry", "not a rotation and a translation"],
        ),
        (
            {"parts": [{"mesh": "box.stl", "symmetry": {"continuous": [{"axis": [0, 0, 0]}]}}]},
            ["continuous.0.axis is [0, 0, 0]", "such as [0, 0, 1]"],
        ),
    ],
    ids=lambda value: str(value)[:50] if isinstance(value, dict) else "",
)
def test_a_wrong_setting_is_named_with_its_file_and_the_allowed_values(
    capsys, tmp_path, changes, words
):
    path, out = write_cell(tmp_path, **changes), tmp_path / "out"
    text = refusal(capsys, "generate", path, "--out", out)
    assert text.startswith(f"graycast: error: {path}: ")
    for word in words:
        assert word in text
    assert not out.exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "words"),
    [
        (b"count: 3\nparts: []\ncount: 4\n", ["line 3", "count is given twice", "remove"]),
        (b"parts: [1, 2\n", ["not YAML", "correct or remove"]),
        (b"parts:\n\t- builtin: x\n", ["line 2", "correct or remove"]),
        (b"parts: \xff\xfe\x00", ["not a text file", "give a YAML file"]),
        (b"parts: \x00", ["not YAML", "bad characters"]),
        (b"parts: 2024-13-45\n", ["not YAML", "month"]),
        (b"parts: " + 1000 * b"[", ["not YAML", "recursion"]),
        (b"", ["holds no keys"]),
        (b"- builtin: toothpaste\n", ["holds no keys", "name: value"]),
        (b"count: 3\n", ["parts is missing: add it"]),
        (b"parts: !!python/object:os.system x\n", ["line 1", "python/object"]),
    ],
    ids=lambda value: str(value)[:30] if isinstance(value, bytes) else "",
)
def test_a_text_that_is_no_configuration_is_refused_with_its_line(capsys, tmp_path, text, words):
    path, out = tmp_path / "bad.yaml", tmp_path / "out"
    path.write_bytes(text)
    answer = refusal(capsys, "generate", path, "--out", out)
    for word in (f"{path}: ", *words):
        assert word in answer
    assert not out.exists()


def test_a_missing_configuration_file_is_refused(capsys, tmp_path):
    assert f"{tmp_path}: cannot be read (Is a directory)" in refusal(capsys, "preview", tmp_path,
                                                                     "--out", "x.png")  # fmt: skip
    assert "none.yaml: no such file: check the path" in refusal(capsys, "parts", "none.yaml")


# --- the files that a configuration names ------------------------------------------------------


def box():
    return trimesh.creation.box((60, 40, 30))


def inside_out():
    mesh = box()
    mesh.invert()
    return mesh


def lidless():
    mesh = box()
    mesh.update_faces(np.arange(10))
    return mesh


def not_a_number():
    mesh = box()
    vertices = np.array(mesh.vertices)
    vertices[0, 0] = np.nan
    return trimesh.Trimesh(vertices, mesh.faces, process=False)


def written(content):
    return lambda path: path.write_bytes(content)


def cut(path):
    box().export(path)
    path.write_bytes(path.read_bytes()[:300])


@pytest.mark.parametrize(
    ("name", "make", "unit", "words"),
    [
        ("none.stl", lambda path: None, "mm", ["no such file", "check the path"]),
        ("part.stl", written(b""), "mm", ["the file is empty", "export the mesh again"]),
        ("part.stl", cut, "mm", ["may be incomplete", "export it again"]),
        ("part.stl", lambda path: lidless().export(path), "mm", ["open", "close its holes"]),
        ("part.stl", lambda path: inside_out().export(path), "mm", ["inside out", "flip"]),
        ("part.stl", lambda path: not_a_number().export(path), "mm", ["NaN", "export"]),
        ("part.stl", lambda path: box().export(path), "m", ["60 m", "state unit: cm or mm"]),
        ("part.stl", lambda path: box().export(path), None, ["no unit", "state unit: cm or mm"]),
        ("part.dwg", written(b"x"), "mm", ["cannot read .dwg", "export .obj, .ply, .stl, .glb"]),
    ],
    ids="missing empty cut open inside-out nan metres unstated step".split(),
)
def test_a_bad_mesh_is_named_with_the_remedy(capsys, tmp_path, name, make, unit, words):
    make(tmp_path / name)
    path, out = write_cell(tmp_path, parts=[{"mesh": name, "unit": unit}]), tmp_path / "out"
    text = refusal(capsys, "generate", path, "--out", out)
    for word in (str(path), str(tmp_path / name), *words):
        assert word in text
    assert not out.exists()


def picture_bytes(folder):
    pixels = np.random.default_rng(0).integers(0, 255, (64, 64, 3), dtype=np.uint8)
    Image.fromarray(pixels).save(folder / "sound.png")
    return (folder / "sound.png").read_bytes()


@pytest.mark.parametrize("damage", ["cut", "flipped", "other", "folder"])
def test_a_broken_texture_is_named_with_the_remedy(capsys, tmp_path, damage):
    sound, path = picture_bytes(tmp_path), tmp_path / "texture.png"
    match damage:
        case "cut":
            path.write_bytes(sound[: len(sound) // 2])
        case "flipped":
            path.write_bytes(sound[:200] + bytes([sound[200] ^ 255]) + sound[201:])
        case "other":
            path.write_bytes(b"no picture")
        case "folder":
            path.mkdir()
    config = write_cell(tmp_path, bin={"material": {"texture": "texture.png"}})
    text = refusal(capsys, "generate", config, "--out", tmp_path / "out")
    assert f"{config}: texture {path}: " in text
    assert "give a PNG or JPEG picture" in text
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
@pytest.mark.parametrize("ending", [slow("exr"), "hdr"])
def test_a_damaged_environment_map_is_named_and_no_folder_is_made(capsys, tmp_path, ending):
    """The output folder once stayed claimed, so the corrected configuration was refused."""
    sky = np.random.default_rng(0).random((16, 32, 3)).astype(np.float32)
    whole = cv2.imencode(".hdr", sky)[1].tobytes()
    content = b"v/1\x01\x02\x00\x00\x00channels" if ending == "exr" else whole[: len(whole) // 2]
    (tmp_path / f"sky.{ending}").write_bytes(content)
    path = write_cell(tmp_path, light={"environment": {"map": f"sky.{ending}"}})
    text = refusal(capsys, "generate", path, "--out", tmp_path / "out", "--device", "cpu")
    assert f"environment map {tmp_path / f'sky.{ending}'} cannot be read" in text
    assert "give a latitude-longitude EXR or HDR picture" in text
    assert_untouched(tmp_path / "out")


def test_a_broken_rig_file_is_named_by_its_key(capsys, tmp_path):
    path = write_cell(tmp_path)
    rig = tmp_path / "rig.yaml"
    rig.write_text(rig.read_text().replace("near_m", "naer_m"))
    text = refusal(capsys, "generate", path, "--out", tmp_path / "out")
    assert f"{path}: {rig}: unknown key naer_m: did you mean near_m?" in text
    assert not (tmp_path / "out").exists()
    assert "did you mean near_m?" in refusal(capsys, "rig", "show", rig)


@pytest.mark.slow
def test_parts_that_do_not_fit_in_the_bin_are_refused_before_they_fall(capsys, tmp_path):
    for count, inner_m, words in (
        (3, [0.02, 0.02, 0.1], ["part box", "60 x 40 x 30 mm", "20 x 20 x 100 mm", "larger bin"]),
        (255, [0.08, 0.08, 0.05], ["255 parts", "18.4 litres", "drop 3 at most"]),
    ):
        path = write_cell(tmp_path, count=count, bin={"inner_m": inner_m, "material": {}})
        text = refusal(capsys, "generate", path, "--out", tmp_path / "out", "--device", "cpu")
        for word in words:
            assert word in text
        assert_untouched(tmp_path / "out")


CALIBRATION = """
K1: [[900, 0, 320], [0, 900, 240], [0, 0, 1]]
K2: [[800, 0, 400], [0, 800, 300], [0, 0, 1]]
cam_size: [640, 480]
pro_size: [800, 600]
R: [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
T: [-0.1, 0, 0]
"""


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("K1", "X1", ["no camera matrix", "M1 or K1 or cameraMatrix1 or cam_K"]),
        ("[0, 0, 1]]\nT", "[0, 0, 2]]\nT", ["R is not a rotation", "det 2", "all digits"]),
        ("-0.1", "-5.0", ["T has length 5", "--unit"]),
        ("cam_size", "other", ["the camera image size is missing", "cam_size: [width, height]"]),
    ],
)
def test_a_bad_calibration_is_named_by_its_key(capsys, tmp_path, old, new, words):
    path, out = tmp_path / "stereo.yaml", tmp_path / "rig.yaml"
    arguments = ("rig", "import", path, "--out", out, "--near", "0.3", "--far", "1.0")
    path.write_text(CALIBRATION.replace(old, new))
    text = refusal(capsys, *arguments)
    for word in (str(path), *words):
        assert word in text
    assert not out.exists()
    path.write_text(CALIBRATION)
    assert main([str(argument) for argument in arguments]) == 0


# --- folders, devices, datasets ----------------------------------------------------------------


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    """Return a dataset of one scene, and the path of its configuration."""
    folder = tmp_path_factory.mktemp("made")
    path = write_cell(folder)
    out = folder / "out"
    arguments = ["generate", str(path), "--out", str(out), "--scenes", "1", "--device", "cpu"]
    with no_pixels():  # The plots of the dataset's card need no pixels.
        assert main(arguments) == 0
    return path, out


def everything(folder):
    return {path: path.stat().st_mtime_ns for path in folder.rglob("*") if path.name != ".lock"}


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("foreign", ["is not empty and holds no Graycast dataset", "thesis.txt", "choose another"]),
        ("file", ["is a file", "give a folder"]),
        ("below a file", ["Not a directory"]),
    ],
)
def test_an_existing_file_or_a_folder_of_other_files_stays_unchanged(capsys, tmp_path, kind, words):
    path, out = write_cell(tmp_path), tmp_path / "out"
    if kind == "foreign":
        out.mkdir()
        (out / "thesis.txt").write_text("years of work")
    else:
        out.write_text("years of work")
    before = everything(tmp_path)
    where = out / "deeper" if kind == "below a file" else out
    text = refusal(capsys, "generate", path, "--out", where)
    for word in (str(out), *words):
        assert word in text
    assert everything(tmp_path) == before


@pytest.mark.parametrize(
    ("arguments", "changes", "words"),
    [
        (["--seed", "1"], {}, "differs in seed (0 there, 1 here)"),
        ([], {"count": 4}, "differs in config.count (3 there, 4 here)"),
        (
            [],
            {"render": {"samples": 5, "denoise": False}},
            "differs in config.render.samples (4 there, 5 here)",
        ),
    ],
)
def test_a_dataset_of_another_configuration_stays_unchanged(
    capsys, tmp_path, dataset, arguments, changes, words
):
    out, path = dataset[1], write_cell(tmp_path, **changes)
    before = everything(out)
    text = refusal(capsys, "generate", path, "--out", out, *arguments)
    assert str(out) in text
    assert words in text
    assert "choose another folder, or remove this one" in text
    assert everything(out) == before


def test_a_dataset_that_another_run_is_writing_stays_unchanged(capsys, dataset):
    path, out = dataset
    before = everything(out)
    with open(out / ".lock", "a") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        text = refusal(capsys, "generate", path, "--out", out, "--scenes", "1")
    assert f"another run is writing to {out}: wait until it ends" in text
    assert everything(out) == before


def test_a_folder_without_permission_to_write_is_named(capsys, tmp_path):
    path, locked = write_cell(tmp_path), tmp_path / "locked"
    locked.mkdir(mode=0o500)
    if os.access(locked, os.W_OK):
        pytest.skip("this user may write everywhere")
    text = refusal(capsys, "generate", path, "--out", locked / "out")
    assert f"cannot write to {locked / 'out'}" in text
    assert "make the folder writable" in text


@pytest.mark.slow
def test_the_error_for_a_picture_or_table_without_a_folder_says_what_to_check(capsys, tmp_path):
    nowhere = tmp_path / "none" / "rig.png"
    text = refusal(capsys, "rig", "show", "paper", "--out", nowhere)
    assert str(nowhere) in text
    assert "): give a path in an existing folder with free space" in text
    text = refusal(capsys, "rig", "write", "paper", "--out", nowhere)
    assert f"the rig {nowhere}: cannot be written" in text
    assert not nowhere.parent.exists()


def test_a_missing_gpu_is_reported_with_the_remedy(capsys, tmp_path):
    if examine_cuda().usable:
        pytest.skip("this machine has a GPU")
    path = write_cell(tmp_path)
    text = refusal(capsys, "generate", path, "--out", tmp_path / "out", "--device", "cuda")
    assert "device cuda cannot be used" in text
    assert "use --device cpu" in text
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("has_apt", "remedy"),
    [(True, "apt-get install libllvm19\n"), (False, "install a shared LLVM 19 with the system")],
)
def test_the_error_for_missing_llvm_has_a_remedy(capsys, tmp_path, monkeypatch, has_apt, remedy):
    monkeypatch.setattr(device, "find_llvm", lambda folders=None: None)
    monkeypatch.setattr(device, "list_llvm", lambda folders=None: ())
    monkeypatch.setattr(device, "examine_cuda", lambda: CudaState(problem="none"))
    monkeypatch.setattr(device.shutil, "which", lambda name: f"/bin/{name}" if has_apt else None)
    path = write_cell(tmp_path)
    text = refusal(capsys, "generate", path, "--out", tmp_path / "out")
    assert "rendering on the processor needs a shared LLVM 19 or newer" in text
    assert remedy in text
    assert not (tmp_path / "out").exists()


def test_a_folder_that_is_no_dataset_is_not_validated(capsys, tmp_path):
    (tmp_path / "note.txt").write_text("x")
    for path in (tmp_path, tmp_path / "none", tmp_path / "note.txt"):
        text = refusal(capsys, "validate", path)
        assert f"{path} is not a Graycast dataset that can be read: graycast.json" in text


def test_a_truncated_picture_and_its_scene_are_named(capsys, tmp_path, dataset):
    shutil.copytree(dataset[1], tmp_path / "out")
    picture = tmp_path / "out" / "train" / "000000" / "rgb" / "000000.png"
    picture.write_bytes(picture.read_bytes()[:-200])
    assert main(["validate", str(tmp_path / "out")]) == 1
    printed, complaint = capsys.readouterr()
    assert "scene 000000: rgb/000000.png is cut off or damaged\n" in printed
    assert "2 problem(s)" in printed
    assert complaint == ""


# --- the command line itself -------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nope"], "'nope' does not exist: graycast --help lists all"),
        (["generat"], "'generat' does not exist: did you mean generate?"),
        (["generate"], "required: config, --out"),
        (["generate", "x.yaml", "--out", "x", "--wrokers", "2"], "--wrokers"),
        (["generate", "x.yaml", "--out", "x", "--workers", "0"], "'0' is not a whole number"),
        (["generate", "x.yaml", "--out", "x", "--scenes", "-3"], "--scenes"),
        (["generate", "x.yaml", "--out", "x", "--seed", "1.5"], "'1.5' is not a whole number"),
        (["generate", "x.yaml", "--out", "x", "--device", "tpu"], "did you mean cpu?"),
        (["preview", "x.yaml", "--out", "x.png", "--scene", "-1"], "'-1' is not a whole number"),
        (["schema", "part"], "invalid choice: 'part'"),
        (["rig", "import", "x", "--out", "y", "--near", "1", "--far", "2", "--camera-size", "9"],
         "'9' is not a size such as 1280x720"),
    ],
)  # fmt: skip
def test_wrong_arguments_are_named_and_end_with_code_2(capsys, arguments, words):
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    assert caught.value.code == 2
    assert words in capsys.readouterr().err.splitlines()[-1]


@pytest.mark.slow
def test_a_failing_command_exits_with_its_code_and_one_line(tmp_path):
    path = write_cell(tmp_path, scnes=3)
    run = subprocess.run(
        [*GRAYCAST, "generate", str(path), "--out", str(tmp_path / "out")],
        capture_output=True,
        text=True,
    )
    assert run.returncode == 1
    assert "did you mean scenes?" in one_line(run.stderr)
    assert run.stdout == ""
    assert subprocess.run([*GRAYCAST, "nope"], capture_output=True).returncode == 2


def test_the_option_debug_prints_the_traceback_of_an_error(tmp_path):
    path = write_cell(tmp_path, scnes=3)
    with pytest.raises(Exception, match=r"did you mean scenes\?"):
        main(["generate", str(path), "--out", str(tmp_path / "out"), "--debug"])
