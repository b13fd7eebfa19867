"""Test the plot of a study: legible names, intervals, and axes that begin at 0."""

import itertools

import numpy as np
import pytest
from backends import slow
from drawn import axes_of, figures_of, no_pixels
from test_choosing import row, spec

from graycast.score.design import design_tables


@pytest.mark.slow
@pytest.mark.parametrize("count", [2, slow(25)])
def test_a_picture_of_a_study_names_settings_without_overlap_and_shows_intervals(tmp_path, count):
    """Two settings are both named, and neither is on an axis; the names of many do not overlap."""
    rng = np.random.default_rng(2)
    rows = [
        row(f"setting_{i}", rng.uniform(0.4, 0.6, 6), sigma_m=0.0002 + 1e-6 * i, seconds=0.5 + i)
        for i in range(count)
    ]
    with no_pixels(), figures_of(design_tables) as figures:
        design_tables._draw_pareto(spec(title="Bin"), rows, tmp_path / "pareto.png")
    figures[0].draw_without_rendering()
    for ax in axes_of(figures[0]).values():
        names = [text for text in ax.texts if text.get_text()]
        assert len(names) >= min(count, 8)
        boxes = [text.get_window_extent() for text in names]
        assert not any(a.overlaps(b) for a, b in itertools.combinations(boxes, 2))
        assert all(ax.bbox.x0 <= box.x0 and box.x1 <= ax.bbox.x1 for box in boxes)
        assert ax.get_xlim()[0] == 0 and ax.get_ylim()[0] == 0
        intervals = [sorted(line.get_ydata()) for line in ax.lines if len(line.get_xdata()) == 2]
        for one in rows:
            limits = [100 * one.measured.low, 100 * one.measured.high]
            assert any(np.allclose(limits, interval) for interval in intervals)
        assert f"of {count} settings are on the front" in ax.get_title(loc="left")
