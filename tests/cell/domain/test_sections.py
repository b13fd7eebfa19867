"""The section `domain` of a configuration, and the errors about it."""

import numpy as np
import pytest
import yaml
from small_cell import write_cell

from graycast.base.errors import ConfigError
from graycast.cell.config import Config, load_config
from graycast.cell.domain import AdaptedSection, RandomizedSection
from graycast.cell.resolve import file_digests


def config(domain):
    return Config.model_validate({"parts": [{"builtin": "toothpaste"}], "domain": domain})


def test_a_domain_given_by_name_has_all_defaults_of_this_kind():
    assert config("adapted").domain == config({"kind": "adapted"}).domain
    assert config("randomized").domain == config({"kind": "randomized"}).domain
    assert isinstance(config("adapted").domain, AdaptedSection)
    assert isinstance(config("randomized").domain, RandomizedSection)
    assert config(None).domain is None


def test_a_written_configuration_is_read_as_the_same_configuration():
    written = {
        "kind": "randomized",
        "camera": None,
        "bin": {"textures": "wood", "roughness": [0.2, 0.3]},
        "distractors": {"count": [1, 2], "parts": [{"builtin": "toothpaste"}]},
    }
    once = config(written)
    assert Config.model_validate(once.model_dump(mode="json")) == once


@pytest.mark.parametrize(
    ("domain", "message"),
    [
        ("randomised", r"domain is 'randomised': give adapted or randomized"),
        ({"bin": {}}, r"domain: give adapted or randomized, or a mapping with one of them"),
        ({"kind": "adapted", "lmps": 1}, r"unknown key domain\.lmps: did you mean lamps\?"),
        (
            {"kind": "randomized", "lamps": {"cuont": [1, 2]}},
            r"unknown key domain\.lamps\.cuont: did you mean count\?",
        ),
        (
            {"kind": "randomized", "bin": {"color": {"hue": [1, 2]}}},
            r"unknown key domain\.bin\.color\.hue: did you mean hue_deg\?",
        ),
        (
            {"kind": "randomized", "distractors": {"parts": [{"mash": "a.stl"}]}},
            r"unknown key domain\.distractors\.parts\.0\.mash: did you mean mesh\?",
        ),
        (
            {"kind": "randomized", "lamps": {"distance_m": [2, 1]}},
            r"domain\.lamps\.distance_m is \[2, 1\]: give two numbers \[lowest, highest\]",
        ),
        ({"kind": "randomized", "camera": {"tilt_deg": [-90, 0]}}, r"domain\.camera\.tilt_deg\.0"),
        ({"kind": "randomized", "lamps": {"irradiance": [0, 1]}}, r"domain\.lamps\.irradiance\.0"),
        ({"kind": "adapted", "bin": {"position_m": -1}}, r"domain\.bin\.position_m is -1"),
    ],
)
def test_impossible_domain_values_are_refused_with_their_keys(tmp_path, domain, message):
    path = tmp_path / "cell.yaml"
    path.write_text(yaml.safe_dump({"parts": [{"builtin": "toothpaste"}], "domain": domain}))
    with pytest.raises(ConfigError, match=rf"{path}: {message}"):
        load_config(path)


def folder_of(path, *names):
    path.mkdir()
    for name in names:
        (path / name).write_bytes(name.encode())


def test_every_file_of_a_domain_has_a_digest_that_reveals_a_change(tmp_path):
    folder_of(tmp_path / "skies", "b.exr", "a.hdr", "readme.txt")
    folder_of(tmp_path / "wood", "oak.png", "ash.JPG")
    settings = {
        "kind": "randomized",
        "environment": {"maps": "skies"},
        "bin": {"textures": "wood"},
        "table": {"textures": "wood"},
        "distractors": {"parts": [{"mesh": "bolt.stl", "unit": "mm"}]},
    }
    (tmp_path / "bolt.stl").write_bytes(b"bolt")
    path = write_cell(tmp_path, domain=settings)
    before = file_digests(load_config(path), tmp_path)
    assert set(before) == {
        "box.stl", "bolt.stl", "skies/a.hdr", "skies/b.exr", "wood/ash.JPG", "wood/oak.png",
    }  # fmt: skip
    for name in ("skies/b.exr", "wood/oak.png", "bolt.stl"):
        (tmp_path / name).write_bytes(b"changed")
        after = file_digests(load_config(path), tmp_path)
        assert {key for key in after if after[key] != before[key]} == {name}
        before = after
    (tmp_path / "skies" / "c.exr").write_bytes(b"new")
    assert "skies/c.exr" in file_digests(load_config(path), tmp_path)


@pytest.mark.parametrize("exists", [False, True])
def test_the_error_for_a_missing_or_empty_folder_names_the_folder(tmp_path, exists):
    if exists:
        folder_of(tmp_path / "skies", "license.txt")
    settings = {"kind": "randomized", "environment": {"maps": "skies"}}
    path = write_cell(tmp_path, domain=settings)
    with pytest.raises(ConfigError, match=r"domain\.environment\.maps: .*skies"):
        file_digests(load_config(path), tmp_path)


def test_an_additional_seed_stream_does_not_change_the_other_seeds():
    """There were five seeds of a scene's stages; the domain's is a sixth."""
    for seed, scene_id in ((0, 0), (7, 123), (2**40, 99999)):
        sequence = np.random.SeedSequence(seed, spawn_key=(scene_id,))
        five, six = (sequence.generate_state(n, np.uint64) for n in (5, 6))
        assert (five == six[:5]).all()
