# SPDX-License-Identifier: Apache-2.0
"""Conclusions of sections 3.6 and 3.7 of [thesis] about extractors, each compared with our figures."""

from collections.abc import Callable, Sequence
from statistics import median

from uav_vslam.evaluation.study import TABLE, Row
from uav_vslam.studies.engine.pool import grouped
from uav_vslam.studies.features.compute import BANDS, ON_A_GRID, PLACES, SPACINGS, SWEEP_RATIOS, THRESHOLDS

TRENDS = "Trends of the thesis"
BEYOND = ("thermal", "near infrared")  # the thesis's infrared is thermal; near infrared is reflected light
COLOUR = ("PHOW (RGB)", "PHOW (HSV)", "PHOW (opponent)")
THESIS = ("ASIFT", "SURF", "SIFT", "DSIFT", *COLOUR)
SIMILAR = 1.5  # rates of two methods are "similar" within this factor
FAILS = 0.02  # largest share of the points that a method which fails across bands keeps after RANSAC
CHANCE = 10  # matches that a homography finds among wrong ones
FEW = 0.05  # the same for one that is "poor" within a band
NO_MATCHES = "too few images match"
Verdict = tuple[bool | None, str]
Trend = tuple[str, str, Callable[[Sequence[Row]], Verdict]]


def trend_rows(rows: Sequence[Row]) -> list[Row]:
    """Return a row per conclusion: its section, whether our figures agree, and the figures.

    Matches of a grid with itself, where the camera is static, are left out.
    """
    rows = [row for row in rows if not (row["camera"] == "still" and row["method"] in ON_A_GRID)]
    found: list[Row] = []
    for section, claim, check in _trends():
        agrees, figures = check(rows)
        verdict = "not tested" if agrees is None else "agrees" if agrees else "differs"
        labels = {TABLE: TRENDS, "method": claim, "condition": f"section {section}"}
        found.append({**labels, "verdict": verdict, "figures": figures})
    return found


def _trends() -> list[Trend]:
    return [
        ("3.6.2", "a higher threshold gives more matches, and more wrong ones", _threshold_matters),
        ("3.6.2", "RANSAC removes false matches", _ransac_cleans),
        ("3.6.3", "ASIFT finds the most matches", _first("matches", "ASIFT", most=True)),
        ("3.6.3", "ASIFT has the highest matching rates", _first("rate_1", "ASIFT", most=True)),
        ("3.6.3", "ASIFT takes the longest", _first("total_s", "ASIFT", most=True)),
        ("3.6.3", "SURF is the fastest", _first("total_s", "SURF", most=False)),
        ("3.6.3", "SURF's matching rates are similar to SIFT's", _surf_like_sift),
        ("3.6.4", "SURF gives fewer points and matches than ASIFT and SIFT", _surf_is_sparse),
        *[
            ("3.6.3", f"{band} images match at higher rates than visible ones", _infrared_matches(band))
            for band in BEYOND
        ],
        ("3.6.3", "dense SIFT is no faster than SIFT and matches fewer points", _dense_gains_nothing),
        ("3.6.3", "colour descriptors are poor: few matches are left after RANSAC", _colour_is_poor),
        ("3.6.3", "of the colour descriptors RGB is the best", _rgb_is_best),
        *[("3.6.3", f"matching visible with {band} images nearly fails", _bands_fail(band)) for band in BEYOND],
        ("3.6.4", "urban images give more points and matches than rural ones", lambda _: (None, "no urban set")),
        ("3.6.5", "matches grow fewer with the interval", _spacing_costs),
        ("3.6.5", "matches in descending order: ASIFT, SIFT, DSIFT, PHOW (RGB), SURF", _order),
        ("3.7", "RANSAC fails where most matches are wrong", _ransac_fails),
    ]


def _rows(rows: Sequence[Row], table: str, **wanted: object) -> list[Row]:
    return [row for row in rows if row[TABLE] == table and all(row[key] == value for key, value in wanted.items())]


def _by_method(rows: Sequence[Row], key: str) -> dict[str, float]:
    """Return each algorithm's median of a figure over its rows."""
    found: dict[str, list[float]] = {}
    for row in rows:
        value = row["extract_s"] + row["match_s"] if key == "total_s" else row[key]
        if value is not None and value == value:
            found.setdefault(row["method"], []).append(value)
    return {method: median(values) for method, values in found.items()}


