"""A fitted configuration has a new rig and drops the sections that belong to the old rig."""

from pathlib import Path

import yaml

from graycast.real.fitted_config import fitted_text

BASE = """\
# mine
parts: [{builtin: washer}]
rig: like-phoxi-m
decode:
  min_contrast: 0.05
scenes: 4  # kept
"""


def test_a_fitted_configuration_has_the_new_rig_without_the_sections_of_the_old_rig():
    text = fitted_text(
        BASE, Path("cell.yaml"), {"rig": "twin.rig.yaml"}, {"rig": "fitted"}, dropped=("decode",)
    )
    assert yaml.safe_load(text) == {
        "parts": [{"builtin": "washer"}],
        "rig": "twin.rig.yaml",
        "scenes": 4,
    }
    assert "# fitted\nrig: twin.rig.yaml\n" in text
    assert "# mine\n" in text and "scenes: 4  # kept\n" in text
