"""What options name of the matching, without arrays."""

from __future__ import annotations

from typing import Final, Literal

Method = Literal["oriented", "gradient", "pcwlad", "pclad", "pclsm", "coarse"]
Keypoints = Literal["cells", "strongest"]
Consensus = Literal["auto", "off"]
AUTO_FEATURES: Final = 1000
"""Largest number of candidates of a tile, unless it is given."""
