"""What the page has to know before any picture: reasons, their colours, and colour maps."""

import json
from functools import cache

from ..decode import REASON_COLOR, Reason
from ..report.page.packing import color_table
from ..report.page.scene_files import REASON_MEANING

_COLORMAPS = ("viridis_r", "viridis", "RdBu_r", "gray", "magma")


@cache
def about() -> str:
    """A script that says so."""
    reasons = [
        {
            "number": int(reason),
            "name": reason.name.lower(),
            "color": REASON_COLOR[reason],
            "meaning": REASON_MEANING[reason],
        }
        for reason in Reason
    ]
    content = {
        "reasons": reasons,
        "colormaps": {name: color_table(name) for name in _COLORMAPS},
        "code": None,
        "claim": {"rig": None},
        "statistics": {"part_error": {"sigma_mm": None}},
    }
    return f"Graycast.report = {json.dumps(content)};\n"
