"""Fast readers of PNGs agree with Pillow, and what they do not know is left to a decoder."""

import io
import zlib

import numpy as np
import pytest
from PIL import Image

from graycast.dataset.files.safe_reading import Unreadable, is_intact_png, mask_pixels
from graycast.dataset.write.picture_bytes import mask_png, png
from graycast.rendering.radiance import Silhouette

RNG = np.random.default_rng(5)
MASK = RNG.random((40, 30)) < 0.5
PICTURES = [
    RNG.integers(0, 256, (40, 30, 3), np.uint8),
    RNG.integers(0, 256, (40, 30), np.uint8),
    RNG.integers(0, 65536, (40, 30), np.uint16),
]


def by_pillow(image, **options):
    data = io.BytesIO()
    Image.fromarray(image).save(data, format="PNG", **options)
    return data.getvalue()


def own_mask(mask):
    return mask_png(Silhouette(left_px=0, top_px=0, mask=mask.copy()), *mask.shape)


def with_pixels(data, change):
    """Replace the compressed pixels of a PNG with one chunk of them; its checksum is correct."""
    body = b"IDAT" + change(data[41:-16])
    length = (len(body) - 4).to_bytes(4, "big")
    return data[:33] + length + body + zlib.crc32(body).to_bytes(4, "big") + data[-12:]


@pytest.mark.parametrize("mask", [MASK, np.ones_like(MASK), np.zeros_like(MASK)])
@pytest.mark.parametrize("write", [own_mask, lambda mask: by_pillow(mask * np.uint8(255))])
def test_masks_with_and_without_filters_are_read(mask, write):
    np.testing.assert_array_equal(mask_pixels(write(mask), "mask"), mask)


@pytest.mark.parametrize(
    "change",
    [lambda pixels: pixels[:-9], lambda pixels: b"\0" + pixels,
     lambda pixels: zlib.compress(zlib.decompress(pixels)[:-31])],
)  # fmt: skip
def test_a_mask_whose_pixels_are_incomplete_is_refused(change):
    with pytest.raises(Unreadable, match="mask is not an image, or is damaged"):
        mask_pixels(with_pixels(own_mask(MASK), change), "mask")


@pytest.mark.parametrize("image", PICTURES)
def test_an_intact_picture_is_one_whose_form_and_checksums_are_right(image, tmp_path):
    path, form = tmp_path / "0.png", (image.shape, image.dtype.type)
    for data in (png(image), by_pillow(image)):
        path.write_bytes(data)
        assert is_intact_png(path, *form)
        for other in PICTURES:
            own = (other.shape, other.dtype.type)
            assert is_intact_png(path, *own) == (own == form)
        assert not is_intact_png(path, (30, 40, *image.shape[2:]), image.dtype.type)
        for at in range(16, len(data), 397):  # The name of IHDR and all before it are not used.
            path.write_bytes(data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :])
            assert not is_intact_png(path, *form), at
            path.write_bytes(data[:at])
            assert not is_intact_png(path, *form), at


def test_a_picture_that_only_a_decoder_knows_is_not_called_intact(tmp_path):
    path, form = tmp_path / "0.png", ((40, 30, 3), np.uint8)
    assert not is_intact_png(path, *form)
    exif = Image.Exif()
    exif[0x0112] = 6
    with_palette = io.BytesIO()
    Image.fromarray(PICTURES[0]).quantize(16).save(with_palette, format="PNG")
    for data in (by_pillow(PICTURES[0], exif=exif), with_palette.getvalue(), b"", b"\x89PNG"):
        path.write_bytes(data)
        assert not is_intact_png(path, *form)
