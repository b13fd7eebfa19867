"""Volumes of the zoo's parts, compared with closed forms or integrals of the true shapes [mm^3]."""

import numpy as np
import pytest
import trimesh
from scipy.integrate import quad

from benchmarks.zoo_parts import SEGMENTS, WIRE_SEGMENTS, ZOO, zoo_part
from graycast.world.parts import BUILTIN

# Area of an inscribed polygon of n corners, as a share of the circle's.
ROUND, WIRE, SPRING_WIRE = (np.sinc(2 / n) for n in (SEGMENTS, WIRE_SEGMENTS, 16))
HEXAGON = np.sqrt(3) / 2  # area over the width across flats, squared


def body(name):
    part = zoo_part(name)
    return trimesh.Trimesh(1e3 * part.mesh.vertices_m, part.mesh.faces, process=False)


def disc(diameter, height):
    return np.pi / 4 * diameter**2 * height


def cone(bottom, top, height):
    """Return the volume of a frustum between two diameters."""
    return np.pi / 12 * (bottom**2 + bottom * top + top**2) * height


def torus(radius, cord):
    return 2 * np.pi * radius * np.pi / 4 * cord**2


def nut():
    """Integrate 12 sectors from flat to corner; the height falls beyond the flats' circle."""

    def height(r):
        return 6.8 - 2 * np.tan(np.pi / 6) * max(0.0, r - 6.5)

    def sector(angle):
        return quad(lambda r: r * height(r), 0, 6.5 / np.cos(angle), points=[6.5])[0]

    return 12 * quad(sector, 0, np.pi / 6)[0] - ROUND * disc(6.647, 6.8)


def gear():
    """Integrate the width of 20 teeth over the radius, and add the disc below them."""
    base = 20 * np.cos(np.radians(20))

    def involute(r):
        pressure = np.arccos(min(1.0, base / r))
        return np.tan(pressure) - pressure

    def width(r):
        return 2 * r * (np.pi / 40 + involute(20.0) - involute(r))

    teeth = 20 * quad(width, 17.5, 22, points=[base])[0]
    return 15 * (np.pi * 17.5**2 + teeth) - ROUND * disc(12, 15)


def bottle():
    """Integrate discs over the height, with the exact curves of the outline."""
    foot = quad(lambda z: (26 + np.sqrt(16 - (4 - z) ** 2)) ** 2, 0, 4)[0]
    shoulder = quad(lambda s: 35 * (30 - 17 * s * s * (3 - 2 * s)) ** 2, 0, 1)[0]
    straight = 30**2 * 91 + 13**2 * 28
    return ROUND * (np.pi * (foot + straight + shoulder) + cone(26, 22, 2))


def clip():
    """Return the volume; the ring and the foot overlap by 1 mm, which counts once."""
    overlap = 36 * np.arccos(5 / 6) - 5 * np.sqrt(36 - 25)
    ring = np.radians(280) / 2 * (6**2 - 4**2)
    return 10 * (ring + 24 * 2 - overlap) - ROUND * disc(4, 2)


def spring_wire_mm():
    """Return the length of three helices; a turn rises by 1.55, 5.9 and 1.55 mm."""
    girth = 2 * np.pi * 6.75
    return 2 * np.hypot(girth, 1.55) + 6 * np.hypot(girth, 35.4 / 6)


