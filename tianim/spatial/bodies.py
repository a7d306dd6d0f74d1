"""Bodies at run time: what every system sees as signed distance, normal and surface velocity.

A row of `table` holds a body's pose, velocities and shape; kernels get the table and call

    hit = signed_distance(table, samples, b, x)      # (normal x, y, z, distance [m])
    v = surface_velocity(table, samples, b, x)       # [m/s]

Distance is positive in free space and negative in the solid, the normal is its gradient; for
containers free space is inside. Sphere, capsule and box are one formula: the distance to a box
of half lengths h (0 for the sphere, (0, l/2, 0) for the capsule) less a radius. A cylinder is a
box in the plane of its axis and the point. Meshes look a sampled grid up (`distance_grid`); a mesh
sequence blends the grids of two keys.
"""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tianim.frame import Float, Lines, Mesh
from tianim.lang import f32_1d, f32_2d, ti
from tianim.math.quaternion import from_axis_angle, rotate, rotate_back
from tianim.math.rotations import angular_velocity, from_euler
from tianim.math.rotations import rotate as rotate_array
from tianim.spatial.body_params import (
    BodyParams,
    Box,
    Capsule,
    Cylinder,
    MeshSequence,
    Plane,
    Sphere,
    TriangleMesh,
)
from tianim.spatial.body_shapes import Edges, Surface, primitive_shape, wire
from tianim.spatial.mesh_bodies import BLOCK, MeshGrid

__all__ = [
    "Bodies",
    "BodyParams",
    "Box",
    "Capsule",
    "Cylinder",
    "MeshSequence",
    "Plane",
    "Sphere",
    "TriangleMesh",
    "distance_ahead",
    "signed_distance",
    "surface_velocity",
]

# Columns of a row of the table.
KIND = 0
SIGN = 1  # 1 for a solid, -1 for a container
ROUNDING = 2  # radius of sphere and capsule, reach of a shell [m]
POSITION = 3  # [m], 3 columns
ROTATION = 6  # quaternion (x, y, z, w)
VELOCITY = 10  # of the origin [m/s], 3 columns
SPIN = 13  # angular velocity in world axes [rad/s], 3 columns
SHAPE = (
    16  # half lengths (cylinder: radius, half length, far) or lower corner of the grid [m], plane's normal
)
CELL = 19  # of the grid [m]
SIZE = 20  # samples of the grid along x, y, z
FIRST = 23  # first sample of the key before, in blocks
SECOND = 24  # first sample of the key after, in blocks
BLEND = 25  # 0: the key before, 1: the key after
RATE = 26  # keys a second, negative when played backwards; 0 where one key is all there is [1/s]
WIDTH = 28

PLANE, ROUNDED, MESH, CYLINDER = 0, 1, 2, 3
FAR = 1e30  # [m], more than any distance


@ti.func
def _triple(table: ti.template(), b, column: ti.template()):
    return ti.Vector([table[b, column], table[b, column + 1], table[b, column + 2]])


@ti.func
def _pose_rotation(table: ti.template(), b):
    return ti.Vector(
        [table[b, ROTATION], table[b, ROTATION + 1], table[b, ROTATION + 2], table[b, ROTATION + 3]]
    )


@ti.func
def _rounded_box(p, half, radius):
    """Normal and distance of a box of half lengths `half`, grown by `radius`, at local `p`."""
    q = ti.abs(p) - half
    side = ti.select(p < 0.0, -1.0, 1.0)
    outside = ti.max(q, 0.0)
    length = outside.norm()
    normal = ti.Vector([0.0, 0.0, side.z])
    if q.x >= q.y and q.x >= q.z:
        normal = ti.Vector([side.x, 0.0, 0.0])
    elif q.y >= q.z:
        normal = ti.Vector([0.0, side.y, 0.0])
    if length > 0.0:
        normal = side * outside / length
    distance = length + ti.min(q.max(), 0.0) - radius
    return ti.Vector([normal.x, normal.y, normal.z, distance])


@ti.func
def _cylinder(p, half):
    """Normal and distance of a cylinder along y at local `p`; `half`: radius, half length, far."""
    r = ti.Vector([p.x, 0.0, p.z]).norm()
    flat = _rounded_box(ti.Vector([r, p.y, 0.0]), half, 0.0)
    out = ti.Vector([1.0, 0.0, 0.0])
    if r > 0.0:
        out = ti.Vector([p.x, 0.0, p.z]) / r
    return ti.Vector([flat.x * out.x, flat.y, flat.x * out.z, flat.w])


