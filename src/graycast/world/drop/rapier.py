"""The physics engine Rapier 0.36, which only this file uses.

Internally, lengths and gravity are scaled by 20, because Rapier's contact model is tuned to objects
of a metre; times and masses are not scaled. With Rapier's defaults, parts overlap by 1 mm or never
rest. It runs in one thread, so equal starts give equal ends, bit for bit, on one type of machine.

Leaves out: bouncing (restitution is 0), rolling friction, bending, air. Friction of a pair is the
mean of the two coefficients; the engine's cone gives 86 to 100 % of it, by direction. Flat faces
come to rest 0.2 mm above the bin and 0.4 mm apart (`SKIN_M`); curved faces, whose hulls were
thinned, are closer or overlap slightly.
"""

from dataclasses import dataclass
from itertools import product

import numpy as np
import rapier3d
from jaxtyping import Float
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from ...base.frames import rotation_from_quaternion
from ..parts import Mesh
from ..scene import Bin
from .body import Body, Kinds, Poses

SCALE = 20.0
GRAVITY_M_S2 = 9.81
STEP_S = 0.004
LINEAR_DAMPING = 0.2
ANGULAR_DAMPING = 1.0
# A part that falls from the top of the grid would arrive at 5 m/s, pass through the thin wall of
# another part and stay locked in it. So no part falls faster than this limit.
SPEED_LIMIT_M_S = 1.0
# Parts keep this distance, as contacts between slightly separated bodies are steadier. It also
# makes up for the thinning of curved hulls: 0.2 mm for a small part, 0.6 mm for a bottle.
SKIN_M = 0.2e-3
TRUSTED_DEPTH_M = 0.05e-3  # Deeper contacts than this are measured again, exactly.
TABLE_M = 3.0  # Half the table's width
WALL_M = 0.15  # Walls extend this far outwards, so that no part tunnels through.


@dataclass(frozen=True, slots=True, kw_only=True)
class Terms:
    """The conditions under which parts move."""

    guided: bool = False  # Whether walls without friction extend the bin's walls upwards.
    clustered: bool = False  # Whether contacts are clustered, see `_world`
    friction: float = 1.0  # The share of each friction coefficient that is used.
    speed_m_s: float = SPEED_LIMIT_M_S  # the largest speed of a part
    step_s: float = STEP_S


@dataclass(frozen=True, slots=True, kw_only=True)
class RapierPart:
    """A kind of part as objects of the engine."""

    shape: rapier3d.SharedShape
    mass: rapier3d.MassProperties
    friction: float

    @staticmethod
    def of(body: Body) -> "RapierPart":
        hulls = [
            rapier3d.SharedShape.convex_mesh(
                (vertices * SCALE).astype(np.float32), faces.astype(np.uint32)
            )
            for vertices, faces in body.hulls
        ]
        still = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
        compound = rapier3d.SharedShape.compound
        moments, axes = np.linalg.eigh(body.inertia_kg_m2 * SCALE**2)
        axes[:, 2] *= np.linalg.det(axes)  # The sign makes the axes a rotation, not a reflection.
        return RapierPart(
            shape=hulls[0] if len(hulls) == 1 else compound([(still, hull) for hull in hulls]),
            mass=rapier3d.MassProperties(
                tuple(body.center_m * SCALE), body.mass_kg, tuple(moments), _rotation(axes)
            ),
            friction=body.friction,
        )


Pieces = Float[np.ndarray, "_ _ 3"]
"""A fixed obstacle: the corners [m] of its convex pieces."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RapierHeap:
    """A world with a bin and parts that start at rest; collider labels count blocks, then parts."""

    world: rapier3d.PhysicsWorld
    blocks: list[Pieces]
    parts: list[rapier3d.RigidBodyHandle]

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / self.world.integration_parameters.dt)):
            self.world.step()

    def motion(self, number: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return a part's pose, its origin's velocity [m/s] and turn rate [rad/s], in the world."""
        body = self.world.rigid_bodies[self.parts[number]]
        at_origin = body.velocity_at_point(body.position.translation.to_tuple())
        return _poses([body])[0], _three(at_origin) / SCALE, _three(body.angvel)

    def push(
        self, number: int, force_n: Float[np.ndarray, "3"], moment_nm: Float[np.ndarray, "3"]
    ) -> None:
        """Apply a force on a part's origin, and a moment about it, until the next call."""
        body = self.world.rigid_bodies[self.parts[number]]
        body.reset_forces(True)
        body.reset_torques(True)
        origin = body.position.translation.to_tuple()
        body.add_force_at_point(tuple((SCALE * force_n).tolist()), origin, True)
        body.add_torque(tuple((SCALE**2 * moment_nm).tolist()), True)

    def damp(self, factor: Float[np.ndarray, " n"]) -> None:
        """Set each part's damping to its factor times the small default; 0 means no damping."""
        for handle, own in zip(self.parts, factor.tolist(), strict=True):
            body = self.world.rigid_bodies[handle]
            body.linear_damping = LINEAR_DAMPING * own
            body.angular_damping = ANGULAR_DAMPING * own

    def poses(self) -> Float[np.ndarray, "n 4 4"]:
        return _poses([self.world.rigid_bodies[handle] for handle in self.parts])


