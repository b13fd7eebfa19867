"""The note on parts with little depth: its text, and the change that it names."""

import numpy as np
import pytest

from graycast.camera.decode import DepthMap, Reason, little_depth_note
from graycast.camera.scanner import preset
from graycast.cell.remedies import DepthShares, advice, depth_shares, remedies


def shares(**of_reason: float) -> dict[str, float]:
    return {reason.label: of_reason.get(reason.label, 0.0) for reason in Reason}


def test_the_note_about_little_depth_states_the_share_and_the_main_reason():
    note = little_depth_note(shares(decoded=0.13, saturated=0.5, low_modulation=0.37))
    assert note == (
        "13.0% of the parts' pixels have depth; the main reason of missing depth is saturated "
        "(50.0%)"
    )


@pytest.mark.parametrize("of_parts", [{}, shares(decoded=0.5, shadow=0.5)])
def test_no_note_is_given_without_parts_or_if_half_of_their_pixels_have_depth(of_parts):
    assert little_depth_note(of_parts) == ""


def test_a_remedy_that_the_scanner_already_has_is_not_tried_again():
    first = remedies(preset("like-phoxi-m", "small"))
    again = remedies(first[0].scanner)
    assert "exposure: {auto: true}" in [remedy.words for remedy in first]
    assert "exposure: {auto: true}" not in [remedy.words for remedy in again]


def of(depth: float, wrong: float) -> DepthShares:
    return DepthShares(depth=depth, wrong=wrong)


def test_the_remedy_with_most_depth_is_named_with_its_share_of_wrong_depths():
    tries = {"exposure": of(0.36, 0.004), "decode": of(0.2, 0.0), "other": of(0.131, 0.0)}
    assert advice(of(0.13, 0.001), tries) == (
        "now 0.1% of the depths are wrong (over 1 mm and 5 sigma off); with `exposure` 36.0% have "
        "depth, 0.4% of it wrong (tried on this scene)"
    )


def test_a_change_that_adds_many_wrong_depths_is_no_remedy():
    tries = {"decode": of(0.4, 0.06), "exposure": of(0.36, 0.003)}
    text = advice(of(0.13, 0.001), tries)
    assert "with `exposure` 36.0% have depth, 0.3% of it wrong" in text
    assert "`decode` is no remedy: 40.0% have depth, but 6.0% of it is wrong" in text
    alone = advice(of(0.13, 0.001), {"decode": of(0.4, 0.06)})
    assert "with `" not in alone
    assert "`decode` is no remedy" in alone


def test_useless_changes_are_listed_with_the_share_of_wrong_depths():
    tries = {"exposure": of(0.134, 0.0), "decode": of(0.1, 0.0)}
    assert advice(of(0.13, 0.021), tries) == (
        "now 2.1% of the depths are wrong (over 1 mm and 5 sigma off); none of these changes gives "
        "more depth: `exposure`, `decode`"
    )


def test_a_wrong_depth_exceeds_two_limits_and_only_parts_are_counted():
    """Each pixel is a case of the definition in docs/measurements/materials.md."""
    true_m = np.full((1, 7), 0.5)
    off_mm = np.array([[0.0, 0.9, 1.1, -1.1, -9.0, np.nan, 5.0]])
    sigma_mm = np.array([[0.1, 0.1, 0.2, 0.3, 1.0, np.nan, 0.1]])
    depth = DepthMap(
        depth_m=true_m + 1e-3 * off_mm,
        sigma_m=1e-3 * sigma_mm,
        reason=np.zeros((1, 7), np.uint8),
        camera=preset("like-phoxi-m", "small").rig.camera,
    )
    part = np.array([[True] * 6 + [False]])
    # The third (1.1 mm, 5.5 sigma) and fifth (9 sigma) depths are wrong; the last shows no part.
    shares = depth_shares(depth, true_m, part)
    assert shares.depth == pytest.approx(5 / 6)
    assert shares.wrong == pytest.approx(2 / 5)
    nothing = depth_shares(depth, true_m, np.zeros_like(part))
    assert nothing == of(0.0, 0.0)
