"""What the command line says and writes: a table, a report for machines, the changed points, a page (chapter 18)."""

from __future__ import annotations

import json
from collections.abc import Sequence
from html import escape
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np

from gmmcd_teach.clouds import Floats, write_cloud
from gmmcd_teach.detection import Detection
from gmmcd_teach.formats.mixtures import write_mixture
from gmmcd_teach.regions import Region

if TYPE_CHECKING:
    from gmmcd_teach.figures import Camera

FILES = (
    "appeared.ply", "disappeared.ply", "before_mixture.npz", "after_mixture.npz", "report.json", "report.html",
    "report.png",
)  # fmt: skip
LISTED = 10  # groups of each kind in the table for a person
SEEN = "share of the group's points where the other scan looked past them, at something farther away"
NEAR = (
    "share of the group's points that have nothing of the other scan near; it is high in the other scan's shadow, too"
)
STYLE = (
    "<style>.found{border-collapse:collapse;width:100%}.found th,.found td{padding:.2rem .6rem;text-align:right;"
    "border-bottom:1px solid #c9ced4}.found th:first-child,.found td:first-child{text-align:left}"
    ".warning{border-left:4px solid #d55e00;padding-left:.6rem}div:has(>.found){overflow-x:auto}</style>"
)


def table(report: dict[str, Any]) -> str:
    """The report in a few lines for a person.

    Examples
    --------
    >>> side = {"points": 9, "appeared": 0, "disappeared": 0}
    >>> nothing = {"appeared": [], "disappeared": []}
    >>> print(table({"method": "m", "before": side, "after": side, "seconds": {"total": 1.0}, "regions": nothing}))
    m: 0 of 9 points appeared, 0 of 9 disappeared (1.0 s)
    """
    lines = [
        f"{report['method']}: {report['after']['appeared']} of {report['after']['points']} points appeared, "
        f"{report['before']['disappeared']} of {report['before']['points']} disappeared "
        f"({report['seconds']['total']:.1f} s)"
    ]
    if any(report["regions"].values()):
        lines.append(f"{'':>15}{'points':>8}   {'center x, y, z [m]':<23}{'size x, y, z [m]':<19}{'confidence':>10}")
    for kind, number, region in _numbered(report):
        if number <= LISTED:
            center = "".join(f" {x:7.2f}" for x in region["center"])
            size = "".join(f" {x:5.2f}" for x in region["size"])
            lines.append(f"{kind:<12}{number:>3} {region['n_points']:>7} {center} {size}{region['confidence']:11.2f}")
    for kind, groups in report["regions"].items():
        if len(groups) > LISTED:
            lines.append(f"and {len(groups) - LISTED} smaller groups that {kind}: see report.json")
    return "\n".join([*lines, *(fill(words, 79) for words in _notes(report))])


def _notes(report: dict[str, Any]) -> list[str]:
    """What confidence means, for the kinds of change that were found."""
    words = {kind: report["confidence"][kind] for kind, found in report["regions"].items() if found}
    if len(words) > len(set(words.values())):
        return [f"Confidence: {next(iter(words.values()))}."]
    return [f"Confidence, {kind}: {meaning}." for kind, meaning in words.items()]


def _numbered(report: dict[str, Any]) -> list[tuple[str, int, dict[str, Any]]]:
    return [(kind, i, region) for kind, found in report["regions"].items() for i, region in enumerate(found, start=1)]