def _listed(medians: dict[str, float]) -> str:
    ordered = sorted(medians.items(), key=lambda item: -item[1])
    return "median " + ", ".join(f"{method} {value:.3g}" for method, value in ordered)


def _first(key: str, method: str, *, most: bool) -> Callable[[Sequence[Row]], Verdict]:
    """Return a check that a method of the thesis has the largest, or the smallest, value of a figure."""

    def check(rows: Sequence[Row]) -> Verdict:
        medians = {name: value for name, value in _by_method(_rows(rows, PLACES), key).items() if name in THESIS}
        if method not in medians or len(medians) < 2:
            return None, "the algorithm was not run, or found no points"
        if not any(medians.values()):
            return None, NO_MATCHES
        best = (max if most else min)(medians, key=lambda name: medians[name])
        return best == method, _listed(medians)

    return check


def _threshold_matters(rows: Sequence[Row]) -> Verdict:
    low, high = (
        {(r["method"], r["condition"]): r for r in _rows(rows, THRESHOLDS, descriptor_ratio=SWEEP_RATIOS[k])}
        for k in (0, -1)
    )
    if not low:
        return None, "no ratios were compared"
    more = sum(high[key]["matches"] >= low[key]["matches"] for key in low)
    shares = [[_removed(row) for row in part.values() if row["matches"]] for part in (low, high)]
    if not all(shares):
        return None, NO_MATCHES
    worse = median(shares[1]) > median(shares[0])
    removed = f"RANSAC removes {median(shares[0]):.0%} and {median(shares[1]):.0%}"
    return more == len(low) and worse, f"more matches in {more} of {len(low)} pairs; {removed}"


def _removed(row: Row) -> float:
    return float(1.0 - row["matches_ransac"] / row["matches"])


def _ransac_cleans(rows: Sequence[Row]) -> Verdict:
    known = [
        row
        for row in [*_rows(rows, SPACINGS), *_rows(rows, THRESHOLDS)]
        if row["precision"] is not None and row["matches_ransac"] > 0 and row["precision"] < 1.0
    ]
    if not known:
        return None, "no truth"
    better = sum(row["precision_ransac"] > row["precision"] for row in known)
    before, after = (median(row[key] for row in known) for key in ("precision", "precision_ransac"))
    text = f"precision rises in {better} of {len(known)} pairs, median {before:.3f} to {after:.3f}"
    return better > 0.9 * len(known), text


def _surf_like_sift(rows: Sequence[Row]) -> Verdict:
    rates = _by_method(_rows(rows, PLACES), "rate_1")
    if not {"SURF", "SIFT"} <= set(rates):
        return None, "the algorithms were not run, or found no points"
    if not rates["SIFT"]:
        return None, NO_MATCHES
    quotient = rates["SURF"] / rates["SIFT"]
    return 1 / SIMILAR < quotient < SIMILAR, f"median rate SURF {rates['SURF']:.3f}, SIFT {rates['SIFT']:.3f}"


def _surf_is_sparse(rows: Sequence[Row]) -> Verdict:
    points, matches = (_by_method(_rows(rows, PLACES), key) for key in ("keypoints_1", "matches"))
    if not {"SURF", "SIFT", "ASIFT"} <= set(points):
        return None, "the algorithms were not run"
    fewer = all(part["SURF"] < part[other] for part in (points, matches) for other in ("ASIFT", "SIFT"))
    return fewer, ", ".join(f"{m} {points[m]:.0f} points, {matches[m]:.0f} matches" for m in ("SURF", "SIFT", "ASIFT"))


def _infrared_matches(band: str) -> Callable[[Sequence[Row]], Verdict]:
    """Return a check of the rates in a band against those in the visible one, by set and algorithm."""

    def check(rows: Sequence[Row]) -> Verdict:
        rates = {(row["method"], row["condition"].rsplit(" ", 3)[0]): row["rate_1"] for row in _rows(rows, BANDS)}
        pairs = [
            (rates[method, images.removesuffix(band) + "visible"], rate)
            for (method, images), rate in rates.items()
            if images.endswith(f" {band}") and "/" not in images
        ]
        quotients = [rate / visible for visible, rate in pairs if visible > 0]
        if not quotients:
            return None, "no such band"
        higher = sum(quotient > 1.0 for quotient in quotients)
        text = f"higher for {higher} of {len(quotients)} algorithms and sets, median {median(quotients):.2f} times"
        return higher > len(quotients) / 2, text

    return check


