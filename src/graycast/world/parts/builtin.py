"""The built-in parts: our counterparts of the paper's five parts, modelled in code.

The origin of each part is the middle of its bounding box. Shapes are modelled in millimetres and
scaled once. A filled package is one solid of uniform density: its mass is right, but its centre of
mass and its moments of inertia assume even filling.
"""

from importlib.resources import files
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int, UInt8
from manifold3d import CrossSection, Manifold
from PIL import Image

from ...base.file_limits import parse_json
from ...base.frames import axis_rotation, rigid
from .normals import crease_normals
from .part import Material, Mesh, Part, Symmetry
from .shapes import PANELS, loft, revolve, rounded_box, solid, superellipse, union

CREASE_RAD = np.radians(35)  # Angle between chamfers (45 deg) and the widest facet step (22.5 deg)
_STEEL_KG_M3 = 7800.0
SALT_BOX_MM = (70.0, 60.0, 145.0)  # outer x, y, z
TOOTHPASTE_MM = (190.0, 38.0, 45.0)

# The ring's half section (r, z) runs counter-clockwise: a flange has a groove in its rim, the hub
# above it is narrower, with a fillet at its foot, and the bore has a counterbore from above.
RING_PROFILE_MM = (
    (15.0, 0.0), (24.2, 0.0), (25.0, 0.8), (25.0, 3.0), (23.5, 3.0), (23.5, 5.0), (25.0, 5.0),
    (25.0, 7.2), (24.2, 8.0), (22.0, 8.0), (21.5, 8.134), (21.134, 8.5), (21.0, 9.0),
    (21.0, 17.2), (20.2, 18.0), (17.6, 18.0), (17.0, 17.4), (17.0, 13.0), (14.6, 13.0),
    (14.0, 12.4), (14.0, 1.0),
)  # fmt: skip
RING_SEGMENTS = 128  # A rim facet is up to 7.5 um inside the circle.


def _mesh(
    vertices_mm: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "f 3"],
    corner_uv: Float[np.ndarray, "f 3 2"] | None = None,
) -> Mesh:
    middle_mm = (vertices_mm.min(axis=0) + vertices_mm.max(axis=0)) / 2
    vertices_m = (vertices_mm - middle_mm) * 1e-3
    return Mesh(
        vertices_m=vertices_m,
        faces=faces,
        corner_uv=corner_uv,
        corner_normals=crease_normals(vertices_m, faces, CREASE_RAD),
    )


def _ring() -> Part:
    """Return a turned steel ring. Its ends differ, so it is symmetric only about its axis."""
    return Part(
        name="metal_workpiece_2",
        mesh=_mesh(*revolve(np.array(RING_PROFILE_MM), RING_SEGMENTS)),
        material=Material(base_color=(0.21, 0.21, 0.215), metallic=1.0, roughness=0.5),
        density_kg_m3=_STEEL_KG_M3,
        friction=0.3,
        symmetry=Symmetry(continuous=(((0.0, 0.0, 1.0), (0.0, 0.0, 0.0)),)),
    )


def _bracket() -> Part:
    """Return a milled steel U bracket, 60 x 40 x 30 mm; half a turn about z leaves it unchanged."""
    body = _extruded_along_y(_u_profile_mm(), 40.0) ^ _chamfered_footprint()
    cuts = Manifold()
    for x in (-12.0, 12.0):  # screw holes in the base, countersunk from above
        hole = Manifold.cylinder(12, 3.3, 3.3, 48).translate((0, 0, -1))
        # The cone extends past the surface, so that no two faces coincide there.
        sink = Manifold.cylinder(3.2, 3.3, 6.5, 48).translate((0, 0, 5.0))
        cuts += (hole + sink).translate((x, 0, 0))
    slot_ends = [Manifold.cylinder(12, 4, 4, 48).translate((0, y, -1)) for y in (-9.0, 9.0)]
    cuts += Manifold.batch_hull(slot_ends)
    # One bore runs through both walls and is chamfered on their outer faces.
    across = Manifold.cylinder(70, 4.5, 4.5, 64, True).rotate((0, 90, 0))
    cone = Manifold.cylinder(3, 4.0, 7.0, 64).translate((0, 0, 28.5)).rotate((0, 90, 0))
    cuts += (across + cone + cone.rotate((0, 0, 180))).translate((0, 0, 19))
    vertices, faces, _ = union({"bracket": body - cuts})
    half_turn = rigid(axis_rotation("z", np.pi), np.zeros(3))
    return Part(
        name="metal_workpiece_1",
        mesh=_mesh(vertices, faces),
        material=Material(base_color=(0.22, 0.22, 0.225), metallic=1.0, roughness=0.5),
        density_kg_m3=_STEEL_KG_M3,
        friction=0.3,
        symmetry=Symmetry(discrete=(half_turn,)),
    )


