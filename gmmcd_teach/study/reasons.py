"""One sentence for each row of the ledger: what our number owes to what, from the same tables (appendix C)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pandas as pd

from gmmcd_teach.study.claims import Claim
from gmmcd_teach.study.explain import CHANGES
from gmmcd_teach.study.intervals import Interval
from gmmcd_teach.study.runtime import PUBLISHED_RUNTIME, growth
from gmmcd_teach.study.tables import FORWARD, PUBLISHED_METRICS, Tables, appeared, at, scan_means


def reason(claim: Claim, ours: Interval, tables: Tables) -> str:
    """Why our number is what it is, in one sentence.

    Parameters
    ----------
    claim, ours : the claim, and what we measured.
    tables : see `ledger`.

    Examples
    --------
    >>> from gmmcd_teach.study.claims import CLAIMS
    >>> claim = next(claim for claim in CLAIMS if claim.name == "merging")
    >>> reason(claim, Interval(0.1, 0.0, 0.2, 10), {})
    'Merging counts fragments of one thing once, and changes no claimed point.'
    """
    if claim.rule == "seconds":
        assert isinstance(claim.value, float)
        return (
            f"The paper's is {claim.value / max(ours.mean, 1e-9):,.0f} times ours: other computer, program and cloud."
        )
    if claim.rule == "value":
        return _metric(claim, ours, tables)
    return WHY[claim.name](tables)


def _metric(claim: Claim, ours: Interval, tables: Tables) -> str:
    metric, objects = claim.name.split("-")
    assert isinstance(claim.value, float)
    gap = ours.mean - claim.value
    scenes = ("cargo_bag", "astrobee") if objects == "one" else (f"{objects}_objects",)
    rows = explained(tables, scenes)
    means, seeds = rows.groupby("change")[metric].mean(), rows["seed"].unique()
    here = at(tables["metrics"], "component", objects=objects, **FORWARD)
    every = scan_means(here, ["objects"], [metric])
    same = every.loc[every["seed"].isin(seeds), metric]
    return (
        f"{abs(gap):.2f} {'above' if gap > 0 else 'below'} the paper. On {len(same)} of {len(every)} scans, "
        f"{same.mean():.2f} here; one new start on each, voxels of {100 * rows['leaf_size'].iloc[0]:.0f} cm: "
        f"{means['as it is']:.2f} as it is, {means['no shadows']:.2f} without shadows, {means['one fit']:.2f} with one "
        "scan and one fit."
    )


def explained(tables: Tables, scenes: tuple[str, ...], level: str = "component") -> pd.DataFrame:
    """Rows of these scenes with each change of `CHANGES` that was made, all on the same scans."""
    rows = at(tables["explained"], level)
    return rows[rows["scene"].isin(scenes)]


def _work(tables: Tables) -> str:
    times = tables["times"].set_index("max_components")
    times = times.loc[[times.index.min(), times.index.max()], ["n_steps", "updates"]]
    ratio = times.iloc[1] / times.iloc[0]
    theirs = growth(PUBLISHED_RUNTIME.index, PUBLISHED_RUNTIME["em"])
    return (f"From K = {times.index[0]} to {times.index[1]}, {ratio.n_steps:.1f} times as many M-steps of more "
            f"components each: {ratio.updates:.1f} times the updates. The paper's own {theirs.n} EM times "
            f"give b = {theirs}, which would not pass this rule either.")  # fmt: skip


def _em(tables: Tables) -> str:
    return f"The rest together takes {(1 - tables['times']['em'] / tables['times']['total']).max():.1%} at most."


def _winner(metric: str) -> Callable[[Tables], str]:
    def why(tables: Tables) -> str:
        means = {name: appeared(tables, metric, name).mean() for name in PUBLISHED_METRICS.columns}
        return "Ours: " + ", ".join(f"{name} {mean:.2f}" for name, mean in means.items()) + "."

    return why


def _edges(tables: Tables) -> str:
    rows = at(tables["frames"])
    shares = rows["edge_false"].mean(), rows["edge_all"].mean()
    return f"{shares[0]:.0%} of the false points lie within 20 cm of the outline, and {shares[1]:.0%} of all unchanged."


def _found(scene: str) -> Callable[[Tables], str]:
    def why(tables: Tables) -> str:
        rows = at(tables["metrics"], scene=scene, **FORWARD)
        names = sorted({name for cell in (*rows["found"], *rows["missed"]) for name in cell.split(", ") if name})
        parts = (f"{name} in {rows['found'].str.contains(name).sum()}" for name in names)
        return (
            f"Of {len(rows)} scans, found: {', '.join(parts)}; {rows['claimed'].mean():.0%} of the points are claimed."
        )

    return why


def _frames(tables: Tables) -> str:
    rows = at(tables["frames"])
    found = rows[rows["missed"] == ""].groupby("scene").size()
    runs = rows.groupby("scene").size()
    parts = (f"{scene.replace('_', ' ')} in {found.get(scene, 0)} of {runs[scene]}" for scene in runs.index)
    return f"Found: {', '.join(parts)}."


def _clean(tables: Tables) -> str:
    every = at(tables["frames"], "object")["fp"]
    rows = explained(tables, ("cargo_bag", "astrobee"), "object")
    means, n = rows.groupby("change")["fp"].mean(), (rows["change"] == CHANGES[0]).sum()
    return (
        f"{every.mean():.1f} false regions a scan, none in {(every == 0).sum()} of {len(every)}; on {n} of the scans "
        f"{means['as it is']:.1f} as it is, {means['no shadows']:.1f} without shadows."
    )


def _stars(tables: Tables) -> str:
    rows = at(tables["frames"])
    all_k = np.array([*rows["n_before"], *rows["n_after"]])
    share = ((all_k >= 20) & (all_k <= 23)).mean()
    return (
        f"Of {len(all_k)} fits, two for each pair of scans, {share:.0%} end there; all of them at {all_k.min()} to "
        f"{all_k.max()}."
    )


def _ks(column: str, words: str) -> Callable[[Tables], str]:
    def why(tables: Tables) -> str:
        means = at(tables["sweep"]).groupby("max_components")[column].mean()
        return f"{words}: " + ", ".join(f"{value:.2f} (K = {k})" for k, value in means.items()) + "."

    return why


def _melts(tables: Tables) -> str:
    rows = at(tables["sweep"])
    missed = rows.assign(missed=rows["missed"] != "").groupby("max_components")["missed"].mean()
    return "Missed: " + ", ".join(f"{share:.0%} (K = {k})" for k, share in missed.items()) + "."


def _beside_plain(tables: Tables, name: str) -> str:
    """F1 on points of each scene, as it is and in another table."""
    plain, other = (at(table).groupby("scene")["f1"].mean() for table in (tables["frames"], tables[name]))
    return ", ".join(f"{scene.replace('_', ' ')} {plain[scene]:.2f} to {other[scene]:.2f}" for scene in plain.index)


def _pca(tables: Tables) -> str:
    cells = _beside_plain(tables, "plane")
    return f"In a frame PCA drops the direction of view, along which objects stand out: F1 {cells}."


def _filter(tables: Tables) -> str:
    cells = _beside_plain(tables, "cleaned")
    return f"F1 without and with the filter: {cells}; what misleads the method are not outliers."


def _voxels(tables: Tables) -> str:
    means = at(tables["leaves"]).groupby("leaf_size")[["f1", "cpu"]].mean()
    rows = zip(means.index, means["f1"], means["cpu"], strict=True)
    return "F1: " + ", ".join(f"{f1:.2f} in {cpu:.2f} s ({100 * leaf:.0f} cm)" for leaf, f1, cpu in rows) + "."


def _pca_time(tables: Tables) -> str:
    means = [at(tables[name])["cpu"].mean() for name in ("frames", "plane")]
    return (
        f"{means[0]:.2f} s without and {means[1]:.2f} s with PCA: more M-steps; chapter 12 tries the rule that ends EM."
    )


def _mixed(tables: Tables) -> str:
    means = at(tables["mixed"], order="forward").groupby("direction")["f1"].mean()
    return f"Appeared {means['appeared']:.2f}, disappeared {means['disappeared']:.2f}, asked for together."


WHY: dict[str, Callable[[Tables], str]] = {
    "em-dominates": _em,
    "linear-in-k": _work,
    "recall-best-one": _winner("recall"),
    "precision-best-three": _winner("precision"),
    "f1-best-three": _winner("f1"),
    "f1-one-over-two": _winner("f1"),
    "disappearances-similar": lambda tables: (
        "From the same two fits they are equal by construction; ours are new fits, from other starts."
    ),
    "k-star": _stars,
    "frame-found": _frames,
    "frame-clean": _clean,
    "map-two-found": _found("two_objects"),
    "map-three-found": _found("three_objects"),
    "docked-missed": _found("three_objects"),
    "k10-missed": _melts,
    "area-shrinks": _ks("claimed", "Share claimed"),
    "k50-fragments": _ks("n_true", "Components of the bag"),
    "k25-best": _ks("f1", "F1"),
    "pca-keeps": _pca,
    "pca-saves": _pca_time,
    "edges": _edges,
    "tradeoff": _ks("cpu", "Seconds"),
    "downsampling": _voxels,
    "filtering": _filter,
    "mixed": _mixed,
    "merging": lambda tables: "Merging counts fragments of one thing once, and changes no claimed point.",
}
"""Name of a claim -> its sentence; metrics and seconds have one of their own kind."""
