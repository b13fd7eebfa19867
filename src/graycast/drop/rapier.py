"""The physics engine, Rapier 0.36: the only file that knows it.

Lengths are scaled by 20 inside, gravity too, because Rapier's contact model is tuned to things
of a metre; times and masses are not. With the settings below, 255 concave parts come to rest
without creeping and without overlap to speak of; Rapier's defaults leave 1 mm or never rest. One
thread, so that one start gives one end, bit for bit, on one type of machine.

Leaves out: bouncing (restitution is 0), rolling friction, bending, air. A little damping stands in
for them and cures trembling heaps. Friction of a pair is the mean of the two coefficients. Parts
fall no faster than 1 m/s, as if let down by hand. Flat faces come to lie 0.2 mm above the bin and
0.4 mm apart (`SKIN_M`); curved ones, whose hulls were thinned, closer or slightly into each other.
"""

from dataclasses import dataclass
from itertools import product

import numpy as np
import rapier3d
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation

from ..frames import rotation_from_quaternion, transform_points
from ..parts import Mesh, Part
from ..scene import Bin, Layout
from .decomposition import Hull
from .overlap import overlap_m

SCALE = 20.0
GRAVITY_M_S2 = 9.81
STEP_S = 0.002
STEPS_PER_LOOK = 20
REST_SPEED_M_S = 0.005
REST_SPIN_RAD_S = 0.1
REST_LOOKS = 5  # with 20 steps of 2 ms each: 0.2 s
LINEAR_DAMPING = 0.2
ANGULAR_DAMPING = 1.0
# What falls from the top of the grid would arrive at 5 m/s, pass through the thin wall of another
# part and stay locked in it. Parts are rather let down, no faster than this.
SPEED_LIMIT_M_S = 1.0
# Parts keep this distance: contact is found more steadily between bodies a little apart, and it
# makes up for what thinning takes from curved hulls: 0.2 mm of a small part, 0.6 mm of a bottle.
SKIN_M = 0.2e-3
TRUSTED_DEPTH_M = 0.05e-3  # deeper contacts than this are measured again, exactly
TABLE_M = 3.0  # half its width
WALL_M = 0.15  # thickness outwards of what parts collide with: nothing tunnels through


@dataclass(frozen=True, slots=True, kw_only=True)
class Body:
    """One kind of part as the engine needs it, in the part's frame.

    Mass, centre and moments are those of the true mesh filled evenly, not of the hulls.
    """

    hulls: tuple[Hull, ...]
    volume_m3: float
    mass_kg: float
    center_m: Float[np.ndarray, "3"]
    inertia_kg_m2: Float[np.ndarray, "3 3"]  # about the centre, along the part's axes
    friction: float

    def __post_init__(self) -> None:
        self.center_m.flags.writeable = False
        self.inertia_kg_m2.flags.writeable = False


def body_of(part: Part, hulls: tuple[Hull, ...]) -> Body:
    """Mass, centre of mass and inertia of a closed mesh, by signed tetrahedra from the origin.

    A tetrahedron (0, a, b, c) of signed volume V has the second moment
    `V / 20 (s s^T + a a^T + b b^T + c c^T)` with `s = a + b + c`.

    Raises:
        ValueError: the mesh encloses no volume, or is inside out.
    """
    corner = part.mesh.vertices_m[part.mesh.faces]
    volume = np.linalg.det(corner) / 6
    if volume.sum() <= 0:
        raise ValueError(
            f"part {part.name} encloses {1e9 * volume.sum():.3g} mm^3: is its mesh closed and "
            "are its faces counter-clockwise seen from outside?"
        )
    total = corner.sum(axis=1)
    center_m = np.einsum("f,fi->i", volume, total) / 4 / volume.sum()
    second = np.einsum("f,fi,fj->ij", volume, total, total)
    second = (second + np.einsum("f,fki,fkj->ij", volume, corner, corner)) / 20
    second -= volume.sum() * np.outer(center_m, center_m)
    return Body(
        hulls=hulls,
        volume_m3=float(volume.sum()),
        mass_kg=float(part.density_kg_m3 * volume.sum()),
        center_m=center_m,
        inertia_kg_m2=part.density_kg_m3 * (np.trace(second) * np.eye(3) - second),
        friction=part.friction,
    )


