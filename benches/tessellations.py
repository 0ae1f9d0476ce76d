"""Suspects with a tessellation of their own, for `benches/registration.rs`.

    python benches/tessellations.py QUADMARK HOST.obj OUT

marks HOST with the QUADMARK binary and writes simplified, remeshed and subdivided copies of the
marked mesh, whole and cropped, to OUT; prints the arguments for the benchmark. Needs pymeshlab.
"""

import subprocess
import sys
from pathlib import Path

try:
    import pymeshlab
except ImportError:
    sys.exit("skipped: pymeshlab is not installed")


def simplified(share):
    def attack(meshes):
        faces = int(meshes.current_mesh().face_number() * share)
        meshes.meshing_decimation_quadric_edge_collapse(targetfacenum=faces)

    return attack


def remeshed(meshes):
    meshes.meshing_isotropic_explicit_remeshing(
        iterations=5, targetlen=pymeshlab.PercentageValue(1.0)
    )


def subdivided(meshes):
    meshes.meshing_surface_subdivision_loop(
        iterations=1, threshold=pymeshlab.PercentageValue(0.0)
    )


ATTACKS = {
    "simplified50": simplified(0.5),
    "simplified10": simplified(0.1),
    "remeshed": remeshed,
    "loop": subdivided,
}


def cropped(meshes, kept):
    """Keeps what lies beyond a plane across the box, at this share of its first axis."""
    box = meshes.current_mesh().bounding_box()
    x = box.max()[0] - kept * box.dim_x()
    z, depth = box.center()[2], box.dim_z()
    meshes.compute_selection_by_condition_per_vertex(
        condselect=f"(x + 0.3 * (z - ({z})) * {box.dim_x() / depth} < {x})"
    )
    meshes.meshing_remove_selected_vertices()


def main(quadmark, host, out):
    out.mkdir(parents=True, exist_ok=True)
    marked = out / f"{host.stem}-marked.obj"
    key = "07" * 32
    subprocess.run(
        [quadmark, "embed", host, "-o", marked, "--key", key, "--message", "0123456789abcdef"],
        check=True,
    )
    for name, attack in ATTACKS.items():
        for kept in (1.0, 0.5, 0.25):
            meshes = pymeshlab.MeshSet()
            meshes.load_new_mesh(str(marked))
            meshes.meshing_remove_unreferenced_vertices()
            attack(meshes)
            if kept < 1.0:
                cropped(meshes, kept)
            file = out / f"{host.stem}-{name}-{int(100 * kept)}.obj"
            meshes.save_current_mesh(str(file), save_vertex_normal=False)
            print(f"{host}={file}")


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3]))
