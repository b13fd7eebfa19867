"""Pictures of a stack in memory, and which error is reported first."""

import tracemalloc

import numpy as np
import pytest
from PIL import Image

from graycast.base.errors import DecodeError
from graycast.camera.stack.stack_pictures import read_pictures


@pytest.fixture
def files(tmp_path):
    rng = np.random.default_rng(4)
    paths = []
    for k in range(32):
        paths.append(tmp_path / f"{k:02d}.png")
        picture = rng.integers(0, 256, (200, 300), dtype=np.uint8)
        Image.fromarray(picture).save(paths[-1], compress_level=0)
    return paths


def test_reading_pictures_needs_little_memory_beyond_the_stack(files):
    """Pictures that waited for the last one doubled the memory: 440 MB for 44 pictures of 5 MP."""
    read_pictures(files[:2])
    tracemalloc.start()
    try:
        pictures = read_pictures(files)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 1.6 * pictures.frames.nbytes
    for k in (0, 1, 17, 31):
        assert np.array_equal(pictures.frames[k], np.asarray(Image.open(files[k])))


def test_the_error_names_the_first_wrong_picture_whichever_thread_reads_it(files):
    Image.fromarray(np.zeros((200, 301), np.uint8)).save(files[9])
    files[5].write_bytes(files[5].read_bytes()[:2000])
    files[20].unlink()
    for _ in range(5):
        with pytest.raises(DecodeError, match=r"05\.png: is damaged"):
            read_pictures(files)
    with pytest.raises(DecodeError, match=r"09\.png is 301 x 200 px, 00\.png is 300 x 200 px"):
        read_pictures(files[:5] + files[6:])