def _u_profile_mm() -> list[tuple[float, float]]:
    """Return the profile (x, z), counter-clockwise: 1.5 mm chamfers, 3 mm inner fillets."""
    fillet = [(19 + 3 * np.sin(a), 10 - 3 * np.cos(a)) for a in np.pi / 2 * np.arange(7) / 6]
    right = [(28.5, 0.0), (30.0, 1.5), (30.0, 28.5), (28.5, 30.0), (23.5, 30.0), (22.0, 28.5)]
    right += fillet[::-1]
    return right + [(-x, z) for x, z in right[::-1]]


def _extruded_along_y(profile_mm: list[tuple[float, float]], length_mm: float) -> Manifold:
    """Return a profile in x and z, extruded symmetrically about y = 0."""
    block = CrossSection([profile_mm]).extrude(length_mm)
    return block.rotate((90, 0, 0)).translate((0, length_mm / 2, 0))


def _chamfered_footprint() -> Manifold:
    x, y, c = 31.0, 20.0, 4.0  # slightly longer than the bracket, so that no end faces coincide
    corner = [(x, y - c), (x - c, y), (-x + c, y), (-x, y - c)]
    return CrossSection([corner + [(-a, -b) for a, b in corner]]).extrude(40).translate((0, 0, -1))


Region = tuple[float, float, float, float]


def _label(name: str) -> tuple[UInt8[np.ndarray, "h w 3"], dict[str, Region]]:
    """Read a printed label, which `studies/printed_labels.py` drew.

    Returns:
        The label's picture (8-bit sRGB), and the lower left and upper right corner (u0, v0, u1, v1)
        of each panel, v up.
    """
    folder = files(__package__) / "labels"
    with (folder / f"{name}.png").open("rb") as file:
        image = np.array(Image.open(file))
    height, width = image.shape[:2]
    places = parse_json((folder / "panels.json").read_text(encoding="utf-8"))[name]
    return image, {
        panel: (x / width, 1 - (y + h) / height, (x + w) / width, 1 - y / height)
        for panel, (x, y, w, h) in places.items()
    }


def _carton(
    name: str,
    size_mm: tuple[float, float, float],
    label: str,
    *,
    edge_mm: float,
    density_kg_m3: float,
    roughness: float,
) -> Part:
    """Return a printed box with slightly rounded edges; each side has a different print."""
    image, region = _label(label)
    vertices, faces, panel = rounded_box(size_mm, edge_mm, steps=3)
    corner_uv = np.empty((len(faces), 3, 2))
    for side, (_, right, up) in PANELS.items():
        mine = np.array([p == side for p in panel])
        axes = np.array([right, up])
        share = vertices[faces[mine]] @ axes.T / (np.abs(axes) @ np.array(size_mm)) + 0.5
        corner_uv[mine] = _into_region(share, region[side])
    return Part(
        name=name,
        mesh=_mesh(vertices, faces, corner_uv),
        material=Material(texture=image, roughness=roughness),
        density_kg_m3=density_kg_m3,
        friction=0.45,
    )


