"""Test the curves of a training: readable names, and a legend that covers no line."""

import pytest
from drawn import axes_of, figures_of, no_pixels

pytest.importorskip("torch", reason="needs torch: pip install 'graycast[detect]'")

from graycast.learn.detect import run


@pytest.mark.slow
def test_curves_have_names_for_readers_and_a_legend_that_covers_no_line(tmp_path):
    """The losses have torchvision's names and one unknown name; legends are checked as drawn."""
    losses = ("loss", "loss_classifier", "loss_rpn_box_reg", "loss_own_term")
    precisions = ("box_ap", "box_ap50", "mask_ap", "mask_ap50")
    rows = [
        {"epoch": k, **dict.fromkeys(losses, 1.0 / k), **dict.fromkeys(precisions, 1 - 1.0 / k)}
        for k in range(1, 6)
    ]
    with no_pixels(), figures_of(run) as figures:
        run._draw(rows, tmp_path / "curves.png")
    figures[0].draw_without_rendering()
    panels = axes_of(figures[0])
    assert len(panels) == 2
    for ax in panels.values():
        labels = [text.get_text() for text in ax.get_legend().get_texts()]
        assert len(labels) == len(set(labels)) == 4
        assert not any("_" in label or label.startswith("loss") for label in labels)
        assert not ax.get_legend().get_window_extent().overlaps(ax.get_window_extent())
        assert ax.get_xlabel() and ax.get_ylabel()