def simulate(
    box: Bin,
    bodies: tuple[Body, ...],
    T_world_part: Float[np.ndarray, "n 4 4"],
    part_index: Int[np.ndarray, "n"],
    *,
    simulated_s: float,
    attempt: int = 0,
) -> Layout:
    """Lets parts fall from their start poses until they rest, or for `simulated_s`.

    At rest means: seen every 40 ms for 0.2 s, no part was faster than 5 mm/s or 0.1 rad/s.
    Walls without friction stand on the bin's walls while parts fall. At the first rest they go
    and the parts have to rest once more, so what leans over the rim falls off it.

    Returns:
        The end, judged by nobody: `flaws` does that. `deepest_penetration_m` is the
        deepest overlap of any two hulls of different parts, or of a hull and the bin.
    """
    world = _world()
    ceiling_m = float(T_world_part[:, 2, 3].max(initial=0.0)) + 1.0
    blocks = _add_bin(world, box, ceiling_m)
    handles = _add_parts(world, bodies, T_world_part, part_index, first_label=len(blocks))
    time_s, calm, walled, at_rest, speed_m_s, spin_rad_s = 0.0, 0, True, False, 0.0, 0.0
    while not at_rest and time_s < simulated_s:
        for _ in range(STEPS_PER_LOOK):
            world.step()
        time_s += STEPS_PER_LOOK * STEP_S
        speed_m_s, spin_rad_s = _fastest(world, handles)
        still = speed_m_s < REST_SPEED_M_S and spin_rad_s < REST_SPIN_RAD_S
        calm = calm + 1 if still else 0
        if calm >= REST_LOOKS and walled:
            for block in blocks:
                if block.above_rim:
                    world.remove_collider(block.handle)
            walled, calm = False, 0
        at_rest = calm >= REST_LOOKS
    end = _poses(world, handles)
    solids = [list(block.pieces_m) for block in blocks]
    for T, kind in zip(end, part_index, strict=True):
        solids.append([transform_points(T, vertices) for vertices, _ in bodies[kind].hulls])
    return Layout(
        T_world_part=end,
        part_index=part_index,
        at_rest=at_rest,
        last_speed_m_s=speed_m_s,
        last_spin_rad_s=spin_rad_s,
        deepest_penetration_m=_deepest_penetration_m(world, solids),
        outside=int(parts_outside(box, bodies, end, part_index).sum()),
        simulated_s=time_s,
        attempt=attempt,
    )


def parts_outside(
    box: Bin,
    bodies: tuple[Body, ...],
    T_world_part: Float[np.ndarray, "n 4 4"],
    part_index: Int[np.ndarray, "n"],
) -> Bool[np.ndarray, "n"]:
    """Which parts are not in the bin.

    A part is in the bin if its centre of mass is above the inner floor's rectangle and its lowest
    point is below the rim. So a part that sticks out of the heap over the rim is inside, one that
    hangs over the wall with its weight beyond it, or lies on top of an overfull heap, is not.
    """
    outside = np.zeros(len(part_index), dtype=bool)
    for i, (T, kind) in enumerate(zip(T_world_part, part_index, strict=True)):
        x, y, z = T[:3, :3] @ bodies[kind].center_m + T[:3, 3]
        lowest = min(float((v @ T[2, :3]).min()) for v, _ in bodies[kind].hulls) + T[2, 3]
        over_floor = abs(x) < box.inner_m[0] / 2 and abs(y) < box.inner_m[1] / 2 and z > 0
        outside[i] = not (over_floor and lowest < box.inner_m[2])
    return outside


