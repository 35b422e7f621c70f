"""The one function behind every 3-D scene: a PyVista page that turns with the mouse, offline, and a still of it."""

from __future__ import annotations

import base64
import contextlib
import hashlib
import io
import json
import os
import re
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from html import escape, unescape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gmmcd_teach.formats.atomic import write_text_atomically

from .cards import CARD_STYLE, card, checked_alt, image_tag, png, unique_id
from .page import TEMPLATE
from .scenes import VIEW_ANGLE, Camera, Floats, Layer, Mesh, fitted_camera, is_cloud, thinned
from .style import INK, PAPER

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_STYLE = (
    ".gmmcd-card iframe{display:block;width:100%;border:0;border-radius:.3rem;background:#f6f7f8}"
    ".gmmcd-card summary{cursor:pointer;margin-top:.4rem}"
    ".gmmcd-card .gmmcd-still{display:none}"
    ".gmmcd-card details[open]+.gmmcd-still{display:block}"
    "@media print{.gmmcd-card iframe,.gmmcd-card details{display:none}"
    ".gmmcd-card .gmmcd-still{display:block!important}}"
)
_VIEWER = re.compile(r'<script type="module">(.*?)</script>', re.DOTALL)
_FRAME = re.compile(r'<iframe class="gmmcd-view" srcdoc="([^"]*)"')


@dataclass(frozen=True, eq=False)
class View:
    """A 3-D scene as a notebook shows it; `save` writes it as one page that opens with no network.

    Attributes
    ----------
    panels : title -> meshes, drawn side by side from the same camera.
    extent : metres along x, y and z that all points take, those that are left out too.
    camera, alt, caption, height : where from; what is seen, in words; what to look at; CSS pixels.
    """

    panels: Mapping[str, Sequence[Mesh]]
    extent: Floats
    camera: Camera
    alt: str
    caption: str | None
    height: int

    @cached_property
    def page(self) -> str:
        """The scene as one self-contained HTML page."""
        return _page(self)

    @cached_property
    def still(self) -> bytes:
        """The scene as a PNG, seen by the same camera, drawn by matplotlib."""
        return _still(self)

    def _repr_html_(self) -> str:
        body = (
            f'<iframe class="gmmcd-view" srcdoc="{escape(self.page)}" title="{escape(self.alt)}" '
            f'height="{self.height}" loading="lazy"></iframe>{self._still_html()}'
        )
        return card(body, self.caption, identity=unique_id("view", self.still), style=_STYLE)

    def save(self, path: str | Path, *, title: str = "3-D view", extra: str = "") -> Path:
        """Write the view as one HTML page, all or nothing; `extra` is HTML to stand beneath it. Returns the path."""
        caption = f"<p>{escape(self.caption)}</p>" if self.caption else ""
        below = f'<div class="gmmcd-card">{caption}{self._still_html()}{extra}</div><style>{CARD_STYLE}{_STYLE}</style>'
        page = re.sub(r"<title>.*?</title>", lambda _: f"<title>{escape(title)}</title>", self.page, count=1)
        page = page.replace('<body class="framed">', '<body class="alone">').replace("<!--below-->", below)
        write_text_atomically(Path(path), page)
        return Path(path)

    def _still_html(self) -> str:
        image = image_tag(self.still, self.alt, width=900).replace('class="', 'class="gmmcd-still ', 1)
        always = "<noscript><style>.gmmcd-card .gmmcd-still{display:block!important}</style></noscript>"
        return f"<details><summary>Still picture</summary></details>{image}{always}"


