"""Run the notebooks before Sphinx reads them: two at a time, each in an empty folder with no network, and measured.

MyST-NB would run them one after the other. Here they run in a pool first, a chapter that uses both cores by itself
alone, and `source-read` hands Sphinx the notebook with its outputs. Outputs are kept in `_build/.executed` under a key
made of the notebook's code cells, the package, the lock file, the Python version and whether the real scans are at
hand; when one of these changes, it runs again.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor, as_completed
from itertools import chain
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import nbformat
import psutil
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError, CellTimeoutError, DeadKernelError
from sphinx.application import Sphinx
from sphinx.config import Config
from sphinx.environment import BuildEnvironment
from sphinx.errors import ExtensionError
from sphinx.util import logging
from srcroot import ROOT, chapters_wanted

logger = logging.getLogger(__name__)
WORKERS = 2
ALONE = ("09", "10")  # keep two cores busy by themselves: they scan the maps that others read
FIRST = ("11", "12", "17", "C")  # the ledger (C) reads what 10 to 12 have kept; late chapters run longest
OFFLINE = Path(__file__).with_name("offline")
RUNS_IN = re.compile(r"(\*\*It runs\*\* in under [\w ]+?)\.(?=\n|$)")
COST_PAGES = ("book/intro",)  # pages that quote the chapters' measured times


def notebook_path(docname: str) -> Path:
    return ROOT / f"{docname}.ipynb"


def fingerprint(notebook: nbformat.NotebookNode) -> str:
    """Everything that the outputs depend on, in 16 characters."""
    scans = Path(os.environ.get("GMMCD_TEACH_DATA", ROOT.parent / "shared" / "real"))
    digest = hashlib.sha256(f"{sys.version} {scans.is_dir()}".encode())
    package = sorted((ROOT / "gmmcd_teach").rglob("*.py"))
    for path in [ROOT / "requirements.lock", ROOT / "pyproject.toml", *package, Path(__file__)]:
        digest.update(path.read_bytes())
    for cell in notebook.cells:
        if cell.cell_type == "code":
            digest.update(json.dumps([cell.source, cell.metadata.get("tags")]).encode())
    return digest.hexdigest()[:16]


class Meter(threading.Thread):
    """Samples memory and computing time of a kernel and its children until `stop` is set."""

    def __init__(self, client: NotebookClient) -> None:
        super().__init__(daemon=True)
        self.client, self.stop = client, threading.Event()
        self.peak, self.computing = 0, 0.0  # bytes, seconds

    def run(self) -> None:
        while not self.stop.wait(0.2):
            provisioner = getattr(self.client.km, "provisioner", None)
            pid = getattr(provisioner, "pid", None)
            if pid is None:
                continue
            try:
                kernel = psutil.Process(pid)
                family = [kernel, *kernel.children(recursive=True)]
                self.peak = max(self.peak, sum(process.memory_info().rss for process in family))
                self.computing = max(self.computing, sum(sum(process.cpu_times()[:4]) for process in family))
            except psutil.NoSuchProcess:  # a child that ended between the two calls
                continue


def run_notebook(path: Path, timeout: int, python_path: str = "") -> dict[str, Any]:
    """Execute one notebook in an empty folder, cut off from the network; return its outputs and what it cost.

    A folder `python_path` comes before all others when modules are looked for.
    """
    notebook = nbformat.read(path, as_version=4)
    found_in = os.pathsep.join(filter(None, (str(OFFLINE), python_path, os.environ.get("PYTHONPATH"))))
    environment = os.environ | {"TQDM_DISABLE": "1", "PYTHONHASHSEED": "0", "PYTHONPATH": found_in}
    for library in ("OMP", "OPENBLAS", "MKL"):  # one core for each of the two kernels
        environment.setdefault(f"{library}_NUM_THREADS", "1")
    if (scans := ROOT.parent / "shared" / "real").is_dir():
        environment.setdefault("GMMCD_TEACH_DATA", str(scans))
    with TemporaryDirectory(ignore_cleanup_errors=True) as empty:
        client = NotebookClient(
            notebook,
            timeout=timeout,
            kernel_name="python3",
            resources={"metadata": {"path": empty}},
            extra_arguments=["--IPKernelApp.log_level=40"],  # errors only
        )
        meter = Meter(client)
        meter.start()
        start = time.perf_counter()
        try:
            client.execute(env=environment)
        finally:
            meter.stop.set()
        seconds = time.perf_counter() - start
    outputs = [cell.outputs for cell in notebook.cells if cell.cell_type == "code"]
    cost = {"seconds": seconds, "computing": meter.computing, "megabytes": meter.peak / 1e6}
    return {"outputs": outputs, **cost}


def stored(app: Sphinx, docname: str) -> Path:
    """Where the outputs of the notebook, as it and the package are now, are kept."""
    key = fingerprint(nbformat.read(notebook_path(docname), as_version=4))
    return Path(app.outdir).parent / ".executed" / f"{Path(docname).name}-{key}.json"


def take_over(app: Sphinx, config: Config) -> None:
    """`execute_notebooks: force` is carried out here, not by MyST-NB."""
    app.runs_notebooks = config.nb_execution_mode == "force"  # type: ignore[attr-defined]
    if app.runs_notebooks:  # type: ignore[attr-defined]
        config.nb_execution_mode = "off"  # type: ignore[attr-defined]


def is_run(app: Sphinx, docname: str) -> bool:
    wanted = chapters_wanted()
    named = not wanted or any(Path(docname).name.startswith(number) for number in wanted)
    return app.runs_notebooks and notebook_path(docname).is_file() and named  # type: ignore[attr-defined]


def outdated(app: Sphinx, env: BuildEnvironment, added: set[str], changed: set[str], removed: set[str]) -> set[str]:
    """Notebooks that Sphinx thinks unchanged, but whose package, lock or scans have changed."""
    shown = getattr(env, "notebook_outputs", {})
    return {doc for doc in env.found_docs if is_run(app, doc) and shown.get(doc) != stored(app, doc).name}


def number_of(docname: str) -> str:
    return Path(docname).name.split("_")[0]


def place_in_line(docname: str) -> tuple[int, str]:
    """Those of FIRST in their order, then the later before the earlier; for `sorted`, from the last to the first."""
    number = number_of(docname)
    return -FIRST.index(number) if number in FIRST else -len(FIRST), docname


def run_in_pool(docnames: list[str], workers: int, timeout: int) -> Iterator[tuple[str, Future[dict[str, Any]]]]:
    with ThreadPoolExecutor(workers) as pool:
        running = {pool.submit(run_notebook, notebook_path(doc), timeout): doc for doc in docnames}
        for done in as_completed(running):
            yield running[done], done


def run_outdated(app: Sphinx, env: BuildEnvironment, docnames: list[str]) -> None:
    notebooks = [doc for doc in docnames if is_run(app, doc)]
    targets = {doc: stored(app, doc) for doc in notebooks}
    order = sorted(notebooks, key=place_in_line, reverse=True)
    missing = [doc for doc in order if not targets[doc].is_file()]
    failures = []
    alone = sorted(doc for doc in missing if number_of(doc) in ALONE)
    timeout, beside = app.config.nb_execution_timeout, [doc for doc in missing if doc not in alone]
    for docname, done in chain(run_in_pool(alone, 1, timeout), run_in_pool(beside, WORKERS, timeout)):
        target = targets[docname]
        try:
            result = done.result()
        except (CellExecutionError, CellTimeoutError, DeadKernelError) as error:
            failures.append(docname)
            logger.error("%s failed\n%s", docname, error)
            continue
        target.parent.mkdir(parents=True, exist_ok=True)
        for old in target.parent.glob(f"{Path(docname).name}-*.json"):
            old.unlink()
        target.write_text(json.dumps(result), encoding="utf8")
        logger.info("ran %s: %.1f s, %.0f MB", docname, result["seconds"], result["megabytes"])
    if failures:
        raise ExtensionError(f"notebooks failed: {', '.join(sorted(failures))}")
    shown = env.notebook_outputs = getattr(env, "notebook_outputs", {})  # type: ignore[attr-defined]
    costs = env.notebook_costs = getattr(env, "notebook_costs", {})  # type: ignore[attr-defined]
    for doc, target in targets.items():
        result = json.loads(target.read_text(encoding="utf8"))
        shown[doc], costs[doc] = target.name, (result["seconds"], result["megabytes"])
    if notebooks:
        docnames.extend(page for page in COST_PAGES if page in env.found_docs and page not in docnames)


def put_outputs(app: Sphinx, docname: str, source: list[str]) -> None:
    """Give Sphinx the notebook with its outputs, and the measured cost after the promise "It runs in under ..."."""
    if not is_run(app, docname):
        return
    name = app.env.notebook_outputs[docname]  # type: ignore[attr-defined]
    result = json.loads((Path(app.outdir).parent / ".executed" / name).read_text(encoding="utf8"))
    notebook = nbformat.reads(source[0], as_version=4)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    for cell, outputs in zip(code, result["outputs"], strict=True):
        cell.outputs = [nbformat.from_dict(output) for output in outputs]
    measured = f"{result['seconds']:.0f} s and {result['megabytes']:.0f} MB when this page was built"
    first = notebook.cells[0]
    first.source = RUNS_IN.sub(rf"\1 ({measured}).", first.source)
    source[0] = nbformat.writes(notebook)


def setup(app: Sphinx) -> dict[str, Any]:
    app.connect("config-inited", take_over)
    app.connect("env-get-outdated", outdated)
    app.connect("env-before-read-docs", run_outdated)
    app.connect("source-read", put_outputs)
    return {"version": "1", "env_version": 1, "parallel_read_safe": True, "parallel_write_safe": True}
