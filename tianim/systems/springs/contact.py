"""Contact of points with bodies and bounds: distance kept, Coulomb friction that sticks, nothing missed.

A point is led along its path of a step wherever that is longer than the way to the nearest wall: by steps no
longer than the distance that is left (sphere tracing, Hart 1996, doi:10.1007/s003710050084), so that nothing
thin is jumped over. Explicit steps then change velocities, as impulses:

    v_n' = -e v_n,   v_t' = v_t max(0, 1 - mu |dv_n| / |v_t|)

Implicit ones hold contact as forces lambda within the iterations of the solve (`projective.py`),

    lambda += A_c e,   lambda_n >= 0,   |lambda_t| <= mu lambda_n

e what a point lacks: its depth along the normal, less what it slid in this step. A_c are the rows of the
solve's own matrix among the points in contact, without what pulls on them from elsewhere: never more than
their true stiffness, so that forces do not overshoot, and nearly that wherever a patch is larger than a few
cells. They start from those of the last step. So the sheet gives way around what it rests on, where putting
points back after a solve stretches it by a tenth.

Limits: of several bodies at one point the nearest counts.
"""

from typing import Any

import numpy as np

from tianim.lang import f32_1d, f32_2d, f64_1d, f64_2d, ti
from tianim.spatial.bodies import FAR, Bodies, distance_ahead, surface_velocity
from tianim.system import Bounds
from tianim.systems.springs.params import Contact
from tianim.systems.springs.points import Points

# Steps along a path; each goes at least this part of the thickness.
MOST_TRACES, LEAST_TRACE = 64, 0.25
# What is as near as this, in thicknesses, touches: contact leaves points at 1 but for rounding.
TOUCHING = 1.01


@ti.func
def wall_gap(bounds: ti.template(), x):
    """Inward normal and distance of the nearest side of the bounds."""
    hit = ti.Vector([0.0, 1.0, 0.0, FAR])
    for c in ti.static(range(3)):
        low, high = x[c] - bounds[0, c], bounds[1, c] - x[c]
        near = ti.min(low, high)
        if near < hit.w:
            hit = ti.Vector([0.0, 0.0, 0.0, near])
            hit[c] = ti.select(low < high, 1.0, -1.0)
    return hit


@ti.func
def nearest_wall(table: ti.template(), samples: ti.template(), count, bounds: ti.template(), x, ahead):
    """Normal and distance of the nearest body or side from `x`, and its number: `count` for the bounds."""
    hit, which = wall_gap(bounds, x), count
    for b in range(count):
        other = distance_ahead(table, samples, b, x, ahead)
        if other.w < hit.w:
            hit, which = other, b
    return hit, which


@ti.func
def wall_velocity(table: ti.template(), samples: ti.template(), count, which, x):
    """Velocity of a wall at x."""
    v = ti.Vector([0.0, 0.0, 0.0])
    if which < count:
        v = surface_velocity(table, samples, which, x)
    return v


@ti.func
def met_wall(
    table: ti.template(), samples: ti.template(), count, bounds: ti.template(), thickness, dt, start, end,
):  # fmt: skip
    """What a point meets that goes from `start` to `end` in `dt`: normal, distance at the end, number.

    Where it passes through something, the distance is that from the tangent plane at the place of entry.
    """
    before, first = nearest_wall(table, samples, count, bounds, start, 0.0)
    moves, fastest = ti.Vector([0.0, 0.0, 0.0]), 0.0
    for b in range(count):
        own = dt * surface_velocity(table, samples, b, start)
        fastest = ti.max(fastest, own.norm())
        if b == first:
            moves = own
    reach = (end - start).norm() + fastest
    return met_from(before, first, moves, reach, table, samples, count, bounds, thickness, dt, start, end)


@ti.func
def met_from(
    before, first, moves, reach, table: ti.template(), samples: ti.template(), count, bounds: ti.template(),
    thickness, dt, start, end,
):  # fmt: skip
    """As `met_wall`, of a point whose nearest wall at `start` is known: `before`, number `first`, its way.

    `reach` is how far point and any wall go towards each other in the step at most.
    """
    way = end - start
    hit, which = before, first
    # The end is looked up in the same place as the way: a second one would take as long to compile again.
    place, s, traced, going = end, 1.0, 0, 1
    while going == 1:
        at, there = nearest_wall(table, samples, count, bounds, place, s * dt)
        if traced == 0:
            hit, which, s = at, there, 0.0
            going = ti.select(before.w > thickness and reach > before.w - thickness, 1, 0)
            at.w = before.w
        elif at.w < thickness:
            rest = (1.0 - s) * way
            if there < count:
                rest -= (1.0 - s) * dt * surface_velocity(table, samples, there, place)
            through = at.w + rest.dot(at.xyz)
            # The side it came from counts where it ends amid a thin wall.
            if through < hit.w + LEAST_TRACE * thickness:
                hit, which = ti.Vector([at.x, at.y, at.z, through]), there
            going = 0
        s += ti.max(at.w - thickness, LEAST_TRACE * thickness) / ti.max(reach, 1e-20)
        place = start + s * way
        if s >= 1.0 or traced == MOST_TRACES:
            going = 0
        traced += 1
    if before.w <= thickness:
        # What touches and is driven in may come out on the other side within a step.
        deep = (way - moves).dot(before.xyz)
        if deep < -thickness and before.w + deep < hit.w + LEAST_TRACE * thickness:
            hit, which = ti.Vector([before.x, before.y, before.z, before.w + deep]), first
    return hit, which