def _into_region(share: Float[np.ndarray, "*n 2"], region: Region) -> Float[np.ndarray, "*n 2"]:
    """Map positions in a panel (0 to 1, to the right and up) to uv of the whole label."""
    low, high = np.array(region[:2]), np.array(region[2:])
    return low + share * (high - low)


def _salt_box() -> Part:
    """Return a salt box as large as KIT's `yellowsaltcube`, which is not a cube: 61 x 70 x 146 mm.

    Density: 650 g of salt (1.2 kg per litre as poured, the box nine tenths full) and 20 g of
    carton in 0.607 litres.
    """
    return _carton(
        "yellow_salt_cube",
        SALT_BOX_MM,
        "salt_box",
        edge_mm=2.5,
        density_kg_m3=1100.0,
        roughness=0.45,
    )


def _toothpaste() -> Part:
    """Return a toothpaste carton with its long side along x.

    Density: a 100 ml tube (1.3 kg per litre, 10 g of tube) and a 15 g carton in 0.324 litres.
    """
    return _carton(
        "toothpaste",
        TOOTHPASTE_MM,
        "toothpaste",
        edge_mm=1.0,
        density_kg_m3=480.0,
        roughness=0.35,
    )


# The first two are outer sizes along x and y, the third is the height of the neck's lower end.
_SPRAY_BODY_MM = (58.0, 46.0, 128.0)


def _spray() -> Part:
    """Return a trigger spray bottle, its nozzle along +x and the front of its label towards -y.

    Density: 250 g of liquid and 45 g of plastic in the 0.31 litres that the shape encloses.
    """
    body = _spray_body()
    neck_z = _SPRAY_BODY_MM[2]
    rim = Manifold.cylinder(2, 15.5, 13, 64).translate((0, 0, 14))
    collar = Manifold.cylinder(14, 15.5, 15.5, 64) + rim
    head = collar.translate((0, 0, neck_z)) + _spray_head()
    trigger = _chain(
        [(19.0, 158.0), (22.0, 148.0), (26.0, 138.0), (33.0, 129.0)], radius_mm=3.0, width_mm=13.0
    )
    vertices, faces, piece = union({"body": solid(body), "head": head, "trigger": trigger})
    image, region = _label("spray")
    corner = vertices[faces]
    corner_uv = np.empty((len(faces), 3, 2))
    for name in ("head", "trigger"):
        mine = np.array([p == name for p in piece])
        share = (corner[mine][..., [0, 2]] - [-40, 100]) / [100, 100]  # The picture is plain here.
        corner_uv[mine] = _into_region(share, region[name])
    mine = np.array([p == "body" for p in piece])
    corner_uv[mine] = _into_region(_wrap(corner[mine]), region["body"])
    return Part(
        name="hygiene_spray",
        mesh=_mesh(vertices, faces, corner_uv),
        material=Material(texture=image, roughness=0.3),
        density_kg_m3=950.0,
        friction=0.35,
    )


def _spray_body() -> tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]]:
    """Return the lofted body: a rounded foot, straight sides, a shoulder and a neck."""
    half_x, half_y, neck_z = _SPRAY_BODY_MM[0] / 2, _SPRAY_BODY_MM[1] / 2, _SPRAY_BODY_MM[2]
    sections = []
    for a in np.pi / 2 * np.arange(6) / 5:
        inset, z = 5 * (1 - np.sin(a)), 5 * (1 - np.cos(a))
        sections.append((half_x - inset, half_y - inset, 3.2, z))
    for s in np.linspace(0, 1, 15):
        bend = s * s * (3 - 2 * s)
        x, y, n = half_x + (13 - half_x) * bend, half_y + (13 - half_y) * bend, 3.2 - 1.2 * bend
        sections.append((x, y, n, 92 + (neck_z - 92) * s))
    sections.append((13.0, 13.0, 2.0, neck_z + 4))  # This end is inside the collar.
    return loft(np.stack([superellipse(x, y, n, z, 96) for x, y, n, z in sections]))