def view(
    layers: Sequence[Layer] | Mapping[str, Sequence[Layer]],
    *,
    alt: str,
    caption: str | None = None,
    camera: str | Camera = "oblique",
    height: int = 480,
    max_points: int = 40_000,
) -> View:
    """Return a 3-D scene that turns with the mouse, in the book, in JupyterLab and as a saved page, with no network.

    Parameters
    ----------
    layers : what to draw (Points, Ellipsoids, Boxes, Lines, Frusta), or panel title -> layers: panels stand side by
        side and turn together. The legend switches each meaning on and off.
    alt : what the scene shows, in words, for readers who do not see it.
    caption : what to look at.
    camera : "oblique", "top", "front", "back", "side" (z up), "sensor" (points in a depth camera's frame), or a Camera.
    height : CSS pixels.
    max_points : points drawn in all panels together, others are left out evenly, the small groups last: 40,000 points
        make a page of about 1.5 MB, of which 1.1 MB is the viewer.

    Raises
    ------
    ValueError
        No alt text, nothing to draw, an unknown camera or colour.
    CloudError
        Points that are not (N, 3) finite numbers.

    Examples
    --------
    >>> from gmmcd_teach.figures import Points, view
    >>> cube = [[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]
    >>> scene = view([Points(cube, "before")], alt="The corners of a cube.")
    >>> list(scene.panels[""])[0].label
    'before'
    """
    alt = checked_alt(alt)
    panels = layers if isinstance(layers, Mapping) else {"": layers}
    drawn = {title: [mesh for layer in panel for mesh in layer.meshes()] for title, panel in panels.items()}
    meshes = [mesh for panel in drawn.values() for mesh in panel]
    if not drawn or any(not panel for panel in drawn.values()):
        raise ValueError("view: nothing to draw; give each panel at least one layer")
    if max_points < 1 or height < 1:
        raise ValueError(f"max_points = {max_points}, height = {height}; both must be at least 1")
    if isinstance(camera, str):
        camera = fitted_camera(meshes, camera, aspect=_aspect(len(drawn)))
    extent = np.ptp(np.concatenate([mesh.vertices for mesh in meshes]), axis=0)
    fewer = iter(thinned(meshes, max_points))
    shown = {title: [next(fewer) for _ in panel] for title, panel in drawn.items()}
    return View(shown, extent, camera, alt, caption, height)


def _aspect(n_panels: int) -> float:
    """Return width / height of the part of a panel that the camera fills."""
    return 1.5 if n_panels == 1 else 1.0


def share_viewer(directory: str | Path) -> int:
    """Let all views of a built book share one copy of the viewer; returns the bytes saved.

    Each view's page moves out of the page that shows it to _static/gmmcd-views/, its data alone, and loads the viewer
    from one script beside it: a script tag and a frame work without a server too. Running it again changes nothing.

    Parameters
    ----------
    directory : the folder of built HTML pages, as _build/html.

    Examples
    --------
    >>> import tempfile
    >>> share_viewer(tempfile.mkdtemp())
    0
    """
    root = Path(directory)
    store = root / "_static" / "gmmcd-views"
    written: dict[Path, str] = {}
    saved = 0

    def put(content: str, suffix: str) -> Path:
        path = store / f"{hashlib.sha256(content.encode()).hexdigest()[:12]}{suffix}"
        written[path] = content
        return path

    for page in sorted(root.rglob("*.html")):
        html = page.read_text(encoding="utf-8")

        def link(match: re.Match[str], page: Path = page) -> str:
            scene = unescape(match[1])
            viewer = _VIEWER.search(scene)
            if viewer is None:
                raise ValueError(f"{page.name}: a 3-D view without its viewer; build the page anew")
            script = put(f"(() => {{\n{viewer[1]}\n}})();\n", ".js")
            shared = f'{scene[: viewer.start()]}<script defer src="{script.name}"></script>{scene[viewer.end() :]}'
            target = os.path.relpath(put(shared, ".html"), page.parent).replace(os.sep, "/")
            return f'<iframe class="gmmcd-view" src="{target}"'

        lighter = _FRAME.sub(link, html)
        if lighter != html:
            saved += len(html.encode()) - len(lighter.encode())
            write_text_atomically(page, lighter)
    for path, content in written.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text_atomically(path, content)
        saved -= len(content.encode())
    return saved


def _page(view: View) -> str:
    """Fill the template: the scene, the viewer that draws it, titles and legend."""
    entries: dict[tuple[str, str], int] = {}
    parts = [[entries.setdefault((m.label, m.key), len(entries)) for m in panel] for panel in view.panels.values()]
    legend = "".join(
        f'<label><input type="checkbox" checked value="{i}"><i style="background:{key}"></i>{escape(label)}</label>'
        for (label, key), i in entries.items()
    )
    extent = " × ".join(f"{length:.2f}" for length in view.extent)
    fields = {
        "PAPER": PAPER,
        "INK": INK,
        "ALT": escape(view.alt),
        "TITLES": "".join(f"<b>{escape(title)}</b>" for title in view.panels),
        "LEGEND": legend,
        "PANELS": _panel_switch(list(view.panels)),
        "EXTENT": f"x, y, z extent {extent} m",
        "PARTS": json.dumps(parts),
        "ANGLE": f"{VIEW_ANGLE:g}",
        "ASPECT": f"{_aspect(len(view.panels)):g}",
        "SCENE": _packed_scene(view),
        "VIEWER": _viewer(),
    }
    return re.sub("@([A-Z]+)@", lambda match: fields[match[1]], TEMPLATE)


