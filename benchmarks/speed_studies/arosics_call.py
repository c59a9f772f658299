"""Run AROSICS' COREG_LOCAL on two rasters: called with the Python of its own environment.

Usage::

    python arosics_call.py REFERENCE TARGET GRID_RES WINDOW MAX_SHIFT OUT.csv

Writes the tie points that it keeps, and prints what the library call cost as JSON.
"""

from __future__ import annotations

import json
import os
import resource
import sys
import time


def cpu_s() -> float:
    """Return the CPU time of this process and of the workers that have ended."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(usage.ru_utime + usage.ru_stime for usage in used)


def main() -> None:
    """Run the call."""
    reference, target, grid_res, window, max_shift, out = sys.argv[1:]
    import arosics

    begun, cpu_begun = time.perf_counter(), cpu_s()
    job = arosics.COREG_LOCAL(
        reference,
        target,
        grid_res=int(grid_res),
        window_size=(int(window), int(window)),
        max_shift=int(max_shift),
        CPUs=len(os.sched_getaffinity(0)),  # its default counts those that it may not use, too
        q=True,
        progress=False,
    )
    table = job.CoRegPoints_table
    wall_s, cpu = time.perf_counter() - begun, cpu_s() - cpu_begun
    matched = table[table["X_SHIFT_M"] != -9999]
    kept = matched[matched["OUTLIER"].astype(str) == "False"]
    kept[["X_MAP", "Y_MAP", "X_SHIFT_M", "Y_SHIFT_M"]].to_csv(out, index=False)
    figures = {"wall_s": wall_s, "cpu_s": cpu, "grid_points": len(table), "matched": len(matched)}
    print(json.dumps(figures | {"version": arosics.__version__}))


if __name__ == "__main__":
    main()
