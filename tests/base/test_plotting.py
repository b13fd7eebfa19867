"""Pictures of figures: the same bytes each time, and whole or not there."""

import pytest
from matplotlib.figure import Figure
from PIL import Image

from graycast.base.errors import GraycastError
from graycast.base.plotting import plain_figure, save_png


class Broken(Figure):
    """A figure whose disk is full after a few bytes."""

    def savefig(self, file, **options):
        file.write(b"\x89PNG")
        raise OSError(28, "No space left on device")


def test_a_figure_is_written_at_its_resolution_and_has_the_same_bytes_each_time(tmp_path):
    for name in ("a.png", "b.png"):
        save_png(plain_figure(2.0, 1.0, (1, 2))[0], tmp_path / name, dpi=50)
    with Image.open(tmp_path / "a.png") as image:
        assert image.size == (100, 50)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    assert {path.name for path in tmp_path.iterdir()} == {"a.png", "b.png"}


def test_a_picture_that_cannot_be_written_leaves_the_old_one_and_nothing_else(tmp_path):
    path = tmp_path / "plot.png"
    path.write_bytes(b"old")
    with pytest.raises(GraycastError, match=r"plot\.png: cannot be written \(No space left"):
        save_png(Broken(), path, dpi=50)
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_missing_folder_is_named(tmp_path):
    with pytest.raises(GraycastError, match=r"nowhere.*give a path in an existing folder"):
        save_png(Figure(), tmp_path / "nowhere" / "plot.png", dpi=50)


def test_columns_share_the_width_as_asked():
    """Oracle: with a plain layout, axes of width ratio 1 to 3 are 1 to 3 wide."""
    figure, (left, right) = plain_figure(8.0, 2.0, (1, 3))
    figure.set_layout_engine("none")
    assert right.get_position().width == pytest.approx(3 * left.get_position().width)
