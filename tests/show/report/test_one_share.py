"""The share of the parts' pixels with depth is the same in run, statistics, card and page."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from small_cell import write_cell

from graycast.camera.decode import Reason, little_depth_note, pooled_shares, reason_counts
from graycast.cell.generate import generate
from graycast.cell.resolve import load_cell
from graycast.dataset.card import write_card
from graycast.dataset.read.rescanned import ImageRecord
from graycast.dataset.stats import dataset_statistics, statistics_json
from graycast.show.report.page import write_report


def test_shares_of_pictures_of_unequal_sizes_are_weighted_by_pixels():
    """Half of ten pixels and all of ninety are 95 %; the mean of the shares would be 75 %."""
    few = np.repeat(np.array([Reason.DECODED, Reason.SHADOW], dtype=np.uint8), 5)
    many, none = np.zeros(90, dtype=np.uint8), np.zeros(0, dtype=np.uint8)
    shares = pooled_shares([reason_counts(few), reason_counts(many), reason_counts(none)])
    assert shares["decoded"] == 0.95 and sum(shares.values()) == pytest.approx(1)
    assert pooled_shares([reason_counts(none)]) == {} == pooled_shares([])


def pixels_of(out):
    """Return the reasons of the parts' pixels in each scene, read from its pictures."""
    scenes = []
    for folder in sorted((out / "train").iterdir()):
        reason = cv2.imread(str(folder / "reason_sl/000000.png"), cv2.IMREAD_UNCHANGED)
        on_part = np.zeros(reason.shape, dtype=bool)
        for mask in (folder / "mask_visib").glob("*.png"):
            on_part |= cv2.imread(str(mask), cv2.IMREAD_UNCHANGED) > 0
        scenes.append(reason[on_part])
    return scenes


@pytest.mark.slow
def test_the_run_statistics_card_and_page_state_the_same_share(tmp_path):
    """One scene is empty, and the others differ. Oracle: a count of the pixels in the pictures."""
    cell = load_cell(write_cell(tmp_path, count=[0, 9]))
    out = tmp_path / "out"
    results = []
    summary = generate(cell, out, scenes=3, seed=9, device="cpu", on_result=results.append)
    scenes = pixels_of(out)
    shares = [float((one == Reason.DECODED).mean()) if one.size else None for one in scenes]
    pooled = float((np.concatenate(scenes) == Reason.DECODED).mean())
    known = [share for share in shares if share is not None]
    assert len(known) == 2 and abs(np.mean(known) - pooled) > 0.002  # The scenes differ enough.
    assert [one.part_reasons.get("decoded") for one in results] == pytest.approx(shares)
    assert summary.part_reasons["decoded"] == pytest.approx(pooled)
    statistics = dataset_statistics(out)
    assert statistics.part_reason == pytest.approx(summary.part_reasons)
    assert statistics.decoded_share.sum() == len(known)
    assert f"| with a scanner depth | {pooled:.1%} of the parts' pixels, " in (
        write_card(out, statistics).read_text()
    )
    little = replace(statistics, part_reason={"decoded": 0.2, "shadow": 0.8})
    note = (
        "20.0% of the parts' pixels have depth; the main reason of missing depth is shadow (80.0%)"
    )
    assert f"| note | {note}; " in write_card(out, little).read_text()
    page = write_report(out, tmp_path / "page").page.with_name("index.js").read_text()
    index = json.loads(page.removeprefix("Graycast.report = ").rstrip().rstrip(";"))
    assert index["statistics"] == json.loads(json.dumps(statistics_json(statistics)))
    assert index["statistics"]["part_reasons"]["decoded"] == pytest.approx(pooled)
    assert index["note"] == little_depth_note(statistics.part_reason)
    of_page = [dict(zip(index["columns"], row, strict=True)) for row in index["scenes"]]
    for row, share in zip(of_page, shares, strict=True):
        assert row["part_decoded"] == (None if share is None else round(share, 4))
        assert (row["part_reasons"] is None) == (share is None)
        if share:
            assert row["part_reasons"]["decoded"] == row["part_decoded"]


def test_the_record_of_a_rescan_gives_the_pixel_counts_of_its_shares():
    """Shares of 7 of 12 and of 2 of 5 pixels are converted back to whole numbers."""
    record = ImageRecord(
        seeds={},
        exposure_s=0.01,
        reasons={"decoded": 7 / 12, "shadow": 5 / 12},
        part_reasons={"decoded": 2 / 5, "shadow": 3 / 5},
        seconds=1.0,
        perfect_step_mm=0.1,
        entries={
            "scene_gt_info_sl": [{"px_count_visib": 4}, {"px_count_visib": 1}],
            "scene_gt_coco_sl": {"images": [{"width": 4, "height": 3}]},
        },
        sha256={},
    )
    assert record.reason_px == {"decoded": 7, "shadow": 5}
    assert record.part_reason_px == {"decoded": 2, "shadow": 3}