def open_heap(
    terms: Terms, box: Bin, kinds: list[RapierPart], T_world_part: Poses, part_index: Kinds
) -> RapierHeap:
    """Open a new world without speeds, forces or contacts of an earlier stage."""
    world = _world(terms)
    ceiling_m = float(T_world_part[:, 2, 3].max(initial=0.0)) + 1.0 if terms.guided else None
    blocks = _add_bin(world, box, ceiling_m, friction=terms.friction)
    parts = _add_parts(world, kinds, T_world_part, part_index, terms, first_label=len(blocks))
    return RapierHeap(world=world, blocks=blocks, parts=parts)


def _world(terms: Terms) -> rapier3d.PhysicsWorld:
    world = rapier3d.PhysicsWorld(gravity=(0.0, 0.0, -GRAVITY_M_S2 * SCALE))
    world.set_num_threads(1)
    settings = world.integration_parameters
    settings.dt = terms.step_s
    settings.num_solver_iterations = 8
    # Continuous collision detection against fixed bodies would take two thirds of the time, because
    # it computes every hull's mass properties at every step. A part moves 4 mm per step at most.
    settings.max_ccd_substeps = 0
    # Clustering selects some of a compound's contact points at every step. It is four times as
    # fast, but a part on three points (a bolt or a tube) rocks forever from one pair of points to
    # another. So parts fall with clustering and come to rest without it.
    settings.contact_clustering = terms.clustered
    settings.normalized_prediction_distance = 0.01
    # The engine's own, cheaper friction model also resists spin about a point contact, which is
    # wrong: in a heap it stopped six of ten bottles that roll away in another engine.
    settings.friction_model = rapier3d.FrictionModel.COULOMB
    settings.contact_softness = rapier3d.SpringCoefficients(240.0, 10.0)
    settings.static_contact_softness = rapier3d.SpringCoefficients(480.0, 10.0)
    settings.normalized_allowed_linear_error = 0.001
    settings.normalized_contact_recycle_distance = 0.005
    settings.normalized_max_linear_velocity = terms.speed_m_s * SCALE
    return world


def _add_bin(
    world: rapier3d.PhysicsWorld, box: Bin, ceiling_m: float | None, *, friction: float
) -> list[Pieces]:
    """Add floor, walls, table, and frictionless invisible walls from the rim to the ceiling."""
    half_x, half_y, rim_m = box.inner_m[0] / 2, box.inner_m[1] / 2, box.inner_m[2]
    out_x, out_y, below = half_x + WALL_M, half_y + WALL_M, -max(WALL_M, box.wall_m)
    sides = [((-out_x, -half_x), (-out_y, out_y)), ((half_x, out_x), (-out_y, out_y))]
    sides += [((-half_x, half_x), (-out_y, -half_y)), ((-half_x, half_x), (half_y, out_y))]
    is_box = box.mesh is None
    spans = [((-out_x, out_x), (-out_y, out_y), (below, 0.0))] if is_box else []
    table_m = (below - box.floor_m, -box.floor_m)
    spans += [((-TABLE_M, TABLE_M), (-TABLE_M, TABLE_M), table_m)]
    spans += [(x, y, (0.0, rim_m)) for x, y in sides] if is_box else []
    guides = [] if ceiling_m is None else [(x, y, (rim_m, ceiling_m)) for x, y in sides]
    blocks: list[Pieces] = []
    for span in spans + guides:
        low, high = np.array(span).T
        collider = (
            rapier3d.Collider.cuboid(*map(float, (high - low) / 2 * SCALE))
            .translation(tuple((high + low) / 2 * SCALE))
            .friction(0.0 if span in guides else box.friction * friction)
            .user_data(len(blocks))
        )
        world.add_collider(collider)
        blocks.append(np.array([list(product(*span))]))
    if box.mesh is not None:
        blocks.append(_add_mesh(world, box.mesh, box.friction * friction, label=len(blocks)))
    return blocks