def _world() -> rapier3d.PhysicsWorld:
    world = rapier3d.PhysicsWorld(gravity=(0.0, 0.0, -GRAVITY_M_S2 * SCALE))
    world.set_num_threads(1)
    settings = world.integration_parameters
    settings.dt = STEP_S
    settings.num_solver_iterations = 8
    # Continuous detection against what stands still computes every hull's mass properties anew at
    # every step, two thirds of all time. No part that moves 2 mm a step gets through `WALL_M`.
    settings.max_ccd_substeps = 0
    settings.contact_softness = rapier3d.SpringCoefficients(240.0, 10.0)
    settings.static_contact_softness = rapier3d.SpringCoefficients(480.0, 10.0)
    settings.normalized_allowed_linear_error = 0.001
    settings.normalized_contact_recycle_distance = 0.005
    settings.normalized_max_linear_velocity = SPEED_LIMIT_M_S * SCALE
    return world


@dataclass(frozen=True, slots=True, kw_only=True)
class _Block:
    """What stands still; each piece is the corners [m] of something convex."""

    handle: rapier3d.ColliderHandle
    pieces_m: Float[np.ndarray, "p c 3"]
    above_rim: bool


def _add_bin(world: rapier3d.PhysicsWorld, box: Bin, ceiling_m: float) -> list[_Block]:
    """Floor, walls, table, and invisible walls from the rim to the ceiling."""
    half_x, half_y, rim_m = box.inner_m[0] / 2, box.inner_m[1] / 2, box.inner_m[2]
    out_x, out_y, below = half_x + WALL_M, half_y + WALL_M, -max(WALL_M, box.wall_m)
    sides = [((-out_x, -half_x), (-out_y, out_y)), ((half_x, out_x), (-out_y, out_y))]
    sides += [((-half_x, half_x), (-out_y, -half_y)), ((-half_x, half_x), (half_y, out_y))]
    is_box = box.mesh is None
    spans = [((-out_x, out_x), (-out_y, out_y), (below, 0.0))] if is_box else []
    table_m = (below - box.floor_m, -box.floor_m)
    spans += [((-TABLE_M, TABLE_M), (-TABLE_M, TABLE_M), table_m)]
    spans += [(x, y, (0.0, rim_m)) for x, y in sides] if is_box else []
    spans += [(x, y, (rim_m, ceiling_m)) for x, y in sides]
    blocks = []
    for span in spans:
        low, high = np.array(span).T
        above_rim = span[2][0] == rim_m
        collider = (
            rapier3d.Collider.cuboid(*map(float, (high - low) / 2 * SCALE))
            .translation(tuple((high + low) / 2 * SCALE))
            .friction(0.0 if above_rim else box.friction)
            .user_data(len(blocks))
        )
        handle = world.add_collider(collider)
        pieces_m = np.array([list(product(*span))])
        blocks.append(_Block(handle=handle, pieces_m=pieces_m, above_rim=above_rim))
    if box.mesh is not None:
        blocks.append(_add_mesh(world, box.mesh, box.friction, label=len(blocks)))
    return blocks


def _add_mesh(world: rapier3d.PhysicsWorld, mesh: Mesh, friction: float, *, label: int) -> _Block:
    """A mesh that stands still, as the triangles that it is."""
    shape = rapier3d.SharedShape.trimesh(
        (mesh.vertices_m * SCALE).astype(np.float32),
        mesh.faces.astype(np.uint32),
        # What is in the mesh is pushed out of it, and an edge between coplanar faces is none.
        flags=rapier3d.TriMeshFlags.ORIENTED | rapier3d.TriMeshFlags.FIX_INTERNAL_EDGES,
    )
    handle = world.add_collider(rapier3d.Collider.new(shape).friction(friction).user_data(label))
    return _Block(handle=handle, pieces_m=mesh.vertices_m[mesh.faces], above_rim=False)


def _add_parts(
    world: rapier3d.PhysicsWorld,
    bodies: tuple[Body, ...],
    T_world_part: Float[np.ndarray, "n 4 4"],
    part_index: Int[np.ndarray, "n"],
    *,
    first_label: int,
) -> list[rapier3d.RigidBodyHandle]:
    shapes = [_shape(body) for body in bodies]
    masses = [_mass_properties(body) for body in bodies]
    handles = []
    for label, (T, kind) in enumerate(zip(T_world_part, part_index, strict=True), first_label):
        builder = (
            rapier3d.RigidBody.dynamic()
            .position((tuple(T[:3, 3] * SCALE), _rotation(T[:3, :3])))
            .linear_damping(LINEAR_DAMPING)
            .angular_damping(ANGULAR_DAMPING)
            # Rapier's sleep would freeze parts that still creep.
            .can_sleep(False)
        )
        collider = (
            rapier3d.Collider.new(shapes[kind])
            .mass_properties(masses[kind])
            .friction(bodies[kind].friction)
            .contact_skin(SKIN_M * SCALE)
            .user_data(label)
        )
        handles.append(world.add_body(builder, [collider]))
    return handles


