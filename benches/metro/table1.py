#!/usr/bin/env python3
"""Table 1 of Luo and Bors 2009: MRMS of the four methods, measured by MeshLab's Metro.

    cargo build --release
    pip install pymeshlab
    python3 benches/metro/table1.py FOLDER_WITH_OBJ_FILES/{bunny,dragon,gear_involute_g7}.obj

For each mesh and method: single pass (--open-loop), alpha 0.1, 64 bits, the mean over random
keys and messages. Distances are MeshLab's `get_hausdorff_distance` in both directions, the larger
RMS, unreferenced vertices dropped, in the mesh's own unit, with vertices, edges and faces sampled
as the original Metro does (--vertices-only: the filter's default). The last column says how far
our own `quadmark compare` is from it.
"""

import argparse
import json
import pathlib
import secrets
import subprocess
import tempfile

import pymeshlab

METHODS = ["qsp-mean", "qsp-var", "cho-mean", "cho-var"]
PAPER = {  # x 1e-4 of the mesh's unit; the paper's gear is another file than ours
    "bunny": dict(zip(METHODS, [0.25, 0.17, 0.77, 0.37])),
    "dragon": dict(zip(METHODS, [0.23, 0.11, 0.85, 0.44])),
    "gear": dict(zip(METHODS, [447.58, 164.53, 1481.24, 811.89])),
}


def metro(host, marked, samples):
    """MRMS: the larger RMS of the two directions."""
    meshes = pymeshlab.MeshSet()
    for path in (host, marked):
        meshes.load_new_mesh(str(path))
        meshes.meshing_remove_unreferenced_vertices()
    one_way = lambda a, b: meshes.get_hausdorff_distance(
        sampledmesh=a, targetmesh=b, samplevert=True, sampleedge=samples > 0,
        sampleface=samples > 0, samplenum=max(samples, 1), maxdist=pymeshlab.PercentageValue(100))["RMS"]
    return max(one_way(0, 1), one_way(1, 0))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("meshes", nargs="+", type=pathlib.Path)
    parser.add_argument("--keys", type=int, default=10)
    parser.add_argument("--binary", default="target/release/quadmark")
    parser.add_argument("--strength", default="0.1")
    parser.add_argument("--closed-loop", action="store_true", help="the service's own embedding")
    parser.add_argument("--samples", type=int, default=500_000, help="on edges, and on faces")
    parser.add_argument("--vertices-only", dest="samples", action="store_const", const=0)
    options = parser.parse_args()
    loop = [] if options.closed_loop else ["--open-loop"]
    for mesh in options.meshes:
        means = {}
        for method in METHODS:
            total, worst = 0.0, 0.0
            for _ in range(options.keys):
                with tempfile.TemporaryDirectory() as folder:
                    marked = pathlib.Path(folder) / "marked.obj"
                    subprocess.run(
                        [options.binary, "embed", mesh, "-o", marked, "--key",
                         secrets.token_hex(32), "--method", method,
                         "--strength", options.strength, *loop],
                        check=True, capture_output=True)
                    theirs = metro(mesh, marked, options.samples)
                    ours = json.loads(subprocess.run(
                        [options.binary, "compare", mesh, marked, "--json",
                         "--samples", str(options.samples)],
                        check=True, capture_output=True).stdout)
                total += theirs
                worst = max(worst, abs(ours["mrms"] / theirs - 1))
            means[method] = total / options.keys
            name = next((name for name in PAPER if mesh.stem.startswith(name)), None)
            paper = PAPER[name][method] if name else float("nan")
            print(f"{mesh.stem:20} {method:9} mrms {means[method]:.4e} "
                  f"({100 * means[method] / ours['diagonal']:.5f} % of the diagonal)  "
                  f"paper {paper:8.2f}e-4  ours/Metro off by at most {100 * worst:.2f} %", flush=True)
        print(f"{mesh.stem:20} QSP/Cho   mean {means['qsp-mean'] / means['cho-mean']:.3f}  "
              f"variance {means['qsp-var'] / means['cho-var']:.3f}", flush=True)


if __name__ == "__main__":
    main()
