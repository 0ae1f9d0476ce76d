#!/usr/bin/env python3
"""The lab's MSDM2 beside a literal one, and that beside the map of the author's program.

    python3 benches/metro/msdm2.py FILE.obj... [--binary target/release/quadmark]
    python3 benches/metro/msdm2.py --published cow.off cow_msdm2_reference.obj [--binary ...]

needs numpy, scipy and trimesh. The literal one is written from the description in Lavoue 2011 and from
how the author's published implementation (MEPP2, `msdm2.h` and `curvature.hpp`) goes about it, with
none of its code: one vertex after the other, in the plainest way.

Pairs are each mesh with noise, smoothing and waves; prints one row per pair. With `--published` the pair
is that of MEPP2's own test: an original, and the output that the test expects, which is the other mesh
with its local values as colours, from the least to the largest in 255 steps (both in MEPP2's
`Testing/Data`; the cow is the common one of 2904 vertices). Each vertex's step is compared: one way,
and up to a factor and an offset, since the values themselves are not in it.
"""

import argparse
import json
import math
import pathlib
import subprocess
import tempfile

import numpy
import trimesh
from scipy.spatial import cKDTree

RADII = (0.002, 0.003, 0.004)


class Shape:
    def __init__(self, vertices, faces):
        self.vertices, self.faces = vertices, faces
        self.places = [tuple(p) for p in vertices.tolist()]
        normals = numpy.cross(vertices[faces[:, 1]] - vertices[faces[:, 0]],
                              vertices[faces[:, 2]] - vertices[faces[:, 0]])
        length = numpy.linalg.norm(normals, axis=1, keepdims=True)
        normals = normals / numpy.where(length > 0, length, 1)
        sides = {}
        for f, (a, b, c) in enumerate(faces.tolist()):
            for u, v in ((a, b), (b, c), (c, a)):
                sides[u, v] = f
        self.spokes = [[] for _ in vertices]
        for (u, v), f in sides.items():
            g = sides.get((v, u))
            angle = None
            if g is not None:
                along = vertices[v] - vertices[u]
                sine = numpy.cross(normals[f], normals[g]) @ along / max(numpy.linalg.norm(along), 1e-300)
                angle = math.asin(max(-1.0, min(1.0, float(sine))))
            self.spokes[u].append((v, angle))
            if g is None:
                self.spokes[v].append((u, None))
        self.side = float((vertices.max(0) - vertices.min(0)).max())


def minus(a, b):
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def inside(place, centre, edge, radius):
    """The share of an edge, from a place in the ball, that lies in the ball."""
    w = minus(place, centre)
    a, b, c = dot(edge, edge), dot(edge, w), dot(w, w) - radius * radius
    if a == 0 or b * b - a * c < 0:
        return 0.0
    return max(0.0, min(1.0, (-b + math.sqrt(b * b - a * c)) / a))


def walk(shape, vertex, radius):
    """(from, to, share, angle, is new) for the edges that lead away from the centre of a ball."""
    centre = shape.places[vertex]
    known, stack = {vertex}, [vertex]
    while stack:
        u = stack.pop()
        place = shape.places[u]
        for v, angle in shape.spokes[u]:
            edge = minus(shape.places[v], place)
            if u != vertex and dot(edge, minus(place, centre)) <= 0:
                continue
            share = inside(place, centre, edge, radius)
            new = share >= 1.0 and v not in known
            if new:
                known.add(v)
                stack.append(v)
            yield u, v, share, angle, new


def curvatures(shape, radius):
    result = numpy.zeros(len(shape.vertices))
    for vertex in range(len(shape.vertices)):
        tensor = numpy.zeros((3, 3))
        for u, v, share, angle, _ in walk(shape, vertex, radius):
            if angle is None:
                continue
            edge = share * numpy.subtract(shape.places[v], shape.places[u])
            length = math.sqrt(float(edge @ edge))
            if length > 0:
                tensor += numpy.outer(edge, edge) * (angle / length)
        sizes = numpy.sort(numpy.abs(numpy.linalg.eigvalsh(tensor / (math.pi * radius * radius))))
        result[vertex] = shape.side * (sizes[1] + sizes[2]) / 2
    return result


def nearest(place, triangles):
    """The closest point of each triangle: of its plane, if that is within it, or else of its sides. (The
    one of trimesh 5.2 is up to a thousandth of a side away, next to the sides of a triangle.)"""
    sides = numpy.roll(triangles, -1, 1) - triangles
    normals = numpy.cross(sides[:, 0], sides[:, 1])
    heights = ((place - triangles[:, 0]) * normals).sum(1) / (normals ** 2).sum(1)
    feet = place - heights[:, None] * normals
    turns = numpy.cross(sides, feet[:, None] - triangles) * normals[:, None]
    within = (turns.sum(2) >= 0).all(1)
    along = ((place - triangles) * sides).sum(2) / (sides ** 2).sum(2)
    on_sides = triangles + along.clip(0, 1)[..., None] * sides
    best = ((on_sides - place) ** 2).sum(2).argmin(1)
    return numpy.where(within[:, None], feet, on_sides[numpy.arange(len(best)), best])


