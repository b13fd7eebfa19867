"""Figures have the same bytes in each run, and a picture file is complete or absent."""

import itertools

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from graycast.base.errors import GraycastError
from graycast.base.plotting import caption, legend_below, plain_figure, save_png, write_names


class Broken(Figure):
    """A figure for which the disk is full after a few bytes."""

    def savefig(self, file, **options):
        file.write(b"\x89PNG")
        raise OSError(28, "No space left on device")


@pytest.mark.slow
def test_a_figure_is_written_at_its_resolution_with_reproducible_bytes(tmp_path):
    for name in ("a.png", "b.png"):
        save_png(plain_figure(2.0, 1.0, (1, 2))[0], tmp_path / name, dpi=50)
    with Image.open(tmp_path / "a.png") as image:
        assert image.size == (100, 50)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    assert {path.name for path in tmp_path.iterdir()} == {"a.png", "b.png"}


def test_a_failed_write_of_a_figure_keeps_the_old_file_and_leaves_no_other(tmp_path):
    path = tmp_path / "plot.png"
    path.write_bytes(b"old")
    with pytest.raises(GraycastError, match=r"plot\.png: cannot be written \(No space left"):
        save_png(Broken(), path, dpi=50)
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_the_error_for_a_missing_figure_folder_names_the_folder(tmp_path):
    with pytest.raises(GraycastError, match=r"nowhere.*give a path in an existing folder"):
        save_png(Figure(), tmp_path / "nowhere" / "plot.png", dpi=50)


def test_the_columns_of_a_figure_have_the_requested_width_ratios():
    """Oracle: in a plain layout, axes of width ratio 1 to 3 have this ratio of widths."""
    figure, (left, right) = plain_figure(8.0, 2.0, (1, 3))
    figure.set_layout_engine("none")
    assert right.get_position().width == pytest.approx(3 * left.get_position().width)


def test_a_legend_below_the_axes_overlaps_neither_axes_nor_label():
    figure, (ax,) = plain_figure(4.0, 3.0, (1,))
    for name in ("one", "two", "three"):
        ax.plot([0, 1], [0, 1], label=name)
    caption(ax, "Title", "epoch", "loss")
    legend_below(ax, columns=2)
    figure.draw_without_rendering()
    box = ax.get_legend().get_window_extent()
    assert not box.overlaps(ax.get_window_extent())
    assert not box.overlaps(ax.xaxis.label.get_window_extent())
    assert box.y0 >= 0 and box.x1 <= figure.bbox.x1


@pytest.mark.slow
def test_labels_of_close_points_do_not_overlap_and_the_first_points_are_labelled():
    """Thirty points are close together; the boxes of the labels are compared as they are drawn."""
    figure, (ax,) = plain_figure(5.0, 4.0, (1,))
    points = np.random.default_rng(1).uniform(0.4, 0.6, (30, 2))
    ax.set(xlim=(0, 1), ylim=(0, 1))
    write_names(ax, [f"setting {i}" for i in range(30)], points, ["black"] * 30)
    figure.draw_without_rendering()
    boxes = [text.get_window_extent() for text in ax.texts]
    assert ax.texts[0].get_text() == "setting 0" and len(boxes) > 5
    assert not any(a.overlaps(b) for a, b in itertools.combinations(boxes, 2))


def test_a_point_at_nan_gets_no_label():
    _, (ax,) = plain_figure(5.0, 4.0, (1,))
    write_names(ax, ["there", "nowhere"], np.array([[0.5, 0.5], [np.nan, 0.5]]), ["black"] * 2)
    assert [text.get_text() for text in ax.texts] == ["there"]
