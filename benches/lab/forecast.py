#!/usr/bin/env python3
"""Fits the model of `quadmark::forecast` to a run of the lab's blind grid.

    quadmark lab FILE... --grid blind --trials N --methods ... --strengths ... --bits ... --out DIR
    python3 benches/lab/forecast.py DIR FILE... [--binary target/release/quadmark]

Prints `src/forecast/table.rs`, and on standard error what each model is worth. Two models per
attack. From counts: ln of a bin's signal over its noise is linear in the logarithms of strength,
vertices per bin and the object's size in bins, with an offset for variance methods. From a rehearsal,
as `quadmark inspect --json` tells it: a line from the rehearsed bound to the measured one. Errors are
root mean squares over meshes that were left out of the fit one by one.
"""

import argparse
import collections
import csv
import json
import math
import pathlib
import subprocess
import sys

import numpy
from scipy.optimize import least_squares
from scipy.special import ndtr

# What physics says: signal in proportion to strength, noise to one over the root of the count.
PRIOR = numpy.array([0.0, 1.0, 0.5, 0.0, 0.0])
# Three times as weak, meshes that were left out came out worse.
STRENGTH_OF_PRIOR = numpy.array([0.06, 0.9, 0.9, 0.9, 0.9])
# A rehearsal tells the truth unless the data say otherwise, in marks.
RANKED = 4.0


def bound(bins, agreement):
    """log10 of the Chernoff bound at an agreement between -1 and 1 of equal weights."""
    if agreement <= 0:
        return 0.0
    a = min(agreement, 1 - 1e-12)
    s = math.atanh(a)
    return bins * (math.log(math.cosh(s)) - s * a) / math.log(10)


class Sample:
    def __init__(self, row, seen):
        width = (seen["rho_max"] - seen["rho_min"]) / seen["bits"]
        self.mesh, self.measured = row["mesh"], float(row["log10_bound"])
        self.bins, self.best = seen["usable_bins"], seen["best_log10_fp"]
        self.x = numpy.array([
            1.0, math.log(float(row["strength"])), math.log(max(seen["median_count"], 1)),
            math.log(seen["rho_max"] / width), float(row["method"].endswith("var"))])
        told = [e for e in seen["expected"] if e["attack"] == row["attack"]]
        self.rehearsed = told[0]["rehearsed"] if told else None


def from_counts(theta, sample):
    signal = math.exp(max(-20.0, min(5.0, float(theta @ sample.x))))
    return bound(sample.bins, 2 * ndtr(signal) - 1)


def fit_counts(samples):
    def residuals(theta):
        errors = [from_counts(theta, s) - s.measured for s in samples]
        return numpy.concatenate([errors, len(samples) ** 0.5 * STRENGTH_OF_PRIOR * (theta - PRIOR)])
    best = None
    for start in (-1.0, 1.5):
        found = least_squares(residuals, PRIOR + [start, 0, 0, 0, 0], max_nfev=60)
        if best is None or found.cost < best.cost:
            best = found
    return best.x


def from_rehearsal(line, sample):
    return min(0.0, max(sample.best, line[0] + line[1] * sample.rehearsed))


def fit_rehearsal(samples):
    def residuals(line):
        errors = [from_rehearsal(line, s) - s.measured for s in samples]
        return numpy.concatenate([errors, RANKED ** 0.5 * numpy.array([line[0], 10 * (line[1] - 1)])])
    return least_squares(residuals, [-0.1, 0.95]).x


def left_out(samples, fit, model):
    errors = []
    for mesh in sorted({s.mesh for s in samples}):
        without = fit([s for s in samples if s.mesh != mesh])
        errors += [model(without, s) - s.measured for s in samples if s.mesh == mesh]
    return errors


def rms(errors):
    return float(numpy.sqrt(numpy.mean(numpy.square(errors))))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("results", type=pathlib.Path)
    parser.add_argument("meshes", nargs="+", type=pathlib.Path)
    parser.add_argument("--binary", default="target/release/quadmark")
    options = parser.parse_args()
    files = {path.stem: path for path in options.meshes}
    if len(files) < len(options.meshes):
        parser.error("meshes in several folders have the same name: rename one, and run the lab again")
    inspections = {}

    def inspect(row):
        key = tuple(row[name] for name in ("mesh", "bits", "method", "strength"))
        if key not in inspections:
            mesh, bits, method, strength = key
            inspections[key] = json.loads(subprocess.run(
                [options.binary, "inspect", files[mesh], "--bits", bits, "--method", method,
                 "--strength", strength, "--json"], check=True, capture_output=True).stdout)
        return inspections[key]

    samples = collections.defaultdict(list)
    for row in csv.DictReader(open(options.results / "results.csv")):
        if row["mesh"] not in files:
            parser.error(f"name the file of {row['mesh']}, too: the rows are of it")
        if not row["error"]:
            samples[row["attack"]].append(Sample(row, inspect(row)))
    count = len(next(iter(samples.values())))
    meshes = {s.mesh for own in samples.values() for s in own}
    print(f"//! Fitted by `benches/lab/forecast.py` to {count} marks of {len(meshes)} meshes; do not "
          "edit.\n")
    print("use super::{Coefficients, Line};\n")
    print("/// In the order of the attacks.")
    print(f"pub const TABLE: [Coefficients; {len(samples)}] = [")
    totals = [], []
    print("attack | deviation | counts | rehearsal as it is | rehearsal, fitted", file=sys.stderr)
    for attack, own in samples.items():
        theta, counts = fit_counts(own), left_out(own, fit_counts, from_counts)
        numbers = ", ".join(f"{t:.4f}" for t in theta)
        print("    Coefficients {")
        print(f"        attack: {json.dumps(attack)},\n        theta: [{numbers}],")
        print(f"        error: {max(rms(counts), 0.01):.2f},")
        told = [s for s in own if s.rehearsed is not None]
        deviation = numpy.std([s.measured for s in own])
        said = f"{attack} | {deviation:.2f} | {rms(counts):.2f}"
        told = told if len(told) > 0.8 * len(own) else []
        if told:
            line, fitted = fit_rehearsal(told), left_out(told, fit_rehearsal, from_rehearsal)
            as_is = rms([s.rehearsed - s.measured for s in told])
            said += f" | {as_is:.2f} | {rms(fitted):.2f}"
        # Only where it tells more than counts.
        errors = fitted if told and rms(fitted) < rms(counts) else counts
        if errors is counts:
            print("        line: None,")
        else:
            print("        line: Some(Line {")
            print(f"            start: {line[0]:.4f},\n            slope: {line[1]:.4f},")
            print(f"            error: {max(rms(errors), 0.01):.2f},\n        }}),")
        print("    },")
        print(said, file=sys.stderr)
        totals[0].extend(counts)
        totals[1].extend(errors)
    print("];")
    print(f"all | | {rms(totals[0]):.2f} | | {rms(totals[1]):.2f}", file=sys.stderr)


if __name__ == "__main__":
    main()