@ti.func
def _in_cells(table: ti.template(), b, p):
    """Local `p` in cells from the lower corner of the grid in row `b`."""
    return (p - _triple(table, b, SHAPE)) / table[b, CELL]


@ti.func
def _kept_inside(table: ti.template(), b, g):
    """The point of the grid of row `b` that is nearest to `g` [cells]."""
    return ti.max(ti.min(g, _triple(table, b, SIZE) - 1.0), 0.0)


@ti.func
def _lookup(table: ti.template(), samples: ti.template(), b, g):
    """Trilinear gradient [1/cell] and value of row `b` at `g`, and the change to the next key.

    One loop over the eight corners of one or two grids: unrolled it would triple the compile time.
    """
    ny, nz = ti.cast(table[b, SIZE + 1], ti.i32), ti.cast(table[b, SIZE + 2], ti.i32)
    base = ti.cast(ti.min(g, _triple(table, b, SIZE) - 2.0), ti.i32)
    f = g - base
    at = (base.x * ny + base.y) * nz + base.z
    hit, change = ti.Vector([0.0, 0.0, 0.0, 0.0]), 0.0
    for n in range(ti.select(table[b, RATE] == 0.0, 8, 16)):
        second, i, j, k = n // 8, n // 4 % 2, n // 2 % 2, n % 2
        start = ti.cast(ti.select(second, table[b, SECOND], table[b, FIRST]), ti.i32) * BLOCK
        s = samples[start + at + (i * ny + j) * nz + k]
        blend = ti.select(second, table[b, BLEND], 1.0 - table[b, BLEND])
        x, y, z = ti.select(i, f.x, 1.0 - f.x), ti.select(j, f.y, 1.0 - f.y), ti.select(k, f.z, 1.0 - f.z)
        u, v, w = 2.0 * i - 1.0, 2.0 * j - 1.0, 2.0 * k - 1.0
        hit += blend * s * ti.Vector([u * y * z, x * v * z, x * y * w, x * y * z])
        change += ti.select(second, s, -s) * x * y * z
    return hit, change


@ti.func
def _mesh(table: ti.template(), samples: ti.template(), b, p):
    """Normal and distance of the mesh in row `b` at local `p`."""
    wanted = _in_cells(table, b, p)
    g = _kept_inside(table, b, wanted)
    hit, _ = _lookup(table, samples, b, g)
    normal = ti.Vector([0.0, 1.0, 0.0])
    if hit.xyz.norm_sqr() > 0.0:
        normal = hit.xyz.normalized()
    distance = hit.w
    # Outside the grid the surface point nearest to the grid's border stands for the nearest: never
    # too near, up to 5 % too far (a sphere in a cubic grid).
    beyond = wanted - g
    if beyond.norm_sqr() > 0.0:
        reach = beyond * table[b, CELL] + distance * normal
        distance = reach.norm()
        normal = reach / ti.max(distance, 1e-20)
    return ti.Vector([normal.x, normal.y, normal.z, distance - table[b, ROUNDING]])


@ti.func
def signed_distance(table: ti.template(), samples: ti.template(), b, x):
    """Body `b` seen from `x` [m]: (normal x, y, z, distance [m]), distance positive in free space."""
    rotation = _pose_rotation(table, b)
    p = rotate_back(rotation, x - _triple(table, b, POSITION))
    kind = ti.cast(table[b, KIND], ti.i32)
    shape = _triple(table, b, SHAPE)
    hit = ti.Vector([shape.x, shape.y, shape.z, shape.dot(p)])
    if kind == ROUNDED:
        hit = _rounded_box(p, shape, table[b, ROUNDING])
    if kind == CYLINDER:
        hit = _cylinder(p, shape)
    if kind == MESH:
        hit = _mesh(table, samples, b, p)
    n = rotate(rotation, hit.xyz)
    return table[b, SIGN] * ti.Vector([n.x, n.y, n.z, hit.w])


