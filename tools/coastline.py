"""Makes `sapopt/plotting/data/coastline.json`, the land of the maps, from Natural Earth (public domain).

    npm pack world-atlas && tar xzf world-atlas-*.tgz
    python tools/coastline.py package/land-50m.json sapopt/plotting/data/coastline.json

The rings of Natural Earth's 1:50 million land (version 4.1, as the npm package world-atlas 2.0.2 redistributes it) are
simplified (Douglas and Peucker) to 0.12 degrees, the smallest islands are left out, and what remains is rounded to
0.05 degrees.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np

from sapopt.data.files import write_text

TOLERANCE_DEG = 0.12
LEAST_AREA_DEG2 = 0.12
UNIT_DEG = 0.05


def main() -> None:
    source, target = map(Path, sys.argv[1:])
    topology = json.loads(source.read_text(encoding="utf-8"))
    arcs = decoded(topology)
    rings = []
    for geometry in topology["objects"]["land"]["geometries"]:
        for polygon in geometry["arcs"]:
            for numbers in polygon:
                ring = joined(arcs, numbers)
                if area(ring) >= LEAST_AREA_DEG2:
                    rings += [encoded(simplified(part)) for part in cut(ring)]
    rings = sorted((ring for ring in rings if len(ring) >= 8), key=len, reverse=True)
    head = {
        "source": "Natural Earth 1:50m land, version 4.1 (naturalearthdata.com), by way of world-atlas 2.0.2",
        "licence": "public domain",
        "made_by": "tools/coastline.py",
        "unit_deg": UNIT_DEG,
        "form": "each ring: longitude, latitude of its first point, then differences, in units; closed",
    }
    text = (
        json.dumps(head)[:-1]
        + ', "rings": [\n'
        + ",\n".join(json.dumps(r, separators=(",", ":")) for r in rings)
    )
    write_text(target, text + "\n]}\n")
    print(f"{len(rings)} rings, {sum(map(len, rings)) // 2} points, {target.stat().st_size} bytes")


def decoded(topology: dict) -> list[np.ndarray]:
    """The arcs in degrees."""
    scale, shift = topology["transform"]["scale"], topology["transform"]["translate"]
    return [np.cumsum(np.array(arc), axis=0) * scale + shift for arc in topology["arcs"]]


def joined(arcs: list[np.ndarray], numbers: list[int]) -> np.ndarray:
    """One ring from its arcs; a negative number means an arc read backwards."""
    parts = [arcs[k] if k >= 0 else arcs[~k][::-1] for k in numbers]
    return np.concatenate([part if k == 0 else part[1:] for k, part in enumerate(parts)])


def area(ring: np.ndarray) -> float:
    """Area in square degrees."""
    x, y = ring.T
    return abs(float(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]))) / 2


def cut(ring: np.ndarray) -> list[np.ndarray]:
    """The parts of a closed ring on a map from -180 to 180 degrees, so that no outline runs across the whole map.

    A ring that goes round the pole is closed along the lower edge of the map.
    """
    ring = np.column_stack([np.unwrap(ring[:, 0], period=360.0), ring[:, 1]])
    if abs(ring[-1, 0] - ring[0, 0]) > 180.0:
        below = np.array([[ring[-1, 0], -90.0], [ring[0, 0], -90.0]])
        ring = np.concatenate([ring, below, ring[:1]])
    parts = []
    for shift in (-360.0, 0.0, 360.0):
        part = ring[:-1] + np.array([shift, 0.0])
        for sign in (1.0, -1.0):
            part = beside(part, sign)
        if len(part) >= 3 and area(part) > 0:
            parts.append(np.concatenate([part, part[:1]]))
    return parts


def beside(points: np.ndarray, sign: float) -> np.ndarray:
    """What of an outline has ``sign * longitude`` of at most 180 (Sutherland and Hodgman)."""
    out = []
    for before, after in zip(np.roll(points, 1, axis=0), points, strict=True):
        inside = sign * before[0] <= 180.0, sign * after[0] <= 180.0
        if inside[0] != inside[1]:
            share = (sign * 180.0 - before[0]) / (after[0] - before[0])
            out.append([sign * 180.0, before[1] + share * (after[1] - before[1])])
        if inside[1]:
            out.append(list(after))
    return np.array(out).reshape(-1, 2)


def simplified(points: np.ndarray) -> np.ndarray:
    """Douglas and Peucker, on the two halves of the ring."""
    half = int(np.argmax(np.linalg.norm(points - points[0], axis=1)))
    keep = np.zeros(len(points), dtype=bool)
    keep[[0, half, -1]] = True
    stack = [(0, half), (half, len(points) - 1)]
    while stack:
        first, last = stack.pop()
        if last - first < 2:
            continue
        begin, end = points[first], points[last]
        chord = end - begin
        length = float(np.hypot(*chord))
        away = points[first + 1 : last] - begin
        if length > 0:
            distance = np.abs(chord[0] * away[:, 1] - chord[1] * away[:, 0]) / length
        else:
            distance = np.hypot(away[:, 0], away[:, 1])
        worst = int(np.argmax(distance))
        if distance[worst] > TOLERANCE_DEG:
            middle = first + 1 + worst
            keep[middle] = True
            stack += [(first, middle), (middle, last)]
    return points[keep]


def encoded(ring: np.ndarray) -> list[int]:
    """First point and differences, whole units, without repeated points."""
    grid = np.round(ring / UNIT_DEG).astype(int)
    steps = np.diff(grid, axis=0, prepend=np.zeros((1, 2), dtype=int))
    moved = np.any(steps != 0, axis=1)
    moved[0] = True
    return steps[moved].ravel().tolist()


if __name__ == "__main__":
    main()
