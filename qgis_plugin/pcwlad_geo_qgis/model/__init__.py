"""What QGIS knows and the engine needs, and the other way round: layers, areas, settings. No widgets."""