@ti.kernel
def bounce(
    n: ti.i32, dt: ti.f32, thickness: ti.f32, restitution: ti.f32, resting: ti.f32, table: f32_2d,
    samples: f32_1d, count: ti.i32, bounds: f32_2d, friction: f32_1d, inverse_mass: f64_1d, start: f64_2d,
    x: f64_2d, v: f64_2d,
):  # fmt: skip
    """Points that came too near go no nearer; friction takes off what they slide.

    Approaches slower than `resting` do not bounce: gravity alone gives a resting point as much in a step.
    """
    for i in range(n):
        if inverse_mass[i] > 0.0:
            begin = ti.cast(ti.Vector([start[i, 0], start[i, 1], start[i, 2]]), ti.f32)
            end = ti.cast(ti.Vector([x[i, 0], x[i, 1], x[i, 2]]), ti.f32)
            hit, which = met_wall(table, samples, count, bounds, thickness, dt, begin, end)
            if hit.w < thickness:
                nrm = hit.xyz
                wall = wall_velocity(table, samples, count, which, end)
                u = ti.cast(ti.Vector([v[i, 0], v[i, 1], v[i, 2]]), ti.f32) - wall
                un = u.dot(nrm)
                if un < 0.0:
                    along = u - un * nrm
                    back = ti.select(un < -resting, -restitution * un, 0.0)
                    slid = along.norm()
                    kept = ti.max(0.0, 1.0 - friction[which] * (back - un) / ti.max(slid, 1e-20))
                    u = kept * along + back * nrm
                    # What it slid beyond the place where it stuck is taken back too.
                    undo = -dt * (1.0 - kept) * along
                    for c in ti.static(range(3)):
                        v[i, c] = wall[c] + u[c]
                        x[i, c] += undo[c]
                for c in ti.static(range(3)):
                    x[i, c] += (thickness - hit.w) * nrm[c]


@ti.kernel
def count_touching(
    n: ti.i32, near: ti.f32, table: f32_2d, samples: f32_1d, count: ti.i32, bounds: f32_2d,
    inverse_mass: f64_1d, x: f64_2d,
) -> ti.i32:  # fmt: skip
    """Points that are no farther than `near` from a wall; what is held is not counted."""
    found = 0
    for i in range(n):
        if inverse_mass[i] > 0.0:
            at = ti.cast(ti.Vector([x[i, 0], x[i, 1], x[i, 2]]), ti.f32)
            hit, _ = nearest_wall(table, samples, count, bounds, at, 0.0)
            if hit.w <= near:
                found += 1
    return found


class Walls:
    """What points touch: the bodies of the world, its bounds, and how.

    count     bodies; `friction` has one more, for the bounds
    any       whether there is anything to touch
    """

    def __init__(self, contact: Contact, bodies: Bodies, bounds: Bounds) -> None:
        self.bodies, self.thickness = bodies, contact.thickness
        self.restitution = contact.restitution
        self.count = bodies.count
        coefficients = [
            contact.bodies[name].friction if name in contact.bodies else contact.friction
            for name in bodies.names
        ]
        self.friction: Any = ti.ndarray(ti.f32, self.count + 1)
        self.friction.from_numpy(np.array([*coefficients, contact.friction], np.float32))
        corners = np.array([[-FAR] * 3, [FAR] * 3], np.float32)
        if bounds.kind == "contained":
            corners = np.array([bounds.lower, bounds.upper], np.float32)
        self.bounds: Any = ti.ndarray(ti.f32, (2, 3))
        self.bounds.from_numpy(corners)
        self.any = self.count > 0 or bounds.kind == "contained"

    def touching(self, points: Points) -> int:
        """How many points lie at the distance that is kept, or nearer."""
        if not self.any:
            return 0
        return count_touching(
            points.count, TOUCHING * self.thickness, self.bodies.table, self.bodies.samples, self.count,
            self.bounds, points.inverse_mass, points.x,
        )  # fmt: skip