def _panel_switch(titles: Sequence[str]) -> str:
    """Return buttons that show all panels or one of them, so that the eye can flick between them in one place."""
    if len(titles) < 2:
        return ""
    buttons = "".join(
        f'<button type="button" value="{i}" aria-pressed="{str(i < 0).lower()}">{escape(title)}</button>'
        for i, title in enumerate(["side by side", *titles], start=-1)
    )
    return f'<span class="panels" role="group" aria-label="Show">{buttons}</span>'


@cache
def _viewer() -> str:
    """Return the script of the viewer that trame-vtk carries for pages that stand alone, its downloads taken out."""
    from trame_vtk.tools.vtksz2html import HTML_VIEWER_PATH  # type: ignore[import-untyped]

    viewer = _VIEWER.search(HTML_VIEWER_PATH.read_text(encoding="utf-8"))
    if viewer is None:
        raise RuntimeError("the viewer of trame-vtk has changed its form; install the version that the lock file names")
    return re.sub(r"https://kitware\.github\.io/[^`\"']*favicon[^`\"']*", "data:,", viewer[1])  # icons are fetched


def _packed_scene(view: View) -> str:
    """Return the PyVista scene in the form that the viewer reads.

    These are the steps behind PyVista's `plotter.trame.export_html`, which would also start a web server and try to
    download a second viewer. Memory addresses become running numbers, so that the same view is the same page.
    """
    from trame_vtk.modules.vtk.serializers import (  # type: ignore[import-untyped]
        SynchronizationContext,
        extract_array_hash,
        initialize_serializers,
        serialize,
    )

    initialize_serializers()
    context = SynchronizationContext()
    context.set_ignore_last_dependencies(True)
    with _plotter(view) as plotter:
        scene = serialize(None, plotter.render_window, 1, context, 1)
        hashes = {
            entry["hash"]: entry | {"content": context.get_cached_data_array(entry["hash"], False)}
            for entry in extract_array_hash(scene)
        }
    numbers: dict[str, str] = {}
    address = re.compile(r'(?<=["{])[0-9a-f]{16}(?=["}-])')
    text = json.dumps({"hashes": hashes, "scene": scene})
    text = address.sub(lambda match: numbers.setdefault(match[0], f"{len(numbers) + 1:x}"), text)
    text = re.sub(r'"mtime": \d+', '"mtime": 1', text)
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        entry = zipfile.ZipInfo("index.json", date_time=(2000, 1, 1, 0, 0, 0))
        archive.writestr(entry, text, compress_type=zipfile.ZIP_DEFLATED, compresslevel=9)
    return base64.b64encode(packed.getvalue()).decode()


@contextlib.contextmanager
def _plotter(view: View) -> Iterator[Any]:
    """Yield a PyVista plotter that holds the scene; nothing is rendered, so neither a screen nor OpenGL is needed."""
    import pyvista as pv
    from vtkmodules.vtkCommonCore import vtkLogger

    verbosity, variable = vtkLogger.GetCurrentVerbosityCutoff(), "VTK_DEFAULT_OPENGL_WINDOW"
    wanted = os.environ.get(variable)
    os.environ[variable] = "vtkOSOpenGLRenderWindow"
    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_ERROR)
    plotter: Any = pv.Plotter(shape=(1, len(view.panels)), off_screen=True, border=False, lighting="light kit")
    try:
        everything = np.concatenate([mesh.vertices for panel in view.panels.values() for mesh in panel])
        step = 2.0 ** np.floor(np.log2(max(float(np.ptp(everything, axis=0).max()), 1e-6) / 8192))
        for column, panel in enumerate(view.panels.values()):
            plotter.subplot(0, column)
            plotter.set_background(PAPER)
            for mesh in panel:
                _add(plotter, mesh, step)
        plotter.link_views()
        plotter.camera_position = (view.camera.position, view.camera.focal_point, view.camera.up)
        plotter.camera.view_angle = VIEW_ANGLE
        yield plotter
    finally:
        plotter.close()
        vtkLogger.SetStderrVerbosity(verbosity)
        if wanted is None:
            os.environ.pop(variable, None)
        else:
            os.environ[variable] = wanted


