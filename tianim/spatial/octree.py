"""Octree over stars in Morton order: cubes with their mass, centre of mass and second moments.

    tree = Octree(count)
    tree.build(x, mass)       # then kernels read tree.link, tree.moment, tree.lattice, tree.weight

A node is a run of stars in Morton order, cut where the next three bits of the key change; cubes
with one child only are passed over, so an inner node has two to eight children, which stand next
to each other. A node of at most LEAF stars is not cut. Stars that share all 63 bits of the key
cannot be cut either: such a leaf may be of any size.

One core cuts the top of the tree; below nodes of some thousand stars each task cuts a subtree at
a time, breadth first, in its own scratch, and then takes a run of nodes for it. Which run depends
on the threads, what stands in it does not: walks see the same children in the same order.

What a node holds is named in nodes.py. Moments are summed over the node's own stars; those of nodes of
more than EXACT stars over their children's, where radius and third moment are upper bounds.
"""

from typing import Any

from tianim.lang import f32_1d, f32_2d, i32_1d, i32_2d, i64_1d, ti, workers
from tianim.spatial import morton
from tianim.spatial.columns import staggered
from tianim.spatial.morton import Cube, Sorter
from tianim.spatial.nodes import (
    BEGIN,
    CHILDREN,
    END,
    HEAP,
    LINK_ROWS,
    MOMENT_ROWS,
    NONE,
    join_moments,
    set_moments,
)

LEAF = 16
# Subtrees of this many stars or fewer are cut by one task; about so many of them are wanted.
SMALLEST_SUBTREE, LARGEST_SUBTREE, SUBTREES = 1024, 16_384, 128
# Nodes for each star that arrays are made for at first; more are taken when a tree needs them.
NODES_PER_STAR = 0.4
FEWEST_NODES = 4096
# Moments of nodes of so many stars are summed over the stars, those of larger ones over the children.
EXACT = 256
# `level` of a node of the top whose subtree is cut.
CUT = -1
# Entries of `counter`.
NODES, NEXT, ROOTS = 0, 1, 2


@ti.func
def octant(key, level):
    """Which child of a cube of `level` a key lies in."""
    return ti.cast((key >> (60 - 3 * level)) & 7, ti.i32)


@ti.func
def common_level(first, last, level):
    """The first level from `level` on at which two keys part; LEVELS where they do not."""
    result = level
    different = first ^ last
    while result < morton.LEVELS and (different >> (60 - 3 * result)) == 0:
        result += 1
    return result


@ti.func
def end_of_octant(key: ti.template(), begin, end, level):
    """First star in begin + 1 ... end that lies in another child than star `begin`."""
    own = octant(key[begin], level)
    low, high = begin + 1, end
    while low < high:
        middle = (low + high) // 2
        if octant(key[middle], level) == own:
            low = middle + 1
        else:
            high = middle
    return low


