#!/usr/bin/env python3
"""The lab's attacks beside MeshLab's own.

    pip install pymeshlab numpy
    cargo bench --bench attack --no-run
    python3 benches/metro/attacks.py --binary target/release/deps/attack-HASH FILE.obj ...

For each mesh and attack: triangles of both results, the distance between them and the distance of
each from the mesh before (MRMS in percent of the diagonal, Metro's sampling). MeshLab's Laplacian of
any lambda is Taubin smoothing with mu 0. Remeshing is given the edge length that ours came out with.
Cropping, quantisation, noise and sqrt(3) have no counterpart there.
"""

import argparse
import pathlib
import subprocess
import tempfile

import numpy
import pymeshlab


def arrays(path):
    """Used vertices, and triangles with an area; MeshLab's own reader keeps the others."""
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


def load(path):
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(*arrays(path)))
    return meshes


def between(a, b, samples=200_000):
    """MRMS of two pymeshlab meshes: the larger RMS of the two directions, and the diagonal of a."""
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(a)
    meshes.add_mesh(b)
    one_way = lambda i, j: meshes.get_hausdorff_distance(
        sampledmesh=i, targetmesh=j, samplevert=True, sampleedge=True, sampleface=True,
        samplenum=samples, maxdist=pymeshlab.PercentageValue(100))
    there, back = one_way(0, 1), one_way(1, 0)
    return max(there["RMS"], back["RMS"]) / there["diag_mesh_0"]


def smooth(meshes, lam, rounds, _):
    meshes.apply_coord_taubin_smoothing(lambda_=lam, mu=0.0, stepsmoothnum=int(rounds))


def simplify(meshes, share, ours):
    faces = meshes.current_mesh().face_number()
    meshes.meshing_decimation_quadric_edge_collapse(targetfacenum=round(faces * (1 - share)))


def remesh(meshes, _, ours):
    # An equilateral triangle has area sqrt(3)/4 l^2: the goal that ours was near to in the end.
    area = ours.get_geometric_measures()["surface_area"]
    length = (4 * area / (3 ** 0.5 * ours.current_mesh().face_number())) ** 0.5
    meshes.meshing_isotropic_explicit_remeshing(
        iterations=10, targetlen=pymeshlab.PureValue(length), featuredeg=30)


def subdivide(name):
    def apply(meshes, _):
        getattr(meshes, "meshing_surface_subdivision_" + name)(
            iterations=1, threshold=pymeshlab.PureValue(0))
    return apply


ATTACKS = [
    ("smoothing", (0.5, 1), smooth), ("smoothing", (0.5, 10), smooth), ("smoothing", (0.1, 30), smooth),
    ("simplification", (0.5,), simplify), ("simplification", (0.9,), simplify),
    ("remeshing", (1.0,), remesh), ("remeshing", (0.4,), remesh),
    ("midpoint", (), subdivide("midpoint")), ("butterfly", (), subdivide("butterfly")),
    ("loop", (), subdivide("loop")),
]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("meshes", nargs="+", type=pathlib.Path)
    parser.add_argument("--binary", required=True, help="the built benchmark `attack`")
    options = parser.parse_args()
    print(f"{'mesh':18} {'attack':20} {'triangles':>9} {'MeshLab':>9}   "
          f"{'ours-theirs':>11} {'ours-host':>9} {'theirs-host':>11}  (MRMS, % of the diagonal)")
    for mesh in options.meshes:
        # A mesh lives as long as its set.
        before = load(mesh)
        host = before.current_mesh()
        for family, amounts, theirs in ATTACKS:
            with tempfile.TemporaryDirectory() as folder:
                out = pathlib.Path(folder) / "ours.obj"
                subprocess.run([options.binary, mesh, out, family, *map(str, amounts)], check=True)
                ours = load(out)
            meshes = load(mesh)
            theirs(meshes, *amounts, ours)
            a, b = ours.current_mesh(), meshes.current_mesh()
            print(f"{mesh.stem:18} {family + ' ' + ' x '.join(map(str, amounts)):20} "
                  f"{a.face_number():9} {b.face_number():9}   {100 * between(a, b):11.5f} "
                  f"{100 * between(host, a):9.5f} {100 * between(host, b):11.5f}", flush=True)


if __name__ == "__main__":
    main()