def _add(plotter: Any, mesh: Mesh, step: float) -> None:
    """Add a mesh, its vertices rounded to multiples of `step` metres (a power of 2), which compress well."""
    import pyvista as pv

    vertices = (np.round(mesh.vertices / step) * step).astype(np.float32)
    n = len(vertices)
    if mesh.triangles is not None:
        data = pv.PolyData(vertices, faces=np.column_stack([np.full(len(mesh.triangles), 3), mesh.triangles]).ravel())
    elif mesh.lines is not None:
        data = pv.PolyData(vertices, lines=np.column_stack([np.full(len(mesh.lines), 2), mesh.lines]).ravel())
    else:
        data = pv.PolyData(vertices, verts=np.concatenate([[n], np.arange(n)]))
    options: dict[str, Any] = {"color": mesh.color}
    if not isinstance(mesh.color, str):
        data.point_data["color"] = mesh.color
        options = {"scalars": "color", "rgb": True}
    plotter.add_mesh(
        data,
        point_size=mesh.size,
        line_width=mesh.size,
        opacity=mesh.opacity,
        smooth_shading=mesh.triangles is not None,
        lighting=mesh.triangles is not None,
        ambient=0.5,
        diffuse=0.5,
        show_scalar_bar=False,
        **options,
    )


def _still(view: View) -> bytes:
    """Draw the panels as the camera sees them."""
    from matplotlib.figure import Figure

    n = len(view.panels)
    wide = _aspect(n)
    figure = Figure(figsize=(9, 0.9 + 9 / (n * wide)), facecolor=PAPER, layout="constrained")
    for ax, (title, meshes) in zip(figure.subplots(1, n, squeeze=False)[0], view.panels.items(), strict=True):
        ax.set(xlim=(-wide, wide), ylim=(-1, 1), aspect="equal")
        ax.set_title(title, color=INK, weight="bold", size=11, loc="center")
        ax.set_axis_off()
        for mesh in sorted(thinned(meshes, 8_000 // n), key=lambda mesh: not is_cloud(mesh)):
            _draw(ax, mesh, view.camera)
    keys: dict[str, Any] = {}
    for ax in figure.axes:
        handles, labels = ax.get_legend_handles_labels()
        keys |= dict(zip(labels, handles, strict=True))
    figure.legend(list(keys.values()), list(keys), loc="outside lower center", ncols=3, frameon=False, markerscale=4)
    return png(figure, dpi=150)


def _draw(ax: Axes, mesh: Mesh, camera: Camera) -> None:
    """Draw one mesh of the still picture: points far ones first, ellipsoids as shaded triangles, lines as they are."""
    from matplotlib.collections import LineCollection, PolyCollection

    flat = camera.project(mesh.vertices)
    color = mesh.color if isinstance(mesh.color, str) else mesh.color / 255
    if is_cloud(mesh):
        style: dict[str, Any] = {"c": color, "s": 2 * mesh.size, "alpha": mesh.opacity}
        ax.scatter(flat[:, 0], flat[:, 1], linewidths=0, label=mesh.label, **style)
    elif mesh.lines is not None:
        ax.add_collection(LineCollection(list(flat[mesh.lines]), colors=color, linewidths=1.2, label=mesh.label))
    elif mesh.triangles is not None:
        corners = flat[mesh.triangles]  # (T, 3, 2)
        (ux, uy), (vx, vy) = np.diff(corners, axis=1).transpose(1, 2, 0)
        across = ux * vy - uy * vx  # > 0 where the triangle faces the camera
        front = mesh.triangles[across > 0]
        shade = color if isinstance(color, str) else color[front[:, 0]]
        ax.add_collection(
            PolyCollection(list(flat[front]), facecolors=shade, linewidths=0, alpha=mesh.opacity, label=mesh.label)
        )
