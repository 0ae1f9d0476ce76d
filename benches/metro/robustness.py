#!/usr/bin/env python3
"""Bits right after attacks, at equal distortion: the `exact` methods against `qsp-mean` at 0.1.

    cargo build --release
    pip install pymeshlab numpy
    python3 benches/metro/robustness.py FILE.obj ...

For each mesh and key: `qsp-mean` at strength 0.1 sets the distortion (MRMS, `quadmark compare`);
each other method gets the strength (at most 0.25) whose MRMS comes nearest to it from below. Then
both are attacked alike and read blindly; a bit that is an erasure counts as half right. Attacks are
MeshLab's where it has them: Laplacian smoothing (lambda 0.5 by averaging with the smoothed
positions), quadric simplification, isotropic remeshing.
"""

import argparse
import collections
import json
import pathlib
import subprocess
import tempfile

import numpy
import pymeshlab


def run(options, *words):
    return subprocess.run([options.binary, *map(str, words)], check=True, capture_output=True).stdout


def load(path):
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(*arrays(path)))
    return meshes


def save(vertices, faces, path):
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(vertices, faces))
    meshes.save_current_mesh(str(path), save_vertex_normal=False, save_vertex_color=False)


def arrays(path):
    """Used vertices, and triangles; MeshLab's own reader keeps the unused ones."""
    vertices, faces = [], []
    for line in open(path, encoding="latin-1"):
        words = line.split()
        if words[:1] == ["v"]:
            vertices.append(words[1:4])
        elif words[:1] == ["f"]:
            corners = [int(word.split("/")[0]) - 1 for word in words[1:]]
            faces += [[corners[0], b, c] for b, c in zip(corners[1:], corners[2:])]
    used, faces = numpy.unique(numpy.array(faces), return_inverse=True)
    return numpy.array(vertices, dtype=float)[used], faces.reshape(-1, 3)


def noise(path, out, share, seed):
    vertices, faces = arrays(path)
    random = numpy.random.default_rng(seed)
    direction = random.normal(size=vertices.shape)
    direction /= numpy.linalg.norm(direction, axis=1)[:, None]
    size = numpy.linalg.norm(vertices - vertices.mean(0), axis=1).max()
    save(vertices + share * size * direction, faces, out)


def smooth(path, out, rounds, _):
    vertices, faces = arrays(path)
    edges = numpy.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    edges = numpy.unique(numpy.sort(edges, axis=1), axis=0)
    for _ in range(rounds):
        total, count = numpy.zeros_like(vertices), numpy.zeros(len(vertices))
        for a, b in ((0, 1), (1, 0)):
            numpy.add.at(total, edges[:, a], vertices[edges[:, b]])
            numpy.add.at(count, edges[:, a], 1)
        used = count > 0
        vertices[used] += 0.5 * (total[used] / count[used, None] - vertices[used])
    save(vertices, faces, out)


def quantise(path, out, bits, _):
    vertices, faces = arrays(path)
    low, size = vertices.min(0), (vertices.max(0) - vertices.min(0)).max()
    step = size / (2 ** bits - 1)
    save(low + numpy.round((vertices - low) / step) * step, faces, out)


def simplify(path, out, share, _):
    meshes = load(path)
    faces = int(meshes.current_mesh().face_number() * (1 - share))
    meshes.meshing_decimation_quadric_edge_collapse(targetfacenum=faces)
    meshes.save_current_mesh(str(out))


def remesh(path, out, _, __):
    meshes = load(path)
    edge = meshes.get_geometric_measures()["avg_edge_length"]
    meshes.meshing_isotropic_explicit_remeshing(
        iterations=3, targetlen=pymeshlab.PureValue(edge))
    meshes.save_current_mesh(str(out))


ATTACKS = [
    ("noise 0.3 %", noise, 0.003), ("noise 0.5 %", noise, 0.005),
    ("Laplacian 0.5 x 1", smooth, 1), ("Laplacian 0.5 x 10", smooth, 10),
    ("quantised 8 bits", quantise, 8), ("quantised 7 bits", quantise, 7),
    ("simplified 50 %", simplify, 0.5), ("simplified 90 %", simplify, 0.9),
    ("remeshed", remesh, 0),
]


def embed(options, mesh, out, method, strength, key, message):
    run(options, "embed", mesh, "-o", out, "--key", key, "--message", message,
        "--method", method, "--strength", f"{strength:.4f}")
    return json.loads(run(options, "compare", mesh, out, "--samples", 50000, "--json"))["mrms"]


def at_equal_distortion(options, mesh, out, method, goal, key, message):
    low, high, best = 0.05, 0.25, None
    if embed(options, mesh, out, method, high, key, message) <= goal:
        return high
    for _ in range(4):
        middle = (low + high) / 2
        if embed(options, mesh, out, method, middle, key, message) <= goal:
            low = best = middle
        else:
            high = middle
    strength = best or low
    embed(options, mesh, out, method, strength, key, message)
    return strength


def bits_right(options, path, method, key, message):
    modulation = "variance" if method.endswith("var") else "mean"
    found = json.loads(run(options, "extract", path, "--key", key, "--json",
                           "--modulation", modulation))["bits"]
    meant = [int(message, 16) >> (63 - i) & 1 for i in range(64)]
    return sum(0.5 if f is None else float(f == m) for f, m in zip(found, meant)) / 64


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("meshes", nargs="+", type=pathlib.Path)
    parser.add_argument("--keys", type=int, default=3)
    parser.add_argument("--methods", default="qsp-mean,exact-mean,exact-var")
    parser.add_argument("--binary", default="target/release/quadmark")
    options = parser.parse_args()
    methods = options.methods.split(",")
    total = collections.defaultdict(list)
    for mesh in options.meshes:
        with tempfile.TemporaryDirectory() as folder:
            folder = pathlib.Path(folder)
            for number in range(options.keys):
                random = numpy.random.default_rng(number)
                key, message = random.bytes(32).hex(), random.bytes(8).hex()
                goal = None
                for method in methods:
                    marked, hit = folder / "marked.obj", folder / "attacked.obj"
                    if goal is None:
                        strength = 0.1
                        goal = embed(options, mesh, marked, method, strength, key, message)
                    else:
                        strength = at_equal_distortion(
                            options, mesh, marked, method, goal, key, message)
                    total[method, "strength"].append(strength)
                    for name, attack, amount in ATTACKS:
                        attack(marked, hit, amount, number)
                        total[method, name].append(bits_right(options, hit, method, key, message))
        print(mesh.stem, flush=True)
        for name in ["strength"] + [name for name, *_ in ATTACKS]:
            print(f"  {name:20}", *(f"{m}: {numpy.mean(total[m, name]):.3f}" for m in methods),
                  flush=True)


if __name__ == "__main__":
    main()