@ti.func
def distance_ahead(table: ti.template(), samples: ti.template(), b, x, ahead):
    """As `signed_distance`, `ahead` seconds after the pose of the table, moved as a rigid body."""
    origin, spin = _triple(table, b, POSITION), _triple(table, b, SPIN)
    turn = ti.Vector([0.0, 0.0, 0.0, 1.0])
    rate = spin.norm()
    if rate > 0.0:
        turn = from_axis_angle(spin / rate, rate * ahead)
    arm = rotate_back(turn, x - origin - ahead * _triple(table, b, VELOCITY))
    hit = signed_distance(table, samples, b, origin + arm)
    n = rotate(turn, hit.xyz)
    return ti.Vector([n.x, n.y, n.z, hit.w])


@ti.func
def surface_velocity(table: ti.template(), samples: ti.template(), b, x):
    """Velocity of body `b` at `x` [m/s]: rigid, v + omega x r, as if the body reached to `x`.

    A mesh sequence adds the speed of its surface along the normal, less the distance's rate.
    """
    arm = x - _triple(table, b, POSITION)
    velocity = _triple(table, b, VELOCITY) + _triple(table, b, SPIN).cross(arm)
    if table[b, RATE] != 0.0:
        rotation = _pose_rotation(table, b)
        g = _kept_inside(table, b, _in_cells(table, b, rotate_back(rotation, arm)))
        hit, change = _lookup(table, samples, b, g)
        if hit.xyz.norm_sqr() > 0.0:
            velocity -= table[b, RATE] * change * rotate(rotation, hit.xyz.normalized())
    return velocity


@ti.kernel
def query_bodies(table: f32_2d, samples: f32_1d, count: ti.i32, x: f32_2d, hits: f32_2d, velocity: f32_2d):
    """The nearest of `count` bodies at each of `x` (n, 3): `hits` (n, 4), `velocity` (n, 3)."""
    for i in range(x.shape[0]):
        p = ti.Vector([x[i, 0], x[i, 1], x[i, 2]])
        nearest = 0
        hit = ti.Vector([0.0, 0.0, 0.0, FAR])
        for b in range(count):
            other = signed_distance(table, samples, b, p)
            if other.w < hit.w:
                hit = other
                nearest = b
        v = surface_velocity(table, samples, nearest, p)
        for c in ti.static(range(4)):
            hits[i, c] = hit[c]
        for c in ti.static(range(3)):
            velocity[i, c] = v[c]


