"""Former names of scanners still work, with one note, and mean the same scanners."""

import json
import logging
from dataclasses import replace

import pytest
import yaml
from small_cell import write_cell

from graycast.base.errors import DatasetError
from graycast.camera.rig_file import load_scanner, named_scanner, scanner_text
from graycast.camera.scanner import preset
from graycast.cell.config import Config
from graycast.cell.generate import generate, read_origin, rerender
from graycast.cell.resolve import load_cell
from graycast.cli.command import main
from graycast.dataset.files.seal import differing_files
from graycast.dataset.write.claim import fingerprint, make_claim, refuse_other
from graycast.rig.former_names import current_name, with_current_names
from graycast.rig.pair import PRESETS, preset_rig
from graycast.score.design.study import DesignSpec

FORMER = ("phoxi-s", "phoxi-m", "phoxi-l")
PARTS = [{"builtin": "toothpaste"}]


@pytest.fixture(autouse=True)
def _first_use():
    current_name.cache_clear()


@pytest.fixture
def lines():
    """Collect the package's log lines; pytest's own log plugin is switched off."""
    written = []
    handler = logging.Handler()
    handler.emit = lambda record: written.append(record.getMessage())
    logging.getLogger("graycast").addHandler(handler)
    yield written
    logging.getLogger("graycast").removeHandler(handler)


@pytest.mark.parametrize("former", FORMER)
def test_a_former_name_of_a_scanner_gives_the_same_scanner(former, tmp_path):
    now = f"like-{former}"
    assert former not in PRESETS and now in PRESETS
    assert scanner_text(preset(former, "small")) == scanner_text(preset(now, "small"))
    assert preset_rig(former).name == now
    assert named_scanner(former, folder=tmp_path).rig.name == now


def test_repeated_use_of_a_former_name_is_logged_once(lines):
    for name in ("phoxi-m", "like-phoxi-m", "phoxi-m", "paper", "phoxi-l", "phoxi-m"):
        preset(name, "small")
    assert lines == [
        f"phoxi-{size} is now like-phoxi-{size}: change the name, which is understood until "
        "version 1.0"
        for size in "ml"
    ]


def test_a_current_name_causes_no_log_line(lines):
    """The paper's rig is derived from another rig, whose name causes no log line either."""
    for name in PRESETS:
        preset(name, "small")
    assert lines == []


def test_files_with_a_former_name_are_read_with_the_current_name(tmp_path):
    assert Config(parts=PARTS, rig="phoxi-s").rig == "like-phoxi-s"
    entries = [{"name": "left", "rig": "phoxi-l"}, {"name": "right", "rig": "paper"}]
    config = Config(parts=PARTS, scanners=entries)
    assert [entry.rig for entry in config.scanners] == ["like-phoxi-l", "paper"]
    study = {"cell": "cell.yaml", "sweeps": [{"rig": ["phoxi-m", "own.yaml"]}]}
    assert DesignSpec.model_validate(study).sweeps[0].rig == ("like-phoxi-m", "own.yaml")


def test_reading_a_rig_file_keeps_the_name_that_its_owner_wrote(tmp_path):
    """A name in a rig file is its owner's, who may use it for another device."""
    path = tmp_path / "own.yaml"
    path.write_text(scanner_text(preset("phoxi-m")).replace("like-phoxi-m", "phoxi-m"))
    assert load_scanner(path).rig.name == "phoxi-m"


def test_a_command_with_a_former_name_prints_the_current_name(capsys):
    assert main(["rig", "show", "phoxi-l"]) == 0
    assert capsys.readouterr().out.startswith("rig like-phoxi-l\n")


@pytest.mark.parametrize(
    ("text", "current"),
    [
        ('{"rig": "phoxi-s"}', '{"rig": "like-phoxi-s"}'),
        ("like-phoxi-s phoxi-xl phoxi-s2 my-phoxi-s", "like-phoxi-s phoxi-xl phoxi-s2 my-phoxi-s"),
        ("name: phoxi-m\n", "name: like-phoxi-m\n"),
    ],
)
def test_a_former_name_inside_a_longer_word_is_not_replaced(text, current):
    assert with_current_names(text) == current


def claim_of(name, *, seed=3, **changes):
    rig = replace(preset_rig("like-phoxi-s", "small"), name=name)
    return make_claim({"rig": name} | changes, seed, (), rig, 0.1)


def test_a_dataset_s_claim_may_have_the_former_name_of_its_scanner(tmp_path):
    path = tmp_path / "graycast.json"
    path.write_text(json.dumps(claim_of("phoxi-s")))
    refuse_other(path, claim_of("like-phoxi-s"))
    for other in (
        claim_of("like-phoxi-m"),
        claim_of("like-phoxi-s", seed=4),
        claim_of("like-phoxi-s", count=2),
    ):
        with pytest.raises(DatasetError, match="of another configuration"):
            refuse_other(path, other)


def test_a_hand_edited_claim_with_a_former_name_is_refused(tmp_path):
    path = tmp_path / "graycast.json"
    path.write_text(json.dumps(claim_of("phoxi-s", seed=4) | {"seed": 3}))
    with pytest.raises(DatasetError, match="of another configuration"):
        refuse_other(path, claim_of("like-phoxi-s"))


def test_a_former_name_alone_does_not_make_a_scene_differ(tmp_path):
    manifest = {"config": {"rig": "phoxi-s", "count": 3}}
    (tmp_path / "manifest.json").write_text(json.dumps(manifest))
    (tmp_path / "rig.yaml").write_bytes(b"name: phoxi-s\nfx: 1\n")
    new = [("manifest.json", b'{"config": {"rig": "like-phoxi-s", "count": 3}}')]
    new.append(("rig.yaml", b"name: like-phoxi-s\nfx: 1\n"))
    assert differing_files(tmp_path, new) == {}
    new = [("manifest.json", b'{"config": {"rig": "like-phoxi-m", "count": 3}}')]
    new.append(("rig.yaml", b"name: like-phoxi-s\nfx: 2\n"))
    assert [*differing_files(tmp_path, new)] == ["manifest.json", "rig.yaml"]


@pytest.mark.slow
def test_a_dataset_begun_under_a_former_name_can_be_continued(tmp_path):
    path = write_cell(tmp_path, rig="like-phoxi-s", resolution="small")
    out = tmp_path / "out"
    generate(load_cell(path), out, scenes=1, seed=5, device="cpu")
    for file in (out / "graycast.json", out / "train/000000/manifest.json"):
        text = file.read_text().replace("like-phoxi-s", "phoxi-s")
        content = json.loads(text)
        if "fingerprint" in content:
            content["fingerprint"] = fingerprint(content)
        file.write_text(json.dumps(content))
    for name in ("like-phoxi-s", "phoxi-s"):
        path.write_text(yaml.safe_dump(yaml.safe_load(path.read_text()) | {"rig": name}))
        run = generate(load_cell(path), out, scenes=2, seed=5, device="cpu")
        assert run.found + run.written == 2 and run.found >= 1
    origin = read_origin(out)
    assert origin.config.rig == "like-phoxi-s" and "phoxi-s" not in origin.files
    assert rerender(load_cell(path), out, 0, seed=5, device="cpu") == {}
