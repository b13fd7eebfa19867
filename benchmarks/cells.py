"""Scenes of the benchmarks, and the renderers that are compared on these scenes."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace

from graycast.camera.decode import DecodeSpec
from graycast.camera.scanner import Scanner
from graycast.camera.sensor import SensorSpec, auto_exposure_s
from graycast.cell.resolve import Cell
from graycast.rendering import Radiance, Renderer, open_renderer
from graycast.rig.optics import Optics
from graycast.rig.pair import preset_rig
from graycast.rig.pattern import CodeSpec
from graycast.world.drop import DropLimits, drop
from graycast.world.parts import Material
from graycast.world.scene import Layout

from .stages import cell_of

# The full well is so large that photon noise is at most 2 of 65535 digital numbers. The noise of a
# picture is therefore the noise of the renderer.
QUIET_SENSOR = SensorSpec(
    full_well_e=1e9, gain_dn_per_e=6.5e-5, read_noise_e=0.0, dark_current_e_s=0.0, bit_depth=16
)

GRAY = CodeSpec(codec="gray", axes=("column",))  # the paper's code, along the baseline
PHASE = CodeSpec(codec="gray_phase", axes=("column",), period_px=16.0, steps=4)
PHASE_BOTH = replace(PHASE, axes=("column", "row"))  # 24 frames of 1024 x 768

# One bracket in three materials, so that the classes differ only in material.
MATERIALS = {
    "diffuse": Material(base_color=(0.5, 0.5, 0.5), specular=0.0),
    "metal": Material(base_color=(0.22, 0.22, 0.225), metallic=1.0, roughness=0.5),
    "plastic": Material(base_color=(0.6, 0.3, 0.1), roughness=0.4),
}
SMALL_BIN_M = (0.18, 0.13, 0.06)


@contextmanager
def opened(*patterns_per_render: int) -> Iterator[tuple[Renderer, ...]]:
    """Open Mitsuba, and Cycles for each number of patterns per render, on a GPU if there is one.

    Raises:
        DeviceError: Cycles is not installed.
    """
    with ExitStack() as stack:
        # Cycles is opened first, so that the error comes at once if Cycles is not installed.
        cycles = [
            stack.enter_context(open_renderer("cycles", patterns_per_render=number))
            for number in patterns_per_render
        ]
        yield (stack.enter_context(open_renderer("mitsuba")), *cycles)


def bracket_cell(
    count: int, code: CodeSpec, size_px: tuple[int, int], *, rig: str = "like-phoxi-m"
) -> Cell:
    """Return a cell of the paper's metal brackets in front of a rig with a cropped camera.

    'like-phoxi-m' has light of one wavelength, so Cycles may render three patterns at once. 'paper'
    has white light.
    """
    return _before(rig, cell_of({"count": count}), code, size_px)


def materials_cell(size_px: tuple[int, int]) -> Cell:
    """Return a cell: brackets of three materials in a small box, PhoXi M and phase code."""
    cell = cell_of({"bin": {"inner_m": SMALL_BIN_M}})
    bracket = cell.scene.parts[0]
    parts = tuple(replace(bracket, name=n, material=m) for n, m in MATERIALS.items())
    cell = replace(cell, scene=replace(cell.scene, parts=parts))
    return _before("like-phoxi-m", cell, PHASE, size_px)


def dropped(cell: Cell, each: int, *, seed: int) -> Layout:
    """Return a layout at rest with the given number of each kind of part."""
    counts = (each,) * len(cell.scene.parts)
    return drop(cell.scene, counts, seed=seed, limits=DropLimits())


def cropped(camera: Optics, size_px: tuple[int, int]) -> Optics:
    """Return a camera that has only the central pixels of another camera, with the same rays.

    Raises:
        ValueError: the crop is larger than the picture.
    """
    width_px, height_px = size_px
    left, top = (camera.width_px - width_px) // 2, (camera.height_px - height_px) // 2
    if left < 0 or top < 0 or min(size_px) < 1:
        own = f"{camera.width_px} x {camera.height_px}"
        raise ValueError(
            f"size {width_px} x {height_px} does not fit into the camera's {own} px: give a "
            "smaller size"
        )
    return replace(
        camera,
        width_px=width_px,
        height_px=height_px,
        cx_px=camera.cx_px - left,
        cy_px=camera.cy_px - top,
    )


def exposed_alike(scanner: Scanner, radiance: Radiance) -> Scanner:
    """Return the scanner with a fixed exposure, equal to its automatic exposure for this light."""
    rule = scanner.exposure
    time_s = auto_exposure_s(
        radiance.white + radiance.ambient,
        scanner.sensor,
        percentile=rule.percentile,
        target=rule.target,
    )
    return replace(scanner, exposure=replace(rule, exposure_s=time_s))


def _before(name: str, cell: Cell, code: CodeSpec, size_px: tuple[int, int]) -> Cell:
    """Return the cell with a rig of sharp lenses, a code, and a sensor without noise."""
    rig = preset_rig(name, "low")
    rig = replace(rig, camera=cropped(rig.camera, size_px))
    decode = DecodeSpec(max_epipolar_px=0.0)
    scanner = Scanner(rig=rig, code=code, sensor=QUIET_SENSOR, decode=decode)
    return replace(cell, scene=replace(cell.scene, rig=rig), scanner=scanner)