class Bodies:
    """The bodies of a scene by name, posed by `move`.

    table    ti.ndarray f32 (max(count, 1), WIDTH), a row a body
    samples  ti.ndarray f32 (m,), distance grids of the meshes
    """

    def __init__(self, params: Mapping[str, BodyParams]) -> None:
        """Pose the bodies at time 0, at rest. SceneError where a mesh cannot be used."""
        self.params = dict(params)
        self.names = tuple(self.params)
        self.count = len(self.names)
        self._bodies = tuple(self.params.values())
        self._moving = tuple(b for b, body in enumerate(self._bodies) if not is_fixed(body))
        self._grids: dict[int, MeshGrid] = {}
        blocks = 0
        for b, body in enumerate(self._bodies):
            if isinstance(body, TriangleMesh | MeshSequence):
                self._grids[b] = MeshGrid(body, blocks)
                blocks += self._grids[b].blocks
        self._rows = np.zeros((max(self.count, 1), WIDTH), dtype=np.float32)
        self.table: Any = ti.ndarray(ti.f32, shape=self._rows.shape)
        self.samples: Any = ti.ndarray(ti.f32, shape=max(blocks * BLOCK, 1))
        for b, body in enumerate(self._bodies):
            self._pack_shape(b, body)
        self._pack(range(self.count), 0.0, 0.0)

    def index(self, name: str) -> int:
        """The row of the body called `name`; KeyError names those there are."""
        if name not in self.params:
            raise KeyError(f"no body {name!r}; there are {', '.join(self.names) or 'none'}")
        return self.names.index(name)

    def move(self, time: float, dt: float) -> None:
        """Pose the bodies at `time` [s], with the velocities that take them to `time + dt`.

        With dt = 0 they stand still. Bodies that never move cost nothing.
        """
        if self._moving:
            self._pack(self._moving, time, dt)

    def _pack_shape(self, b: int, body: BodyParams) -> None:
        row = self._rows[b]
        row[SIGN] = -1.0 if getattr(body, "inside", False) else 1.0
        row[KIND] = ROUNDED
        if isinstance(body, Plane):
            row[KIND] = PLANE
            row[SHAPE : SHAPE + 3] = np.array(body.normal) / np.linalg.norm(body.normal)
        elif isinstance(body, Box):
            row[SHAPE : SHAPE + 3] = 0.5 * np.array(body.size)
        elif isinstance(body, Sphere):
            row[ROUNDING] = body.radius
        elif isinstance(body, Capsule):
            row[ROUNDING], row[SHAPE + 1] = body.radius, 0.5 * body.length
        elif isinstance(body, Cylinder):
            row[KIND] = CYLINDER
            row[SHAPE : SHAPE + 3] = body.radius, 0.5 * body.length, FAR
        else:
            row[KIND], row[ROUNDING] = MESH, body.thickness
            grid = self._grids[b].grid
            row[SHAPE : SHAPE + 3], row[CELL], row[SIZE : SIZE + 3] = grid.lower, grid.cell, grid.size

    def _pack(self, which: Iterable[int], time: float, dt: float) -> None:
        for b in which:
            row, body = self._rows[b], self._bodies[b].at(time)
            rotation = from_euler(body.rotation)
            row[POSITION : POSITION + 3], row[ROTATION : ROTATION + 4] = body.position, rotation
            row[VELOCITY : VELOCITY + 6] = 0.0
            if dt > 0.0:
                after = self._bodies[b].at(time + dt)
                row[VELOCITY : VELOCITY + 3] = (np.array(after.position) - body.position) / dt
                row[SPIN : SPIN + 3] = angular_velocity(rotation, from_euler(after.rotation), dt)
            if b in self._grids:
                keys = self._grids[b].load(self.samples, time)
                row[FIRST : RATE + 1] = keys.first, keys.second, keys.blend, keys.rate
        self.table.from_numpy(self._rows)

    def distance(self, x: ArrayLike) -> tuple[Float, Float, Float]:
        """The nearest body seen from `x` (n, 3) [m].

        Returns distance (n,) [m], positive in free space, normal (n, 3) and the body's
        velocity there (n, 3) [m/s]. Without bodies: infinity and zeros.
        """
        points = np.ascontiguousarray(x, dtype=np.float32).reshape(-1, 3)
        hits = np.zeros((len(points), 4), dtype=np.float32)
        velocity = np.zeros((len(points), 3), dtype=np.float32)
        if self.count == 0:
            hits[:, 3] = np.inf
        elif len(points):
            query_bodies(self.table, self.samples, self.count, points, hits, velocity)
        return hits[:, 3], hits[:, :3], velocity

    def snapshot(self) -> tuple[Mesh | Lines, ...]:
        """The bodies as they stand since the last `move`: triangles, containers as lines.

        Each point has its `velocity` [m/s].
        """
        return tuple(self._show(b) for b in range(self.count))

    def _shape(self, b: int) -> Surface | Edges:
        body = self._bodies[b]
        if isinstance(body, TriangleMesh | MeshSequence):
            surface = self._grids[b].shape()
            return wire(surface) if getattr(body, "inside", False) else surface
        return primitive_shape(body)

    def _show(self, b: int) -> Mesh | Lines:
        row, name = self._rows[b].astype(np.float64), self.names[b]
        shape = self._shape(b)
        arm = rotate_array(row[ROTATION : ROTATION + 4], shape.position)
        position = (arm + row[POSITION : POSITION + 3]).astype(np.float32)
        velocity = row[VELOCITY : VELOCITY + 3] + np.cross(row[SPIN : SPIN + 3], arm)
        if isinstance(shape, Surface) and shape.velocity is not None:
            velocity += rotate_array(row[ROTATION : ROTATION + 4], shape.velocity)
        data, units = {"velocity": velocity.astype(np.float32)}, {"velocity": "m/s"}
        if isinstance(shape, Edges):
            return Lines(name, position, shape.segments, data=data, units=units)
        return Mesh(name, position, shape.triangles, data=data, units=units)


def is_fixed(body: BodyParams) -> bool:
    """True where nothing about `body` depends on time."""
    return not isinstance(body, MeshSequence) and body.at(0.0) is body
