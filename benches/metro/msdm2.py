#!/usr/bin/env python3
"""The lab's MSDM2 beside an independent, literal one.

    python3 benches/metro/msdm2.py FILE.obj... [--binary target/release/quadmark]

needs numpy, scipy and trimesh. Written from the description in Lavoue 2011 and from how the author's
published implementation (MEPP2, `msdm2.h` and `curvature.hpp`) goes about it, with none of its code:
one vertex after the other, in the plainest way. Two variants of the curvature differ in which edges of
a ball are summed. `outward` is what that implementation does: from every vertex that is reached, the
edges that lead away from the ball's centre. `all` is what the definition (Cohen-Steiner and Morvan
2003) says and the lab does: an edge whose nearest point to the centre is in its middle counts too.
Pairs are each mesh with noise and with smoothing. Prints one row per pair.
"""

import argparse
import math
import pathlib
import re
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


def walk(shape, vertex, radius, outward):
    """(from, to, share, angle, is new) for the edges in a ball."""
    centre = shape.places[vertex]
    known, stack = {vertex}, [vertex]
    counted = set()
    while stack:
        u = stack.pop()
        place = shape.places[u]
        for v, angle in shape.spokes[u]:
            edge = minus(shape.places[v], place)
            leads_away = u == vertex or dot(edge, minus(place, centre)) > 0
            if outward and not leads_away:
                continue
            share = inside(place, centre, edge, radius)
            new = share >= 1.0 and v not in known
            if not outward:
                # Each edge once; one that leads nearer is met again from its other end.
                key = (min(u, v), max(u, v))
                nearer = dot(edge, minus(shape.places[v], centre)) < 0
                if not leads_away and nearer or share >= 1.0 and key in counted:
                    if new:
                        known.add(v)
                        stack.append(v)
                        yield u, v, None, None, True
                    continue
                counted.add(key)
            if new:
                known.add(v)
                stack.append(v)
            yield u, v, share, angle, new


def curvatures(shape, radius, outward):
    result = numpy.zeros(len(shape.vertices))
    for vertex in range(len(shape.vertices)):
        tensor = numpy.zeros((3, 3))
        for u, v, share, angle, _ in walk(shape, vertex, radius, outward):
            if angle is None or share is None:
                continue
            edge = share * numpy.subtract(shape.places[v], shape.places[u])
            length = math.sqrt(float(edge @ edge))
            if length > 0:
                tensor += numpy.outer(edge, edge) * (angle / length)
        sizes = numpy.sort(numpy.abs(numpy.linalg.eigvalsh(tensor / (math.pi * radius * radius))))
        result[vertex] = shape.side * (sizes[1] + sizes[2]) / 2
    return result


def matched(a, b):
    """Per vertex of a, the closest point of b, its triangle and weights there."""
    around = [[] for _ in b.vertices]
    for f, corners in enumerate(b.faces.tolist()):
        for v in corners:
            around[v].append(f)
    _, near = cKDTree(b.vertices).query(a.vertices, k=6)
    places = numpy.empty_like(a.vertices)
    triangles = numpy.empty(len(a.vertices), dtype=int)
    for vertex, candidates in enumerate(near):
        faces = sorted({f for v in candidates for f in around[v]})
        corners = b.vertices[b.faces[faces]]
        points = trimesh.triangles.closest_point(corners, numpy.repeat(a.vertices[vertex][None], len(faces), 0))
        best = int(((points - a.vertices[vertex]) ** 2).sum(1).argmin())
        places[vertex], triangles[vertex] = points[best], faces[best]
    weights = trimesh.triangles.points_to_barycentric(b.vertices[b.faces[triangles]], places)
    return places, triangles, numpy.nan_to_num(weights, nan=1 / 3)


def one_sided(a, b, outward):
    places, triangles, weights = matched(a, b)
    feet = [tuple(p) for p in places.tolist()]
    local = numpy.zeros(len(a.vertices))
    for share_of_side in RADII:
        # Both by the size of the surface that is looked at.
        radius = share_of_side * a.side
        own = curvatures(a, radius, outward)
        other = curvatures(b, radius, outward) * a.side / b.side
        other = (other[b.faces[triangles]] * weights).sum(1)
        window = 5 * radius
        for vertex in range(len(a.vertices)):
            samples = [(own[vertex], other[vertex], a.places[vertex], feet[vertex])]
            for u, v, share, _, new in walk(a, vertex, window, outward):
                if new:
                    samples.append((own[v], other[v], a.places[v], feet[v]))
                elif share is not None and share < 1.0:
                    blend = lambda x, y: x + share * (y - x)
                    samples.append((blend(own[u], own[v]), blend(other[u], other[v]),
                                    tuple(map(blend, a.places[u], a.places[v])),
                                    tuple(map(blend, feet[u], feet[v]))))
            local[vertex] += compared(samples, a.places[vertex], feet[vertex], window / 2)
    return float((((local / len(RADII)) ** 3).mean()) ** (1 / 3))


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


def msdm2(a, b, outward):
    return (one_sided(a, b, outward) + one_sided(b, a, outward)) / 2


def read(path):
    mesh = trimesh.load(path, process=False, maintain_order=True, force="mesh", skip_materials=True)
    vertices, index = numpy.unique(mesh.vertices, axis=0, return_inverse=True)
    faces = index.reshape(-1)[mesh.faces]
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


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("meshes", nargs="+", type=pathlib.Path)
    parser.add_argument("--binary", default="target/release/quadmark")
    options = parser.parse_args()
    print("| mesh | change | lab | literal, all edges | literal, outward edges |")
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
        for name, moved in changes.items():
            with tempfile.TemporaryDirectory() as folder:
                pair = [pathlib.Path(folder, f"{k}.obj") for k in "ab"]
                write(pair[0], vertices, faces)
                write(pair[1], moved, faces)
                said = subprocess.run([options.binary, "compare", *pair, "--perceived"],
                                      check=True, capture_output=True, text=True).stdout
            ours = float(re.search(r"perceived ([0-9.e-]+)", said).group(1))
            a, b = Shape(vertices, faces), Shape(moved, faces)
            every, outward = (msdm2(a, b, way) for way in (False, True))
            print(f"| {path.stem} | {name} | {ours:.4f} | {every:.4f} | {outward:.4f} |", flush=True)


if __name__ == "__main__":
    main()