def matched(a, b):
    """Per vertex of a, the closest point of b, and (corner, weight) pairs for the curvature there: the
    areas that the vertex itself spans with the two other corners of its triangle. Where several
    triangles share the closest point, the program takes the one that its search meets first; this
    takes the mean of them."""
    around = [[] for _ in b.vertices]
    for f, corners in enumerate(b.faces.tolist()):
        for v in corners:
            around[v].append(f)
    sides = b.vertices[b.faces] - b.vertices[b.faces[:, [1, 2, 0]]]
    longest = float(numpy.linalg.norm(sides, axis=2).max())
    tree = cKDTree(b.vertices)
    places, shares = numpy.empty_like(a.vertices), []
    for vertex, place in enumerate(a.vertices):
        # The closest point is no farther than the closest vertex, and its corners a side from there.
        reach = (tree.query(place)[0] + longest) * (1 + 1e-9)
        faces = numpy.array(sorted({f for v in tree.query_ball_point(place, reach) for f in around[v]}))
        points = nearest(place, b.vertices[b.faces[faces]])
        distances = numpy.linalg.norm(points - place, axis=1)
        places[vertex] = points[int(distances.argmin())]
        same = numpy.linalg.norm(points - places[vertex], axis=1) <= 1e-9 * longest
        own = []
        for corners in b.faces[faces[same]].tolist():
            p, q, r = (b.vertices[v] - place for v in corners)
            areas = [float(numpy.linalg.norm(numpy.cross(*pair))) for pair in ((q, r), (r, p), (p, q))]
            total = sum(areas)
            own += [(v, (area / total if total > 0 else 1 / 3) / same.sum())
                    for v, area in zip(corners, areas)]
        shares.append(own)
    return places, shares


def local_values(a, b):
    """Per vertex of a, how different b is around it."""
    places, shares = matched(a, b)
    feet = [tuple(p) for p in places.tolist()]
    local = numpy.zeros(len(a.vertices))
    for share_of_side in RADII:
        # Both by the size of the surface that is looked at.
        radius = share_of_side * a.side
        own = curvatures(a, radius)
        other = curvatures(b, radius) * a.side / b.side
        other = [sum(weight * other[v] for v, weight in own_shares) for own_shares in shares]
        window = 5 * radius
        for vertex in range(len(a.vertices)):
            samples = [(own[vertex], other[vertex], a.places[vertex], feet[vertex])]
            for u, v, share, _, new in walk(a, vertex, window):
                if new:
                    samples.append((own[v], other[v], a.places[v], feet[v]))
                elif share < 1.0:
                    blend = lambda x, y: x + share * (y - x)
                    samples.append((blend(own[u], own[v]), blend(other[u], other[v]),
                                    tuple(map(blend, a.places[u], a.places[v])),
                                    tuple(map(blend, feet[u], feet[v]))))
            local[vertex] += compared(samples, a.places[vertex], feet[vertex], window / 2)
    return local / len(RADII)


def pooled(local):
    return float((local ** 3).mean() ** (1 / 3))


def compared(samples, centre, foot, sigma):
    x = numpy.array([s[0] for s in samples])
    y = numpy.array([s[1] for s in samples])
    bell = lambda places, middle: numpy.exp(
        -((numpy.array(places) - middle) ** 2).sum(1) / (2 * sigma * sigma))
    w, v = bell([s[2] for s in samples], centre), bell([s[3] for s in samples], foot)
    mean_x, mean_y = (w * x).sum() / w.sum(), (v * y).sum() / v.sum()
    dev_x = math.sqrt((w * (x - mean_x) ** 2).sum() / w.sum())
    dev_y = math.sqrt((v * (y - mean_y) ** 2).sum() / v.sum())
    # The published implementation weighs by the one and divides by the other.
    common = (v * (x - mean_x) * (y - mean_y)).sum() / w.sum()
    one = abs(mean_x - mean_y) / (max(mean_x, mean_y) + 1)
    two = abs(dev_x - dev_y) / (max(dev_x, dev_y) + 1)
    three = abs(dev_x * dev_y - common) / (dev_x * dev_y + 1)
    return (one + two + 0.5 * three) / 2.5


def msdm2(a, b):
    return (pooled(local_values(a, b)) + pooled(local_values(b, a))) / 2


def read(path):
    mesh = trimesh.load(path, process=False, maintain_order=True, force="mesh", skip_materials=True)
    return welded(mesh.vertices, mesh.faces)


def welded(vertices, faces):
    """Each position once, as the lab has it; no triangles without area, no vertices without one."""
    vertices, index = numpy.unique(vertices, axis=0, return_inverse=True)
    faces = index.reshape(-1)[faces]
    area = numpy.linalg.norm(numpy.cross(vertices[faces[:, 1]] - vertices[faces[:, 0]],
                                         vertices[faces[:, 2]] - vertices[faces[:, 0]]), axis=1)
    faces = faces[area > 0]
    used, index = numpy.unique(faces, return_inverse=True)
    return vertices[used], index.reshape(-1, 3)


