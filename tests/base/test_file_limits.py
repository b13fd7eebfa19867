"""Users' files that would fill the memory or the stack are refused when their beginning is read."""

import io
import json
import re
import struct
import zipfile
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image, ImageFile
from simulated_dataset import write_dataset

from graycast.base.errors import ConfigError, DatasetError, DecodeError, GraycastError
from graycast.base.file_limits import (
    MOST_PX,
    check_runs,
    load_array,
    parse_json,
    refuse_large_picture,
    refuse_turned,
)
from graycast.camera.rig_file import missing_distortions
from graycast.camera.stack.stack_pictures import read_pictures
from graycast.cell.config import EnvironmentSection, resolve_environment
from graycast.cli import main
from graycast.dataset.files.safe_reading import Unreadable, read_png
from graycast.real.depth_file import FileOptions, read_image, read_intrinsics
from graycast.real.picture_pairs import RealPicture, read_shot
from graycast.world.parts.material_section import read_texture

SOURCE = Path(__file__).resolve().parents[2] / "src" / "graycast"
SIDE = 12_000  # side of a picture that is too large [px]
# Messages between our own processes, which no user writes.
OWN_CHILDREN = {
    "world/drop/decomposition/hull_process.py",
    "rendering/cycles/process.py",
    "rendering/cycles/worker/frames.py",
    "rendering/device.py",
}


# --- JSON ----------------------------------------------------------------------------------------


def test_parsed_json_equals_the_result_of_the_standard_library():
    """Oracle: the standard library's parser, compared to the last bit of random doubles."""
    rng = np.random.default_rng(36)
    value = rng.integers(0, 2**64, 20_000, dtype=np.uint64).view(np.float64)
    content = {"value": value[np.isfinite(value)].tolist(), "text": 'é"\\\n', "none": [None, True]}
    text = json.dumps(content)
    assert parse_json(text) == parse_json(text.encode()) == json.loads(text) == content
    assert parse_json(b"\xef\xbb\xbf[1]") == [1]  # some editors write a byte-order mark


def test_json_that_is_nested_too_deeply_raises_a_value_error():
    for text in ("[" * 200_000, '{"a":' * 200_000, "[" * 500 + "]" * 500):
        with pytest.raises(ValueError, match=r"^nested too deeply at line 1"):
            parse_json(text)
    assert parse_json("[" * 150 + "]" * 150)


def test_all_json_files_are_read_by_one_function():
    readers = {
        str(file.relative_to(SOURCE))
        for file in SOURCE.rglob("*.py")
        if re.search(r"json\.loads?\(", file.read_text(encoding="utf-8"))
    }
    assert readers == OWN_CHILDREN


@pytest.fixture(scope="module")
def deep(tmp_path_factory):
    """Write a dataset, a deeply nested file, and a copy of the dataset with that file as claim."""
    folder = tmp_path_factory.mktemp("deep")
    write_dataset(folder / "whole", (0,))
    write_dataset(folder / "broken", (0,))
    for path in (folder / "k.json", folder / "broken" / "graycast.json"):
        path.write_text("[" * 200_000)
    for place in ("depth", "pictures/depth"):
        (folder / place).mkdir(parents=True)
        np.save(folder / place / "a.npy", np.ones((4, 4), np.float32))
    return folder


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("detector score k.json --on whole --out o", "k.json: is not JSON, or is cut off (nested"),
        ("rig import k.json --out r.yaml", "k.json: is not JSON (nested too deeply at line 1"),
        ("real measure depth --intrinsics k.json --out o", "cannot be read (nested too deeply"),
        ("dataset import pictures --annotations k.json --intrinsics 5,5,2,2 --out o", "k.json"),
        ("validate broken", "graycast.json"),
        ("dataset stats broken --out o", "graycast.json"),
        ("dataset export broken --format coco --out o", "graycast.json"),
    ],
)
def test_no_command_prints_a_traceback_for_deeply_nested_json(
    deep, capsys, monkeypatch, command, words
):
    monkeypatch.chdir(deep)
    assert main(command.split()) == 1
    printed = capsys.readouterr()
    assert "Traceback" not in printed.err
    assert words in printed.out + printed.err