def _add_mesh(world: rapier3d.PhysicsWorld, mesh: Mesh, friction: float, *, label: int) -> Pieces:
    """Add a fixed mesh as triangles."""
    shape = rapier3d.SharedShape.trimesh(
        (mesh.vertices_m * SCALE).astype(np.float32),
        mesh.faces.astype(np.uint32),
        # Bodies inside the mesh are pushed out, and edges between coplanar faces are ignored.
        flags=rapier3d.TriMeshFlags.ORIENTED | rapier3d.TriMeshFlags.FIX_INTERNAL_EDGES,
    )
    world.add_collider(rapier3d.Collider.new(shape).friction(friction).user_data(label))
    return mesh.vertices_m[mesh.faces]


def _add_parts(
    world: rapier3d.PhysicsWorld,
    kinds: list[RapierPart],
    T_world_part: Poses,
    part_index: Kinds,
    terms: Terms,
    *,
    first_label: int,
) -> list[rapier3d.RigidBodyHandle]:
    handles = []
    for label, (T, index) in enumerate(zip(T_world_part, part_index, strict=True), first_label):
        kind = kinds[index]
        builder = (
            rapier3d.RigidBody.dynamic()
            .position((tuple(T[:3, 3] * SCALE), _rotation(T[:3, :3])))
            # Rapier's sleep would freeze parts that still creep.
            .can_sleep(False)
        )
        collider = (
            rapier3d.Collider.new(kind.shape)
            .mass_properties(kind.mass)
            .friction(kind.friction * terms.friction)
            .contact_skin(SKIN_M * SCALE)
            .user_data(label)
        )
        handles.append(world.add_body(builder, [collider]))
    return handles


def _poses(bodies: list[rapier3d.RigidBody]) -> Float[np.ndarray, "n 4 4"]:
    places = [body.position for body in bodies]
    turns = [(q.i, q.j, q.k, q.w) for q in (place.rotation for place in places)]
    T = np.tile(np.eye(4), (len(bodies), 1, 1))
    T[:, :3, :3] = rotation_from_quaternion(np.array(turns).reshape(-1, 4))
    at = [place.translation.to_tuple() for place in places]
    T[:, :3, 3] = np.array(at).reshape(-1, 3) / SCALE
    return T


def _three(vector: rapier3d.Vec3) -> Float[np.ndarray, "3"]:
    return np.array([vector.x, vector.y, vector.z])


def _rotation(matrix: Float[np.ndarray, "3 3"]) -> tuple[float, ...]:
    return tuple(map(float, Rotation.from_matrix(matrix).as_quat()))  # (x, y, z, w)


def _near(one: list[np.ndarray], other: list[np.ndarray]) -> list[list[int]]:
    """Return index pairs of pieces, one from each solid, whose bounding boxes overlap."""
    (low, high), (low_b, high_b) = (
        np.array([[piece.min(axis=0), piece.max(axis=0)] for piece in solid]).swapaxes(0, 1)
        for solid in (one, other)
    )
    apart = (low[:, None] > high_b) | (low_b > high[:, None])
    return np.argwhere(~apart.any(axis=2)).tolist()


def deepest_penetration_m(world: rapier3d.PhysicsWorld, solids: list[list[np.ndarray]]) -> float:
    """Return the deepest overlap of any two solids [m].

    `solids` has the vertices [m] of convex pieces in the world, by collider label.

    The engine's own figure is not reliable: in a heap of 255 concave parts it reports a depth of
    metres for one or two pairs, and such a false alarm would reject every full bin.
    """
    # Detect contacts afresh, because recycled contacts do not belong to the poses read above.
    world.integration_parameters.contact_recycling = False
    world.detect_collisions()
    deepest_m = 0.0
    for pair in world.narrow_phase.contact_pairs():
        contact = pair.find_deepest_contact()
        depth_m = 0.0 if contact is None else -contact.dist / SCALE
        if not depth_m <= TRUSTED_DEPTH_M:  # NaN is refused, too.
            one, other = (
                solids[world.colliders[handle].user_data]
                for handle in (pair.collider1, pair.collider2)
            )
            depth_m = max((overlap_m(one[i], other[j]) for i, j in _near(one, other)), default=0.0)
        deepest_m = max(deepest_m, depth_m)
    return deepest_m


def overlap_m(a: Float[np.ndarray, "v 3"], b: Float[np.ndarray, "w 3"]) -> float:
    """Return the shortest move that separates two point sets' convex hulls; 0 if they are apart.

    The hulls overlap if their Minkowski difference `{p - q}` contains the origin, and the depth is
    the origin's distance to its nearest face.

    Source: Ericson, "Real-Time Collision Detection", 2005, section 9.3 (Minkowski difference).
    """
    if (a.min(axis=0) >= b.max(axis=0)).any() or (b.min(axis=0) >= a.max(axis=0)).any():
        return 0.0
    difference = (a[:, None] - b[None]).reshape(-1, 3)
    offset_m = ConvexHull(difference).equations[:, 3]  # n . 0 + offset: negative inside
    return max(0.0, -float(offset_m.max()))
