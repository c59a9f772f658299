"""The tiles of a larger scene on a dask cluster: the same tie points as in one process, to the last bit."""

import tempfile

import numpy as np
from distributed import Client, LocalCluster
from scene import ORANGE, panels, read, save, show, write_band

import pcwlad_geo

if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        red = write_band(f"{folder}/red.tif", side=600)
        thermal = write_band(f"{folder}/thermal.tif", "thermal", side=600, shift_px=(1.4, -0.8))
        alone = pcwlad_geo.match(red, thermal, tile_size=256, jobs=1)
        cluster = LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0")
        with cluster, Client(cluster) as client:
            workers = client.get_executor()
            shared = pcwlad_geo.match(red, thermal, tile_size=256, executor=workers)
        image = read(red)
    single, clustered = (points.select("matched") for points in (alone, shared))
    apart = np.abs(single.target_px - clustered.target_px).max()
    titles = [f"one process: {len(single)} tie points", f"two dask workers: {len(clustered)} tie points"]
    figure, axes = panels(titles)
    for axis, points in zip(axes, (single, clustered), strict=True):
        show(axis, image)
        axis.plot(*points.reference_px.T, ".", ms=3, color=ORANGE)
    figure.supxlabel(f"largest difference of a coordinate: {apart:g} px", fontsize=9)
    save(figure, __file__)
