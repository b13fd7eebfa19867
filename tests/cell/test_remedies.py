"""The note on parts with little depth: its words, and the change that it names."""

import pytest

from graycast.camera.decode import Reason, little_depth_note
from graycast.camera.scanner import preset
from graycast.cell.remedies import remedies


def shares(**of_reason: float) -> dict[str, float]:
    return {reason.label: of_reason.get(reason.label, 0.0) for reason in Reason}


def test_the_note_names_the_share_and_the_main_reason():
    note = little_depth_note(shares(decoded=0.13, saturated=0.5, low_modulation=0.37))
    assert note == (
        "13.0% of the parts' pixels have depth; the main reason of missing depth is saturated "
        "(50.0%)"
    )


@pytest.mark.parametrize("of_parts", [{}, shares(decoded=0.5, shadow=0.5)])
def test_there_is_no_note_without_parts_or_from_half_of_the_pixels_on(of_parts):
    assert little_depth_note(of_parts) == ""


def test_a_change_that_a_scanner_has_already_is_not_tried_again():
    first = remedies(preset("like-phoxi-m", "small"))
    again = remedies(first[0].scanner)
    assert "exposure: {auto: true}" in [remedy.words for remedy in first]
    assert "exposure: {auto: true}" not in [remedy.words for remedy in again]