@ti.kernel
def cut_top(
    n: ti.i32,
    subtree: ti.i32,
    capacity: ti.i32,
    key: i64_1d,
    link: i32_2d,
    level: i32_1d,
    roots: i32_1d,
    counter: i32_1d,
):
    """Cut nodes of more than `subtree` stars; list those that tasks shall cut on in `roots`."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        link[BEGIN, 0], link[END, 0] = 0, n
        level[0] = 0
        nodes, listed, q = 1, 0, 0
        while q < nodes:
            begin, end = link[BEGIN, q], link[END, q]
            link[CHILDREN, q] = NONE
            depth = common_level(key[begin], key[end - 1], level[q])
            if end - begin > LEAF and depth < morton.LEVELS:
                if end - begin <= subtree:
                    link[CHILDREN, q] = 0
                    level[q] = depth
                    roots[listed] = q
                    listed += 1
                elif nodes + 8 <= capacity:
                    first, star = nodes, begin
                    while star < end:
                        after = end_of_octant(key, star, end, depth)
                        link[BEGIN, nodes], link[END, nodes] = star, after
                        level[nodes] = depth + 1
                        nodes += 1
                        star = after
                    link[CHILDREN, q] = first * 8 + nodes - first - 1
                else:
                    nodes = capacity + 8
                    q = nodes
            elif end - begin > LEAF:
                link[CHILDREN, q] = HEAP
            q += 1
        counter[NODES] = nodes
        counter[NEXT] = 0
        counter[ROOTS] = listed


@ti.func
def cut_subtree(
    root, s, key: ti.template(), level: ti.template(), link: ti.template(), scratch: ti.template()
):
    """Cut below `root` into scratch from s on, breadth first; returns how many nodes there are.

    Rows of scratch: begin, end, children as in `link` but counted from s, level.
    """
    scratch[0, s], scratch[1, s], scratch[3, s] = link[BEGIN, root], link[END, root], level[root]
    nodes, q = 1, 0
    while q < nodes:
        begin, end = scratch[0, s + q], scratch[1, s + q]
        scratch[2, s + q] = NONE
        if end - begin > LEAF:
            depth = common_level(key[begin], key[end - 1], scratch[3, s + q])
            if depth < morton.LEVELS:
                first, star = nodes, begin
                while star < end:
                    after = end_of_octant(key, star, end, depth)
                    scratch[0, s + nodes], scratch[1, s + nodes] = star, after
                    scratch[3, s + nodes] = depth + 1
                    nodes += 1
                    star = after
                scratch[2, s + q] = first * 8 + nodes - first - 1
            else:
                scratch[2, s + q] = HEAP
        q += 1
    return nodes


@ti.kernel
def cut_subtrees(
    tasks: ti.i32,
    stride: ti.i32,
    page: ti.i32,
    capacity: ti.i32,
    key: i64_1d,
    lattice: i32_2d,
    weight: f32_1d,
    roots: i32_1d,
    level: i32_1d,
    scratch: i32_2d,
    link: i32_2d,
    moment: f32_2d,
    counter: i32_1d,
):
    """Each task cuts one subtree after another and sets its moments."""
    for task_block in range(tasks * stride):
        if task_block % stride == 0:
            s = (task_block // stride) * page
            turn = ti.atomic_add(counter[NEXT], 1)
            while turn < counter[ROOTS]:
                root = roots[turn]
                nodes = cut_subtree(root, s, key, level, link, scratch)
                # The root has its place already: the others follow from `base + 1` on.
                base = ti.atomic_add(counter[NODES], nodes - 1) - 1
                if base + nodes <= capacity:
                    for k in range(nodes):
                        at = ti.select(k == 0, root, base + k)
                        children = scratch[2, s + k]
                        link[BEGIN, at], link[END, at] = scratch[0, s + k], scratch[1, s + k]
                        link[CHILDREN, at] = ti.select(children < 0, children, children + 8 * base)
                    for step in range(nodes):
                        k = nodes - 1 - step
                        at = ti.select(k == 0, root, base + k)
                        if scratch[2, s + k] < 0 or scratch[1, s + k] - scratch[0, s + k] <= EXACT:
                            set_moments(at, lattice, weight, link, moment)
                        else:
                            join_moments(at, lattice, weight, link, moment)
                level[root] = CUT
                turn = ti.atomic_add(counter[NEXT], 1)


@ti.kernel
def set_top_moments(
    top: ti.i32, lattice: i32_2d, weight: f32_1d, level: i32_1d, link: i32_2d, moment: f32_2d
):
    """Moments of the nodes above the subtrees, the lowest first."""
    ti.loop_config(serialize=True)
    for step in range(top):
        q = top - 1 - step
        if link[CHILDREN, q] < 0:
            set_moments(q, lattice, weight, link, moment)
        elif level[q] != CUT:
            join_moments(q, lattice, weight, link, moment)


@ti.func
def append_group(begin, end, listed, most, groups: ti.template()):
    """Write group number `listed` where there is room for it; returns the next number."""
    if listed < most:
        groups[0, listed], groups[1, listed] = begin, end
    return listed + 1


@ti.kernel
def list_groups(group: ti.i32, most: ti.i32, link: i32_2d, stack: i32_1d, groups: i32_2d, counter: i32_1d):
    """Cut the stars into groups of at most `group`: neighbouring children of one node together."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        stack[0] = 0
        depth, listed, start = 1, 0, 0
        while depth > 0:
            depth -= 1
            q = stack[depth]
            begin, end, children = link[BEGIN, q], link[END, q], link[CHILDREN, q]
            if end - start > group and start < begin:
                listed = append_group(start, begin, listed, most, groups)
                start = begin
            if end - begin > group and children >= 0:
                for k in range((children & 7) + 1):
                    stack[depth] = (children >> 3) + (children & 7) - k
                    depth += 1
            else:
                while end - start > group:  # a leaf of stars in one place
                    listed = append_group(start, start + group, listed, most, groups)
                    start += group
        if start < link[END, 0]:
            listed = append_group(start, link[END, 0], listed, most, groups)
        counter[0] = listed