def _spray_head() -> Manifold:
    def block(low: tuple[int, int, int], high: tuple[int, int, int]) -> list[Manifold]:
        ball = Manifold.sphere(4, 24)
        return [ball.translate((x, y, z)) for x in (low[0] + 4, high[0] - 4)
                for y in (low[1] + 4, high[1] - 4) for z in (low[2] + 4, high[2] - 4)]  # fmt: skip

    rear = block((-21, -11, 149), (4, 11, 172))
    front = block((8, -9, 158), (30, 9, 180))
    stem = Manifold.cylinder(20, 10, 10, 48).translate((0, 0, 138))
    tip = Manifold.cylinder(2, 6, 4.5, 48).translate((0, 0, 10))
    nozzle = Manifold.cylinder(10, 6, 6, 48) + tip
    bore = Manifold.cylinder(3, 1.5, 1.5, 24).translate((0, 0, 10))
    placed = (nozzle - bore).rotate((0, 90, 0)).translate((26, 0, 170))
    return Manifold.batch_hull(rear + front) + stem + placed


def _chain(path_mm: list[tuple[float, float]], *, radius_mm: float, width_mm: float) -> Manifold:
    """Return a round-edged strip along a path in x and z, `width_mm` wide in y."""
    rod = Manifold.cylinder(width_mm, radius_mm, radius_mm, 24, True).rotate((90, 0, 0))
    rods = [rod.translate((x, 0, z)) for x, z in path_mm]
    links = [Manifold.batch_hull(list(pair)) for pair in pairwise(rods)]
    return links[0] + links[1] + links[2]


def _wrap(corner_mm: Float[np.ndarray, "f 3 3"]) -> Float[np.ndarray, "f 3 2"]:
    """Return the position on the wrapped label, 0 to 1: arc length from the seam at +y, and height.

    The arc length is measured on the widest section, at the same polar angle. Seen from above it
    runs counter-clockwise, so a reader in front sees it run from left to right.
    """
    half_x, half_y, height = _SPRAY_BODY_MM[0] / 2, _SPRAY_BODY_MM[1] / 2, _SPRAY_BODY_MM[2]
    outline = superellipse(half_x, half_y, 3.2, 0.0, 960)[:, :2]
    step = np.linalg.norm(np.roll(outline, -1, axis=0) - outline, axis=1)
    arc = np.concatenate([[0], np.cumsum(step)]) / step.sum()
    turn = np.unwrap(np.arctan2(outline[:, 1], outline[:, 0])) / (2 * np.pi) - 0.25
    angle = np.arctan2(corner_mm[..., 1], corner_mm[..., 0]) / (2 * np.pi) - 0.25
    angle = angle % 1.0
    # A face that ends on the seam has corners at 0 and at 1, so move them to one side.
    wide = np.ptp(angle, axis=1, keepdims=True) > 0.5
    angle = np.where(wide & (angle < 0.5), angle + 1, angle)
    u = np.interp(angle % 1.0, np.append(turn, 1.0), arc) + np.floor(angle)
    u = u - np.floor(u.mean(axis=1, keepdims=True))
    wrapped = np.stack([u, np.clip(corner_mm[..., 2] / height, 0, 1)], axis=-1)
    # The flat bottom cannot be wrapped, so it shows the plain plastic below the print.
    flat = np.all(corner_mm[..., 2] < 1e-6, axis=1)[:, None, None]
    return np.where(flat, np.array([0.5, 0.06]) + corner_mm[..., :2] / 1000, wrapped)


_MAKERS = {
    "metal_workpiece_1": _bracket,
    "metal_workpiece_2": _ring,
    "yellow_salt_cube": _salt_box,
    "hygiene_spray": _spray,
    "toothpaste": _toothpaste,
}
BUILTIN: tuple[str, ...] = tuple(_MAKERS)


def builtin_part(name: str) -> Part:
    """Return the built-in part with this name.

    Raises:
        ValueError: the name is not in `BUILTIN`.
    """
    if name not in _MAKERS:
        raise ValueError(f"no built-in part {name!r}: choose one of {', '.join(BUILTIN)}")
    return _MAKERS[name]()
