"""A zoo of parts that are typical for bins, modelled in code with standard dimensions.

A drop that works for the five built-in parts may fail for a bolt, so the zoo has a part of each
common family. Meshes are closed, their faces are counter-clockwise seen from outside, and the
middle of the bounding box is the origin. Shapes are modelled in millimetres and then scaled; a full
turn has 48 facets.

Leaves out: threads (a shank is a cylinder of the nominal diameter, and the bore of a nut has the
inner diameter of the thread), and symmetries, which a drop does not need.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from manifold3d import CrossSection, Manifold

from graycast.world.parts import BUILTIN, Material, Mesh, Part, builtin_part
from graycast.world.parts.builtin import CREASE_RAD
from graycast.world.parts.normals import crease_normals
from graycast.world.parts.shapes import loft, revolve, solid

SEGMENTS = 48  # per full turn; the facets of an 8 mm shank are up to 9 um inside its circle
WIRE_SEGMENTS = 24  # around the cross-section of a wire or a cord

_STEEL = Material(base_color=(0.45, 0.45, 0.46), metallic=1.0, roughness=0.4)
_BRASS = Material(base_color=(0.55, 0.42, 0.2), metallic=1.0, roughness=0.35)
_COPPER = Material(base_color=(0.6, 0.33, 0.22), metallic=1.0, roughness=0.35)
_RUBBER = Material(base_color=(0.04, 0.04, 0.04), roughness=0.6)
_PLASTIC = Material(base_color=(0.12, 0.25, 0.5), roughness=0.4)
_CARD = Material(base_color=(0.5, 0.36, 0.22), roughness=0.8, specular=0.2)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Family:
    """The shape [mm] of a part and its material properties."""

    shape: Callable[[], Manifold]
    density_kg_m3: float = 7800.0
    friction: float = 0.3
    material: Material = _STEEL


def zoo_part(name: str) -> Part:
    """Return the part of a family of `ZOO`.

    Raises:
        ValueError: the name is not in `ZOO`.
    """
    if name in BUILTIN:
        return builtin_part(name)
    if name not in _FAMILIES:
        raise ValueError(f"the zoo has no part {name!r}: choose one of {', '.join(ZOO)}")
    family = _FAMILIES[name]
    mesh = family.shape().to_mesh64()
    vertices_mm = np.array(mesh.vert_properties[:, :3], dtype=np.float64)
    middle_mm = (vertices_mm.min(axis=0) + vertices_mm.max(axis=0)) / 2
    vertices_m = (vertices_mm - middle_mm) * 1e-3
    faces = np.asarray(mesh.tri_verts).astype(np.int64)
    return Part(
        name=name,
        mesh=Mesh(
            vertices_m=vertices_m,
            faces=faces,
            corner_normals=crease_normals(vertices_m, faces, CREASE_RAD),
        ),
        material=family.material,
        density_kg_m3=family.density_kg_m3,
        friction=family.friction,
        source="zoo",
    )


def wavy_ring(faces: int) -> Mesh:
    """Return a smooth ring of about `faces` faces, 56 mm wide, with waves of 1 mm."""
    turn = np.linspace(0, 2 * np.pi, int(np.sqrt(faces / 3.4)), endpoint=False)
    section_m = np.stack([0.02 + 0.008 * np.cos(turn), 0.008 * np.sin(turn)], axis=1)
    vertices_m, triangles = revolve(section_m, int(1.7 * len(turn)))
    waves = 1 + 0.02 * np.sin(400 * vertices_m[:, [1, 2, 0]])
    return Mesh(vertices_m=vertices_m * waves, faces=triangles)


# --- elements of shapes --------------------------------------------------------------------------


def _turned(profile_mm: list[tuple[float | int, float | int]]) -> Manifold:
    """Revolve a closed, counter-clockwise profile (r, z) [mm] around the z axis."""
    return CrossSection([profile_mm]).revolve(SEGMENTS)


def _hexagon(width_mm: float, height_mm: float) -> Manifold:
    """Return a hexagonal prism on z = 0 with `width_mm` across flats."""
    corner_mm = width_mm / np.sqrt(3)
    return Manifold.cylinder(height_mm, corner_mm, corner_mm, 6)


def _bore(diameter_mm: float, height_mm: float) -> Manifold:
    """Return a cylinder on z = 0, to be subtracted from a part."""
    return Manifold.cylinder(height_mm, diameter_mm / 2, diameter_mm / 2, SEGMENTS)


def _rod(path_mm: Float[np.ndarray, "n 3"], diameter_mm: float, segments: int) -> Manifold:
    """Return a round wire along a path, with flat ends normal to the path.

    Its cross-section does not rotate about the path (Bishop frame).
    """
    step = np.diff(path_mm, axis=0)
    step /= np.linalg.norm(step, axis=1, keepdims=True)
    along = np.vstack([step[:1], step[:-1] + step[1:], step[-1:]])
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    side = np.cross(along[0], np.eye(3)[np.abs(along[0]).argmin()])
    angle = 2 * np.pi * np.arange(segments) / segments
    sections = []
    for point, forward in zip(path_mm, along, strict=True):
        side = side - (side @ forward) * forward
        side /= np.linalg.norm(side)
        other = np.cross(forward, side)
        round_mm = np.outer(np.cos(angle), side) + np.outer(np.sin(angle), other)
        sections.append(point + diameter_mm / 2 * round_mm)
    return solid(loft(np.stack(sections)))


def _arc(
    center_mm: tuple[float, float], radius_mm: float, from_deg: float, to_deg: float
) -> Float[np.ndarray, "n 3"]:
    """Return points of an arc in the plane y = 0; angles are measured from x to z."""
    steps = int(np.ceil(abs(to_deg - from_deg) / 360 * SEGMENTS))
    turn = np.radians(np.linspace(from_deg, to_deg, steps + 1))
    x, z = center_mm[0] + radius_mm * np.cos(turn), center_mm[1] + radius_mm * np.sin(turn)
    return np.stack([x, 0 * x, z], axis=1)


# --- fasteners -----------------------------------------------------------------------------------


def _hex_bolt() -> Manifold:
    """Return ISO 4017 M8 x 25: 13 mm across flats, head 5.3 mm, end chamfered by 1.25 mm."""
    shank = _turned([(0, -25), (2.75, -25), (4, -23.75), (4, 1), (0, 1)])
    return _hexagon(13.0, 5.3) + shank


def _socket_screw() -> Manifold:
    """Return ISO 4762 M3 x 10: head 5.5 x 3 mm, socket 2.5 mm wide and 1.3 mm deep."""
    body = [(0, -10), (1.1, -10), (1.5, -9.6), (1.5, 0), (2.75, 0), (2.75, 2.7), (2.45, 3), (0, 3)]
    return _turned(body) - _hexagon(2.5, 2.0).translate((0, 0, 1.7))


def _countersunk_screw() -> Manifold:
    """Return ISO 10642 M4 x 16: head 8 mm with a cone of 90 degrees, socket 2.5 mm, 1.5 mm deep."""
    body = [(0, -16), (1.6, -16), (2, -15.6), (2, -2.3), (4, -0.3), (4, 0), (0, 0)]
    return _turned(body) - _hexagon(2.5, 2.0).translate((0, 0, -1.5))


def _rivet() -> Manifold:
    """Return DIN 660 4 x 10: a domed head 7 mm wide and 2.4 mm high, a shank of 10 mm."""
    radius = (3.5**2 + 2.4**2) / (2 * 2.4)  # radius of the sphere of the dome
    rise = np.arcsin((radius - 2.4) / radius)
    turn = np.linspace(rise, np.pi / 2, 13)
    dome = np.stack([radius * np.cos(turn), 2.4 - radius + radius * np.sin(turn)], axis=1)
    dome[-1, 0] = 0.0
    return _turned([(0, -10), (2, -10), (2, 0), *map(tuple, dome.tolist())])


def _nut() -> Manifold:
    """Return ISO 4032 M8: 13 mm across flats, 6.8 mm high, corners chamfered at 30 degrees."""
    far, drop = 9.0, (9.0 - 6.5) * np.tan(np.radians(30))  # The cones begin at the flats.
    cones = [(0, 0), (6.5, 0), (far, drop), (far, 6.8 - drop), (6.5, 6.8), (0, 6.8)]
    return (_hexagon(13.0, 6.8) ^ _turned(cones)) - _bore(6.647, 8.0).translate((0, 0, -0.5))


def _washer() -> Manifold:
    """Return ISO 7089 M8: 16 mm wide, 1.6 mm thick, a hole of 8.4 mm."""
    return _turned([(4.2, 0), (8, 0), (8, 1.6), (4.2, 1.6)])


def _pin() -> Manifold:
    """Return a cylindrical pin of 6 x 30 mm, both ends chamfered by 0.8 mm."""
    return _turned([(0, 0), (2.2, 0), (3, 0.8), (3, 29.2), (2.2, 30), (0, 30)])


def _ball() -> Manifold:
    """Return a ball with a diameter of 20 mm."""
    return Manifold.sphere(10, SEGMENTS)


# --- rings, pipes, wires -------------------------------------------------------------------------


def _torus(radius_mm: float, cord_mm: float) -> Manifold:
    cord = CrossSection.circle(cord_mm / 2, WIRE_SEGMENTS).translate((radius_mm, 0))
    return cord.revolve(SEGMENTS)


def _o_ring() -> Manifold:
    """Return an O-ring with an inner diameter of 30 mm and a cord of 3.5 mm."""
    return _torus(15.0 + 1.75, 3.5)


def _tube() -> Manifold:
    """Return a tube with an outer diameter of 20 mm, a wall of 2 mm and a length of 60 mm."""
    return _turned([(8, 0), (10, 0), (10, 60), (8, 60)])


def _elbow() -> Manifold:
    """Return a pipe of 22 x 1.5 mm, bent by 90 degrees with a radius of 27 mm, with 12 mm ends."""
    bend = _arc((0.0, 0.0), 27.0, 0.0, 90.0)

    def pipe(diameter_mm: float, end_mm: float) -> Manifold:
        first, last = np.array([[27.0, 0, -end_mm]]), np.array([[-end_mm, 0, 27.0]])
        return _rod(np.vstack([first, bend, last]), diameter_mm, SEGMENTS)

    return pipe(22.0, 12.0) - pipe(19.0, 13.0)


def _tee() -> Manifold:
    """Return a pipe of 22 x 2 mm, 60 mm long, with a branch that ends 30 mm from its axis."""

    def pipe(diameter_mm: float, more_mm: float) -> Manifold:
        run = _bore(diameter_mm, 60.0 + 2.0 * more_mm).translate((0, 0, -30 - more_mm))
        return run.rotate((0, 90, 0)) + _bore(diameter_mm, 30.0 + more_mm)

    return pipe(22.0, 0.0) - pipe(18.0, 1.0)


def _spring() -> Manifold:
    """Return a compression spring: wire 1.5 mm, outer diameter 15 mm, length 40 mm, 8 turns.

    The first and last turn are closed: they rise by 1.55 mm, so that turns do not touch.
    """
    turn = np.linspace(0, 8, 8 * SEGMENTS + 1)
    height = np.interp(turn, [0, 1, 7, 8], [0, 1.55, 36.95, 38.5])
    path = np.stack([np.cos(2 * np.pi * turn), np.sin(2 * np.pi * turn)], axis=1) * 6.75
    return _rod(np.column_stack([path, height]), 1.5, 16)


def _hook() -> Manifold:
    """Return an S of 4 mm wire: two arcs of 240 degrees (radius 10 mm) and a straight wire."""
    upper, lower = _arc((10.0, 12.0), 10.0, -60.0, 180.0), _arc((-10.0, -12.0), 10.0, 0.0, -240.0)
    return _rod(np.vstack([upper, lower]), 4.0, WIRE_SEGMENTS)


def _chain() -> Manifold:
    """Return four linked rings of 2.5 mm wire with a radius of 8 mm, as one rigid part."""
    ring = _torus(8.0, 2.5)
    rings = [ring.rotate((90 * (i % 2), 0, 0)).translate((12.0 * i, 0, 0)) for i in range(4)]
    return Manifold.compose(rings)


# --- sheet, gears, plastics ----------------------------------------------------------------------


def _sheet_bracket() -> Manifold:
    """Return an L of 2 mm sheet, 40 x 30 mm and 30 mm wide, with two 5 mm bores in each leg."""
    turn = np.radians(np.linspace(270, 180, SEGMENTS // 4 + 1))
    inner = np.stack([4 + 2 * np.cos(turn), 4 + 2 * np.sin(turn)], axis=1)
    outer = np.stack([4 + 4 * np.cos(turn), 4 + 4 * np.sin(turn)], axis=1)
    outline = [*outer[::-1].tolist(), [40, 0], [40, 2], *inner.tolist(), [2, 30], [0, 30]]
    sheet = CrossSection([outline]).extrude(30).rotate((90, 0, 0)).translate((0, 15, 0))
    bores = Manifold()
    for y in (-8, 8):
        bores += _bore(5.0, 4.0).translate((28, y, -1))
        bores += _bore(5.0, 4.0).rotate((0, 90, 0)).translate((-1, y, 20))
    return sheet - bores


def _gear() -> Manifold:
    """Return a spur gear: module 2 mm, 20 teeth, pressure angle 20 degrees, width 15, bore 12 mm.

    Flanks are involutes of the base circle, and radial below it; the root has no fillet.
    """
    teeth, pitch_mm, tip_mm, root_mm = 20, 20.0, 22.0, 17.5
    base_mm = pitch_mm * np.cos(np.radians(20))
    radius = np.concatenate([[root_mm], np.linspace(base_mm, tip_mm, 9)])

    def involute(r: Float[np.ndarray, " _"]) -> Float[np.ndarray, " _"]:
        pressure = np.arccos(np.minimum(1, base_mm / r))
        return np.tan(pressure) - pressure

    half_rad = np.pi / (2 * teeth) + involute(np.array([pitch_mm])) - involute(radius)
    angle = np.concatenate([-half_rad, half_rad[::-1]])
    reach = np.concatenate([radius, radius[::-1]])
    angle = (angle + 2 * np.pi * np.arange(teeth)[:, None] / teeth).ravel()
    reach = np.tile(reach, teeth)
    outline = np.stack([reach * np.cos(angle), reach * np.sin(angle)], axis=1)
    return CrossSection([outline.tolist()]).extrude(15) - _bore(12.0, 17.0).translate((0, 0, -1))


def _shaft() -> Manifold:
    """Return a shaft of 120 mm with diameters of 12, 20, 25 and 16 mm, chamfered at both ends."""
    return _turned([(0, 0), (5, 0), (6, 1), (6, 20), (10, 20), (10, 50), (12.5, 50), (12.5, 90),
                    (8, 90), (8, 119), (7, 120), (0, 120)])  # fmt: skip


def _cable_clip() -> Manifold:
    """Return a C of 12 x 2 mm, open upwards by 80 degrees, on a 24 x 2 mm foot with a 4 mm bore."""
    turn = np.radians(np.linspace(130, 410, SEGMENTS + 1))
    arc = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    ring = CrossSection([[*(6 * arc).tolist(), *(4 * arc[::-1]).tolist()]]).translate((0, 5))
    foot = CrossSection([[(-6, -2), (18, -2), (18, 0), (-6, 0)]])
    body = (ring + foot).extrude(10).rotate((90, 0, 0)).translate((0, 5, 0))
    return body - _bore(4.0, 4.0).translate((12, 0, -3))


def _bottle() -> Manifold:
    """Return a full bottle, 60 mm wide and 160 mm high, with a shoulder and a neck of 26 mm."""
    foot = [(26 + 4 * np.sin(a), 4 - 4 * np.cos(a)) for a in np.linspace(0, np.pi / 2, 6)]
    rise = np.linspace(0, 1, 13)
    shoulder = [(30 - 17 * (s * s * (3 - 2 * s)), 95 + 35 * s) for s in rise]
    return _turned([(0, 0), *foot, *shoulder, (13, 158), (11, 160), (0, 160)])


def _carton() -> Manifold:
    return Manifold.cube((120, 60, 40))


_FAMILIES = {
    "hex_bolt": _Family(shape=_hex_bolt),
    "socket_screw": _Family(shape=_socket_screw),
    "countersunk_screw": _Family(shape=_countersunk_screw),
    "rivet": _Family(shape=_rivet, density_kg_m3=2700.0),
    "nut": _Family(shape=_nut),
    "washer": _Family(shape=_washer),
    "pin": _Family(shape=_pin),
    "ball": _Family(shape=_ball, friction=0.2),
    "o_ring": _Family(shape=_o_ring, density_kg_m3=1200.0, friction=0.7, material=_RUBBER),
    "tube": _Family(shape=_tube),
    "elbow": _Family(shape=_elbow, density_kg_m3=8900.0, material=_COPPER),
    "tee": _Family(shape=_tee, density_kg_m3=8500.0, material=_BRASS),
    "spring": _Family(shape=_spring),
    "sheet_bracket": _Family(shape=_sheet_bracket),
    "gear": _Family(shape=_gear),
    "shaft": _Family(shape=_shaft),
    "hook": _Family(shape=_hook),
    "chain": _Family(shape=_chain),
    "cable_clip": _Family(
        shape=_cable_clip, density_kg_m3=1100.0, friction=0.35, material=_PLASTIC
    ),
    "bottle": _Family(shape=_bottle, density_kg_m3=950.0, friction=0.35, material=_PLASTIC),
    "carton": _Family(shape=_carton, density_kg_m3=400.0, friction=0.45, material=_CARD),
}
ZOO: tuple[str, ...] = (*_FAMILIES, *BUILTIN)
