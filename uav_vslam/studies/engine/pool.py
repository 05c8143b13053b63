# SPDX-License-Identifier: Apache-2.0
"""Many independent jobs over a few processes, and the figures pooled over them."""

from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.stats import bootstrap

from uav_vslam.processes import worker_pool

Array = NDArray[np.float64]
Job = TypeVar("Job")
Result = TypeVar("Result")
Item = TypeVar("Item")
Key = TypeVar("Key", bound=Hashable)

CONFIDENCE = 0.95  # of the intervals


def in_pool(
    work: Callable[[Job], Result], jobs: Sequence[Job], workers: int, on_done: Callable[[], None] = lambda: None
) -> Iterator[Result]:
    """Yield the results in the order of the jobs, so that no figure depends on which process is first.

    With one worker, the jobs run in this process.

    Args:
        work: a function of a module, so that it can be pickled.
        jobs: its arguments.
        workers: processes.
        on_done: called for each result.
    """
    for result in map(work, jobs) if workers == 1 else _in_processes(work, jobs, workers):
        on_done()
        yield result


def _in_processes(work: Callable[[Job], Result], jobs: Sequence[Job], workers: int) -> Iterator[Result]:
    with worker_pool(workers) as pool:
        # Not `pool.map`: after a failure it cancels jobs, which the pool's own thread then can't end.
        for future in [pool.submit(work, job) for job in jobs]:
            yield future.result()


def grouped(items: Iterable[Item], key: Callable[[Item], Key]) -> dict[Key, list[Item]]:
    """Return the items by their key; keys and items stay in their order."""
    groups: dict[Key, list[Item]] = {}
    for item in items:
        groups.setdefault(key(item), []).append(item)
    return groups


def rms(values: Sequence[float]) -> float | None:
    """Return the root mean square; None if there are none."""
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else None


def root_mean(squares: Array) -> float | None:
    """Return the root of the mean of squares; None if there are none."""
    return float(np.sqrt(squares.mean())) if len(squares) else None


def mean(values: Sequence[float]) -> float | None:
    """Return the mean; None if there are none."""
    return float(np.mean(values)) if len(values) else None


def median(values: Sequence[float]) -> float | None:
    """Return the median; None if there are none."""
    return float(np.median(values)) if len(values) else None


def ratio(a: float | None, b: float | None) -> float | None:
    """Return a / b; None where either is missing or b is 0."""
    return a / b if a is not None and b else None


def ratio_interval(own: Array, other: Array) -> dict[str, float]:
    """Return the bootstrap's interval of the root mean square of `other` over that of `own`: "ratio_low", "ratio_high".

    Args:
        own, other: (S,) mean squares of each seed.
    """
    return _interval("ratio", (own, other), lambda a, b, axis: np.sqrt(b.mean(axis=axis) / a.mean(axis=axis)))


def mean_interval(name: str, values: Array) -> dict[str, float]:
    """Return the bootstrap's interval of the mean of (S,) values, one of each seed: "<name>_low", "<name>_high"."""
    return _interval(name, (values,), np.mean)


def _interval(name: str, of_seeds: tuple[Array, ...], statistic: Callable[..., Array]) -> dict[str, float]:
    """Return the percentile interval over jointly resampled seeds; none from fewer than three seeds."""
    if len(of_seeds[0]) < 3 or not all(np.isfinite(values).all() for values in of_seeds):
        return {}
    found = bootstrap(
        of_seeds,
        statistic,
        paired=True,
        vectorized=True,
        method="percentile",
        confidence_level=CONFIDENCE,
        rng=np.random.default_rng(0),
    ).confidence_interval
    return {f"{name}_low": float(found.low), f"{name}_high": float(found.high)}
