#!/usr/bin/env python3
"""Fits the model of `quadmark::lab::expected` to a run of the lab's quick grid.

    quadmark lab FILE... --grid quick --trials N --methods ... --strengths ... --bits ... --out DIR
    python3 benches/lab/expected.py DIR FILE... [--binary target/release/quadmark]

Prints `src/lab/expected/table.rs`. Per attack, ln of a bin's signal over its noise is linear in the
logarithms of strength, vertices per bin and the object's size in bins, with an offset for variance
methods; the error is the root mean square over meshes that were left out of the fit one by one.
"""

import argparse
import collections
import csv
import json
import math
import pathlib
import subprocess

import numpy
from scipy.optimize import least_squares
from scipy.special import ndtr

# What physics says: signal in proportion to strength, noise to one over the root of the count.
PRIOR = numpy.array([0.0, 1.0, 0.5, 0.0, 0.0])
# Three times as weak, meshes that were left out came out worse.
STRENGTH_OF_PRIOR = numpy.array([0.06, 0.9, 0.9, 0.9, 0.9])


def bound(bins, agreement):
    """log10 of the Chernoff bound at an agreement between -1 and 1 of equal weights."""
    if agreement <= 0:
        return 0.0
    a = min(agreement, 1 - 1e-12)
    s = math.atanh(a)
    return bins * (math.log(math.cosh(s)) - s * a) / math.log(10)


def features(inspection, strength, variance):
    width = (inspection["rho_max"] - inspection["rho_min"]) / inspection["bits"]
    return numpy.array([1.0, math.log(strength), math.log(max(inspection["median_count"], 1)),
                        math.log(inspection["rho_max"] / width), float(variance)])


def predicted(theta, x, bins):
    signal = math.exp(max(-20.0, min(5.0, float(theta @ x))))
    return bound(bins, 2 * ndtr(signal) - 1)


def fit(samples):
    def residuals(theta):
        errors = [predicted(theta, x, bins) - y for x, bins, y in samples]
        return numpy.concatenate([errors, len(samples) ** 0.5 * STRENGTH_OF_PRIOR * (theta - PRIOR)])
    best = None
    for start in (-1.0, 1.5):
        found = least_squares(residuals, PRIOR + [start, 0, 0, 0, 0], max_nfev=60)
        if best is None or found.cost < best.cost:
            best = found
    return best.x


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("results", type=pathlib.Path)
    parser.add_argument("meshes", nargs="+", type=pathlib.Path)
    parser.add_argument("--binary", default="target/release/quadmark")
    options = parser.parse_args()
    files = {path.stem: path for path in options.meshes}
    inspections = {}

    def inspect(mesh, method, bits):
        key = mesh, bits
        if key not in inspections:
            inspections[key] = json.loads(subprocess.run(
                [options.binary, "inspect", files[mesh], "--bits", bits, "--method", method, "--json"],
                check=True, capture_output=True).stdout)
        return inspections[key]

    samples = collections.defaultdict(list)
    for row in csv.DictReader(open(options.results / "results.csv")):
        if row["error"] or row["mesh"] not in files:
            continue
        seen = inspect(row["mesh"], row["method"], row["bits"])
        x = features(seen, float(row["strength"]), row["method"].endswith("var"))
        samples[row["attack"]].append(
            (row["mesh"], (x, seen["usable_bins"], float(row["log10_bound"]))))
    print("//! Fitted by `benches/lab/expected.py`; do not edit.\n")
    print("use super::Coefficients;\n")
    print("/// In the order of the quick grid.")
    print(f"pub const TABLE: [Coefficients; {len(samples)}] = [")
    total = []
    for attack, own in samples.items():
        theta = fit([sample for _, sample in own])
        errors = []
        for left_out in sorted({mesh for mesh, _ in own}):
            without = fit([sample for mesh, sample in own if mesh != left_out])
            errors += [predicted(without, x, bins) - y
                       for mesh, (x, bins, y) in own if mesh == left_out]
        error = float(numpy.sqrt(numpy.mean(numpy.square(errors))))
        total += errors
        numbers = ", ".join(f"{t:.4f}" for t in theta)
        print("    Coefficients {")
        print(f"        attack: {json.dumps(attack)},\n        theta: [{numbers}],")
        print(f"        error: {error:.2f},\n    }},")
    print("];")
    count = len(next(iter(samples.values())))
    print(f"// {count} marks of {len({m for own in samples.values() for m, _ in own})} meshes; "
          f"all attacks together: {numpy.sqrt(numpy.mean(numpy.square(total))):.2f}")


if __name__ == "__main__":
    main()
