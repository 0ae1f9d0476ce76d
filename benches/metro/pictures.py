#!/usr/bin/env python3
"""Host and marked mesh side by side, shaded with a specular light, and their difference, enlarged.

Usage: pictures.py OUT.png HOST MARKED [--turn DEGREES] [--zoom FACTOR] [--flat]

A glossy surface under one light shows what a mark does to normals: the eye finds ripples in a highlight
that no shape of its own would have. From left to right: the host, the marked mesh, and ten times the
difference of their shades. Normals are those of vertices, averaged by area; with --flat those of triangles.
Needs numpy, numba, pillow and trimesh.
"""
import argparse

import numba
import numpy as np
import trimesh
from PIL import Image

SIZE = 900


@numba.njit
def drawn(points, triangles, normals, flat, size):
    """Shades of an orthographic view from +z of points within [-1, 1]; nan where nothing is."""
    depth = np.full((size, size), -np.inf)
    shade = np.full((size, size), np.nan)
    light = np.array([0.35, 0.45, 0.82])
    half = light + np.array([0.0, 0.0, 1.0])
    half /= np.sqrt((half * half).sum())
    screen = (points[:, :2] + 1.0) * 0.5 * (size - 1)
    for t in range(triangles.shape[0]):
        a, b, c = triangles[t]
        ax, ay = screen[a]
        bx, by = screen[b]
        cx, cy = screen[c]
        area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
        if abs(area) < 1e-12:
            continue
        x0 = max(0, int(np.floor(min(ax, bx, cx))))
        x1 = min(size - 1, int(np.ceil(max(ax, bx, cx))))
        y0 = max(0, int(np.floor(min(ay, by, cy))))
        y1 = min(size - 1, int(np.ceil(max(ay, by, cy))))
        for y in range(y0, y1 + 1):
            for x in range(x0, x1 + 1):
                u = ((bx - x) * (cy - y) - (cx - x) * (by - y)) / area
                v = ((cx - x) * (ay - y) - (ax - x) * (cy - y)) / area
                w = 1.0 - u - v
                if u < 0 or v < 0 or w < 0:
                    continue
                z = u * points[a, 2] + v * points[b, 2] + w * points[c, 2]
                if z <= depth[y, x]:
                    continue
                depth[y, x] = z
                if flat:
                    n = np.cross(points[b] - points[a], points[c] - points[a])
                else:
                    n = u * normals[a] + v * normals[b] + w * normals[c]
                n = n / (np.sqrt((n * n).sum()) + 1e-300)
                if n[2] < 0:
                    n = -n
                diffuse = max(0.0, (n * light).sum())
                gloss = max(0.0, (n * half).sum()) ** 60
                shade[y, x] = min(1.0, 0.12 + 0.5 * diffuse + 0.6 * gloss)
    return shade


def view(mesh, centre, scale, turn, zoom, flat):
    a = np.radians(turn)
    about_y = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
    b = np.radians(20)
    about_x = np.array([[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]])
    turned = about_x @ about_y
    points = (np.asarray(mesh.vertices) - centre) @ turned.T * (zoom / scale)
    corners = points[mesh.faces]
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(points)
    for k in range(3):
        np.add.at(normals, mesh.faces[:, k], areas)
    return drawn(points, np.asarray(mesh.faces), normals, flat, SIZE)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out")
    parser.add_argument("host")
    parser.add_argument("marked")
    parser.add_argument("--turn", type=float, default=30)
    parser.add_argument("--zoom", type=float, default=1)
    parser.add_argument("--flat", action="store_true")
    o = parser.parse_args()
    host, marked = (trimesh.load(f, force="mesh", process=False) for f in (o.host, o.marked))
    low, high = host.bounds
    centre, scale = (low + high) / 2, np.linalg.norm(high - low) / 2
    shades = [view(m, centre, scale, o.turn, o.zoom, o.flat) for m in (host, marked)]
    difference = 0.5 + 5 * (shades[1] - shades[0])
    images = [np.clip(np.nan_to_num(s, nan=1.0), 0, 1)[::-1] for s in [*shades, difference]]
    Image.fromarray((255 * np.hstack(images)).astype(np.uint8)).save(o.out)
    both = ~(np.isnan(shades[0]) | np.isnan(shades[1]))
    off = np.abs(shades[1] - shades[0])[both]
    print(f"{o.out}: shades differ by {off.mean():.4f} in the mean, {np.quantile(off, 0.99):.4f} at 99 %")


if __name__ == "__main__":
    main()
