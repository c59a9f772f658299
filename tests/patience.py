"""How long a test waits for what must come, so that a defect does not hang the suite."""

from typing import Final

PATIENCE_S: Final = 600
"""So long that no machine is too slow for it: whether a test passes must never depend on how fast one is."""
FOR_EVER_S: Final = 36_000
"""Sleep of what a test ends itself."""
