"""Speed and memory of the stages, studies of renderers, of drops and of poses."""

from .agree import study_agreement
from .denoise import study_denoisers
from .engines import measure_engines
from .figures import Figures, describe, stamped
from .hulls import measure_hulls
from .kept import write_figures
from .live import measure_live
from .opening import opened
from .plots import draw
from .poses import measure_poses
from .renderers import study_renderers
from .stages import measure_decode, measure_drop, measure_render, measure_scene
from .zoo import describe_row, study_zoo

__all__ = [
    "Figures",
    "describe",
    "describe_row",
    "draw",
    "measure_decode",
    "measure_drop",
    "measure_engines",
    "measure_hulls",
    "measure_live",
    "measure_poses",
    "measure_render",
    "measure_scene",
    "opened",
    "stamped",
    "study_agreement",
    "study_denoisers",
    "study_renderers",
    "study_zoo",
    "write_figures",
]
