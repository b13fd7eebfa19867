"""Graycast simulates a structured-light camera and makes bin-picking datasets with it.

This module offers every step to Python; `docs/how-to/python.md` begins with these lines:

    import graycast as gc

    cell = gc.load_cell("configs/demo.yaml")
    for scene in gc.scenes(cell, 3, seed=1):
        cloud = scene.depth.points()
        scene.save("out/library")

`import graycast` loads nothing else. A name, and the module that it comes from, is loaded when it
is first asked for. A function then refuses arguments of a wrong kind by their names.

The rooms in order; the docstring of each has a line for each of its modules. A module imports only
from those above it, which `tests/test_imports.py` checks. CONTRIBUTING.md says where a new code,
renderer, detector, exporter or gripper goes.

    base       what every room uses: errors, settings, whole files, frames, random streams, plots
    rig        optics, codes, and the pair of camera and projector
    world      parts, bins, the scene, and the drop: Scene -> Layout
    rendering  light: Layout -> Radiance, and the ground truth
    camera     from light to depth: Radiance -> Capture -> DepthMap; stacks of real scanners
    dataset    ground truth on disk as BOP and COCO: written, checked, read, exported
    cell       a configuration with its files, its scenes, and a dataset of them
    score      scores of detections, poses and depth; certificates; several views; designs
    real       data of a real scanner: its rig, bin, labels, depth statistics; others' datasets
    learn      detectors: training, inference and studies
    robot      poses of parts, grips, and a robot that empties the bin
    show       pictures, scenes for scripts, the web page, and a cell in the browser
    cli        the command `graycast`: files in, files out
"""

from importlib import import_module
from types import FunctionType
from typing import TYPE_CHECKING

from .base.version import __version__

if TYPE_CHECKING:  # for type checkers and editors; `_MODULE` says the same to Python
    from .base.errors import GraycastError as GraycastError
    from .base.errors import ScannerError as ScannerError
    from .camera.decode import CodeMap as CodeMap
    from .camera.decode import DecodeSpec as DecodeSpec
    from .camera.decode import DepthMap as DepthMap
    from .camera.decode import FilterSpec as FilterSpec
    from .camera.decode import Levels as Levels
    from .camera.decode import Reason as Reason
    from .camera.decode import decode as decode
    from .camera.decode import triangulate as triangulate
    from .camera.faults import FaultSpec as FaultSpec
    from .camera.rig_file import SettingRange as SettingRange
    from .camera.rig_file import load_scanner as load_scanner
    from .camera.rig_file import save_scanner as save_scanner
    from .camera.rig_file.scanner_sections import CodeSection as CodeSection
    from .camera.rig_file.scanner_sections import DecodeSection as DecodeSection
    from .camera.rig_file.scanner_sections import ExposureSection as ExposureSection
    from .camera.rig_file.scanner_sections import FaultSection as FaultSection
    from .camera.rig_file.scanner_sections import FilterSection as FilterSection
    from .camera.rig_file.scanner_sections import SensorSection as SensorSection
    from .camera.scanner import Scanner as Scanner
    from .camera.scanner import measure as measure
    from .camera.scanner import preset as preset
    from .camera.scanner import take as take
    from .camera.sensor import Capture as Capture
    from .camera.sensor import SensorSpec as SensorSpec
    from .camera.stack import decode_stack as decode_stack
    from .camera.stack import describe_code as describe_code
    from .cell.bag_scanner import BagScanner as BagScanner
    from .cell.config import BinSection as BinSection
    from .cell.config import Config as Config
    from .cell.config import LightSection as LightSection
    from .cell.config import RenderSection as RenderSection
    from .cell.config import load_config as load_config
    from .cell.engine import Workers as Workers
    from .cell.generate import generate as generate
    from .cell.generate import save_scene as save_scene
    from .cell.resolve import Cell as Cell
    from .cell.resolve import load_cell as load_cell
    from .cell.resolve import open_cell_renderer as open_cell_renderer
    from .cell.scanner_device import ScannerDevice as ScannerDevice
    from .cell.scanner_device import ScannerFrame as ScannerFrame
    from .cell.simulate import Shot as Shot
    from .cell.simulate import make_images as make_images
    from .cell.simulate import make_scene as make_scene
    from .cell.views import ViewSection as ViewSection
    from .cell.virtual_bin import VirtualBin as VirtualBin
    from .cell.virtual_scanner import FrameTruth as FrameTruth
    from .cell.virtual_scanner import VirtualScanner as VirtualScanner
    from .dataset.check.checking import validate as validate
    from .dataset.export.split import Split as Split
    from .dataset.read.detections import Detections as Detections
    from .dataset.training import Example as Example
    from .dataset.training import open_examples as open_examples
    from .learn.detect import TrainSpec as TrainSpec
    from .learn.detect import detect as detect
    from .learn.detect import load_detector as load_detector
    from .learn.detect import pictures_of as pictures_of
    from .learn.detect import train as train
    from .real.material import MaterialFit as MaterialFit
    from .real.material import MaterialScan as MaterialScan
    from .real.material import fit_material as fit_material
    from .real.material import open_scan as open_scan
    from .real.rescan.open_source import open_source as open_source
    from .real.rescan.rescanning import RescanSpec as RescanSpec
    from .real.rescan.rescanning import rescan as rescan
    from .real.rescan.source import SourceOptions as SourceOptions
    from .rendering import GroundTruth as GroundTruth
    from .rendering import Quality as Quality
    from .rendering import Radiance as Radiance
    from .rendering import Renderer as Renderer
    from .rendering import Rendering as Rendering
    from .rendering import open_renderer as open_renderer
    from .rendering import render as render
    from .rig.pair import Rig as Rig
    from .rig.pair import place as place
    from .rig.pattern import Code as Code
    from .rig.pattern import CodeSpec as CodeSpec
    from .rig.pattern import Frame as Frame
    from .robot.pick import load_pick_config as load_pick_config
    from .robot.pick import pick as pick
    from .robot.pick import resolve_pick_cell as resolve_pick_cell
    from .robot.pose import find_pose as find_pose
    from .robot.pose import find_poses as find_poses
    from .robot.pose import pose_model as pose_model
    from .score.evaluate import Protocol as Protocol
    from .score.evaluate import Task as Task
    from .score.evaluate import evaluate as evaluate
    from .show.scenes import SceneResult as SceneResult
    from .show.scenes import scenes as scenes
    from .world.drop import DropLimits as DropLimits
    from .world.drop import drop as drop
    from .world.parts import Material as Material
    from .world.parts import Mesh as Mesh
    from .world.parts import Part as Part
    from .world.parts import builtin_part as builtin_part
    from .world.parts import load_part as load_part
    from .world.parts.material_section import MaterialSection as MaterialSection
    from .world.parts.part_sections import PartSection as PartSection
    from .world.scene import Bin as Bin
    from .world.scene import Environment as Environment
    from .world.scene import Lamp as Lamp
    from .world.scene import Layout as Layout
    from .world.scene import Scene as Scene

