"""The engine as a process: finding, installing, running and asking it. Nothing here knows of QGIS."""
