"""Graycast simulates a structured-light camera and makes bin-picking datasets with it.

This module offers every step to Python; `docs/library.md` begins with ten lines that run:

    cell = graycast.resolve_cell(graycast.load_config(path), path.parent)
    with graycast.open_cell_renderer(cell) as renderer:
        shot = graycast.make_scene(cell, 0, seed=1, renderer=renderer)
    codes, depth = graycast.measure(cell.scanner, shot.capture)
    graycast.save_scene(cell, shot, out)

`import graycast` loads nothing else. A name, and the module that it comes from, is loaded when it
is first asked for.

The packages and modules in order. Each imports only from those above it, which
`tests/test_imports.py` checks.

What all packages use:

    errors           the errors that a caller may want to handle
    array_types      annotations of arrays with their axes
    file_limits      JSON and pictures of users, refused before they fill the memory
    folder           files and folders that are written completely or not at all
    plotting         the style of plots, and how they are written
    settings         YAML files: reading, checking, and errors of one clear line
    usage            time and memory that processes have used
    color            the colour encoding of all pictures on disk
    frames           rigid transforms, rotations and the pixel grid
    lens_inverse     the inverse of lens distortion, compiled
    mask_box         the box about a mask's pixels
    optics           camera and projector: distortion and its inverse, thin lens, vignetting
    raster           the depth of a mesh at pixel centres, for checks
    finish           noise whose amplitude differs between patches of a surface
    ply              point clouds and meshes as PLY files

What is simulated:

    pattern          the frames that a projector shows, and the codes made of them
    rig              a camera and a projector with fixed relative pose
    parts            meshes with materials, built in or from the user's files
    grasp            where a part can be gripped by suction cups or jaws
    bins             a bin from a mesh file
    scene            the world before physics and light, and where the parts lie
    drop             parts fall until they rest: Scene -> Layout
    render           light: Layout -> Radiance, and the ground truth
    camera_light     from rendered radiance to the light on the sensor
    sensor           noise, saturation, quantisation: Radiance -> Capture
    speckle          laser speckle, and its effect on decoded positions
    photon_transfer  properties of a sensor, measured from flat fields
    decode           from pictures to projector positions and depth: Capture -> DepthMap
    line_noise       uneven projector lines, and their effect on decoded positions
    faults           faults of a device's depth, for simulated scans
    scanner          a rig with its code, sensor, exposure, decoder, filters and faults
    picture          the colour picture and the grey picture of the measuring camera
    rig_file         scanners in files, and imported calibrations
    stack            pictures of real scanners: description, decoding, results

What is written, and what makes it:

    dataset          ground truth on disk as BOP and COCO: writing, checking, reading
    detections       what a detector finds in a picture, and COCO's results files
    pose_results     estimated poses, and BOP's results files
    domain           how scenes differ from their cell, and a record of the differences
    views            the camera poses of a scene's images
    config           the configuration in YAML, and the values that it resolves to
    cell             a configuration with all its files read, shared by all scenes
    simulate         one scene, from its seeds to its sample
    engine           where scenes are made: this process, other processes, or a cluster
    generate         many scenes of a cell, written to the folder of a dataset

What is measured, trained and scored:

    metrology        the accuracy of a virtual scanner, as a certificate
    stats            statistics of a dataset
    card             the card of a dataset
    export           datasets in the formats of other programs
    real             data of a real scanner: its rig, bin, labels and depth statistics
    training         training examples from datasets and from exports
    evaluate         scores of detections, poses and depth; imports nothing that it scores
    detect           detectors: training and inference
    pose             the pose of a part from a detection and the scanner's depth
    merge            several views of a scene as one cloud, and what each of them adds
    study_file       the YAML file of a study
    study            models x inputs x training sets x worlds x seeds, in one table
    design           comparison of scanners and their poses on the same heaps
    pick             a robot that empties the bin
    grasp_labels     grasp labels of the parts of a dataset, simulated in physics
    report           pictures of inputs and results, and the web page
    live             a cell in the browser, whose settings can be changed
    doctor           what is installed, and what each missing piece is for
    cli              the command `graycast`: files in, files out
"""