_MODULE = {
    name: module
    for module, names in {
        "base.errors": "GraycastError ScannerError",
        "rig.pair": "Rig place",
        "rig.pattern": "Code CodeSpec Frame",
        "world.drop": "DropLimits drop",
        "world.parts": "Material Mesh Part builtin_part load_part",
        "world.parts.material_section": "MaterialSection",
        "world.parts.part_sections": "PartSection",
        "world.scene": "Bin Environment Lamp Layout Scene",
        "rendering": "GroundTruth Quality Radiance Renderer Rendering open_renderer render",
        "camera.decode": "CodeMap DecodeSpec DepthMap FilterSpec Levels Reason decode triangulate",
        "camera.faults": "FaultSpec",
        "camera.rig_file": "SettingRange load_scanner save_scanner",
        "camera.rig_file.scanner_sections": "CodeSection DecodeSection ExposureSection "
        "FaultSection FilterSection SensorSection",
        "camera.scanner": "Scanner measure preset take",
        "camera.sensor": "Capture SensorSpec",
        "camera.stack": "decode_stack describe_code",
        "dataset.check.checking": "validate",
        "dataset.read.detections": "Detections",
        "dataset.export.split": "Split",
        "dataset.training": "Example open_examples",
        "cell.bag_scanner": "BagScanner",
        "cell.config": "BinSection Config LightSection RenderSection load_config",
        "cell.engine": "Workers",
        "cell.generate": "generate save_scene",
        "cell.resolve": "Cell load_cell open_cell_renderer",
        "cell.scanner_device": "ScannerDevice ScannerFrame",
        "cell.simulate": "Shot make_images make_scene",
        "cell.views": "ViewSection",
        "cell.virtual_bin": "VirtualBin",
        "cell.virtual_scanner": "FrameTruth VirtualScanner",
        "score.evaluate": "Protocol Task evaluate",
        "real.material": "MaterialFit MaterialScan fit_material open_scan",
        "real.rescan.open_source": "open_source",
        "real.rescan.rescanning": "RescanSpec rescan",
        "real.rescan.source": "SourceOptions",
        "learn.detect": "TrainSpec detect load_detector pictures_of train",
        "robot.pick": "load_pick_config pick resolve_pick_cell",
        "robot.pose": "find_pose find_poses pose_model",
        "show.scenes": "SceneResult scenes",
    }.items()
    for name in names.split()
}
__all__ = ["__version__", *_MODULE]


def __getattr__(name: str) -> object:
    if name in _MODULE:
        value = getattr(import_module(f".{_MODULE[name]}", __name__), name)
        if not isinstance(value, FunctionType):
            return value
        from .base.argument_check import checked

        return checked(value)
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