def write(path, vertices, faces):
    with open(path, "w") as out:
        out.writelines(f"v {x!r} {y!r} {z!r}\n" for x, y, z in vertices.tolist())
        out.writelines(f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in faces.tolist())


def smoothed(vertices, faces, rounds):
    edges = numpy.unique(numpy.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    for _ in range(rounds):
        sums, counts = numpy.zeros_like(vertices), numpy.zeros(len(vertices))
        for u, v in ((0, 1), (1, 0)):
            numpy.add.at(sums, edges[:, u], vertices[edges[:, v]])
            numpy.add.at(counts, edges[:, u], 1)
        vertices = vertices + 0.5 * (sums / counts[:, None] - vertices)
    return vertices


def by_the_lab(binary, a, b):
    with tempfile.TemporaryDirectory() as folder:
        pair = [pathlib.Path(folder, f"{k}.obj") for k in "ab"]
        write(pair[0], *a)
        write(pair[1], *b)
        said = subprocess.run([binary, "compare", *pair, "--perceived", "--json"],
                              check=True, capture_output=True, text=True).stdout
    return json.loads(said)["perceived"]


def step(colour):
    """The place of a colour of the usual rainbow from dark blue to dark red, from 0 to 255."""
    r, g, b = colour
    if r == 0 and g == 0:
        return round((b - 33 / 64) * 64)
    if r == 0 and b == 1:
        return 31 + round(g * 64)
    if r == 1 and b == 0:
        return 160 + round((1 - g) * 64)
    if g == 1:
        return 95 + round(r * 64)
    return 224 + round((1 - r) * 64)


def coloured(path):
    """Vertices, triangles and steps of an OBJ whose vertices have colours; nothing is reordered."""
    lines = [line.split() for line in open(path)]
    numbers = numpy.array([[float(x) for x in line[1:7]] for line in lines if line[:1] == ["v"]])
    faces = [[int(x.split("/")[0]) - 1 for x in line[1:4]] for line in lines if line[:1] == ["f"]]
    return numbers[:, :3], numpy.array(faces), numpy.array([step(c) for c in numbers[:, 3:]])


def published(original, reference, binary):
    vertices, faces, steps = coloured(reference)
    mesh = trimesh.load(original, process=False, maintain_order=True, force="mesh")
    a, b = Shape(vertices, faces), Shape(mesh.vertices.view(numpy.ndarray), mesh.faces)
    local = local_values(a, b)
    own = numpy.floor(255 * (local - local.min()) / (local.max() - local.min())).astype(int)
    apart = abs(own - steps)
    print(f"{len(steps)} vertices, steps of {local.min():.4f} to {local.max():.4f} in 255: "
          f"{(apart == 0).sum()} the same, {(apart == 1).sum()} one apart, {(apart > 1).sum()} more; "
          f"correlation {numpy.corrcoef(local, steps)[0, 1]:.6f}")
    # The cow has one position twice, each with a fan of its own. The program keeps both, the lab one.
    a, b = welded(vertices, faces), welded(mesh.vertices, mesh.faces)
    print(f"both ways, welded: literal {msdm2(Shape(*a), Shape(*b)):.6f}, lab {by_the_lab(binary, a, b):.6f}")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("meshes", nargs="*", type=pathlib.Path)
    parser.add_argument("--published", nargs=2, type=pathlib.Path, metavar=("ORIGINAL", "REFERENCE"))
    parser.add_argument("--binary", default="target/release/quadmark")
    options = parser.parse_args()
    if not options.meshes and not options.published:
        parser.error("name meshes, or a published pair")
    if options.published:
        published(*options.published, options.binary)
    if not options.meshes:
        return
    print("| mesh | change | lab | literal | apart |")
    print("|---|---|---|---|---|")
    for path in options.meshes:
        vertices, faces = read(path)
        size = numpy.linalg.norm(vertices - vertices.mean(0), axis=1).max()
        random = numpy.random.default_rng(1)
        changes = {}
        for share in (0.0005, 0.002):
            steps = random.normal(size=vertices.shape)
            steps /= numpy.linalg.norm(steps, axis=1, keepdims=True)
            changes[f"noise {100 * share:g} %"] = vertices + share * size * steps
        changes["smoothing 0.5 x 3"] = smoothed(vertices, faces, 3)
        # The same in other languages: no random numbers.
        waves = numpy.sin(vertices / size * (97, 101, 103))
        for share in (0.002, 0.02):
            changes[f"waves {100 * share:g} %"] = vertices + share * size * waves
        for name, moved in changes.items():
            lab = by_the_lab(options.binary, (vertices, faces), (moved, faces))
            literal = msdm2(Shape(vertices, faces), Shape(moved, faces))
            row = f"| {path.stem} | {name} | {lab:.6f} | {literal:.6f} | {abs(lab - literal):.1e} |"
            print(row, flush=True)


if __name__ == "__main__":
    main()