from importlib import import_module
from typing import TYPE_CHECKING

__version__ = "0.1.0"

if TYPE_CHECKING:  # for type checkers and editors; `_MODULE` says the same to Python
    from .cell import Cell as Cell
    from .cell import open_cell_renderer as open_cell_renderer
    from .cell import resolve_cell as resolve_cell
    from .config import Config as Config
    from .config import load_config as load_config
    from .dataset import validate as validate
    from .decode import CodeMap as CodeMap
    from .decode import DecodeSpec as DecodeSpec
    from .decode import DepthMap as DepthMap
    from .decode import FilterSpec as FilterSpec
    from .decode import Levels as Levels
    from .decode import Reason as Reason
    from .decode import triangulate as triangulate
    from .errors import GraycastError as GraycastError
    from .faults import FaultSpec as FaultSpec
    from .generate import Workers as Workers
    from .generate import save_scene as save_scene
    from .parts import Material as Material
    from .parts import Mesh as Mesh
    from .parts import Part as Part
    from .parts import builtin_part as builtin_part
    from .parts import load_part as load_part
    from .pattern import Code as Code
    from .pattern import CodeSpec as CodeSpec
    from .pattern import Frame as Frame
    from .render import GroundTruth as GroundTruth
    from .render import Quality as Quality
    from .render import Radiance as Radiance
    from .render import Renderer as Renderer
    from .render import Rendering as Rendering
    from .render import open_renderer as open_renderer
    from .rig import Rig as Rig
    from .rig import place as place
    from .rig_file import load_scanner as load_scanner
    from .rig_file import save_scanner as save_scanner
    from .scanner import Scan as Scan
    from .scanner import Scanner as Scanner
    from .scanner import measure as measure
    from .scanner import preset as preset
    from .scanner import scan as scan
    from .scanner import take as take
    from .scene import Bin as Bin
    from .scene import Environment as Environment
    from .scene import Lamp as Lamp
    from .scene import Layout as Layout
    from .scene import Scene as Scene
    from .sensor import Capture as Capture
    from .sensor import SensorSpec as SensorSpec
    from .simulate import Shot as Shot
    from .simulate import make_images as make_images
    from .simulate import make_scene as make_scene
    from .stack import decode_stack as decode_stack
    from .training import Example as Example
    from .training import open_examples as open_examples

_MODULE = {
    name: module
    for module, names in {
        "cell": ("Cell", "open_cell_renderer", "resolve_cell"),
        "config": ("Config", "load_config"),
        "dataset": ("validate",),
        "decode": (
            *("CodeMap", "DecodeSpec", "DepthMap", "FilterSpec", "Levels", "Reason"),
            "triangulate",
        ),
        "errors": ("GraycastError",),
        "faults": ("FaultSpec",),
        "generate": ("Workers", "save_scene"),
        "parts": ("Material", "Mesh", "Part", "builtin_part", "load_part"),
        "pattern": ("Code", "CodeSpec", "Frame"),
        "render": (
            *("GroundTruth", "Quality", "Radiance", "Renderer", "Rendering"),
            "open_renderer",
        ),
        "rig": ("Rig", "place"),
        "rig_file": ("load_scanner", "save_scanner"),
        "scanner": ("Scan", "Scanner", "measure", "preset", "scan", "take"),
        "scene": ("Bin", "Environment", "Lamp", "Layout", "Scene"),
        "sensor": ("Capture", "SensorSpec"),
        "simulate": ("Shot", "make_images", "make_scene"),
        "stack": ("decode_stack",),
        "training": ("Example", "open_examples"),
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
    return sorted({*globals(), *_MODULE})