def _shape(body: Body) -> rapier3d.SharedShape:
    hulls = [
        rapier3d.SharedShape.convex_mesh(
            (vertices * SCALE).astype(np.float32), faces.astype(np.uint32)
        )
        for vertices, faces in body.hulls
    ]
    still = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    return (
        hulls[0] if len(hulls) == 1 else rapier3d.SharedShape.compound([(still, h) for h in hulls])
    )


def _mass_properties(body: Body) -> rapier3d.MassProperties:
    moments, axes = np.linalg.eigh(body.inertia_kg_m2 * SCALE**2)
    axes[:, 2] *= np.linalg.det(axes)  # a rotation, not a mirror
    return rapier3d.MassProperties(
        tuple(body.center_m * SCALE), body.mass_kg, tuple(moments), _rotation(axes)
    )


def _rotation(matrix: Float[np.ndarray, "3 3"]) -> tuple[float, ...]:
    return tuple(map(float, Rotation.from_matrix(matrix).as_quat()))  # (x, y, z, w)


def _fastest(
    world: rapier3d.PhysicsWorld, handles: list[rapier3d.RigidBodyHandle]
) -> tuple[float, float]:
    """Highest speed of a centre of mass [m/s] and highest spin [rad/s]."""
    moving = [world.rigid_bodies[handle] for handle in handles]
    speed = max((body.linvel.norm() for body in moving), default=0.0)
    spin = max((body.angvel.norm() for body in moving), default=0.0)
    return float(speed / SCALE), float(spin)


def _poses(
    world: rapier3d.PhysicsWorld, handles: list[rapier3d.RigidBodyHandle]
) -> Float[np.ndarray, "n 4 4"]:
    T = np.tile(np.eye(4), (len(handles), 1, 1))
    for i, handle in enumerate(handles):
        position = world.rigid_bodies[handle].position
        q = position.rotation
        T[i, :3, :3] = rotation_from_quaternion(np.array([q.i, q.j, q.k, q.w]))
        T[i, :3, 3] = np.array(position.translation.to_tuple()) / SCALE
    return T


def _near(one: list[np.ndarray], other: list[np.ndarray]) -> list[list[int]]:
    """Which pieces of two solids have bounding boxes that meet."""
    (low, high), (low_b, high_b) = (
        np.array([[piece.min(axis=0), piece.max(axis=0)] for piece in solid]).swapaxes(0, 1)
        for solid in (one, other)
    )
    apart = (low[:, None] > high_b) | (low_b > high[:, None])
    return np.argwhere(~apart.any(axis=2)).tolist()


def _deepest_penetration_m(world: rapier3d.PhysicsWorld, solids: list[list[np.ndarray]]) -> float:
    """`solids`: by collider label, its convex pieces as vertices [m] in the world."""
    # Contacts are fresh, not recycled from an earlier step, and belong to the poses read above.
    world.integration_parameters.contact_recycling = False
    world.detect_collisions()
    deepest_m = 0.0
    for pair in world.narrow_phase.contact_pairs():
        contact = pair.find_deepest_contact()
        depth_m = 0.0 if contact is None else -contact.dist / SCALE
        if not depth_m <= TRUSTED_DEPTH_M:  # NaN too
            one, other = (
                solids[world.colliders[handle].user_data]
                for handle in (pair.collider1, pair.collider2)
            )
            depth_m = max((overlap_m(one[i], other[j]) for i, j in _near(one, other)), default=0.0)
        deepest_m = max(deepest_m, depth_m)
    return deepest_m
