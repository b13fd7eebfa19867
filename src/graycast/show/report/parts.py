"""Parts as a picture and as a table."""

from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from matplotlib.figure import Figure

from ...base.color import srgb
from ...base.frames import inverse, look_at, rigid, transform_points
from ...base.plotting import save_png
from ...rendering import Quality, Renderer
from ...rendering.denoise import denoise
from ...rig.optics import pinhole
from ...rig.pair import Rig
from ...world.parts import Material, Mesh, Part, Symmetry, mass_text, size_text
from ...world.scene import Environment, Lamp, Layout, Quad, Scene
from .preview import DPI, pixel_axes

_TILE_PX = (480, 360)
_FOCAL_PX = 900.0  # The field of 30 degrees gives little perspective, as in a catalogue.
_FILL = 0.86  # share of the tile's height or width that a part fills
_FROM = np.array([0.50, -0.80, 0.55])  # direction to the camera: in front, on the right and above
_GAP_PX, _HEAD_PX, _WORDS_PX = 24, 72, 104
_FLOOR = Material(base_color=(0.5, 0.5, 0.5), specular=0.0)
_WHITE_LEVEL = 0.55  # radiance [W sr^-1 m^-2] that the picture shows as white


def describe_parts(parts: tuple[Part, ...]) -> str:
    """Return a table for the terminal: a header, and a line for each part (mm, g or kg)."""
    head = ("part", "size [mm]", "mass", "faces", "material", "symmetries", "source")
    rows = [head] + [
        (
            part.name,
            size_text(part),
            mass_text(part),
            f"{len(part.mesh.faces)}",
            _material_words(part.material),
            _symmetry_words(part.symmetry),
            part.source,
        )
        for part in parts
    ]
    width = [max(map(len, column)) for column in zip(*rows, strict=True)]
    numeric = (False, True, True, True, False, False, False)
    lines = []
    for row in rows:
        cells = zip(row, width, numeric, strict=True)
        lines.append("  ".join(c.rjust(w) if right else c.ljust(w) for c, w, right in cells))
    return "\n".join(line.rstrip() for line in lines)


