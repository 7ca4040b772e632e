"""Draws `docs/images/architecture.svg`: the folders of sapopt in their layers, and the way of four calls.

    python tools/architecture.py

`LAYERS` is that of tests/test_package.py, which checks that imports run downwards; tests/docs/test_architecture.py
checks that the two agree, that the calls really pass through the folders named here, and that the picture is up to
date.
"""

from __future__ import annotations

from pathlib import Path
from xml.sax.saxutils import escape

from sapopt.data.files import write_text

TARGET = Path(__file__).resolve().parents[1] / "docs" / "images" / "architecture.svg"

LAYERS = (
    ("cli",),
    ("sweeps",),
    ("warming",),
    ("api", "live"),
    ("domains", "exchange", "learning", "report"),
    ("solvers", "plotting"),
    ("formulations",),
    ("running", "proofs"),
    ("problem",),
    ("dynamics",),
    ("data",),
    ("kernels",),
)
"""From the top down, as in tests/test_package.py."""

ABOUT = {
    "cli": "the program sapopt",
    "sweeps": "many jobs, many machines",
    "warming": "compiling before the clock starts",
    "api": "solve, bound, certify",
    "live": "sessions: step by step",
    "domains": "instances",
    "exchange": "tables, files",
    "learning": "REDA",
    "report": "HTML page",
    "solvers": "policies, planners",
    "plotting": "figures",
    "formulations": "bounds, programmes to take away",
    "running": "clock, outlook",
    "proofs": "certificates",
    "problem": "SAP, Result",
    "dynamics": "state models, a folder for each family",
    "data": "benefits, windows, assignment, files",
    "kernels": "compiled code",
}
"""What is in each folder, in a few words."""

JOURNEYS = {
    "solve": ("api", "solvers", "running", "problem", "dynamics", "data", "kernels"),
    "bound": ("api", "formulations", "running", "problem", "dynamics", "data", "kernels"),
    "certify": ("api", "proofs", "problem", "dynamics", "data"),
    "verify": ("proofs", "problem", "dynamics", "data"),
}
"""The folders whose code runs in a call: `solve` with HAAL, `bound`, `certify` with prices at hand, `verify`."""

LEFT, WIDTH, ROW, HEAD, GAP = 10, 264, 50, 74, 6
LANES = {name: 300 + 34 * place for place, name in enumerate(JOURNEYS)}
STYLE = """
text { font-family: system-ui, "Segoe UI", Roboto, Helvetica, Arial, sans-serif; fill: #1b2733; }
.page { fill: #ffffff; } .box { fill: #e9eff6; stroke: #7f94ab; } .name { font-size: 14px; font-weight: 600; }
.about { font-size: 11px; fill: #46586b; } .lane { font-size: 13px; font-weight: 600; } .line { stroke-width: 3; }
.solve { stroke: #0062a3; fill: #0062a3; } .bound { stroke: #a84300; fill: #a84300; }
.certify { stroke: #00704f; fill: #00704f; } .verify { stroke: #8a3a78; fill: #8a3a78; } text.lane { stroke: none; }
@media (prefers-color-scheme: dark) {
  text { fill: #e6edf3; } .page { fill: #14181d; } .box { fill: #24303c; stroke: #64788c; } .about { fill: #b3c0cd; }
  .solve { stroke: #62b3f0; fill: #62b3f0; } .bound { stroke: #f29a55; fill: #f29a55; }
  .certify { stroke: #4fc99f; fill: #4fc99f; } .verify { stroke: #d795c8; fill: #d795c8; }
}
"""


def drawing() -> str:
    """The picture as SVG. It has a ground of its own, so that it can be read on light and on dark pages."""
    width, height = max(LANES.values()) + 38, HEAD + ROW * len(LAYERS) + 30
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" viewBox="0 0 {width} {height}" '
        'role="img" aria-labelledby="title">',
        '<title id="title">The folders of sapopt in their layers, and the way of four calls through them</title>',
        f"<style>{STYLE}</style>",
        f'<rect class="page" width="{width}" height="{height}" rx="8"/>',
        text(LEFT, 26, "name", "Each folder imports"),
        text(LEFT, 44, "name", "only from those below it."),
        text(LEFT, 62, "about", "Dots: whose code runs in a call"),
    ]
    tops = {name: HEAD + ROW * level for level, names in enumerate(LAYERS) for name in names}
    for names in LAYERS:
        share = (WIDTH + GAP) / len(names)
        for place, name in enumerate(names):
            x, y = LEFT + share * place, tops[name]
            parts += [
                f'<rect class="box" x="{x:.1f}" y="{y}" width="{share - GAP:.1f}" height="{ROW - GAP}" rx="5"/>',
                text(x + 8, y + 19, "name", name),
                text(x + 8, y + 35, "about", ABOUT[name]),
            ]
    for call, stops in JOURNEYS.items():
        x, heights = LANES[call], sorted({tops[name] + (ROW - GAP) // 2 for name in stops})
        parts += [
            f'<text class="lane {call}" transform="translate({x + 5},{HEAD - 6}) rotate(-60)">{call}</text>',
            f'<path class="line {call}" d="M{x},{heights[0]} V{heights[-1]}"/>',
            *(f'<circle class="{call}" cx="{x}" cy="{y}" r="6"/>' for y in heights),
        ]
    parts.append(
        text(LEFT, height - 10, "about", "solve and bound use running; certify and verify use proofs.")
    )
    return "\n".join([*parts, "</svg>", ""])


def text(x: float, y: float, kind: str, words: str) -> str:
    """A line of text."""
    return f'<text class="{kind}" x="{x:.1f}" y="{y}">{escape(words)}</text>'


if __name__ == "__main__":
    write_text(TARGET, drawing())
    print(f"wrote {TARGET}")