# Volume, and the relative error of facets that is allowed besides that of `ROUND` and `WIRE`.
EXPECTED = {
    "hex_bolt": (HEXAGON * 13**2 * 5.3 + ROUND * (disc(8, 23.75) + cone(5.5, 8, 1.25)), 1e-9),
    "socket_screw": (
        ROUND * (disc(3, 9.6) + cone(2.2, 3, 0.4) + disc(5.5, 2.7) + cone(5.5, 4.9, 0.3))
        - HEXAGON * 2.5**2 * 1.3,
        1e-9,
    ),
    "countersunk_screw": (
        ROUND * (cone(3.2, 4, 0.4) + disc(4, 13.3) + cone(4, 8, 2) + disc(8, 0.3))
        - HEXAGON * 2.5**2 * 1.5,
        1e-9,
    ),
    # The cap of a sphere: pi h (3 a^2 + h^2) / 6, its meridian in 12 chords of 5.7 degrees.
    "rivet": (ROUND * (disc(4, 10) + np.pi * 2.4 * (3 * 3.5**2 + 2.4**2) / 6), 3e-3),
    "nut": (nut(), 2e-3),  # the cones of 48 facets cut a little more off the corners
    "washer": (ROUND * (disc(16, 1.6) - disc(8.4, 1.6)), 1e-9),
    "pin": (ROUND * (disc(6, 28.4) + 2 * cone(4.4, 6, 0.8)), 1e-9),
    "ball": (4 / 3 * np.pi * 10**3, 2 * (1 - ROUND) * 2),  # chords both ways, octahedral facets
    "o_ring": (WIRE * ROUND * torus(16.75, 3.5), 1e-9),
    "tube": (ROUND * (disc(20, 60) - disc(16, 60)), 1e-9),
    "elbow": (ROUND * (disc(22, 1) - disc(19, 1)) * (24 + np.pi / 2 * 27), 3e-3),
    # Cylinders of one diameter share half of Steinmetz's solid, 16/3 r^3, with the half branch.
    "tee": (ROUND * (disc(22, 90) - disc(18, 90)) - 8 / 3 * (11**3 - 9**3), 5e-3),
    "spring": (SPRING_WIRE * disc(1.5, spring_wire_mm()), 4e-3),
    "sheet_bracket": (
        30 * 2 * (36 + 26 + np.pi / 2 * 3) - ROUND * 4 * disc(5, 2),
        1e-3,
    ),
    "gear": (gear(), 2e-3),  # flanks in 8 chords, tips and roots as chords
    "shaft": (
        ROUND * (disc(12, 19) + disc(20, 30) + disc(25, 40) + disc(16, 29))
        + ROUND * (cone(10, 12, 1) + cone(16, 14, 1)),
        1e-9,
    ),
    "hook": (WIRE * disc(4, 2 * np.radians(240) * 10 + 24), 3e-3),
    "chain": (4 * WIRE * ROUND * torus(8, 2.5), 1e-9),
    "cable_clip": (clip(), 2e-3),
    "bottle": (bottle(), 1e-3),
    "carton": (120 * 60 * 40, 1e-9),
}


def test_every_family_of_the_zoo_has_a_reference_volume():
    assert ZOO == (*EXPECTED, *BUILTIN)
    with pytest.raises(ValueError, match=r"'bolt'.*hex_bolt.*toothpaste"):
        zoo_part("bolt")


@pytest.mark.parametrize("name", EXPECTED)
def test_a_part_of_the_zoo_is_closed_and_has_the_volume_of_its_dimensions(name):
    mesh = body(name)
    assert mesh.is_watertight and mesh.is_winding_consistent
    assert mesh.body_count == (4 if name == "chain" else 1)
    assert np.abs(mesh.bounds.sum(axis=0)).max() < 1e-9
    volume, share = EXPECTED[name]
    assert mesh.volume == pytest.approx(volume, rel=share)


@pytest.mark.slow
def test_the_rings_of_the_chain_are_linked_and_do_not_touch():
    """The distance between circles is sampled. Gauss's linking number is 1 if two are linked."""
    angle = 2 * np.pi * np.arange(400) / 400
    flat, zero = [8 * np.cos(angle), 8 * np.sin(angle)], 0 * angle
    rings = [
        np.stack([flat[0] + 12 * i, *((flat[1], zero) if i % 2 == 0 else (zero, flat[1]))], axis=1)
        for i in range(4)
    ]
    mesh = body("chain")
    middle = mesh.bounds.mean(axis=0) - [18, 0, 0]
    pieces = sorted(mesh.split(), key=lambda piece: piece.centroid[0])
    for i, piece in enumerate(pieces):
        reach = np.linalg.norm(piece.vertices[:, None] - middle - rings[i], axis=2).min(axis=1)
        assert reach.max() < 1.26  # each piece is the wire around its circle
        for j in range(i):
            apart = np.linalg.norm(rings[i][:, None] - rings[j], axis=2).min()
            assert apart > 2.5 + 0.5
            assert abs(_linking(rings[i], rings[j])) == pytest.approx(float(i - j == 1), abs=0.01)


def _linking(one, other):
    """Return Gauss's linking integral of two closed curves."""
    step, step_b = np.roll(one, -1, axis=0) - one, np.roll(other, -1, axis=0) - other
    between = (one + step / 2)[:, None] - (other + step_b / 2)
    twist = np.einsum("abi,abi->ab", between, np.cross(step[:, None], step_b))
    return (twist / np.linalg.norm(between, axis=2) ** 3).sum() / (4 * np.pi)
