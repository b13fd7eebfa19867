"""Graycast simulates a structured-light camera and makes bin-picking datasets with it.

This module offers every step to Python; `docs/how-to/python.md` begins with ten lines that run:

    cell = graycast.resolve_cell(graycast.load_config(path), path.parent)
    with graycast.open_cell_renderer(cell) as renderer:
        shot = graycast.make_scene(cell, 0, seed=1, renderer=renderer)
    codes, depth = graycast.measure(cell.scanner, shot.capture)
    graycast.save_scene(cell, shot, out)

`import graycast` loads nothing else. A name, and the module that it comes from, is loaded when it
is first asked for.

The rooms in order; the docstring of each has a line for each of its modules. A module imports only
from those above it, which `tests/test_imports.py` checks. CONTRIBUTING.md says where a new code,
renderer, detector, exporter or gripper goes.

    base       what every room uses: errors, settings, whole files, frames, plots
    rig        optics, codes, and the pair of camera and projector
    world      parts, bins, the scene, and the drop: Scene -> Layout
    rendering  light: Layout -> Radiance, and the ground truth
    camera     from light to depth: Radiance -> Capture -> DepthMap; stacks of real scanners
    dataset    ground truth on disk as BOP and COCO: written, checked, read, exported
    cell       a configuration with its files, its scenes, and a dataset of them
    score      scores of detections, poses and depth; certificates; several views; designs
    real       data of a real scanner: its rig, bin, labels and depth statistics
    learn      detectors: training, inference and studies
    robot      poses of parts, grips, and a robot that empties the bin
    show       pictures of inputs and results, the web page, and a cell in the browser
    cli        the command `graycast`: files in, files out
"""

from importlib import import_module
from typing import TYPE_CHECKING

__version__ = "0.1.0"

if TYPE_CHECKING:  # for type checkers and editors; `_MODULE` says the same to Python
    from .base.errors import GraycastError as GraycastError
    from .camera.decode import CodeMap as CodeMap
    from .camera.decode import DecodeSpec as DecodeSpec
    from .camera.decode import DepthMap as DepthMap
    from .camera.decode import FilterSpec as FilterSpec
    from .camera.decode import Levels as Levels
    from .camera.decode import Reason as Reason
    from .camera.decode import triangulate as triangulate
    from .camera.faults import FaultSpec as FaultSpec
    from .camera.rig_file import load_scanner as load_scanner
    from .camera.rig_file import save_scanner as save_scanner
    from .camera.scanner import Scan as Scan
    from .camera.scanner import Scanner as Scanner
    from .camera.scanner import measure as measure
    from .camera.scanner import preset as preset
    from .camera.scanner import scan as scan
    from .camera.scanner import take as take
    from .camera.sensor import Capture as Capture
    from .camera.sensor import SensorSpec as SensorSpec
    from .camera.stack import decode_stack as decode_stack
    from .cell.config import Config as Config
    from .cell.config import load_config as load_config
    from .cell.engine import Workers as Workers
    from .cell.generate import save_scene as save_scene
    from .cell.resolve import Cell as Cell
    from .cell.resolve import open_cell_renderer as open_cell_renderer
    from .cell.resolve import resolve_cell as resolve_cell
    from .cell.simulate import Shot as Shot
    from .cell.simulate import make_images as make_images
    from .cell.simulate import make_scene as make_scene
    from .dataset import validate as validate
    from .dataset.training import Example as Example
    from .dataset.training import open_examples as open_examples
    from .rendering import GroundTruth as GroundTruth
    from .rendering import Quality as Quality
    from .rendering import Radiance as Radiance
    from .rendering import Renderer as Renderer
    from .rendering import Rendering as Rendering
    from .rendering import open_renderer as open_renderer
    from .rig.pair import Rig as Rig
    from .rig.pair import place as place
    from .rig.pattern import Code as Code
    from .rig.pattern import CodeSpec as CodeSpec
    from .rig.pattern import Frame as Frame
    from .world.parts import Material as Material
    from .world.parts import Mesh as Mesh
    from .world.parts import Part as Part
    from .world.parts import builtin_part as builtin_part
    from .world.parts import load_part as load_part
    from .world.scene import Bin as Bin
    from .world.scene import Environment as Environment
    from .world.scene import Lamp as Lamp
    from .world.scene import Layout as Layout
    from .world.scene import Scene as Scene

_MODULE = {
    name: module
    for module, names in {
        "base.errors": ("GraycastError",),
        "rig.pair": ("Rig", "place"),
        "rig.pattern": ("Code", "CodeSpec", "Frame"),
        "world.parts": ("Material", "Mesh", "Part", "builtin_part", "load_part"),
        "world.scene": ("Bin", "Environment", "Lamp", "Layout", "Scene"),
        "rendering": (
            *("GroundTruth", "Quality", "Radiance", "Renderer", "Rendering"),
            "open_renderer",
        ),
        "camera.decode": (
            *("CodeMap", "DecodeSpec", "DepthMap", "FilterSpec", "Levels", "Reason"),
            "triangulate",
        ),
        "camera.faults": ("FaultSpec",),
        "camera.rig_file": ("load_scanner", "save_scanner"),
        "camera.scanner": ("Scan", "Scanner", "measure", "preset", "scan", "take"),
        "camera.sensor": ("Capture", "SensorSpec"),
        "camera.stack": ("decode_stack",),
        "dataset": ("validate",),
        "dataset.training": ("Example", "open_examples"),
        "cell.config": ("Config", "load_config"),
        "cell.engine": ("Workers",),
        "cell.generate": ("save_scene",),
        "cell.resolve": ("Cell", "open_cell_renderer", "resolve_cell"),
        "cell.simulate": ("Shot", "make_images", "make_scene"),
    }.items()
    for name in names
}
__all__ = ["__version__", *_MODULE]


def __getattr__(name: str) -> object:
    if name in _MODULE:
        return getattr(import_module(f".{_MODULE[name]}", __name__), name)
    room = name.isidentifier() and not name.startswith("_") and _room(name)
    if room:
        return room
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def _room(name: str) -> object:
    """A module of the package; None if there is no such module."""
    full_name = f"{__name__}.{name}"
    try:
        return import_module(full_name)
    except ModuleNotFoundError as error:
        if error.name == full_name:
            return None
        raise


def __dir__() -> list[str]:
    return sorted({*(name for name in globals() if name.startswith("__")), *_MODULE})
