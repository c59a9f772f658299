"""From tie points to corrections: models, fits, model choice, check points, accuracy; arrays only."""

from __future__ import annotations

from typing import Literal

Effort = Literal["quick", "full"]
