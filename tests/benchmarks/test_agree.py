"""The study of agreement reports the known differences between two fake renderers."""

import json
from dataclasses import replace

import numpy as np
import pytest
from drawn import axes_of, figures_of

from benchmarks import agree, plots
from benchmarks.cells import opened
from benchmarks.figures import describe

CLASSES = ("diffuse", "metal", "plastic", "bin")
RATIOS = {"diffuse": 1.013, "metal": 0.961, "plastic": 1.052, "bin": 1.3}


def study(first, second, **changes):
    words = {"scenes": 2, "samples": 64, "size_px": (48, 20), "show": lambda text: None}
    return agree.study(first, second, **words | changes)


def row(figures, light, name):
    return next(r for r in figures["ratios"] if (r["light"], r["class"]) == (light, name))


@pytest.mark.slow
def test_the_light_ratio_of_two_renderers_is_exact_for_each_material_class(painted):
    one = (0.7, 0.4, 0.5, 0.6)
    other = tuple(light * ratio for light, ratio in zip(one, RATIOS.values(), strict=True))
    first = painted(white=one)
    second = painted(name="cycles", white=other, ambient=0.11)
    figures = study(first, second)
    for name, ratio in RATIOS.items():
        entry = row(figures, "white", name)
        assert entry["pixels"] == 2 * 20 * 12
        for word in ("median", "p5", "p95", "of_means"):
            assert entry[word] == pytest.approx(ratio, rel=1e-6)
            assert row(figures, "ambient", name)[word] == pytest.approx(1.1, rel=1e-6)
    assert figures["accepted"] == {
        "diffuse_ratio": True,
        "metal_ratio": True,
        "plastic_ratio": False,
        "depth": True,
        "valid": True,
    }
    assert figures["depth"]["median_abs_columns"] < 1e-3
    assert (figures["first"], figures["second"]) == ("mitsuba", "cycles")


@pytest.mark.parametrize(("shift_px", "accepted"), [(0.2, True), (-0.3, False)])
def test_the_difference_in_columns_is_reported(painted, shift_px, accepted):
    """Interpolation between samples of the cosines has an error, hence the tolerance of 0.03."""
    figures = study(painted(), painted(name="cycles", shift_px=shift_px))
    depth = figures["depth"]
    assert depth["median_columns"] == pytest.approx(shift_px, abs=0.03)
    assert depth["median_abs_columns"] == pytest.approx(abs(shift_px), abs=0.03)
    assert depth["over_one_column_share"] == 0
    assert figures["accepted"]["depth"] is accepted


def test_pixels_that_only_one_renderer_decodes_are_counted(painted):
    """One renderer has no light in 3 of 20 rows. Pixels that are invalid in both count as equal."""
    figures = study(painted(), painted(name="cycles", blind=3))
    depth = figures["depth"]
    assert depth["valid_in_first_only"] == pytest.approx(3 / 20)
    assert depth["valid_in_second_only"] == 0
    assert depth["valid_alike_share"] == pytest.approx(17 / 20)
    assert figures["accepted"]["valid"] is False
    both = study(painted(blind=3), painted(name="cycles", blind=3))["depth"]
    assert both["valid_alike_share"] == 1
    assert both["valid_in_both"] == pytest.approx(17 / 20)


def test_both_renderers_get_the_same_scenes_without_the_footprint_filter(painted):
    heard = []
    first, second = painted(), painted(name="cycles")
    study(first, second, scenes=3, show=heard.append)
    assert [seed for _, _, seed in second.requests] == [0, 1, 2]
    assert first.requests[::2] == [
        (count, replace(quality, samples=8 * 64), seed) for count, quality, seed in second.requests
    ]
    assert [quality for _, quality, _ in first.requests[1::2]] == [q for _, q, _ in second.requests]
    assert not {seed for _, _, seed in first.requests[1::2]} & {0, 1, 2}
    assert {quality.footprint for _, quality, _ in first.requests} == {False}
    assert heard[-1] == "scene 3 of 3"


def test_the_effect_of_noise_alone_does_not_depend_on_the_second_renderer(painted):
    """These figures stay the same if the second renderer returns another picture."""
    noisy = painted(noise=0.5)
    one = study(noisy, painted(name="cycles", shift_px=3.0))["noise_alone"]
    assert one == study(noisy, painted(name="cycles"))["noise_alone"]
    assert 0.01 < one["median_abs_columns"] < 0.5
    assert study(painted(), painted(name="cycles"))["noise_alone"]["valid_alike_share"] == 1


@pytest.mark.slow
def test_figures_of_the_benchmark_are_written_as_json_text_and_plot(painted, tmp_path):
    figures = json.loads(json.dumps(study(painted(), painted(name="cycles"))))
    assert "median_abs_columns" in describe(figures)
    assert len(describe(figures).splitlines()) < 60
    with figures_of(plots) as pictures:
        plots.draw(figures | {"benchmark": "agree"}, tmp_path / "agree.png")
    axes, counts = axes_of(pictures[0]), figures["histograms"]
    for title, light in (("Projector's light", "white"), ("All other light", "ambient")):
        shares = [np.array(counts.get(f"{light} {name}", ())) for name in CLASSES]
        shares = [count / count.max() for count in shares if count.sum()]
        curves = [patch.get_data() for patch in axes[title].patches if hasattr(patch, "get_data")]
        for stairs, share in zip(curves, shares, strict=True):
            assert stairs.values == pytest.approx(share)
            assert stairs.edges == pytest.approx(counts["ratio_edges"])
    assert (tmp_path / "agree.png").is_file()


@pytest.mark.slow
def test_cycles_and_mitsuba_agree_on_a_small_scene(cycles_renderer):
    """The picture is small and noisy, so only the medians have tight limits."""
    with opened(1) as renderers:
        figures = study(*renderers, scenes=1, samples=16, size_px=(172, 130))
    assert np.abs(row(figures, "white", "diffuse")["median"] - 1) < 0.02
    assert np.abs(row(figures, "white", "metal")["median"] - 1) < 0.05
    assert np.abs(row(figures, "white", "plastic")["median"] - 1) < 0.05
    assert figures["depth"]["median_abs_columns"] < 0.25
    assert figures["truth"]["same_instance_share"] > 0.995
    assert figures["truth"]["over_a_tenth_mm_share"] < 1e-3
