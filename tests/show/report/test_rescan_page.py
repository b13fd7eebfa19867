"""The page of a rescanned dataset."""

import html
import re

from graycast.camera.decode import Reason
from graycast.dataset.read.rescanned import ImageRecord
from graycast.show.report.rescan_page import _reasons


def test_each_reason_in_the_table_has_its_meaning():
    record = ImageRecord(
        seeds={},
        exposure_s=0.01,
        reasons={reason.label: 1 / len(Reason) for reason in Reason},
        part_reasons={},
        seconds=1.0,
        perfect_step_mm=0.1,
        entries={
            "scene_gt_info_sl": [],
            "scene_gt_coco_sl": {"images": [{"width": len(Reason), "height": 1}]},
        },
        sha256={},
    )
    table = _reasons([record])
    rows = re.findall(r'<tr title="(.*?)"><td>.*?</i>(\w+)</td><td></td><td>([\d.]+%)</td>', table)
    assert {(html.unescape(title), name) for title, name, _ in rows} == {
        (reason.meaning, reason.name.lower()) for reason in Reason
    }
    assert {share for *_, share in rows} == {f"{100 / len(Reason):.1f}%"}
