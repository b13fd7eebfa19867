"""The page of a rescanned dataset."""

import html
import re
from types import SimpleNamespace

from graycast.camera.decode import Reason
from graycast.show.report.rescan_page import _reasons


def test_each_reason_of_the_table_says_what_it_means():
    counts = {reason.label: 1 for reason in Reason}
    table = _reasons([SimpleNamespace(reason_px=counts, part_reason_px={})])
    rows = re.findall(r'<tr title="(.*?)"><td>.*?</i>(\w+)</td><td></td><td>([\d.]+%)</td>', table)
    assert {(html.unescape(title), name) for title, name, _ in rows} == {
        (reason.meaning, reason.name.lower()) for reason in Reason
    }
    assert {share for *_, share in rows} == {f"{100 / len(Reason):.1f}%"}