def draw_parts(
    parts: tuple[Part, ...], path: Path, *, renderer: Renderer, samples: int = 32
) -> None:
    """Write a PNG with a tile for each part on a grey floor, and with the part's figures below it.

    All parts have the same light and exposure, so their brightness can be compared. Each scene is
    scaled to its part, so sizes cannot be compared. The z axis of the part's frame points up.

    Args:
        path: the PNG file, which is written completely or not at all.
        renderer: an open renderer.
        samples: light paths per pixel.

    Raises:
        GraycastError: the file cannot be written.
        ValueError: there are no parts.
    """
    if not parts:
        raise ValueError("no parts are given: give at least one")
    columns = min(len(parts), 3 if len(parts) <= 6 else 5)
    rows = -(-len(parts) // columns)
    width, height = _TILE_PX
    step_x, step_y = width + _GAP_PX, height + _WORDS_PX + _GAP_PX
    sheet_px = (_GAP_PX + columns * step_x, _HEAD_PX + rows * step_y)
    figure = Figure(figsize=(sheet_px[0] / DPI, sheet_px[1] / DPI), dpi=DPI, facecolor="white")
    title = f"{len(parts)} part{'s' if len(parts) > 1 else ''}"
    figure.text(_GAP_PX / sheet_px[0], 1 - 36 / sheet_px[1], title, fontsize=15, weight="bold",
                va="center")  # fmt: skip
    for index, part in enumerate(parts):
        row, column = divmod(index, columns)
        left, top = _GAP_PX + column * step_x, _HEAD_PX + row * step_y
        ax = pixel_axes(figure, left, top, width, height)
        ax.imshow(_portrait(part, renderer=renderer, samples=samples), interpolation="nearest")
        ax.set_axis_off()
        text = "\n".join(
            [
                f"{size_text(part)} mm    {mass_text(part)}    {len(part.mesh.faces)} faces",
                _material_words(part.material),
                f"symmetries: {_symmetry_words(part.symmetry)}",
            ]
        )
        ax.annotate(part.name, (0, 0), (0, -8), xycoords="axes fraction",
                    textcoords="offset pixels", va="top", fontsize=11, weight="bold")  # fmt: skip
        ax.annotate(text, (0, 0), (0, -32), xycoords="axes fraction",
                    textcoords="offset pixels", va="top", fontsize=9, linespacing=1.4,
                    color="0.25")  # fmt: skip
    save_png(figure, path, dpi=DPI)


# --- picture -----------------------------------------------------------------------------------


def _portrait(part: Part, *, renderer: Renderer, samples: int) -> UInt8[np.ndarray, "h w 3"]:
    scene, layout = portrait_scene(part)
    rendering = renderer.render(
        scene,
        layout,
        np.zeros((1, 2, 2), dtype=np.uint8),  # a dark projector
        quality=Quality(samples=samples, depth=4),
        seed=0,
    )
    radiance = rendering.radiance
    clean = denoise(
        radiance.ambient_rgb, radiance.albedo, rendering.truth.normal, renderer.denoiser
    )
    return srgb(clean / _WHITE_LEVEL)


def portrait_scene(part: Part) -> tuple[Scene, Layout]:
    """Return a scene with a part on a floor under two lamps; the part fills the picture."""
    low, high = part.mesh.bounds_m
    middle = (low + high) / 2
    size_m = float(np.linalg.norm(high - low))
    # The centre of the part moves to the world's origin; the floor touches the lowest point.
    layout = Layout(
        T_world_part=rigid(np.eye(3), -middle)[None], part_index=np.zeros(1, dtype=np.int64)
    )
    towards = _FROM / np.linalg.norm(_FROM)
    T_world_cam = look_at(
        towards * _filling_distance_m(part.mesh, towards), np.zeros(3), np.array([0.0, 0.0, -1.0])
    )
    wide = 40 * size_m
    floor = Quad(
        center_m=(0.0, 0.0, float(low[2] - middle[2])),
        half_u_m=(wide, 0.0, 0.0),
        half_v_m=(0.0, wide, 0.0),
        material=_FLOOR,
    )
    return Scene(
        rig=_rig(),
        T_world_cam=T_world_cam,
        parts=(part,),
        surfaces=(floor,),
        environment=Environment(radiance=(0.25, 0.26, 0.28)),
        lamps=(
            _lamp((-1.4, -1.2, 2.4), size_m, share=1.6, radiance=4.5),
            _lamp((1.2, 2.6, 1.5), size_m, share=1.6, radiance=3.0),
        ),
    ), layout


def _lamp(at: tuple[float, float, float], size_m: float, *, share: float, radiance: float) -> Lamp:
    """Return a lamp whose position and size scale with the part, so all parts are lit equally."""
    x, y, z = (size_m * a for a in at)
    return Lamp(center_m=(x, y, z), size_m=share * size_m, radiance=(radiance,) * 3)


def _filling_distance_m(mesh: Mesh, towards: Float[np.ndarray, "3"]) -> float:
    """Return the distance of the camera from the part's centre at which the part fills the tile.

    With a camera at the centre, a vertex is at (x, y, z). After the camera has moved back by d, the
    vertex appears at f x / (z + d). Hence each vertex needs d >= f |x| / limit - z; the same for y.
    """
    T_middle_cam = look_at(np.zeros(3), -towards, np.array([0.0, 0.0, -1.0]))
    point = mesh.vertices_m[np.unique(mesh.faces)] - mesh.bounds_m.mean(axis=0)
    point_eye = transform_points(inverse(T_middle_cam), point)
    limit_px = 0.5 * _FILL * np.array(_TILE_PX)
    needed = _FOCAL_PX * np.abs(point_eye[:, :2]) / limit_px - point_eye[:, 2:]
    return float(needed.max())


def _rig() -> Rig:
    return Rig(
        name="portrait",
        camera=pinhole(*_TILE_PX, _FOCAL_PX),
        projector=pinhole(2, 2, 2.0),
        T_cam_proj=rigid(np.eye(3), np.array([0.1, 0.0, 0.0])),
        near_m=0.01,
        far_m=100.0,
    )


# --- words -------------------------------------------------------------------------------------


def _material_words(material: Material) -> str:
    if material.transparent is not None:
        kind = f"{material.transparent} glass of index {material.ior:.3f}"
    elif material.metallic == 1:
        kind = "metal"
    elif material.metallic > 0:
        kind = f"{100 * material.metallic:.0f} % metal"
    else:
        kind = "dielectric" if material.specular > 0 else "Lambertian"
    if material.texture is None:
        colour = "colour " + " ".join(f"{c:.2g}" for c in material.base_color)
    else:
        colour = f"texture {material.texture.shape[1]} x {material.texture.shape[0]}"
    smooth = kind == "Lambertian" or material.transparent is not None
    shine = "" if smooth else f", roughness {material.roughness:g}"
    if material.roughness_map is not None and shine:
        shine += " times a map {1} x {0}".format(*material.roughness_map.shape)
    if material.film is not None:
        shine += f", under a film of roughness {material.film:g}"
    if material.diffuse > 0:
        shine += f", {100 * material.diffuse:.0f} % scattered"
    if material.mottle > 0:
        length_mm = 1e3 * material.mottle_length_m
        shine += f", mottled by {100 * material.mottle:.0f} % over {length_mm:g} mm"
    if (grain := material.grooves) is not None:
        way = "turned about" if grain.turned else "brushed along"
        shine += f", {way} {_axis_words(grain.axis)} ({material.anisotropy:g})"
    return f"{kind}, {colour}{shine}"


def _symmetry_words(symmetry: Symmetry) -> str:
    words = [f"any turn about {_axis_words(axis)}" for axis, _ in symmetry.continuous]
    if symmetry.discrete:
        poses = len(symmetry.discrete) + 1
        words.append(f"{poses} equivalent poses")
    return ", ".join(words) or "none"


def _axis_words(axis: tuple[float, float, float]) -> str:
    for name, unit in zip("xyz", np.eye(3), strict=True):
        if np.allclose(np.abs(axis), unit):
            return name
    return "({:.3g}, {:.3g}, {:.3g})".format(*axis)
