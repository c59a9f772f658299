"""Draw the layers of a GeoPackage with their default styles: run by a Python that has QGIS.

Usage: draw_with_qgis.py GPKG FOLDER XMIN YMIN XMAX YMAX
"""

import json
import os
import sys

os.environ["QT_QPA_PLATFORM"] = "offscreen"

from qgis.core import (  # type: ignore[import-not-found]
    QgsApplication,
    QgsMapRendererSequentialJob,
    QgsMapSettings,
    QgsRectangle,
    QgsVectorLayer,
)
from qgis.PyQt.QtCore import QSize  # type: ignore[import-not-found]
from qgis.PyQt.QtGui import QColor  # type: ignore[import-not-found]

SIDE, DPI = 1800, 192


def main(path: str, folder: str, *frame: str) -> None:
    """Draw each layer into a PNG of its name, and print the kinds of their renderers."""
    application = QgsApplication([], False)
    application.initQgis()
    kinds = {}
    for name in ("tie_points", "displacements"):
        layer = QgsVectorLayer(f"{path}|layername={name}", name, "ogr")
        kinds[name] = type(layer.renderer()).__name__
        settings = QgsMapSettings()
        settings.setLayers([layer])
        settings.setBackgroundColor(QColor(255, 255, 255))
        settings.setOutputSize(QSize(SIDE, SIDE))
        settings.setOutputDpi(DPI)
        settings.setDestinationCrs(layer.crs())
        settings.setExtent(QgsRectangle(*map(float, frame)))
        job = QgsMapRendererSequentialJob(settings)
        job.start()
        job.waitForFinished()
        job.renderedImage().save(f"{folder}/{name}.png")
    print(json.dumps(kinds), flush=True)  # noqa: T201
    os._exit(0)  # QGIS without a window does not always end cleanly


if __name__ == "__main__":
    main(*sys.argv[1:])