class Octree:
    """The tree of `count` stars and the groups of at most `group` stars that walk it together.

    After `build`:
        order    i32 (n,)     id of the star that stands k-th
        lattice  i32 (3, n)   its place in lattice steps
        weight   f32 (n,)     its mass over the total
        link     i32 (6, nodes), moment f32 (9, nodes)   see the names of the rows in nodes.py
        groups   i32 (2, group_count)   begin, end
        side, mass    side of the cube and total mass, in the units of what was given
    """

    def __init__(self, count: int, group: int) -> None:
        self.count, self.group = count, group
        self.tasks, self.stride = workers()
        capacity = staggered(count)
        self.lattice = ti.ndarray(ti.i32, (3, capacity))
        self.weight = ti.ndarray(ti.f32, capacity)
        self._sorter = Sorter(count)
        self._counter = ti.ndarray(ti.i32, 8)
        self._stack = ti.ndarray(ti.i32, 8 * (morton.LEVELS + 2))
        self._subtree = min(max(count // SUBTREES, SMALLEST_SUBTREE), LARGEST_SUBTREE)
        self._page = 2 * self._subtree + 64
        self._scratch = ti.ndarray(ti.i32, (4, self.tasks * self._page))
        self._reserve_nodes(int(NODES_PER_STAR * count) + FEWEST_NODES)
        self._reserve_groups(count // max(group // 4, 1) + 64)
        self.node_count, self.group_count = 0, 0

    @property
    def order(self) -> Any:
        """Ids in Morton order."""
        return self._sorter.order[0]

    @property
    def cube(self) -> Cube:
        """The cube that holds all stars."""
        return self._sorter.cube

    @property
    def side(self) -> float:
        """Side of the cube."""
        return self._sorter.cube.side

    @property
    def mass(self) -> float:
        """Total mass."""
        return self._sorter.cube.mass

    def _reserve_nodes(self, nodes: int) -> None:
        self.node_capacity = staggered(nodes)
        self.link = ti.ndarray(ti.i32, (LINK_ROWS, self.node_capacity))
        self.moment = ti.ndarray(ti.f32, (MOMENT_ROWS, self.node_capacity))
        self._level = ti.ndarray(ti.i32, self.node_capacity)
        self._roots = ti.ndarray(ti.i32, self.node_capacity)

    def _reserve_groups(self, groups: int) -> None:
        self.group_capacity = staggered(groups)
        self.groups = ti.ndarray(ti.i32, (2, self.group_capacity))

    def build(self, x: Any, mass: Any) -> None:
        """Sort the stars at x f64 (3, n) with mass f64 (n,) and cut the tree anew."""
        if self.count == 0:
            return
        self._sorter.sort(x, mass, LEAF)
        self._sorter.gather(x, mass, self.lattice, self.weight)
        while not self._cut():
            self._reserve_nodes(2 * self.node_capacity)
        list_groups(self.group, self.group_capacity, self.link, self._stack, self.groups, self._counter)
        self.group_count = int(self._counter.to_numpy()[0])
        if self.group_count > self.group_capacity:
            self._reserve_groups(2 * self.group_count)
            list_groups(self.group, self.group_capacity, self.link, self._stack, self.groups, self._counter)

    def _cut(self) -> bool:
        """Whether the nodes had room."""
        key, capacity = self._sorter.key[0], self.node_capacity
        cut_top(self.count, self._subtree, capacity, key, self.link, self._level, self._roots, self._counter)
        top = int(self._counter.to_numpy()[NODES])
        if top > capacity:
            return False
        cut_subtrees(
            self.tasks, self.stride, self._page, capacity, key, self.lattice, self.weight, self._roots,
            self._level, self._scratch, self.link, self.moment, self._counter,
        )  # fmt: skip
        self.node_count = int(self._counter.to_numpy()[NODES])
        if self.node_count > capacity:
            return False
        set_top_moments(top, self.lattice, self.weight, self._level, self.link, self.moment)
        return True

    def memory_bytes(self) -> int:
        """Bytes of the arrays."""
        capacity = staggered(self.count)
        nodes = 4 * (LINK_ROWS + MOMENT_ROWS + 2) * self.node_capacity
        return (
            capacity * (12 + 4)
            + self._sorter.memory_bytes()
            + nodes
            + 8 * self.group_capacity
            + 16 * self.tasks * self._page
        )
