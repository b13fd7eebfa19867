"""A finished picture equals that of `make_scene`, whichever earlier results are reused."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
import yaml
from backends import slow
from PIL import Image
from small_cell import write_cell

from graycast.camera.rig_file import load_scanner, save_scanner
from graycast.cell.config import Config, load_config
from graycast.cell.resolve import open_cell_renderer, resolve_cell
from graycast.cell.simulate import make_scene
from graycast.show.live.asking import Ask
from graycast.show.live.line import Line, Superseded, _light_key, _physics_key
from graycast.show.live.showing import picture_answer


class Watched:
    """A line with its messages and the requested cell."""

    def __init__(self, path: Path):
        self.path, self.answers, self.stop = path, [], False
        self.line = Line(
            folder=path.parent,
            scene_id=0,
            device="cpu",
            emit=self.answers.append,
            superseded=lambda: self.stop,
        )
        self.config = load_config(path)

    def show(self, *, ambient=1.0, power=1.0, unturned=None, **sections):
        """Show the cell with other sections; return the kinds of the pictures that were sent."""
        self.config = Config.model_validate(
            self.config.model_dump(exclude_none=True) | sections  # in the form that a user writes
        )
        self.answers.clear()
        self.ask = Ask(
            number=1,
            config=self.config,
            unturned=unturned or self.config,
            ambient=ambient,
            power=power,
            frame=0,
        )
        self.line.show(self.ask)
        return [one.header["kind"] for one in self.answers if one.kind == "picture"]

    def look(self):
        """Show another frame of the latest result."""
        self.line.look(replace(self.ask, frame=1))

    def shot(self):
        """Return the result of `make_scene`."""
        cell = resolve_cell(self.config, self.path.parent)
        with open_cell_renderer(cell, device="cpu") as renderer:
            return make_scene(cell, 0, seed=self.config.seed, renderer=renderer)

    def assert_finished(self):
        content, shot = self.line.content, self.shot()
        assert content.exact
        np.testing.assert_array_equal(content.capture.frames, shot.capture.frames)
        np.testing.assert_array_equal(content.depth.depth_m, shot.sample.scanner_depth.depth_m)
        np.testing.assert_array_equal(content.depth.reason, shot.sample.scanner_depth.reason)
        np.testing.assert_array_equal(content.rgb, shot.sample.rgb)


@pytest.fixture(scope="module")
def watched(tmp_path_factory):
    """Stacks of 6 samples are rendered in three passes; `make_scene` renders them in one."""
    path = write_cell(tmp_path_factory.mktemp("live"), render={"samples": 6})
    watched = Watched(path)
    watched.line._opened(resolve_cell(watched.config, path.parent))  # This imports Mitsuba.
    from graycast.rendering.mitsuba import paths as mitsuba_paths

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(mitsuba_paths, "PASS_SAMPLES", 2 * 160 * 120)
        # Denoising would take half of the time of the tests below, but does not affect them.
        watched.show(render={"samples": 6, "denoise": False})
        yield watched


@pytest.mark.slow
def test_the_first_pictures_are_rough_and_the_last_equals_that_of_preview(watched):
    kinds = watched.show(seed=5, render={"samples": 6})
    pictures = [one for one in watched.answers if one.kind == "picture"]
    assert [one.header["samples"] for one in pictures] == [1, 1, 4, 4, 6, 6]  # colour comes second
    assert [one.header["exact"] for one in pictures] == [False] * 5 + [True]
    assert set(kinds) == {"physics"} and [one.kind for one in watched.answers].count("world") == 1
    watched.assert_finished()
    watched.show(render={"samples": 6, "denoise": False})


@pytest.mark.slow
def test_the_page_receives_the_result_in_its_own_formats(watched):
    """Lengths are in mm, matrices are column-major as in WebGL, and instances begin at 1."""
    watched.show(seed=3)
    content = watched.line.content
    (world,) = (one for one in watched.answers if one.kind == "world")
    places = np.frombuffer(world.arrays["places"], np.float32).reshape(-1, 4, 4)
    np.testing.assert_allclose(
        places[:, 3, :3], 1e3 * content.layout.T_world_part[:, :3, 3], rtol=1e-6
    )
    np.testing.assert_allclose(places[:, 0, :3], content.layout.T_world_part[:, :3, 0], atol=1e-6)
    picture = [one for one in watched.answers if one.kind == "picture"][-1]
    instance = np.frombuffer(picture.arrays["instance"], np.uint16).reshape(120, 160)
    np.testing.assert_array_equal(instance - 1.0, content.rendering.truth.instance)
    steps = np.frombuffer(picture.arrays["scanner"], np.uint16).reshape(120, 160)
    depth_m = np.nan_to_num(content.depth.depth_m)
    np.testing.assert_allclose(
        steps * picture.header["depth_scale_mm"], 1e3 * depth_m,
        atol=0.501 * picture.header["depth_scale_mm"],
    )  # fmt: skip
    noise_m = 1e-4 * np.random.default_rng(0).standard_normal(depth_m.shape)
    noisy = content.rendering.truth.depth_m + 2e-4 + noise_m
    ask = Ask(
        number=1, config=watched.config, unturned=watched.config, ambient=1.0, power=1.0, frame=0
    )
    shifted = replace(content, depth=replace(content.depth, depth_m=noisy))
    figures = picture_answer(ask, shifted, kind="look", ms=0.0, first=False).header["figures"]
    pixels = (content.rendering.truth.instance >= 0).sum()
    assert figures["bias_mm"] == pytest.approx(0.2, abs=4 * 1.25 * 0.1 / np.sqrt(pixels))
    # Estimated by the median, a standard deviation has a relative error of 1.17 / sqrt(n).
    assert figures["sigma_mm"] == pytest.approx(0.1, rel=4 * 1.17 / np.sqrt(pixels))
    assert "p_wrong" not in picture.arrays
    p_wrong = np.where(np.isfinite(depth_m), 0.25, np.nan)
    doubted = replace(content, depth=replace(content.depth, p_wrong=p_wrong))
    arrays = picture_answer(ask, doubted, kind="look", ms=0.0, first=False).arrays
    np.testing.assert_array_equal(np.frombuffer(arrays["p_wrong"], np.float32), p_wrong.ravel())


def box(**words):
    return [{"mesh": "box.stl", "unit": "mm", **words}]


@pytest.mark.parametrize(
    ("sections", "falls"),
    [
        ({"parts": box(friction=0.9)}, True),
        ({"parts": box(density_kg_m3=900.0)}, True),
        ({"parts": box(unit="cm")}, True),
        ({"bin": {"inner_m": [0.25, 0.2, 0.1], "friction": 0.9}}, True),
        ({"bin": {"inner_m": [0.25, 0.21, 0.1]}}, True),
        ({"count": 4}, True),
        ({"drop": {"simulated_s": 3.0}}, True),
        ({"parts": box(material={"roughness": 0.9})}, False),
        ({"bin": {"inner_m": [0.25, 0.2, 0.1], "material": {"roughness": 0.9}}}, False),
        ({"view": {"tilt_deg": 20.0}}, False),
    ],
)
def test_parts_are_dropped_again_only_after_changes_that_affect_the_heap(tmp_path, sections, falls):
    def key(**sections):
        config = load_config(write_cell(tmp_path, **sections))
        scene = resolve_cell(config, tmp_path).scene
        return _physics_key(scene, (config.count_range[0],), 5, config.drop)

    assert (key() != key(**sections)) == falls


@pytest.mark.slow
@pytest.mark.parametrize(
    "sections",
    [
        {"exposure": {"target": 0.3, "factors": [1.0, 0.25]}},
        {"sensor": {"read_noise_e": 12.0, "bit_depth": 10}},
        slow({"decode": {"min_contrast": 0.1}, "filters": {"island_px": 20, "smoothing_px": 0.5}}),
        slow({"faults": {"raster_px": 0.3, "raster_limit_m": 0.0005}}),
    ],
)
def test_a_change_of_the_sensor_is_evaluated_again_without_rendering(watched, sections):
    watched.show()
    number = watched.line._count
    assert set(watched.show(**sections)) == {"free"}
    assert watched.line._count == number and len(watched.answers) <= 2
    watched.assert_finished()


@pytest.mark.slow
def test_more_light_is_scaled_at_once_and_then_rendered(watched):
    """Oracle: light is linear, so scaled and rendered pictures differ only by rounding."""
    watched.show()
    unturned = watched.config
    light = unturned.light.model_dump(exclude_none=True)
    for source in (light["environment"], *light["lamps"]):
        source["radiance"] = tuple(1.7 * value for value in source["radiance"])
    scaled, emit = [], watched.line._emit

    def keep(answer):
        emit(answer)
        if answer.kind == "picture":
            scaled.append(watched.line.content)

    watched.line._emit = keep
    kinds = watched.show(light=light, ambient=1.7, unturned=unturned)
    watched.line._emit = emit
    first, last = scaled[0].rendering.radiance, watched.line.content.rendering.radiance
    assert set(kinds) == {"free"} and first is not last
    np.testing.assert_allclose(first.ambient, last.ambient, rtol=2e-5)
    np.testing.assert_allclose(first.ambient_rgb, last.ambient_rgb, rtol=2e-5)
    np.testing.assert_array_equal(first.pattern, last.pattern)
    watched.assert_finished()


@pytest.mark.slow
def test_a_moved_rig_is_rendered_without_a_new_drop(watched):
    layout = watched.line.content.layout
    kinds = watched.show(view={"tilt_deg": 8.0, "azimuth_deg": 20.0})
    assert set(kinds) == {"light"} and watched.line.content.layout is layout
    assert not [one for one in watched.answers if one.kind == "world"]
    watched.assert_finished()


@pytest.mark.slow
def test_a_changed_surface_is_rendered_and_a_changed_number_of_parts_dropped_again(watched):
    watched.show()  # In the slow suite, nothing was shown before.
    box = watched.config.bin.model_dump(exclude_none=True)
    material = box["material"] | {"base_color": (0.8, 0.8, 0.8)}
    assert set(watched.show(bin=box | {"material": material})) == {"light"}
    assert set(watched.show(count=2)) == {"physics"}
    assert len(watched.line.content.layout.part_index) == 2
    watched.assert_finished()


@pytest.mark.slow
def test_an_edited_file_is_read_again_even_if_its_name_is_unchanged(watched):
    """An edited rig file once decoded pictures of the old rig; an edited mesh was not read."""
    folder = watched.path.parent
    rig_file, mesh_file = folder / "rig.yaml", folder / "box.stl"
    rig, mesh = rig_file.read_bytes(), mesh_file.read_bytes()
    watched.show(decode={"min_contrast": 0.02})
    try:
        scanner = load_scanner(rig_file)
        T_cam_proj = scanner.rig.T_cam_proj.copy()
        T_cam_proj[:3, 3] *= 1.2
        save_scanner(replace(scanner, rig=replace(scanner.rig, T_cam_proj=T_cam_proj)), rig_file)
        assert "light" in watched.show(decode={"min_contrast": 0.03})
        watched.assert_finished()
        trimesh.creation.box((50, 40, 30)).export(mesh_file)
        watched.look()
        watched.assert_finished()
        assert watched.line.content.scene.parts[0].mesh.vertices_m[:, 0].max() == 0.025
    finally:
        rig_file.write_bytes(rig)
        mesh_file.write_bytes(mesh)


@pytest.mark.parametrize("word", ["material", "map", "rig"])
def test_changed_picture_files_of_a_cell_are_rendered_again(tmp_path, word):
    picture = tmp_path / "picture.png"
    write_cell(tmp_path)
    settings = yaml.safe_load((tmp_path / "cell.yaml").read_text())
    if word == "material":
        settings["bin"]["material"] = {"texture": "picture.png"}
    else:
        settings["light"] = {"environment": {"map": "picture.png"}}
    config = Config.model_validate(settings)
    line = Line(folder=tmp_path, scene_id=0, device="cpu", emit=print, superseded=lambda: False)
    keys = []
    rig = (tmp_path / "rig.yaml").read_text()
    for grey in (100, 100, 101):
        if word == "rig":
            (tmp_path / "rig.yaml").write_text(rig.replace("near_m: 0.", f"near_m: 0.{grey}"))
        Image.new("RGB", (8, 8), (grey,) * 3).save(picture)
        keys.append(_light_key(config, tmp_path, line._files(config)))
    assert keys[0] == keys[1] != keys[2]


@pytest.mark.slow
def test_a_new_request_interrupts_the_current_rendering(watched):
    """Rough pictures are finished, so that a user who moves a slider sees some pictures."""
    passes, line = [], watched.line

    def on_pass(done, total):
        passes.append((done, total))
        watched.stop = total == 6
        line._passed(done, total)

    line._renderer[1]._on_pass = on_pass
    with pytest.raises(Superseded):
        watched.show(seed=5)
    assert passes == [(1, 1), (2, 4), (4, 4), (2, 6)]
    watched.stop = False
    line._renderer[1]._on_pass = line._passed
    watched.show()
    watched.assert_finished()


@pytest.mark.slow
def test_a_sensor_change_during_a_rough_picture_reuses_the_rough_picture(watched):
    watched.show(seed=6)
    lit = watched.line._lit
    rough = replace(lit, quality=replace(lit.quality, samples=4), final=False)
    watched.line._lit = rough
    watched.show(exposure={"target": 0.4})
    samples = [one.header["samples"] for one in watched.answers if one.kind == "picture"]
    assert samples[0] == 4 and set(samples[2:]) == {6}
    watched.assert_finished()