def _dense_gains_nothing(rows: Sequence[Row]) -> Verdict:
    seconds, matches = (_by_method(_rows(rows, PLACES), key) for key in ("total_s", "matches"))
    if not {"DSIFT", "SIFT"} <= set(seconds):
        return None, "the algorithms were not run"
    text = (
        f"DSIFT {seconds['DSIFT']:.2f} s, {matches['DSIFT']:.0f} matches; "
        f"SIFT {seconds['SIFT']:.2f} s, {matches['SIFT']:.0f} matches"
    )
    return seconds["DSIFT"] >= seconds["SIFT"] and matches["DSIFT"] < matches["SIFT"], text


def _colour_is_poor(rows: Sequence[Row]) -> Verdict:
    rates = {m: r for m, r in _by_method(_rows(rows, PLACES), "rate_1_ransac").items() if m in COLOUR}
    return (max(rates.values()) < FEW, f"rate after RANSAC, {_listed(rates)}") if rates else (None, "not run")


def _rgb_is_best(rows: Sequence[Row]) -> Verdict:
    matches = {m: r for m, r in _by_method(_rows(rows, PLACES), "matches_ransac").items() if m in COLOUR}
    if len(matches) < len(COLOUR):
        return None, "the algorithms were not run"
    best = all(matches[COLOUR[0]] > matches[other] for other in COLOUR[1:])
    return best, f"matches after RANSAC, {_listed(matches)}"


def _bands_fail(band: str) -> Callable[[Sequence[Row]], Verdict]:
    """Return a check that no algorithm matches visible images with those of a band."""

    def check(rows: Sequence[Row]) -> Verdict:
        names = f" visible / {band} ", f" {band} / visible "
        across = [row for row in _rows(rows, BANDS) if any(name in row["condition"] for name in names)]
        cross = [row for row in across if row["method"] in THESIS]
        if not cross:
            return None, "no such band"
        rates, matches = (_by_method(cross, key) for key in ("rate_1_ransac", "matches_ransac"))
        works = [method for method in rates if rates[method] > FAILS and matches[method] > CHANCE]
        return not works, f"matches after RANSAC, {_listed(matches)}; rates, {_listed(rates)}"

    return check


def _spacing_costs(rows: Sequence[Row]) -> Verdict:
    curves = grouped(_rows(rows, SPACINGS), lambda row: (row["method"], row["condition"].rsplit(" ", 3)[0]))
    ends = [(curve[0]["matches"], curve[-1]["matches"]) for curve in curves.values() if len(curve) > 1]
    if not ends:
        return None, "no sequence"
    shares = [last / first for first, last in ends if first]
    if not shares:
        return None, NO_MATCHES
    fewer, kept = sum(last < first for first, last in ends), median(shares)
    return fewer > 0.75 * len(ends), (
        f"fewer at the largest interval in {fewer} of {len(ends)} sequences, median {kept:.2f} of those at the first"
    )


def _order(rows: Sequence[Row]) -> Verdict:
    expected = ["ASIFT", "SIFT", "DSIFT", "PHOW (RGB)", "SURF"]
    medians = _by_method(_rows(rows, SPACINGS), "matches")
    if not set(expected) <= set(medians):
        return None, "the algorithms were not run"
    if not any(medians.values()):
        return None, NO_MATCHES
    found = sorted(expected, key=lambda method: -medians[method])
    return found == expected, _listed({method: medians[method] for method in found})


def _ransac_fails(rows: Sequence[Row]) -> Verdict:
    known = [row for row in rows if row[TABLE] in (BANDS, SPACINGS) and row["precision"] is not None]
    mostly_wrong = [row for row in known if row["precision"] < 0.1 and row["matches"] >= 10]
    if not mostly_wrong:
        return None, "no pair of ten matches or more is nine tenths wrong"
    failed = [row for row in mostly_wrong if not row["matches_ransac"] or row["precision_ransac"] < 0.5]
    of = f"{len(failed)} of {len(mostly_wrong)} pairs with nine tenths of the matches wrong"
    return len(failed) > len(mostly_wrong) / 2, f"RANSAC keeps none, or mostly wrong ones, in {of}"