# --- sizes of pictures ---------------------------------------------------------------------------


def bomb(side=SIDE):
    """Return a valid PNG of zeros with one bit per pixel: some 20 kB that unpack to 18 MB."""

    def chunk(kind, data):
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    rows = zlib.compress(bytes((1 + side // 8) * side))
    head = struct.pack(">IIBBBBB", side, side, 1, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", rows) + chunk(b"IEND", b"")


def encoded(kind):
    """Return a picture of 48 x 32 pixels, and the bytes of its size before and after a change."""
    data = io.BytesIO()
    grey = np.full((32, 48), 7, np.uint8)
    if kind == "exr":
        data.write(b"\x76\x2f\x31\x01\2\0\0\0dataWindow\0box2i\0\x10\0\0\0")
        data.write(struct.pack("<4i", 0, 0, 47, 31))
        return data.getvalue(), (struct.pack("<2i", 47, 31), struct.pack("<2i", SIDE - 1, SIDE - 1))
    if kind == "hdr":
        text = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 32 +X 48\n"
        return text, (b"-Y 32 +X 48", b"-Y %d +X %d" % (SIDE, SIDE))
    if kind == "float tiff":  # three channels of float, which Pillow does not open
        whole = cv2.imencode(".tiff", np.zeros((32, 48, 3), np.float32))[1].tobytes()
        order = "<" if whole.startswith(b"II") else ">"
    else:
        options = {"big_tiff": True} if kind == "big tiff" else {}
        Image.fromarray(grey).save(data, format=kind.split()[-1], **options)
        whole, order = data.getvalue(), "<"
    if kind == "png":
        return whole, (struct.pack(">2I", 48, 32), struct.pack(">2I", SIDE, SIDE))
    if kind == "jpeg":
        return whole, (struct.pack(">2H", 32, 48), struct.pack(">2H", SIDE, SIDE))
    if kind == "bmp":
        return whole, (struct.pack("<2i", 48, 32), struct.pack("<2i", SIDE, SIDE))
    between = 10 if kind == "big tiff" else 6  # type and count of a tag, in bytes
    changed = bytearray(whole)
    for tag in (256, 257):
        at = whole.index(struct.pack(order + "H", tag), 8) + 2
        form = order + {3: "H", 4: "I"}[struct.unpack_from(order + "H", whole, at)[0]]
        struct.pack_into(form, changed, at + between, SIDE)
    return whole, (whole, bytes(changed))


@pytest.mark.parametrize(
    "kind", ["png", "jpeg", "bmp", "tiff", "big tiff", "float tiff", "exr", "hdr"]
)
def test_a_picture_is_refused_if_its_header_states_too_large_a_size(kind, tmp_path):
    whole, (before, after) = encoded(kind)
    refuse_large_picture(whole, "small", ValueError)
    assert before in whole
    (tmp_path / "large").write_bytes(whole.replace(before, after, 1))
    with pytest.raises(ValueError, match=f"^x: has {SIDE} x {SIDE} pixels, and at most 100 mil"):
        refuse_large_picture(tmp_path / "large", "x", ValueError)


@pytest.mark.parametrize("kind", ["jpeg", "png", "tiff"])
def test_a_picture_with_a_damaged_orientation_tag_is_not_refused(kind):
    """A complete picture that is stored rotated is refused; one with a truncated tag is not."""
    data, exif = io.BytesIO(), Image.Exif()
    exif[0x0112] = 6
    Image.fromarray(np.zeros((32, 48), np.uint8)).save(data, format=kind, exif=exif)
    whole = data.getvalue()
    with pytest.raises(ValueError, match=r"EXIF orientation 6"):
        refuse_turned(whole, "x", ValueError)
    at = whole.index(struct.pack("<HH" if kind == "tiff" else ">HH", 0x0112, 3))
    for cut in (whole[: at + 5], whole[:at] + bytes(20) + whole[at + 20 :]):
        refuse_turned(cut, "x", ValueError)


def test_the_size_limit_of_a_picture_counts_pixels_and_not_its_width():
    head = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR"
    refuse_large_picture(head + struct.pack(">2I", 100_000, 1000), "x", ValueError)
    with pytest.raises(ValueError, match="100000 x 1001 pixels"):
        refuse_large_picture(head + struct.pack(">2I", 100_000, 1001), "x", ValueError)
    assert MOST_PX == 100_000 * 1000


@pytest.fixture
def no_decoder(monkeypatch):
    """Let every decoder fail the test that calls it."""

    def decode(*_, **__):
        pytest.fail("the picture was decoded")

    monkeypatch.setattr(cv2, "imread", decode)
    monkeypatch.setattr(cv2, "imdecode", decode)
    monkeypatch.setattr(ImageFile.ImageFile, "load", decode)


@pytest.mark.parametrize(
    ("read", "error"),
    [
        (read_png, Unreadable),
        (read_image, DatasetError),
        (read_texture, ConfigError),
        (lambda path: resolve_environment(EnvironmentSection(map=path), Path()), ConfigError),
        (lambda path: read_pictures([path]), DecodeError),
        (
            lambda path: read_shot(
                RealPicture(stem="a", rgb=None, gray=None, depth=path),
                FileOptions(K=np.eye(3), scale_m=1e-3),
            ),
            DatasetError,
        ),
    ],
    ids=["dataset", "depth", "texture", "map", "stack", "real picture"],
)  # fmt: skip
def test_no_reader_decodes_a_picture_that_is_too_large(read, error, tmp_path, no_decoder):
    (tmp_path / "a.png").write_bytes(bomb())
    with pytest.raises(error, match=f"has {SIDE} x {SIDE} pixels"):
        read(tmp_path / "a.png")


# --- sizes of arrays and masks -------------------------------------------------------------------


def test_an_array_file_shorter_than_its_header_states_is_refused(tmp_path):
    fine = np.arange(12.0).reshape(3, 4)
    np.save(tmp_path / "a.npy", fine)
    assert np.array_equal(load_array(tmp_path / "a.npy"), fine)
    with (tmp_path / "a.npy").open("wb") as file:
        stated = {"descr": "<f8", "fortran_order": False, "shape": (10**6, 10**6)}
        np.lib.format.write_array_header_1_0(file, stated)
        file.write(bytes(100))
    with pytest.raises(ValueError, match="greater than file size"):
        load_array(tmp_path / "a.npy")
    with pytest.raises(DatasetError, match="cannot be read"):
        read_intrinsics(str(tmp_path / "a.npy"))


@pytest.mark.slow
def test_a_calibration_that_unpacks_to_gigabytes_is_refused(tmp_path):
    with zipfile.ZipFile(tmp_path / "c.npz", "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        with archive.open("K1.npy", "w") as file:
            np.lib.format.write_array_header_1_0(
                file, {"descr": "<f8", "fortran_order": False, "shape": (4000, 4000)}
            )
            for _ in range(128):
                file.write(bytes(1_000_000))
    assert (tmp_path / "c.npz").stat().st_size < 1_000_000
    with pytest.raises(ConfigError, match="unpacks to 128 MB"):
        missing_distortions(tmp_path / "c.npz")


@pytest.mark.parametrize("counts", [[10**10], [10**10 - 1, 1]])
def test_a_run_length_mask_of_a_huge_picture_is_refused(counts):
    """The run lengths fill their picture, so that only its size is wrong."""
    with pytest.raises(GraycastError, match="entry 0: has 100000 x 100000 pixels"):
        check_runs({"size": [10**5, 10**5], "counts": counts}, "entry 0", GraycastError)
    with pytest.raises(GraycastError, match="do not fill"):
        check_runs({"size": [120, 160], "counts": counts}, "entry 0", GraycastError)
    check_runs({"size": [2, 3], "counts": [2, 4]}, "entry 0", GraycastError)
