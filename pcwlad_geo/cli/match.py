"""``pcwlad-geo match``: tie points only."""

from __future__ import annotations

import typer

from pcwlad_geo.cli import options as o
from pcwlad_geo.cli.job import run_job


def match(
    context: typer.Context,
    reference: o.Reference,
    target: o.Target,
    out_dir: o.OutDir = None,
    ref_band: o.RefBand = None,
    tgt_band: o.TgtBand = None,
    ref_mask: o.RefMask = None,
    tgt_mask: o.TgtMask = None,
    dem: o.Dem = None,
    dem_vertical: o.DemVertical = None,
    trust_rpc: o.TrustRpc = None,
    method: o.Method = None,
    points: o.Points = None,
    features: o.Features = None,
    keypoints: o.Keypoints = None,
    template: o.Template = None,
    window: o.Window = None,
    search_radius: o.SearchRadius = None,
    ssim_min: o.SsimMin = None,
    iterations: o.Iterations = None,
    consensus: o.Consensus = None,
    prealign: o.Prealign = None,
    pdf: o.Pdf = None,
    require: o.Require = None,
    jobs: o.Jobs = None,
    scheduler: o.Scheduler = None,
    allow_remote: o.AllowRemote = None,
    trust_vrt: o.TrustVrt = None,
    progress: o.ProgressOption = "auto",
    watch_stdin: o.WatchStdin = False,
    config: o.Config = None,
    overwrite: o.Overwrite = False,
    output_tiepoints: o.OutputTiepoints = None,
    output_report: o.OutputReport = None,
    output_points: o.OutputPoints = None,
    debug: o.Debug = False,
) -> None:
    """Match TARGET to REFERENCE: tie points and report, no correction."""
    run_job("match", context.params)
