"""The surface of real parts from one scan: base colour, metal or plastic, and roughness.

normals         smooth normals of a depth map
saturated       the surface in saturated areas
observing       directions and direct light of each pixel
scan            the observations of a stack of pictures
surface_model   the light that the renderer's BSDF predicts, and its likelihood
fitting         the fit of kind, base colour and roughness, with intervals
classes         the division of a scan without masks into classes of one material each
mottle          the fit of reflectance that varies from place to place
material_files  the material as YAML, its summary and its plot
"""

from .classes import Division, divide
from .fitting import FittedValue, MaterialFit, fit_material, scale_of
from .material_files import (
    classes_picture,
    describe_class,
    describe_fit,
    draw_fit,
    material_text,
    matt_text,
)
from .mottle import MottleFit, fit_mottle
from .observing import Reflections, observe, observe_picture
from .scan import MaterialScan, open_scan, read_masks

__all__ = [
    "Division",
    "FittedValue",
    "MaterialFit",
    "MaterialScan",
    "MottleFit",
    "Reflections",
    "classes_picture",
    "describe_class",
    "describe_fit",
    "divide",
    "draw_fit",
    "fit_material",
    "fit_mottle",
    "material_text",
    "matt_text",
    "observe",
    "observe_picture",
    "open_scan",
    "read_masks",
    "scale_of",
]
