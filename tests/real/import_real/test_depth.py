"""Import of depth of real cameras: missing values, distant pixels, and ray lengths."""

import numpy as np
import pytest

from graycast.base.errors import DatasetError
from graycast.cli import main
from graycast.dataset.check.checking import validate
from graycast.dataset.training import open_examples
from graycast.real.depth_file import FileOptions
from graycast.real.import_real import import_real

from .photos import H, K, W, slope_mm, write_depth


def imported(folder, **options):
    """Import a folder; return the first depth map of the dataset, and the result."""
    out = folder.with_name(f"{folder.name}-out")
    files = {
        key: options.pop(key) for key in ("scale_m", "ray_length", "max_depth_m") if key in options
    }
    done = import_real(folder, out, files=FileOptions(K=K, **files), labelled=False, **options)
    assert validate(out) == ()
    return open_examples(out)[0].scanner_depth_m, done


@pytest.mark.parametrize("pixels", [1, 200, 3000], ids=["one", "3 %", "half"])
@pytest.mark.parametrize("kind", ["uint16", "int32", "float32"])
def test_the_largest_number_of_a_type_means_missing_depth(tmp_path, pixels, kind):
    """Symptom: 65535 became a wall at 65.5 m if under 5 % of the pixels had this value."""
    depth = (slope_mm() / (1000 if kind == "float32" else 1)).astype(kind)
    limits = np.finfo(kind) if kind == "float32" else np.iinfo(kind)
    hole = np.zeros(depth.shape, bool)
    hole.flat[np.random.default_rng(0).permutation(depth.size)[:pixels]] = True
    depth[hole] = limits.max
    folder = tmp_path / "scans"
    if kind == "int32":
        (folder / "depth").mkdir(parents=True)
        for k in range(2):
            np.save(folder / f"depth/{k}.npy", depth)
    else:
        write_depth(folder, depth)
    depth_m, done = imported(folder, scale_m=None if kind == "float32" else 0.001)
    assert np.array_equal(np.isnan(depth_m), hole)
    assert np.nanmax(depth_m) < 0.81
    (note,) = done.notes
    assert note.startswith(f"{2 * pixels} pixels in 2 pictures have the largest number")


@pytest.mark.slow
def test_a_single_distant_pixel_that_makes_all_steps_coarse_is_named(tmp_path):
    """Symptom: the step was 1 mm instead of 0.02 mm, without a message."""
    rng = np.random.default_rng(1)
    depth_m = 1e-3 * slope_mm() + 1e-4 * rng.standard_normal((H, W))
    folder = write_depth(tmp_path / "scans", depth_m)
    far = depth_m.copy()
    far[5, 6] = 48.0
    np.save(folder / "depth/000001.npy", far)
    _, done = imported(folder)
    assert done.depth_scale_mm == 1.0
    (note,) = done.notes
    assert "in steps of 1 mm because" in note and "000001.npy has a pixel at 48 m" in note
    assert "0.02 mm would do" in note and note.endswith("give --max-depth 1.31")

    folder = folder.rename(tmp_path / "again")
    stored_m, done = imported(folder, max_depth_m=1.31)
    assert done.depth_scale_mm == 0.02
    assert np.abs(stored_m - depth_m).max() <= 0.51 * 0.02e-3
    assert np.isnan(open_examples(tmp_path / "again-out")[1].scanner_depth_m).sum() == 1
    (note,) = done.notes
    assert "1 pixels in 1 pictures lie beyond --max-depth 1.31" in note
    with pytest.raises(DatasetError, match=r"no depth up to --max-depth 0\.1: give a larger one"):
        import_real(
            folder, tmp_path / "no", files=FileOptions(K=K, max_depth_m=0.1), labelled=False
        )


def test_a_deep_scene_has_coarse_steps_without_a_note(tmp_path):
    depth_m = np.tile(np.linspace(0.5, 60.0, W), (H, 1)) + 1e-3 * np.arange(H)[:, None]
    _, done = imported(write_depth(tmp_path / "scans", depth_m))
    assert (done.depth_scale_mm, done.notes) == (1.0, ())


def tilted_plane_m():
    """Return z and ray lengths of a tilted plane, 0.8 m from the camera."""
    y, x = np.mgrid[:H, :W]
    ray = np.stack([(x - K[0, 2]) / K[0, 0], (y - K[1, 2]) / K[1, 1], np.ones((H, W))], -1)
    normal = np.array([0.2, -0.1, 1.0])
    z_m = 0.8 / (ray @ normal)
    point = ray * z_m[..., None]
    return z_m, np.sqrt((point**2).sum(axis=-1))


@pytest.mark.slow
def test_lengths_of_rays_are_recognised_and_converted(tmp_path):
    """Oracle: the distance and the z of the same points."""
    z_m, length_m = tilted_plane_m()
    assert np.abs(length_m - z_m).max() > 0.1
    _, done = imported(write_depth(tmp_path / "lengths", length_m))
    (note,) = done.notes
    assert "seems to be the length of each ray and not z: taken as lengths, 100%" in note
    folder = write_depth(tmp_path / "converted", length_m)
    stored_m, done = imported(folder, ray_length=True)
    assert done.notes == ()
    assert np.abs(stored_m - z_m).max() <= 0.51e-3 * done.depth_scale_mm
    _, done = imported(write_depth(tmp_path / "z", z_m))
    assert done.notes == ()
    _, done = imported(write_depth(tmp_path / "wrong", z_m), ray_length=True)
    assert "seems to be z and not the length of each ray" in done.notes[0]


def test_the_options_of_depth_exist_on_the_command_line(tmp_path, capsys):
    z_m, length_m = tilted_plane_m()
    length_m[0, 0] = 30.0
    folder, out = write_depth(tmp_path / "scans", length_m), tmp_path / "out"
    words = [
        "--unlabelled",
        "--intrinsics",
        "100,100,47.5,31.5",
        "--ray-length",
        "--max-depth",
        "1.3",
    ]
    assert main(["dataset", "import", str(folder), "--out", str(out), *words]) == 0
    printed = capsys.readouterr().out
    assert "2 pictures, no instances\n" in printed
    assert "note: 2 pixels in 2 pictures lie beyond --max-depth 1.3" in printed
    stored_m = open_examples(out)[0].scanner_depth_m
    assert np.isnan(stored_m[0, 0]) and np.nanmax(np.abs(stored_m - z_m)) < 2e-5