def found_table(report: dict[str, Any]) -> str:
    """The same as HTML, to stand beneath the view: warnings, what was found, and what confidence means."""
    rows = "".join(
        f"<tr><td>{kind} {number}</td><td>{region['n_points']}</td>"
        f"<td>{', '.join(f'{x:.2f}' for x in region['center'])}</td>"
        f"<td>{' × '.join(f'{x:.2f}' for x in region['size'])}</td><td>{region['confidence']:.2f}</td></tr>"
        for kind, number, region in _numbered(report)
    )
    heads = ("what", "points", "center x, y, z [m]", "size x, y, z [m]", "confidence")
    body = f"<table class='found'><tr>{''.join(f'<th>{head}</th>' for head in heads)}</tr>{rows}</table>"
    warnings = "".join(f"<p class='warning'>{escape(warning)}</p>" for warning in report["warnings"])
    first, _, _ = table(report).partition("\n")
    note = "".join(f"<p>{escape(words)}</p>" for words in _notes(report))
    found = f"<div>{body}</div>{note}" if rows else "<p>No group of ten points or more has changed.</p>"
    return f"{STYLE}{warnings}<p>{escape(first)}</p>{found}"


def write_results(
    folder: Path, before: Floats, after: Floats, detection: Detection, report: dict[str, Any], camera: str | Camera
) -> None:
    """Write all files of one detection into a folder."""
    from gmmcd_teach.figures import Points, view  # waits for PyVista: only here, so that --help is quick
    from gmmcd_teach.figures.raster import panels_png

    for name, points, changed in (
        ("appeared", after, detection.appeared),
        ("disappeared", before, detection.disappeared),
    ):
        if changed.any():
            write_cloud(folder / f"{name}.ply", points[changed])
    for name, mixture in (("before", detection.before_mixture), ("after", detection.after_mixture)):
        if mixture is not None:
            write_mixture(folder / f"{name}_mixture.npz", mixture)
    (folder / "report.json").write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")
    clouds = {
        "before": Points(before, masks={"disappeared": detection.disappeared}),
        "after": Points(after, masks={"appeared": detection.appeared}),
    }
    (folder / "report.png").write_bytes(panels_png(clouds, camera))
    words = f"{report['before']['disappeared']} points disappeared, {report['after']['appeared']} points appeared."
    panels = {title: [cloud] for title, cloud in clouds.items()}
    page = view(panels, alt=f"Two scans side by side. {words}", caption=words, height=620, camera=camera)
    page.save(folder / "report.html", title="What changed", extra=found_table(report))


def good_camera(points: Floats, origin: Floats | None) -> str | Camera:
    """From where to look at a scan (N, 3): from behind its sensor where that is known, else from above at a slant.

    Points that all lie within a cone before the origin, along z, are taken to be in a depth camera's own frame.

    Examples
    --------
    >>> good_camera(np.array([[0.1, 0.2, 1.0], [0.3, -0.2, 2.0]]), None)
    'sensor'
    >>> good_camera(np.array([[0.1, 0.2, 1.0], [3.0, -0.2, 2.0]]), None)
    'oblique'
    """
    from gmmcd_teach.figures import Camera

    if (np.hypot(points[:, 0], points[:, 1]) < 1.2 * points[:, 2]).all():
        return "sensor"
    low, high = np.quantile(points, [0.01, 0.99], axis=0)
    middle, radius = (low + high) / 2, float(np.linalg.norm(high - low)) / 2
    if origin is None or not 0 < np.linalg.norm(middle - origin) < np.inf or radius == 0:
        return "oblique"
    forward = (middle - origin) / np.linalg.norm(middle - origin) - [0, 0, 0.35]  # from a little above
    if np.hypot(forward[0], forward[1]) < 0.2:
        return "top"
    place = middle - forward / np.linalg.norm(forward) * radius / np.tan(np.radians(15))
    return Camera(_triple(place), _triple(middle), (0.0, 0.0, 1.0))


def _triple(vector: Sequence[float] | Floats) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in vector)
    return x, y, z


def as_numbers(regions: Sequence[Region]) -> list[dict[str, Any]]:
    """Regions as plain numbers, for JSON: lengths to a tenth of a millimetre, confidence to a hundredth."""
    return [
        {
            "n_points": region.n_points,
            "center": [round(x, 4) for x in region.center],
            "size": [round(x, 4) for x in region.size],
            "confidence": None if region.confidence is None else round(region.confidence, 2),
        }
        for region in regions
    ]
